//! Recording of a rollout to a store.

use std::collections::BTreeMap;
use std::path::Path;

use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

use super::effect::{Effect, EffectSet, Observation};
use super::frame::SimFrame;
use super::rollout::{Rollout, RolloutOptions};
use super::scene::{LookStyle, Scene};
use super::stored_scene::{self, EPISODES, SCENES};
use crate::dataset::zarr::{
    ArraySpec, CAMERA_POSE, Compression, Contact, Dtype, MANO_PROXIMITY, OBJECT_POSE, Values, ZarrWriter,
};
use crate::dataset::{Attributes, EpisodeWriter};
use crate::error::Result;
use crate::hand::Side;
use crate::sensor;
use crate::tactile::{CONTACT_FORCE_N, N_FIELD, Validity};

/// Array (T, 2, 2) f32, left hand first: relative residual of the force sum, and moment that spreading adds, N m; zero
/// for an absent hand.
pub const FORCE_RESIDUAL: &str = "data/force_residual";

/// Array (T, 1556) f32: sliding speed of touching surfaces, m/s; only if the scene observes slip.
pub const SLIP: &str = "data/mano_slip";
/// Array (T, H, W) f32: distance from the camera plane, m; only if the scene observes depth.
pub const DEPTH: &str = "data/camera_ego_depth";

/// Arrays (T, N) f32: readings of the taxels of the left and the right glove, N; only if the hands wear gloves.
pub const TAXELS: [&str; 2] = ["data/left_taxels", "data/right_taxels"];

/// Name of the attribute with the [`RecordSummary`].
pub(super) const SUMMARY: &str = "summary";

/// Counts and extremes of recorded frames.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct RecordSummary {
    /// Number of frames written.
    pub frames: usize,
    /// Number of frames that a guard refused, by reason.
    pub invalid: BTreeMap<String, usize>,
    /// Number of frames in which a vertex is in contact.
    pub touching: usize,
    /// Largest total normal force on one hand, N.
    pub max_force: f64,
    /// Largest relative residual between a hand's force and the sum of its contacts.
    pub sum_residual: f64,
    /// Largest moment that spreading adds, N m.
    pub moment_residual: f64,
    /// Failed episodes, which are not in the store: scene, seed and reason.
    pub failed: Vec<String>,
}

/// Records one episode as a store at `out`; calls `progress` after each frame with (done, all).
///
/// # Errors
/// If the rollout fails or the store cannot be written; no store is left then.
pub fn record(
    scene: &Scene,
    seed: u64,
    options: &RolloutOptions,
    out: &Path,
    progress: impl FnMut(usize, usize),
) -> Result<RecordSummary> {
    record_one(std::slice::from_ref(scene), 0, seed, options, Compression::Keep, out, progress)
}

/// Records an episode of `scenes[scene]`, with the arrays that a store of all `scenes` has.
fn record_one(
    scenes: &[Scene],
    scene: usize,
    seed: u64,
    options: &RolloutOptions,
    compression: Compression,
    out: &Path,
    mut progress: impl FnMut(usize, usize),
) -> Result<RecordSummary> {
    let scene = &scenes[scene];
    let mut rollout = Rollout::new(scene, seed, options)?;
    let extras = ExtraArrays::of(scenes, options);
    let attributes = attributes(std::slice::from_ref(scene), seed, options);
    let writer = ZarrWriter::create(out, attributes, Contact::Truth, extras.arrays())?;
    let mut writer = writer.with_compression(compression);
    writer.set_attribute(EPISODES, json!([episode_entry(scene, seed, &rollout)]));
    writer.set_attribute(SCENES, stored_scene::attribute(std::slice::from_ref(scene))?);
    let mut summary = RecordSummary::default();
    while let Some(frame) = rollout.next_frame()? {
        summary.count(&frame);
        let extra = extras.values(&frame);
        writer.push_with(frame.frame, extra)?;
        progress(summary.frames, rollout.frame_count());
    }
    writer.end_episode()?;
    writer.set_attribute(SUMMARY, json!(summary));
    writer.finish()?;
    Ok(summary)
}

/// Records an episode as a part of a data set of `scenes`.
///
/// # Errors
/// As [`record`].
pub(super) fn record_part(
    scenes: &[Scene],
    scene: usize,
    seed: u64,
    options: &RolloutOptions,
    out: &Path,
) -> Result<()> {
    record_one(scenes, scene, seed, options, Compression::Pass, out, |_, _| ()).map(drop)
}

pub(super) fn attributes(scenes: &[Scene], seed: u64, options: &RolloutOptions) -> Attributes {
    Attributes {
        topology: options.hands[0].topology,
        sigma: options.sigma,
        // Conversion through the shortest decimal keeps 0.05 as 0.05 in f64.
        contact_force: CONTACT_FORCE_N.to_string().parse().unwrap_or(CONTACT_FORCE_N.into()),
        producer: "egotac sim".into(),
        version: env!("CARGO_PKG_VERSION").into(),
        scene: scenes.iter().map(|scene| scene.name.as_str()).collect::<Vec<_>>().join(","),
        seed,
    }
}

/// Returns the number of channels of a scene's gloves; 0 without gloves, and where the map can't be read, which the rollout
/// reports.
fn channels(scene: &Scene) -> usize {
    let map = scene.spec.glove.as_ref().and_then(|glove| sensor::open(&glove.sensor).ok());
    map.map_or(0, |map| map.layout.channels)
}

