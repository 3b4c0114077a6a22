//! Touch from sight: dense force and contact on the 778 vertices of each hand, from egocentric RGB.
//!
//! ```
//! use egotac::model::{predictor::Options, shipped};
//! use egotac::{Predictor, Side};
//!
//! # fn main() -> egotac::Result<()> {
//! let mut predictor = Predictor::load(&shipped::path()?, Options::default())?;
//! let image = egotac::crates::image::RgbImage::new(640, 480); // an image of the camera
//! let prediction = predictor.push(&image, 0.0)?; // and its stamp, s
//! println!("{:.2} N on the right hand", prediction.field.total_force(Side::Right));
//! # Ok(())
//! # }
//! ```
//!
//! | to | start with |
//! |---|---|
//! | predict touch from images | [`Predictor`] |
//! | hold touch at one instant, over time | [`TactileField`], [`TactileSequence`] |
//! | score predictions | [`metrics::evaluate`] |
//! | pose a hand | [`HandModel`], [`HandParams`] |
//! | read stores, bags, LeRobot data sets, tensor files | [`dataset`] |
//! | carry a hand over to a robot (feature `sim`) | `Retargeter` |
//! | simulate hands whose touch is known (feature `sim`) | `Scene`, `Rollout` |
//!
//! Data flow one way: image -> [`model`] -> [`TactileField`] -> message, labels in a [`dataset`], [`metrics`]; the
//! simulation makes fields as well. Each module of this list uses only those above it. The modules without a link are
//! internal: they may change in any version, and `cargo doc --document-hidden-items` shows them.
//!
//! | module | contents |
//! |---|---|
//! | [`error`], `file`, `text`, `host` | the one error type; atomic file writes; numbers for people; places of shipped files |
//! | [`hand`] | MANO's parameters, vertices, joints, regions, vertex numbering; the built-in hand |
//! | [`camera`] | projection between points and pixels |
//! | [`tactile`] | force and contact on both hands, at one instant and over time; validity |
//! | [`image`](mod@image) | preparation of any image for the network |
//! | [`model`] | the network, its checkpoints, the streaming predictor |
//! | `geometry` | meshes, distances, solids, spread of forces over vertices |
//! | `physics` | contact forces from the motion of a body |
//! | `message` | the ROS messages and their CDR bytes, without ROS |
//! | `render` | pictures of hands |
//! | [`dataset`] | Zarr stores, LeRobot data sets, MCAP bags, videos, tensor files |
//! | `sensor` | gloves: where taxels lie on a hand, their readings on its vertices |
//! | [`score`] | the paper's metrics, agreement of labels, gates |
//! | `mujoco`, `sim` | physics; scenes whose touch is known (feature `sim`) |
//! | `retarget` | hand pose and touch carried over to robot hands (feature `sim`) |
//! | `train` | training from stores to a checkpoint |
//! | `label` | the engine behind `egotac label` |
//! | `import` | data sets of others, read into stores with labels from geometry |
//! | `report` | an HTML page about labels |
//! | `view` | a local page and videos that show images with their touch |
//! | `node` | the ROS 2 nodes (feature `ros`) |
//! | `cli` | the commands |
//!
//! Features, none on by default: `ros`, `sim`, `cuda`, `nccl`, `mpi` and `rerun`.
//!
//! Units are SI: metres, newtons, seconds, radians. Cameras look along z, with x to the right and y down; vertex fields
//! hold the left hand first, 778 values each.
#![cfg_attr(docsrs, feature(doc_cfg))]

pub mod camera;
#[doc(hidden)]
pub mod cli;
pub mod dataset;
pub mod error;
#[doc(hidden)]
pub mod file;
#[doc(hidden)]
pub mod geometry;
pub mod hand;
#[doc(hidden)]
pub mod host;
pub mod image;
#[doc(hidden)]
pub mod import;
#[doc(hidden)]
pub mod label;
#[doc(hidden)]
pub mod machine;
#[doc(hidden)]
pub mod message;
pub mod model;
#[cfg(feature = "sim")]
#[doc(hidden)]
pub mod mujoco;
#[cfg(feature = "ros")]
#[doc(hidden)]
pub mod node;
mod numpy;
#[doc(hidden)]
pub mod physics;
#[doc(hidden)]
pub mod render;
#[doc(hidden)]
pub mod report;
#[cfg(feature = "sim")]
pub mod retarget;
pub mod score;
#[doc(hidden)]
pub mod sensor;
#[cfg(feature = "sim")]
pub mod sim;
#[doc(hidden)]
pub mod statistics;
pub mod tactile;
#[doc(hidden)]
pub mod text;
#[doc(hidden)]
pub mod train;
#[cfg(feature = "sim")]
#[doc(hidden)]
pub mod trial;
#[doc(hidden)]
pub mod view;

pub use error::{Error, Result};
pub use hand::{HandModel, HandParams, Side, Topology};
pub use model::{Prediction, Predictor};
#[cfg(feature = "sim")]
pub use retarget::Retargeter;
pub use score::metrics;
#[cfg(feature = "sim")]
pub use sim::{Rollout, Scene};
pub use tactile::{TactileField, TactileSequence, Validity};

/// Crates whose types appear in this crate's signatures, in the versions that it uses.
pub mod crates {
    pub use candle_core;
    pub use glam;
    pub use image;
    pub use nalgebra;
}

/// Version of this crate, for what the programs write.
#[doc(hidden)]
pub const VERSION: &str = env!("CARGO_PKG_VERSION");
