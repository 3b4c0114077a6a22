//! The program `egotac_trainer`.

#[path = "../allocator.rs"]
mod allocator;

use std::process::ExitCode;

fn main() -> ExitCode {
    allocator::install();
    egotac::node::trainer::main()
}
