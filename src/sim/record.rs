//! Recording of rollouts to stores: one episode, or a data set that an interrupted run resumes.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Mutex, PoisonError};

use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

use super::effect::Observation;
use super::frame::SimFrame;
use super::rollout::{Rollout, RolloutOptions};
use super::scene::Scene;
use crate::dataset::zarr::{
    ArraySpec, CAMERA_POSE, Compression, Contact, Dtype, OBJECT_POSE, Values, ZarrReader, ZarrWriter, concatenate,
};
use crate::dataset::{Attributes, EpisodeWriter};
use crate::error::{Error, Result};
use crate::hand::Side;
use crate::tactile::{CONTACT_FORCE_N, N_FIELD, Validity};

/// Array (T, 1556) u8: 1 = an object's surface is within 1 cm.
pub const PROXIMITY: &str = "data/mano_proximity";
/// Array (T, 2, 2) f32, left hand first: relative residual of the force sum, and moment that spreading adds, N m; zero
/// for an absent hand.
pub const FORCE_RESIDUAL: &str = "data/force_residual";

/// Array (T, 1556) f32: sliding speed of touching surfaces, m/s; only if the scene observes slip.
pub const SLIP: &str = "data/mano_slip";
/// Array (T, H, W) f32: distance from the camera plane, m; only if the scene observes depth.
pub const DEPTH: &str = "data/camera_ego_depth";

/// Name of the attribute with the [`RecordSummary`].
const SUMMARY: &str = "summary";

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

/// Progress of [`generate`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum GenerateProgress {
    /// Number of simulated episodes, and of all episodes.
    Episodes(usize, usize),
    /// Number of written chunks of the store, and of all chunks.
    Chunks(usize, usize),
}