fn episode_entry(scene: &Scene, seed: u64, rollout: &Rollout) -> Value {
    let mut entry = json!({
        "scene": scene.name,
        "seed": seed,
        "objects": rollout.objects().iter().filter(|o| o.body().is_some()).map(|o| o.name.as_str()).collect::<Vec<_>>(),
        "intrinsics": rollout.intrinsics(),
        "glove": scene.spec.glove,
    });
    let of_look: EffectSet =
        LookStyle::Photo.effects().iter().filter(|effect| rollout.effects().contains(*effect)).collect();
    if of_look != EffectSet::default() {
        entry["look"] = of_look.iter().map(Effect::name).collect();
    }
    entry
}

/// Arrays in addition to those that every store has.
struct ExtraArrays {
    n_objects: usize,
    slip: bool,
    /// Width and height of the picture, pixels.
    depth: Option<(u32, u32)>,
    /// Largest number of channels of a glove; 0 = none.
    channels: usize,
}

impl ExtraArrays {
    fn of(scenes: &[Scene], options: &RolloutOptions) -> Self {
        let solid = |scene: &Scene| scene.spec.objects.iter().filter(|object| object.solid).count();
        let most = |scene: &Scene| solid(scene) + scene.spec.distractors.high().round() as usize;
        let observed = |wanted: Observation| scenes.iter().any(|scene| scene.spec.observe.contains(&wanted));
        Self {
            n_objects: scenes.iter().map(most).max().unwrap_or(0),
            slip: observed(Observation::Slip),
            depth: options.picture.filter(|_| observed(Observation::Depth)),
            channels: scenes.iter().map(channels).max().unwrap_or(0),
        }
    }

    /// Returns the specifications of the arrays.
    fn arrays(&self) -> Vec<ArraySpec> {
        let mut arrays = vec![
            ArraySpec::new(MANO_PROXIMITY, [N_FIELD], Dtype::U8),
            ArraySpec::new(FORCE_RESIDUAL, [2, 2], Dtype::F32),
            ArraySpec::new(CAMERA_POSE, [7], Dtype::F32),
        ];
        if self.n_objects > 0 {
            arrays.push(ArraySpec::new(OBJECT_POSE, [self.n_objects, 7], Dtype::F32));
        }
        if self.slip {
            arrays.push(ArraySpec::new(SLIP, [N_FIELD], Dtype::F32));
        }
        if let Some((width, height)) = self.depth {
            arrays.push(ArraySpec::new(DEPTH, [height as usize, width as usize], Dtype::F32));
        }
        if self.channels > 0 {
            arrays.extend(TAXELS.map(|name| ArraySpec::new(name, [self.channels], Dtype::F32)));
        }
        arrays
    }

    /// Returns name and length per frame of the arrays that not every scene has.
    fn optional(&self) -> Vec<(&'static str, usize)> {
        let depth = self.depth.map(|(width, height)| (DEPTH, width as usize * height as usize));
        let poses = Some((OBJECT_POSE, 7 * self.n_objects)).filter(|_| self.n_objects > 0);
        let slip = Some((SLIP, N_FIELD)).filter(|_| self.slip);
        let taxels = TAXELS.map(|name| Some((name, self.channels)).filter(|_| self.channels > 0));
        [poses, slip, depth].into_iter().chain(taxels).flatten().collect()
    }

    /// Returns the values of a frame; NaN fills what the scene lacks.
    fn values(&self, frame: &SimFrame) -> Vec<(&'static str, Values)> {
        let pose = |position: glam::DVec3, q: glam::DQuat| {
            [position.x, position.y, position.z, q.w, q.x, q.y, q.z].map(|x| x as f32)
        };
        let camera = pose(frame.camera.position, frame.camera.orientation).to_vec();
        let residuals = frame.hands.iter().flat_map(|hand| {
            hand.as_ref().map_or([0.0; 2], |hand| [hand.sum_residual as f32, hand.moment_residual as f32])
        });
        let mut values = vec![
            (MANO_PROXIMITY, Values::U8(frame.proximity.clone())),
            (FORCE_RESIDUAL, Values::F32(residuals.collect())),
            (CAMERA_POSE, Values::F32(camera)),
        ];
        for (name, length) in self.optional() {
            let mut array: Vec<f32> = match name {
                OBJECT_POSE => {
                    frame.objects.iter().flat_map(|object| pose(object.position, object.orientation)).collect()
                }
                SLIP => frame.slip.clone().unwrap_or_default(),
                name if TAXELS.contains(&name) => {
                    let hand = usize::from(name == TAXELS[1]);
                    frame.taxels.as_ref().map(|taxels| taxels[hand].clone()).unwrap_or_default()
                }
                _ => frame.depth.clone().unwrap_or_default(),
            };
            array.resize(length, f32::NAN);
            values.push((name, Values::F32(array)));
        }
        values
    }
}

impl RecordSummary {
    /// Counts a frame.
    fn count(&mut self, frame: &SimFrame) {
        for hand in frame.hands.iter().flatten() {
            self.sum_residual = self.sum_residual.max(hand.sum_residual);
            self.moment_residual = self.moment_residual.max(hand.moment_residual);
        }
        let frame = &frame.frame;
        self.frames += 1;
        if frame.validity != Validity::Valid {
            *self.invalid.entry(frame.validity.reason().to_string()).or_default() += 1;
        }
        self.touching += usize::from(frame.field.contact.iter().any(|c| *c > 0.5));
        for side in Side::BOTH {
            self.max_force = self.max_force.max(frame.field.total_force(side).into());
        }
    }

    /// Adds the counts of another summary.
    pub(super) fn add(&mut self, other: Self) {
        self.frames += other.frames;
        for (reason, count) in other.invalid {
            *self.invalid.entry(reason).or_default() += count;
        }
        self.touching += other.touching;
        self.max_force = self.max_force.max(other.max_force);
        self.sum_residual = self.sum_residual.max(other.sum_residual);
        self.moment_residual = self.moment_residual.max(other.moment_residual);
    }
}
