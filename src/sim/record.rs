//! Rollouts to stores: one episode, or a training set in parts that survive an interruption.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Mutex, PoisonError};

use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

use super::effect::Observation;
use super::observe::SimFrame;
use super::rollout::{Rollout, RolloutOptions};
use super::scene::Scene;
use crate::dataset::zarr::{
    ArraySpec, CAMERA_POSE, Compression, Contact, Dtype, OBJECT_POSE, Values, ZarrReader, ZarrWriter, concatenate,
};
use crate::dataset::{Attributes, EpisodeWriter};
use crate::error::{Error, Result};
use crate::hand::Side;
use crate::tactile::{CONTACT_FORCE_N, N_FIELD, Validity};

/// (T, 1556) u8: 1 = an object's surface is within 1 cm.
pub const PROXIMITY: &str = "data/mano_proximity";
/// (T, 2, 2) f32: for the left and the right hand, the relative difference between the sum of its forces and that of its
/// contacts, and the moment that spreading adds, N m; zero for a hand that is absent.
pub const FORCE_RESIDUAL: &str = "data/force_residual";

/// (T, 1556) f32: speed at which touching surfaces slide, m/s; there where the scene observes slip.
pub const SLIP: &str = "data/mano_slip";
/// (T, H, W) f32: distance from the camera's plane, m; there where the scene observes depth.
pub const DEPTH: &str = "data/camera_ego_depth";

/// Attribute of a store: its [`Summary`].
const SUMMARY: &str = "summary";

/// What came out of recording.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Summary {
    /// Frames written.
    pub frames: usize,
    /// Frames that a guard refused, by its reason.
    pub invalid: BTreeMap<String, usize>,
    /// Frames in which a vertex is in contact.
    pub touching: usize,
    /// Largest total normal force on one hand, N.
    pub max_force: f64,
    /// Largest relative difference between a hand's force and its contacts' sum.
    pub sum_residual: f64,
    /// Largest moment added by spreading, N m.
    pub moment_residual: f64,
    /// Episodes that failed and were left out: scene, seed and why.
    pub failed: Vec<String>,
}

/// What a training set's making is at.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Progress {
    /// Episodes simulated, and all.
    Episodes(usize, usize),
    /// Chunks of the store written, and all.
    Chunks(usize, usize),
}

/// A training set to make.
#[derive(Debug, Clone)]
pub struct Generate {
    /// Scenes, taken in turn.
    pub scenes: Vec<Scene>,
    /// Episodes altogether.
    pub episodes: usize,
    /// Seed of the first episode; episode `i` has seed + i.
    pub seed: u64,
    /// Episodes at a time, then threads that write the store.
    pub jobs: usize,
    /// What to simulate and record.
    pub options: RolloutOptions,
}

/// Records one episode as a store of its own at `out`; `progress` is called after each frame with (done, all).
///
/// # Errors
/// If the rollout fails or the store can't be written; then there is none.
pub fn record(
    scene: &Scene,
    seed: u64,
    options: &RolloutOptions,
    out: &Path,
    progress: impl FnMut(usize, usize),
) -> Result<Summary> {
    record_one(std::slice::from_ref(scene), 0, seed, options, Compression::Keep, out, progress)
}

