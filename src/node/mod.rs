//! ROS 2 nodes: thin shells around the library. Each node decodes messages, calls the library, and encodes and publishes
//! the results.
//!
//! A node has three kinds of threads. The thread that calls a node's `run` owns the ROS node and spins: it takes
//! messages, answers services and does no slow work. One `worker_thread` per node computes and publishes; the
//! predictor's takes the newest image from a `mailbox`. Shutdown goes in the other direction: the flag is set, spinning
//! ends, the worker is joined, then the ROS node is dropped.

mod allowed_folder;
#[cfg(feature = "sim")]
mod approximate_sync;
pub(crate) mod bag_recorder;
mod clock;
mod create;
mod device;
mod diagnostics;
mod enabled;
mod episode_recorder;
mod exact_sync;
mod flatten;
pub mod glove;
mod hand_confidence;
mod images;
mod input_topics;
mod lifecycle;
mod lock;
mod log;
mod log_level;
mod mailbox;
#[cfg(feature = "sim")]
mod object_pose;
#[doc(hidden)]
pub mod own_domain;
mod parameter_files;
mod parameter_services;
mod params;
pub(crate) mod placed_hand;
mod point_cloud;
pub mod predictor;
mod program;
mod publisher;
mod qos;
mod qos_overrides;
mod rectify;
#[cfg(feature = "sim")]
pub mod retargeter;
mod ros_arguments;
mod runtime;
mod shutdown;
mod sim_time;
#[cfg(feature = "sim")]
pub mod simulator;
mod threads;
mod time_jump;
mod topic_names;
mod topic_statistics;
pub mod trainer;
#[cfg(feature = "sim")]
mod transforms;
pub mod verifier;
pub(crate) mod viewer;
mod worker_thread;
