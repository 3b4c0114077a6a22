//! Poses of hands and camera in a store.

use std::path::Path;

use glam::{DQuat, DVec3};
use serde_json::Value;

use super::projection::Sight;
use crate::camera::Intrinsics;
use crate::dataset::EpisodeReader;
use crate::dataset::zarr::{CAMERA_EGO_RGB, CAMERA_POSE, LEFT_HAND_POSE, RIGHT_HAND_POSE, ZarrReader};
use crate::hand::HandParams;

/// Poses of hands and camera of a store, by frame.
pub(super) struct StorePoses {
    store: ZarrReader,
    /// Intrinsics of each episode; None = the store does not say.
    intrinsics: Vec<Option<Intrinsics>>,
}

impl StorePoses {
    /// Opens the poses of the store at `path`; None if it has none.
    pub(super) fn open(path: &Path) -> Option<Self> {
        let store = ZarrReader::open(path).ok()?;
        let has_hands = [LEFT_HAND_POSE, RIGHT_HAND_POSE].iter().any(|name| store.has(name));
        // The camera of `camera_pose` is that of the head.
        let has_camera = store.has(CAMERA_POSE) && store.camera() == CAMERA_EGO_RGB;
        let of = |episode: &Value| serde_json::from_value(episode.get("intrinsics")?.clone()).ok();
        let episodes = store.raw_attributes().get("episodes").and_then(Value::as_array);
        let intrinsics = match episodes.filter(|_| has_camera) {
            Some(episodes) => episodes.iter().map(of).collect(),
            None => Vec::new(),
        };
        has_hands.then_some(Self { store, intrinsics })
    }

    /// Returns the parameters of both hands in frame `frame`; None = unknown.
    pub(super) fn hands(&self, frame: usize) -> [Option<HandParams>; 2] {
        [LEFT_HAND_POSE, RIGHT_HAND_POSE].map(|name| {
            let row: [f32; 61] = self.row(name, frame)?.try_into().ok()?;
            // Zeros stand for a hand that is absent.
            let known = row.iter().all(|value| value.is_finite()) && row.iter().any(|value| *value != 0.0);
            known.then(|| HandParams::from_array(&row))
        })
    }

    /// Returns the camera's sight in frame `frame`; None = unknown.
    pub(super) fn sight(&self, frame: usize) -> Option<Sight> {
        let episode = self.store.episode_ends().partition_point(|end| *end <= frame);
        let intrinsics = (*self.intrinsics.get(episode)?)?;
        let row: [f32; 7] = self.row(CAMERA_POSE, frame)?.try_into().ok()?;
        let [x, y, z, qw, qx, qy, qz] = row.map(f64::from);
        let orientation = DQuat::from_xyzw(qx, qy, qz, qw);
        let known = row.iter().all(|value| value.is_finite()) && orientation.length_squared() > 0.5;
        known.then(|| Sight { intrinsics, position: DVec3::new(x, y, z), orientation: orientation.normalize() })
    }

    fn row(&self, name: &str, frame: usize) -> Option<Vec<f32>> {
        if !self.store.has(name) {
            return None;
        }
        Some(self.store.read_frame(name, frame).ok()?.into_f32())
    }
}
