//! The ROS 2 nodes, with rclpy peers.
#![cfg(feature = "ros")]

#[path = "../common/mod.rs"]
mod common;
mod harness;
#[cfg(feature = "sim")]
#[path = "../../crates/bench/src/retarget/trajectory.rs"]
#[allow(dead_code)] // used in part
mod trajectory;

mod cameras;
#[cfg(feature = "sim")]
mod docs;
mod glove;
mod hand_tracker;
#[cfg(feature = "sim")]
mod launch_files;
mod lifecycle;
mod observation;
mod parameter_files;
mod predictor;
#[cfg(feature = "sim")]
mod retargeter;
#[cfg(feature = "sim")]
mod simulator;
mod standard;
mod topic_statistics;
mod trainer;
mod verifier;
#[cfg(feature = "sim")]
#[path = "../view/client.rs"]
#[allow(dead_code)] // used in part
mod view_client;
#[cfg(feature = "sim")]
mod viewer;
mod views;
