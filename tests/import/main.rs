//! Data sets of others become stores.
//!
//! Each test writes a simulated take in the layout of a data set, by writers that share no code with the readers, and imports
//! it: the store must hold the simulator's contact, stamps, poses and images.
#![cfg(feature = "sim")]

mod check;
#[path = "../common/mod.rs"]
mod common;
mod egotac_sc;
mod gloves;
mod hot3d;
mod raw_glove;
mod run;
mod sensors;
mod sets;
mod third;
mod videos;
#[allow(dead_code)] // The bench of imports uses all of it.
mod writers;
