//! The program `egotac-bench`, which `egotac bench` and `egotac experiment` run.

use std::process::ExitCode;

#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

fn main() -> ExitCode {
    egotac_bench::cli::main()
}
