//! Tactile gloves: where their taxels lie on a hand, and their readings on its vertices.
//!
//! ```text
//! layout (YAML: pads outlined on the hand) ──build──> TaxelMap (YAML + safetensors) ──> readings <──> vertices
//! ```
//!
//! | form | vertex values | weights |
//! |---|---|---|
//! | reading (the paper's) | interpolated value of the taxels around the vertex, N | sum to 1 per vertex |
//! | spread (ours) | share of the taxels' forces, N; sums to them | sum to 1 per taxel |
//!
//! Vertices without a taxel are unknown (NaN) in both.

mod build;
mod convert;
mod file;
mod layout;
mod map;
mod shares;
mod shipped;
pub mod simulated;
pub mod streams;

pub use convert::convert;
pub use layout::{KEYPOINT_NAMES, Layout, Pad, Placement};
pub use map::{HandTaxels, TaxelMap};
pub use shipped::{names as shipped_names, open, path as map_path};
pub use simulated::{GloveSpec, SimulatedGlove};
