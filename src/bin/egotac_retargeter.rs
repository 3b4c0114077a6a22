//! The program `egotac_retargeter`.

use std::process::ExitCode;

fn main() -> ExitCode {
    egotac::node::retargeter::main()
}