/// Data set to generate.
#[derive(Debug, Clone)]
pub struct DatasetPlan {
    /// Scenes, used in turn.
    pub scenes: Vec<Scene>,
    /// Number of episodes.
    pub episodes: usize,
    /// Seed of the first episode; episode `i` has seed + i.
    pub seed: u64,
    /// Number of episodes simulated at a time, and of threads that write the store.
    pub jobs: usize,
    /// Options of the rollouts.
    pub options: RolloutOptions,
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
    writer.set_attribute("episodes", json!([episode_entry(scene, seed, &rollout)]));
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

/// Generates a data set as one store at `out`; calls `progress` after each episode, then after each chunk.
///
/// Finished episodes are kept in `OUT.parts` until the end; the same call resumes an interrupted one. Other episodes go
/// on when one fails.
///
/// # Errors
/// If `out` exists, the parts belong to another call, or an episode fails; the error names scenes and seeds of the
/// failed episodes.
pub fn generate(plan: &DatasetPlan, out: &Path, progress: impl Fn(GenerateProgress) + Sync) -> Result<RecordSummary> {
    let recorder = || {
        let record = |scene: usize, seed: u64, out: &Path| record_part(&plan.scenes, scene, seed, &plan.options, out);
        Box::new(record) as Recorder
    };
    generate_with(plan, &recorder, false, out, progress)
}

/// Records an episode, given the index of its scene and its seed, as a store.
pub(super) type Recorder<'a> = Box<dyn FnMut(usize, u64, &Path) -> Result<()> + 'a>;

/// Generates a data set as [`generate`] with one recorder per job; `skip_failed` leaves out failed episodes.
pub(super) fn generate_with<'a>(
    plan: &DatasetPlan,
    recorder: &(dyn Fn() -> Recorder<'a> + Sync),
    skip_failed: bool,
    out: &Path,
    progress: impl Fn(GenerateProgress) + Sync,
) -> Result<RecordSummary> {
    if out.exists() {
        return Err(Error::file(out, "exists already; choose another name or remove it"));
    }
    if plan.scenes.is_empty() || plan.episodes == 0 || plan.jobs == 0 {
        return Err(Error::value("scenes, episodes and jobs", "at least one of each", "none"));
    }
    let mut folder = out.as_os_str().to_owned();
    folder.push(".parts");
    let folder = PathBuf::from(folder);
    claim(&folder, plan)?;
    let failed = record_parts(plan, recorder, &folder, &progress);
    if failed.len() == plan.episodes || !(failed.is_empty() || skip_failed) {
        return Err(Error::file(&folder, failure_message(&failed, plan.episodes)));
    }
    // Failed episodes left no part.
    let parts: Vec<PathBuf> =
        (0..plan.episodes).map(|index| part_path(&folder, index)).filter(|part| part.exists()).collect();
    let mut total = merge(plan, &parts, out, progress)?;
    fs::remove_dir_all(&folder).map_err(Error::io(&folder))?;
    total.failed = failed;
    Ok(total)
}

/// Records the missing parts with one thread per job; returns a sorted line for each episode that failed.
fn record_parts<'a>(
    plan: &DatasetPlan,
    recorder: &(dyn Fn() -> Recorder<'a> + Sync),
    folder: &Path,
    progress: &(impl Fn(GenerateProgress) + Sync),
) -> Vec<String> {
    let next = AtomicUsize::new(0);
    let done = AtomicUsize::new(0);
    let failed: Mutex<Vec<String>> = Mutex::new(Vec::new());
    let work = || {
        let mut record = recorder();
        loop {
            let index = next.fetch_add(1, Ordering::Relaxed);
            if index >= plan.episodes {
                return;
            }
            let (scene, seed) = (index % plan.scenes.len(), plan.seed + index as u64);
            let part = part_path(folder, index);
            if !part.exists()
                && let Err(error) = record(scene, seed, &part)
            {
                let line = format!("{} with seed {seed}: {error}", plan.scenes[scene].name);
                failed.lock().unwrap_or_else(PoisonError::into_inner).push(line);
            }
            progress(GenerateProgress::Episodes(done.fetch_add(1, Ordering::Relaxed) + 1, plan.episodes));
        }
    };
    std::thread::scope(|scope| (0..plan.jobs).for_each(|_| drop(scope.spawn(work))));
    let mut failed = failed.into_inner().unwrap_or_else(PoisonError::into_inner);
    failed.sort();
    failed
}

fn part_path(folder: &Path, index: usize) -> PathBuf {
    folder.join(format!("{index:06}"))
}

/// Formats the error for failed episodes; names the first few.
fn failure_message(failed: &[String], episodes: usize) -> String {
    const MAX_NAMED: usize = 5;
    let named = failed.iter().take(MAX_NAMED).map(String::as_str).collect::<Vec<_>>().join("; ");
    let more =
        if failed.len() > MAX_NAMED { format!("; and {} more", failed.len() - MAX_NAMED) } else { String::new() };
    let others = match failed.len() < episodes {
        true => "; the others are kept here, and --skip-failed writes a store of them",
        false => "",
    };
    format!("{} of {episodes} episodes failed: {named}{more}{others}", failed.len())
}

/// Creates the folder of parts, or checks that the same plan created it.
fn claim(folder: &Path, plan: &DatasetPlan) -> Result<()> {
    let scenes: Vec<String> = plan.scenes.iter().map(|s| format!("{} {:?}", s.name, s.spec)).collect();
    let text = format!(
        "{} {} {:?} {:?} {} {}\n{}\n",
        plan.seed,
        plan.options.hands[0].topology.id(),
        plan.options.betas,
        plan.options.picture,
        plan.options.shadows,
        plan.options.sigma,
        scenes.join("\n")
    );
    let file = folder.join("plan");
    if !file.exists() {
        fs::create_dir_all(folder).map_err(Error::io(folder))?;
        return fs::write(&file, text).map_err(Error::io(&file));
    }
    if fs::read_to_string(&file).map_err(Error::io(&file))? != text {
        return Err(Error::file(
            folder,
            "contains episodes of other scenes, seeds or options; remove it or choose another --out",
        ));
    }
    Ok(())
}

/// Concatenates the parts and their summaries to one store.
fn merge(
    plan: &DatasetPlan,
    parts: &[PathBuf],
    out: &Path,
    progress: impl Fn(GenerateProgress) + Sync,
) -> Result<RecordSummary> {
    let mut total = RecordSummary::default();
    let mut entries: Vec<Value> = Vec::new();
    for part in parts {
        let reader = ZarrReader::open(part)?;
        let attributes = reader.raw_attributes();
        entries.extend(attributes.get("episodes").and_then(Value::as_array).cloned().unwrap_or_default());
        let summary = attributes.get(SUMMARY).cloned().unwrap_or_default();
        total.add(serde_json::from_value(summary).map_err(|e| Error::file(part, format!("{SUMMARY}: {e}")))?);
    }
    let attributes = attributes(&plan.scenes, plan.seed, &plan.options);
    let more = [("episodes".to_string(), Value::Array(entries)), (SUMMARY.to_string(), json!(total))];
    let chunks = |done, all| progress(GenerateProgress::Chunks(done, all));
    concatenate(parts, out, &attributes, more.into_iter().collect(), plan.jobs, chunks)?;
    Ok(total)
}

fn attributes(scenes: &[Scene], seed: u64, options: &RolloutOptions) -> Attributes {
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

fn episode_entry(scene: &Scene, seed: u64, rollout: &Rollout) -> Value {
    json!({
        "scene": scene.name,
        "seed": seed,
        "objects": rollout.objects().iter().filter(|o| o.body().is_some()).map(|o| o.name.as_str()).collect::<Vec<_>>(),
        "intrinsics": rollout.intrinsics(),
    })
}

/// Arrays in addition to those that every store has.
struct ExtraArrays {
    n_objects: usize,
    slip: bool,
    /// Width and height of the picture, pixels.
    depth: Option<(u32, u32)>,
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
        }
    }

    /// Returns the specifications of the arrays.
    fn arrays(&self) -> Vec<ArraySpec> {
        let mut arrays = vec![
            ArraySpec::new(PROXIMITY, [N_FIELD], Dtype::U8),
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
        arrays
    }

    /// Returns name and length per frame of the arrays that not every scene has.
    fn optional(&self) -> Vec<(&'static str, usize)> {
        let depth = self.depth.map(|(width, height)| (DEPTH, width as usize * height as usize));
        let poses = Some((OBJECT_POSE, 7 * self.n_objects)).filter(|_| self.n_objects > 0);
        let slip = Some((SLIP, N_FIELD)).filter(|_| self.slip);
        [poses, slip, depth].into_iter().flatten().collect()
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
            (PROXIMITY, Values::U8(frame.proximity.clone())),
            (FORCE_RESIDUAL, Values::F32(residuals.collect())),
            (CAMERA_POSE, Values::F32(camera)),
        ];
        for (name, length) in self.optional() {
            let mut array: Vec<f32> = match name {
                OBJECT_POSE => {
                    frame.objects.iter().flat_map(|object| pose(object.position, object.orientation)).collect()
                }
                SLIP => frame.slip.clone().unwrap_or_default(),
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
    fn add(&mut self, other: Self) {
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
