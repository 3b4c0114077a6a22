//! Forces from motion: contact forces that explain how a body moves, with their uncertainty.
//!
//! ```text
//! poses of a body ──> spline on SE(3) ──> wrench, covariance ──┐
//! hand, meshes, poses ──> contact patches, probabilities ──────┴──> forces in friction cones ──> intervals per link
//! ```
//!
//! The motion of a body fixes the sum of all forces on it, and their moment; it does not tell how hard a hand squeezes. That
//! part follows from a prior on how people grip, and its width is stated. Quantities are in one world frame, SI units.

pub mod body;
pub mod cone;
pub mod contacts;
pub mod demand;
mod draw;
pub mod estimate;
pub mod frame;
pub mod gravity;
pub mod hand_forces;
pub mod motion;
pub mod patch;
pub mod pose;
pub mod settings;
pub mod solve;
pub mod spline;
pub mod take;
pub mod validity;

pub use body::{DensityClass, Mass, RigidBody};
pub use demand::Demand;
pub use estimate::{Estimate, FrameEstimate, lagged, whole};
pub use hand_forces::{HandForces, LinkForce};
pub use motion::Motion;
pub use pose::{Pose, PoseNoise};
pub use settings::Settings;
pub use take::{Fixed, Take, Tracked};
pub use validity::ForceValidity;