/// Records an episode of `scenes[scene]` with the arrays that a set of all these scenes has.
fn record_one(
    scenes: &[Scene],
    scene: usize,
    seed: u64,
    options: &RolloutOptions,
    compression: Compression,
    out: &Path,
    mut progress: impl FnMut(usize, usize),
) -> Result<Summary> {
    let scene = &scenes[scene];
    let mut rollout = Rollout::new(scene, seed, options)?;
    let extras = Extras::of(scenes, options);
    let attributes = attributes(std::slice::from_ref(scene), seed, options);
    let writer = ZarrWriter::create(out, attributes, Contact::Truth, extras.arrays())?;
    let mut writer = writer.with_compression(compression);
    writer.set_attribute("episodes", json!([episode_entry(scene, seed, &rollout)]));
    let mut summary = Summary::default();
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

/// Records an episode that waits to become part of a set of `scenes`.
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

/// Makes a training set as one store at `out`; `progress` is called after each episode, then after each chunk.
///
/// Finished episodes wait beside it in `OUT.parts`; the same call continues an interrupted one. An episode that fails
/// does not keep the others from being made.
///
/// # Errors
/// If there is already something at `out`, the parts belong to another call, or an episode fails; the error names the
/// scenes and seeds of those.
pub fn generate(plan: &Generate, out: &Path, progress: impl Fn(Progress) + Sync) -> Result<Summary> {
    let recorder = || {
        let record = |scene: usize, seed: u64, out: &Path| record_part(&plan.scenes, scene, seed, &plan.options, out);
        Box::new(record) as Recorder
    };
    generate_by(plan, &recorder, false, out, progress)
}

/// Records the episode (index of the scene, seed) as a store of its own.
pub(super) type Recorder<'a> = Box<dyn FnMut(usize, u64, &Path) -> Result<()> + 'a>;

/// [`generate`] by recorders, one for each job; `skip_failed` leaves out episodes that fail.
pub(super) fn generate_by<'a>(
    plan: &Generate,
    recorder: &(dyn Fn() -> Recorder<'a> + Sync),
    skip_failed: bool,
    out: &Path,
    progress: impl Fn(Progress) + Sync,
) -> Result<Summary> {
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
    let part = |index: usize| folder.join(format!("{index:06}"));

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
            if !part(index).exists()
                && let Err(error) = record(scene, seed, &part(index))
            {
                let what = format!("{} with seed {seed}: {error}", plan.scenes[scene].name);
                failed.lock().unwrap_or_else(PoisonError::into_inner).push(what);
            }
            progress(Progress::Episodes(done.fetch_add(1, Ordering::Relaxed) + 1, plan.episodes));
        }
    };
    std::thread::scope(|scope| (0..plan.jobs).for_each(|_| drop(scope.spawn(work))));
    let mut failed = failed.into_inner().unwrap_or_else(PoisonError::into_inner);
    failed.sort();
    if failed.len() == plan.episodes || !(failed.is_empty() || skip_failed) {
        return Err(Error::file(&folder, all_failed(&failed, plan.episodes)));
    }
    // Those that failed left no part.
    let parts: Vec<PathBuf> = (0..plan.episodes).map(part).filter(|part| part.exists()).collect();
    let mut total = merge(plan, &parts, out, progress)?;
    fs::remove_dir_all(&folder).map_err(Error::io(&folder))?;
    total.failed = failed;
    Ok(total)
}

/// Names the first few.
fn all_failed(failed: &[String], episodes: usize) -> String {
    const NAMED: usize = 5;
    let named = failed.iter().take(NAMED).map(String::as_str).collect::<Vec<_>>().join("; ");
    let more = if failed.len() > NAMED { format!("; and {} more", failed.len() - NAMED) } else { String::new() };
    let others = match failed.len() < episodes {
        true => "; the others are kept here, and --skip-failed makes a store of them",
        false => "",
    };
    format!("{} of {episodes} episodes failed: {named}{more}{others}", failed.len())
}

/// Makes the folder of parts, or refuses one that another plan has begun.
fn claim(folder: &Path, plan: &Generate) -> Result<()> {
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
            "holds episodes of other scenes, seeds or options; remove it or choose another --out",
        ));
    }
    Ok(())
}

fn merge(plan: &Generate, parts: &[PathBuf], out: &Path, progress: impl Fn(Progress) + Sync) -> Result<Summary> {
    let mut total = Summary::default();
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
    let chunks = |done, all| progress(Progress::Chunks(done, all));
    concatenate(parts, out, &attributes, more.into_iter().collect(), plan.jobs, chunks)?;
    Ok(total)
}

fn attributes(scenes: &[Scene], seed: u64, options: &RolloutOptions) -> Attributes {
    Attributes {
        topology: options.hands[0].topology,
        sigma: options.sigma,
        // Through the shortest decimal, so that 0.05 stays 0.05 in f64.
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

/// Arrays beside those that every store has.
struct Extras {
    n_objects: usize,
    slip: bool,
    /// Width and height.
    depth: Option<(u32, u32)>,
}

impl Extras {
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

    /// Arrays that not every scene of a set has: name and length of a frame.
    fn optional(&self) -> Vec<(&'static str, usize)> {
        let depth = self.depth.map(|(width, height)| (DEPTH, width as usize * height as usize));
        let poses = Some((OBJECT_POSE, 7 * self.n_objects)).filter(|_| self.n_objects > 0);
        let slip = Some((SLIP, N_FIELD)).filter(|_| self.slip);
        [poses, slip, depth].into_iter().flatten().collect()
    }

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

impl Summary {
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
