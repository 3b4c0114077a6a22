//! Scenes and rollouts.
#![cfg(feature = "sim")]

#[path = "../common/mod.rs"]
mod common;

mod budget;
mod crops;
mod effects;
mod environment;
mod hostile;
mod isolate;
mod looks;
mod present;
mod replay;
mod rollout;
mod scene_file;
mod scenes;
mod splits;
mod touchable;
