//! The program `egotac-bench`, which `egotac bench` and `egotac experiment` run.

// That of egotac's own programs, so that the same is measured.
#[path = "../../../src/allocator.rs"]
mod allocator;

use std::process::ExitCode;

fn main() -> ExitCode {
    allocator::install();
    egotac_bench::cli::main()
}
