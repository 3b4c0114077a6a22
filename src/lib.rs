//! Touch from sight: dense force and contact on the 778 vertices of each hand, from egocentric RGB.
//!
//! ```
//! use egotac::hand::Side;
//! use egotac::model::predictor::{Options, Predictor};
//! use egotac::model::shipped;
//!
//! # fn main() -> egotac::Result<()> {
//! let mut predictor = Predictor::load(&shipped::path()?, Options::default())?;
//! let image = image::RgbImage::new(640, 480); // a frame of a camera
//! let prediction = predictor.push(&image, 0.0)?; // and its stamp, s
//! println!("{:.2} N on the right hand", prediction.field.total_force(Side::Right));
//! # Ok(())
//! # }
//! ```
//!
//! Data flow one way: image -> [`model`] -> [`TactileField`] -> [`message`], labels in a [`dataset`], [`metrics`]; the
//! simulation makes fields as well. From the top of this list downwards, each module uses only those above it:
//!
//! | module | what it knows |
//! |---|---|
//! | [`error`], [`file`](mod@file) | the one error type; files that are written whole |
//! | [`hand`] | MANO's parameters, vertices, joints, regions; the built-in hand |
//! | [`camera`] | from points to pixels and back |
//! | [`tactile`] | force and contact on both hands, what vertex indices mean, validity |
//! | [`image`](mod@image) | from any image to the network's input |
//! | [`model`] | the network, its checkpoints, the streaming predictor |
//! | [`metrics`] | the paper's scores |
//! | [`label`] | touch from geometry and from contact forces |
//! | [`message`] | the ROS messages and their CDR bytes, without ROS |
//! | [`render`] | pictures of hands |
//! | [`dataset`] | Zarr stores, bounded recordings, tensor files, MCAP bags |
//! | `mujoco`, `sim` | physics; scenes whose touch is known (feature `sim`) |
//! | `retarget` | the hand's pose and touch, carried over to robot hands (feature `sim`) |
//! | [`train`] | from stores to a checkpoint |
//! | [`annotate`] | labels for recordings, in their own formats |
//! | [`report`] | a page about labels |
//! | [`verify`] | labels and predictions against simulated truth |
//! | [`mod@bench`] | what accuracy costs, what breaks |
//! | [`experiment`] | several trainings, compared |
//! | `node` | the ROS 2 nodes (feature `ros`) |
//! | [`cli`] | the commands |
//!
//! Features: `ros`, `sim` and `cuda`, none on by default.
//!
//! Units are SI: metres, newtons, seconds, radians. Cameras look along z, with x to the right and y down; vertex fields
//! hold the left hand first, 778 values each.
#![cfg_attr(docsrs, feature(doc_cfg))]

pub mod annotate;
pub mod bench;
pub mod camera;
pub mod cli;
pub mod dataset;
pub mod error;
pub mod experiment;
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
pub mod report;
#[cfg(feature = "sim")]
pub mod retarget;
#[cfg(feature = "sim")]
pub mod sim;
pub mod tactile;
pub mod text;
pub mod train;
pub mod verify;

pub use error::{Error, Result};
pub use tactile::{TactileField, Topology, Validity};
