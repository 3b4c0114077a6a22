//! The node `trainer`.

use std::process::ExitCode;

use egotac::node::{self, trainer};

#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

fn main() -> ExitCode {
    node::main("Trains networks on stores and on live topics.", &trainer::parameters(), trainer::start)
}
