//! The node `trainer`.

use std::process::ExitCode;

use egotac::node::{self, trainer};

fn main() -> ExitCode {
    node::main("Trains networks on stores and on live topics.", &trainer::parameters(), trainer::start)
}
