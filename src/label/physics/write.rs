//! A copy of a store with forces from motion.

use std::collections::BTreeMap;
use std::path::Path;

use serde_json::{Map, Value, json};

use super::bodies::BodyOptions;
use super::fields::FrameFields;
use super::read::read;
use crate::dataset::EpisodeReader;
use crate::dataset::copy::remove;
use crate::dataset::zarr::{
    AddedArrays, ArraySpec, Dtype, MANO_FORCE, MANO_FORCE_STD, MANO_FORCE_VALID, StoreLocation, Values, ZarrReader,
};
use crate::error::{Error, Result};
use crate::file;
use crate::geometry::{ForceSpreader, SIGMA};
use crate::hand::{HandModel, N_JOINTS};
use crate::physics::{Estimate, ForceValidity, Settings, whole};
use crate::tactile::{ForceKind, N_FIELD, episode_ranges};

/// Arrays beside force and its validity: standard deviation per vertex, force and 90 % interval per link, links whose force
/// the motion does not determine, deviation of a hand's total, validity, and per object the wrench that the motion asks for
/// (force, N, moment about the centre of mass, N m, world frame), its deviation and the part that no contact explains.
const ARRAYS: [&str; 9] = [
    MANO_FORCE_STD,
    "data/link_force",
    "data/link_force_interval",
    "data/link_force_undetermined",
    "data/squeeze_std",
    "data/force_validity",
    "data/object_wrench",
    "data/object_wrench_std",
    "data/object_wrench_residual",
];

/// Settings of one run.
#[derive(Debug)]
pub struct Label<'a> {
    /// Left and right hand on the store's topology.
    pub models: &'a [HandModel; 2],
    /// Knowledge of the bodies.
    pub bodies: BodyOptions,
    /// Settings of the estimation.
    pub settings: Settings,
}

/// Counts of one run, of hands: two per frame.
#[derive(Debug, Clone, Default, PartialEq, serde::Serialize)]
pub struct FrameCounts {
    /// Frames.
    pub frames: usize,
    /// Hands with a force above 0.05 N.
    pub touching: usize,
    /// Of these, hands with a link whose force the motion does not determine.
    pub undetermined: usize,
    /// Hands by the reason why forces are unknown.
    pub unknown: BTreeMap<&'static str, usize>,
}

/// Value of the attribute `force_origin` of a store whose forces are estimated from motion.
pub const ESTIMATED: &str = "estimated from motion";

/// Writes a copy of the store at `path` with forces from motion to `out`; calls `progress` with the frames done and all.
///
/// # Errors
/// If the store is damaged, bodies are not known, or `out` exists or can't be written.
pub fn label(path: &Path, out: &Path, run: &Label, mut progress: impl FnMut(usize, usize)) -> Result<FrameCounts> {
    let place = StoreLocation::only(path)?;
    let store = ZarrReader::open_at(&place)?;
    if out.exists() {
        return Err(Error::file(out, "exists already; choose another --out or remove it"));
    }
    if !place.is_v2()? {
        return Err(Error::file(path, "is a Zarr v3 store; expected v2, as egotac and OXT write it"));
    }
    let spreaders = [ForceSpreader::new(&run.models[0], SIGMA)?, ForceSpreader::new(&run.models[1], SIGMA)?];
    let folder = match out.parent().filter(|parent| !parent.as_os_str().is_empty()) {
        Some(parent) => parent,
        None => Path::new("."),
    };
    let partial = tempfile::Builder::new().prefix(".egotac-physics-").tempdir_in(folder).map_err(Error::io(folder))?;
    let at = partial.path().join("store");
    if let Some(lost) = crate::dataset::zarr::copy_store(&place, &at)?.first() {
        return Err(Error::file(path, format!("{} can't be read: {}", lost.file, lost.reason)));
    }
    // Forces that were never known make room; measured or simulated ones stay, and the estimate stands beside them.
    let has_force = store.has(MANO_FORCE) && store.force_kind()?.is_some();
    let [force, valid] = [MANO_FORCE, MANO_FORCE_VALID].map(|name| match has_force {
        true => crate::dataset::zarr::predicted(name),
        false => name.to_string(),
    });
    for name in [&force, &valid] {
        remove(&at.join(name))?;
    }
    let mut arrays: Option<(AddedArrays, usize)> = None;
    let (mut counts, mut episodes) = (FrameCounts::default(), Vec::new());
    let objects = store.arrays().into_iter().find(|info| info.name == crate::dataset::zarr::OBJECT_POSE);
    let objects = objects.map_or(0, |info| info.shape.get(1).copied().unwrap_or(0));
    for index in 0..episode_ranges(store.episode_ends()).count() {
        let named = |error: Error| Error::file(path, format!("episode {index}: {error}"));
        let episode = read(&store, index, run.models, &run.bodies).map_err(named)?;
        let estimate = whole(&episode.take, &run.settings);
        episodes.push(description(&episode.take.bodies, &estimate, episode.gravity));
        let (arrays, _) = match &mut arrays {
            Some(arrays) => arrays,
            none => none.insert((AddedArrays::new(&at, specs(&force, &valid, objects))?, objects)),
        };
        for frame in 0..episode.frames.len() {
            let fields = FrameFields::new(&episode.take, frame, &estimate.frames[frame], &spreaders)?;
            counts.add(&fields);
            arrays.push(values(fields, &estimate, frame, objects))?;
            progress(counts.frames, store.len());
        }
    }
    let Some((arrays, _)) = arrays else { return Err(Error::file(path, "has no episode")) };
    arrays.finish(attributes(run, has_force, &force, episodes, &counts))?;
    file::sync_tree(&at)?;
    file::rename(&at, out)?;
    Ok(counts)
}

