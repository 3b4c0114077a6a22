//! The node `verifier`.

use std::process::ExitCode;

use egotac::node::{self, verifier};

fn main() -> ExitCode {
    node::main("Scores predictions against truth, live.", &verifier::parameters(), verifier::start)
}
