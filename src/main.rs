//! The `egotac` command: parse, dispatch, print the error once.

use std::process::ExitCode;

#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

fn main() -> ExitCode {
    egotac::cli::main()
}
