//! The program `egotac_glove`.

use std::process::ExitCode;

fn main() -> ExitCode {
    egotac::node::glove::main()
}
