//! The node `predictor`.

use std::process::ExitCode;

use egotac::node::{self, predictor};

fn main() -> ExitCode {
    node::main("Predicts touch on both hands from images.", &predictor::parameters(), predictor::start)
}
