//! The `egotac` command: parse, dispatch, print the error once.

use std::process::ExitCode;

fn main() -> ExitCode {
    egotac::cli::main()
}