fn specs(force: &str, valid: &str, objects: usize) -> Vec<ArraySpec> {
    let [sd, links, interval, undetermined, squeeze, validity, wrench, wrench_sd, residual] = ARRAYS;
    vec![
        ArraySpec::new(force, [N_FIELD], Dtype::F32),
        ArraySpec::new(valid, [N_FIELD], Dtype::U8),
        ArraySpec::new(sd, [N_FIELD], Dtype::F32),
        ArraySpec::new(links, [2, N_JOINTS], Dtype::F32),
        ArraySpec::new(interval, [2, N_JOINTS, 2], Dtype::F32),
        ArraySpec::new(undetermined, [2, N_JOINTS], Dtype::U8),
        ArraySpec::new(squeeze, [2], Dtype::F32),
        ArraySpec::new(validity, [2], Dtype::U8),
        ArraySpec::new(wrench, [objects, 6], Dtype::F32),
        ArraySpec::new(wrench_sd, [objects, 6], Dtype::F32),
        ArraySpec::new(residual, [objects, 6], Dtype::F32),
    ]
}

fn values(fields: FrameFields, estimate: &Estimate, frame: usize, objects: usize) -> Vec<Values> {
    let wrenches = |part: fn(&crate::physics::frame::BodyEstimate) -> &nalgebra::Vector6<f64>| {
        let bodies = &estimate.frames[frame].bodies;
        let row = |index: usize| bodies.get(index).and_then(Option::as_ref).map(part);
        let rows = (0..objects).flat_map(|index| match row(index) {
            Some(wrench) => std::array::from_fn::<f32, 6, _>(|k| wrench[k] as f32),
            None => [f32::NAN; 6],
        });
        Values::F32(rows.collect())
    };
    let valid = fields.force.iter().map(|force| u8::from(!force.is_nan())).collect();
    vec![
        Values::F32(fields.force),
        Values::U8(valid),
        Values::F32(fields.sd),
        Values::F32(fields.links),
        Values::F32(fields.interval),
        Values::U8(fields.undetermined),
        Values::F32(fields.squeeze),
        Values::U8(fields.validity),
        wrenches(|body| &body.wrench),
        wrenches(|body| &body.wrench_sd),
        wrenches(|body| &body.residual),
    ]
}

fn description(bodies: &[crate::physics::RigidBody], estimate: &Estimate, gravity: &str) -> Value {
    let body = |(index, body): (usize, &crate::physics::RigidBody)| {
        json!({
            "name": body.name,
            "mass_kg": body.mass.map(|mass| mass.kilograms),
            "mass_log_sd": body.mass.map(|mass| mass.relative_sd),
            "held": body.held,
            "joined_to": body.joined_to,
            "pose_noise": estimate.body_noise[index],
            "bandwidth_hz": estimate.bandwidth[index],
        })
    };
    let bodies: Vec<Value> = bodies.iter().enumerate().map(body).collect();
    json!({ "gravity": gravity, "hand_noise": estimate.hand_noise, "bodies": bodies })
}

fn attributes(
    run: &Label,
    has_force: bool,
    force: &str,
    episodes: Vec<Value>,
    counts: &FrameCounts,
) -> Map<String, Value> {
    let codes: BTreeMap<String, &str> =
        ForceValidity::ALL.iter().map(|validity| (validity.code().to_string(), validity.reason())).collect();
    let mut attributes = Map::new();
    let description = json!({
        "producer": "egotac label --physics",
        "version": crate::VERSION,
        "origin": ESTIMATED,
        "force": force,
        "force_kind": ForceKind::Spread.id(),
        "sigma": SIGMA,
        "settings": run.settings,
        "validity": codes,
        "episodes": episodes,
        "counts": counts,
    });
    attributes.insert("force_from_motion".into(), description);
    if !has_force {
        attributes.insert(ForceKind::ATTRIBUTE.into(), ForceKind::Spread.id().into());
        attributes.insert("force_origin".into(), ESTIMATED.into());
        attributes.insert("sigma".into(), SIGMA.into());
    }
    attributes
}

impl FrameCounts {
    fn add(&mut self, fields: &FrameFields) {
        self.frames += 1;
        for side in 0..2 {
            let links = side * N_JOINTS..(side + 1) * N_JOINTS;
            let force: f32 = fields.links[links.clone()].iter().filter(|force| !force.is_nan()).sum();
            self.touching += usize::from(force > 0.05);
            self.undetermined += usize::from(force > 0.05 && fields.undetermined[links].contains(&1));
            let validity = ForceValidity::ALL.get(usize::from(fields.validity[side]));
            if let Some(reason) = validity.filter(|validity| **validity != ForceValidity::Valid) {
                *self.unknown.entry(reason.reason()).or_default() += 1;
            }
        }
    }
}
