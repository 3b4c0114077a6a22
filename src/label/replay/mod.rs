//! Replay of recorded stores: the engine's contact forces along recorded poses of hands and objects.
//!
//! ```text
//! poses of hands, objects ──> splines ──> positions, velocities, accelerations ──> inverse dynamics ──> contact forces
//! ```
//!
//! Hands and objects follow the recording, so nothing drifts, and no controller has to be tuned. The contact model turns depth
//! and sliding of the recorded poses into force, so a squeeze shows as depth: a second estimate beside forces from motion,
//! which do not see it. Depths of contacts are below a millimetre: noise of that size in poses drowns them.
//!
//! A store of the simulator is replayed in the world of its scene. A recording that was imported is replayed in a world of its
//! hands, the meshes of its objects, and the support that `label --physics` finds.

mod agreement;
mod angles;
mod courses;
mod forces;
mod recorded;
mod stage;

use std::path::Path;

use glam::DVec3;

pub use agreement::{Agreement, ReplayReport};
use courses::Courses;
use stage::Stage;

use super::physics::{self, BodyOptions};
use crate::dataset::EpisodeReader;
use crate::dataset::zarr::ZarrReader;
use crate::error::{Error, Result};
use crate::hand::{HandModel, N_JOINTS};
use crate::tactile::episode_ranges;

/// Forces of one replayed frame.
#[derive(Debug, Clone, PartialEq)]
pub struct ReplayFrame {
    /// Index of the frame in the store.
    pub frame: usize,
    /// Frames to the nearest frame whose poses are not all known, or to the end of the episode; splines have samples on one side
    /// only there.
    pub to_edge: usize,
    /// Normal force on each link of the left and the right hand, N; zero for a hand that is absent, NaN for one that is unknown.
    pub links: [[f64; N_JOINTS]; 2],
    /// Net force of all contacts on each object, world frame of the store, N; NaN for an object whose pose or shape is unknown. That of an
    /// articulated object stands in the row of its first part, and the rows of its other parts are NaN.
    pub net: Vec<DVec3>,
}

/// Forces of all replayed frames of a store.
#[derive(Debug, Clone, PartialEq)]
pub struct Replayed {
    /// Forces. Frames that stand alone between unknown poses have none.
    pub frames: Vec<ReplayFrame>,
    /// Mean rotation that the hinges of the replayed hand miss of a recorded joint, rad.
    pub missed_rotation: f64,
}

/// Computes the engine's contact forces along the poses of a store, frame by frame. `models`: left and right hand on the store's
/// topology; `bodies`: knowledge of bodies that an imported store does not hold.
///
/// # Errors
/// If the store lacks poses, its objects are not known or do not move freely, or an array is damaged.
pub fn replay(path: &Path, models: &[HandModel; 2], bodies: &BodyOptions) -> Result<Replayed> {
    let store = ZarrReader::open(path)?;
    let mut frames = Vec::new();
    let mut missed = (0.0, 0);
    for index in 0..episode_ranges(store.episode_ends()).count() {
        let named = |error: Error| Error::file(path, format!("episode {index}: {error}"));
        let episode = physics::read(&store, index, models, bodies)?;
        let mut stage = match recorded::is_import(&store) {
            true => recorded::stage(&episode.take).map_err(named)?,
            false => Stage::simulated(&store, index, &episode.take).map_err(named)?,
        };
        for run in courses::runs(&episode.take).into_iter().filter(|run| run.len() > 1) {
            let courses = Courses::new(&stage, &episode.take, run.clone()).map_err(named)?;
            missed = (missed.0 + courses.missed_rotation.0, missed.1 + courses.missed_rotation.1);
            for at in 0..run.len() {
                let (links, net) = stage.forces(&courses, at).map_err(named)?;
                let to_edge = at.min(run.len() - 1 - at);
                frames.push(ReplayFrame { frame: episode.frames.start + run.start + at, to_edge, links, net });
            }
        }
    }
    Ok(Replayed { frames, missed_rotation: missed.0 / f64::from(missed.1.max(1)) })
}
