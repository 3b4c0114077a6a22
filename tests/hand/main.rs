//! The hand: shapes, poses, files, maps.

#[path = "../common/mod.rs"]
mod common;

mod builtin;
mod carry;
mod cli;
mod mano;
mod map;
mod sensor;
