//! The program `egotac_simulator`.

use std::process::ExitCode;

fn main() -> ExitCode {
    egotac::node::simulator::main()
}
