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
//! | module | contents |
//! |---|---|
//! | [`error`], [`file`](mod@file), [`text`] | the one error type; atomic file writes; numbers for people |
//! | [`hand`] | MANO's parameters, vertices, joints, regions, vertex numbering; the built-in hand |
//! | [`camera`] | projection between points and pixels |
//! | [`tactile`] | force and contact on both hands, at one instant and over time; validity |
//! | [`image`](mod@image) | preparation of any image for the network |
//! | [`model`] | the network, its checkpoints, the streaming predictor |
//! | [`geometry`] | meshes, distances, solids, spread of forces over vertices |
//! | [`score`] | the paper's metrics, agreement of labels, gates |
//! | [`message`] | the ROS messages and their CDR bytes, without ROS |
//! | [`render`] | pictures of hands |
//! | [`dataset`] | Zarr stores, LeRobot data sets, MCAP bags, videos, tensor files |
//! | `mujoco`, `sim` | physics; scenes whose touch is known (feature `sim`) |
//! | `retarget` | hand pose and touch carried over to robot hands (feature `sim`) |
//! | [`train`] | training from stores to a checkpoint |
//! | [`label`] | the engine behind `egotac label` |
//! | [`report`] | an HTML page about labels |
//! | `node` | the ROS 2 nodes (feature `ros`) |
//! | [`cli`] | the commands |
//!
//! Features: `ros`, `sim` and `cuda`, none on by default.
//!
//! Units are SI: metres, newtons, seconds, radians. Cameras look along z, with x to the right and y down; vertex fields
//! hold the left hand first, 778 values each.
#![cfg_attr(docsrs, feature(doc_cfg))]

pub mod camera;
pub mod cli;
pub mod dataset;
pub mod error;
pub mod file;
pub mod geometry;
pub mod hand;
pub mod image;
pub mod label;
#[doc(hidden)]
pub mod machine;
pub mod message;
pub mod model;
#[cfg(feature = "sim")]
pub mod mujoco;
#[cfg(feature = "ros")]
pub mod node;
mod numpy;
pub mod render;
pub mod report;
#[cfg(feature = "sim")]
pub mod retarget;
pub mod score;
#[cfg(feature = "sim")]
pub mod sim;
#[doc(hidden)]
pub mod statistics;
pub mod tactile;
pub mod text;
pub mod train;

pub use error::{Error, Result};
pub use hand::Topology;
pub use tactile::{TactileField, Validity};

/// Version of this crate, for what the programs write.
#[doc(hidden)]
pub const VERSION: &str = env!("CARGO_PKG_VERSION");
