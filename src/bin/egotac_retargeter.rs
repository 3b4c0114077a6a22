//! The node `retargeter`.

use std::process::ExitCode;

use egotac::node::{self, retargeter};

fn main() -> ExitCode {
    node::main("Follows a hand and its touch with a robot hand.", &retargeter::parameters(), retargeter::start)
}
