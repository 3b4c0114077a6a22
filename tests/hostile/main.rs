//! Input made to do harm.

#[path = "../common/mod.rs"]
mod common;

mod pytorch_file;
mod recordings;
mod stores;
mod weights;
