//! The `egotac` command: parse, dispatch, print the error once.

mod allocator;

use std::process::ExitCode;

fn main() -> ExitCode {
    allocator::install();
    egotac::cli::main()
}
