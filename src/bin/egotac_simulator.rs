//! The node `simulator`.

use std::process::ExitCode;

use egotac::node::{self, simulator};

fn main() -> ExitCode {
    node::main(
        "Plays simulated scenes as a camera topic, with the truth beside it.",
        &simulator::parameters(),
        simulator::start,
    )
}
