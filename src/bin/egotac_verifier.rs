//! The program `egotac_verifier`.

use std::process::ExitCode;

fn main() -> ExitCode {
    egotac::node::verifier::main()
}
