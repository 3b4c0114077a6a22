//! Training.

#[path = "../common/mod.rs"]
mod common;

mod batch;
mod folder;
mod initial_weights;
mod presence;
mod proximity;
mod ranks;
mod recipes;
mod stores;
mod training;
