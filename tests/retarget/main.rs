//! Retargeting to robot hands.
#![cfg(feature = "sim")]

#[path = "../common/mod.rs"]
mod common;
#[path = "../../crates/bench/src/retarget/trajectory.rs"]
#[allow(dead_code)] // used in part
mod trajectory;

mod cli;
mod follow;
mod hostile;
mod live;
mod object;
mod robots;
mod solver;
mod touch;
