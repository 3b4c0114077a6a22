//! Touch from sight: dense force and contact on the 778 vertices of each hand, from egocentric RGB.
#![cfg_attr(docsrs, feature(doc_cfg))]

pub mod cli;
pub mod dataset;
pub mod error;
pub mod file;
pub mod hand;
pub mod image;
pub mod label;
pub mod message;
pub mod metrics;
pub mod model;
#[cfg(feature = "sim")]
pub mod mujoco;
#[cfg(feature = "ros")]
pub mod node;
pub mod render;
#[cfg(feature = "sim")]
pub mod sim;
pub mod tactile;
pub mod train;

pub use error::{Error, Result};
pub use tactile::{TactileField, Topology, Validity};
