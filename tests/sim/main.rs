//! Scenes and rollouts.
#![cfg(feature = "sim")]

mod budget;
mod effects;
mod hostile;
mod isolate;
mod rollout;
mod scene_file;
mod scenes;
mod touchable;
