//! The program `egotac_predictor`.

use std::process::ExitCode;

fn main() -> ExitCode {
    egotac::node::predictor::main()
}
