//! The network, its checkpoints and the predictor.

#[path = "../common/mod.rs"]
mod common;

mod budget;
mod checkpoint;
mod cli;
mod engine;
mod familiarity;
mod focus;
mod get;
mod grow;
mod hands;
mod import;
mod ops;
mod parity;
mod predictor;
mod presence;
mod pretrained;
mod shipped;
mod stable;
mod window;
