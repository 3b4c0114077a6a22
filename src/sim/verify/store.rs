//! Scores of recorded episodes: object shapes regenerated from scene and seed, poses and forces from the store.

use std::ops::Range;

use glam::{DQuat, DVec3, Vec3};

use crate::dataset::EpisodeReader;
use crate::dataset::zarr::{
    FRAME_VALIDITY, LEFT_HAND_POSE, MANO_FORCE, MANO_FORCE_VALID, OBJECT_POSE, RIGHT_HAND_POSE, TIMESTAMPS, ZarrReader,
};
use crate::error::{Error, Result};
use crate::hand::{HandModel, HandParams, N_BETAS, Side};
use crate::model::Predictor;
use crate::score::agreement::{TruthFrame, VertexGroups};
use crate::score::verify::candidate::{Candidate, SweepSettings};
use crate::score::verify::episode::{Episode, EpisodeScorer, VertexDistances};
use crate::sim::ObjectPose;
use crate::sim::rig::HandRig;
use crate::sim::{Scene, Touchables, randomize, stored_scene};
use crate::tactile::{N_FIELD, TactileField, TactileSequence, Validity, episode_ranges};

/// Largest distance of an object's first stored position from the one that its seed gives, m. The store rounds to single
/// precision, and stores the centre of a soft object.
const START_TOLERANCE: f64 = 2e-3;

/// Source of the labels or predictions that are scored against the store's forces.
#[derive(Debug)]
pub enum EstimateSource<'a> {
    /// Labels (a) and (b), from the distances to the objects of the scene; given scenes come before those of the store.
    Labels(&'a [Scene]),
    /// A network, on the store's images.
    Predictor(&'a mut Predictor),
    /// Predictions of all stores, and the index of this store's first frame in them.
    Predictions(&'a TactileSequence, usize),
}

/// Scores every episode of `store`; `hands` must be on its topology.
///
/// # Errors
/// If an array is missing or has another shape, a scene is unknown or differs from the one that the store was made from,
/// or a prediction is on another topology.
pub fn score(
    store: &ZarrReader,
    hands: &[HandModel; 2],
    settings: &SweepSettings,
    mut source: EstimateSource,
) -> Result<Vec<Episode>> {
    let topology = store.attributes().topology;
    hands.iter().try_for_each(|hand| topology.must_match(hand.topology))?;
    if let EstimateSource::Predictor(predictor) = &source {
        topology.must_match(predictor.topology())?;
    }
    // Files that do not name their topology are taken to be on the store's.
    if let EstimateSource::Predictions(TactileSequence { topology: Some(predicted), .. }, _) = &source {
        topology.must_match(*predicted)?;
    }
    let mut episodes = Vec::new();
    for (index, range) in episode_ranges(store.episode_ends()).enumerate() {
        let named = |error: Error| Error::file(store.path(), format!("episode {index}: {error}"));
        episodes.push(episode(store, index, range, hands, settings, &mut source).map_err(named)?);
    }
    Ok(episodes)
}

fn episode(
    store: &ZarrReader,
    index: usize,
    range: Range<usize>,
    hands: &[HandModel; 2],
    settings: &SweepSettings,
    source: &mut EstimateSource,
) -> Result<Episode> {
    let data = Data::read(store, range.clone())?;
    let (name, seed) = stored_scene::origin(store, index);
    let mut near = match source {
        EstimateSource::Labels(scenes) => {
            let name = name.ok_or_else(|| missing(store, "episodes[..].scene"))?;
            let seed = seed.ok_or_else(|| missing(store, "episodes[..].seed"))?;
            Some(touchables(&find_scene(store, name, scenes)?, seed, hands, settings, &data)?)
        }
        _ => None,
    };
    if let EstimateSource::Predictor(predictor) = source {
        predictor.reset();
    }
    let candidates = if near.is_some() { settings.sweep() } else { Candidate::PREDICTIONS.to_vec() };
    let mut scorer = EpisodeScorer::new(&VertexGroups::links(hands), &candidates);
    for (at, frame) in range.enumerate() {
        let topology = hands[0].topology;
        let prediction: Option<TactileField> = match source {
            EstimateSource::Labels(_) => None,
            EstimateSource::Predictor(predictor) => {
                Some(predictor.push(&store.frame(frame)?.camera_ego_rgb, data.timestamps[at])?.field)
            }
            EstimateSource::Predictions(predictions, before) => {
                Some(TactileField { topology, ..predictions.field(*before + frame)? })
            }
        };
        let validity = data.validity(at)?;
        if validity != Validity::Valid {
            scorer.refuse(validity);
            continue;
        }
        let vertices = data.poses(at).map(|pose| pose.map(|pose| HandParams::from_array(&pose)));
        let vertices: [Option<Vec<Vec3>>; 2] =
            Side::BOTH.map(|side| Some(hands[side as usize].forward(vertices[side as usize].as_ref()?).vertices));
        let rows = at * N_FIELD..(at + 1) * N_FIELD;
        let mut positions = vec![Vec3::ZERO; N_FIELD];
        for side in Side::BOTH {
            if let Some(vertices) = &vertices[side as usize] {
                positions[side.range()].copy_from_slice(vertices);
            }
        }
        let mut mask = data.mask.get(rows.clone()).map(<[u8]>::to_vec).unwrap_or_default();
        // Hands that the predictor does not know leave all scores.
        let known = prediction.as_ref().map(TactileField::known_hands).unwrap_or_default();
        match mask.is_empty() {
            true => mask = known,
            false => mask.iter_mut().zip(known).for_each(|(mask, known)| *mask &= known),
        }
        let truth = TruthFrame::new(data.timestamps[at], data.force[rows].to_vec(), mask, positions, None)?;
        let distances = match &mut near {
            Some((touchables, names)) => {
                let hands = vertices.each_ref().map(|hand| hand.as_deref());
                Some(touchables.distances(hands, &data.objects(at, names), settings.reach())?)
            }
            None => None,
        };
        let near = distances.as_ref().map(|d| VertexDistances { points: &d.points, surface: &d.surface });
        scorer.push(&truth, near, prediction.as_ref())?;
    }
    let samplings = near.map(|(touchables, _)| touchables.samplings()).unwrap_or_default();
    Ok(scorer.finish(name.map_or_else(|| store.path().display().to_string(), str::to_owned), seed, samplings))
}

fn missing(store: &ZarrReader, name: &str) -> Error {
    let present = store.raw_attributes().keys().cloned().collect::<Vec<_>>().join(", ");
    let place = format!("{}, whose objects are not known without it", store.path().display());
    Error::Missing { name: format!("attribute {name}"), place, present }
}

fn find_scene(store: &ZarrReader, name: &str, given: &[Scene]) -> Result<Scene> {
    if let Some(scene) = given.iter().find(|scene| scene.name == name) {
        return Ok(scene.clone());
    }
    stored_scene::scene(store, name).map_err(|error| {
        Error::value(
            "scene",
            "one that the program ships, or its YAML file with --scene FILE",
            format!("{name} ({error})"),
        )
    })
}

/// Returns the surfaces that the hands can touch in the episode, and the names of the objects.
fn touchables(
    scene: &Scene,
    seed: u64,
    hands: &[HandModel; 2],
    settings: &SweepSettings,
    data: &Data,
) -> Result<(Touchables, Vec<String>)> {
    let betas = data.betas();
    let [left, right] = hands;
    let rigs = [HandRig::new(left.clone(), betas)?, HandRig::new(right.clone(), betas)?];
    let drawn = randomize::EpisodeDraw::sample(scene, seed, &rigs)?;
    // Stores hold poses of solid objects only.
    let solid = || drawn.objects.iter().filter(|object| object.solid);
    let names: Vec<String> = solid().map(|object| object.name.clone()).collect();
    for (object, pose) in solid().zip(data.objects(0, &names)) {
        let off = pose.position.distance(object.position);
        if off.is_nan() || off > START_TOLERANCE {
            let expected = format!("the one that the store was made from, with {} at {}", object.name, pose.position);
            return Err(Error::value(format!("scene {} with seed {seed}", scene.name), expected, object.position));
        }
    }
    Ok((Touchables::new(&drawn, hands.each_ref(), settings.spacing)?, names))
}

/// The arrays of one episode.
struct Data {
    timestamps: Vec<f64>,
    force: Vec<f32>,
    mask: Vec<u8>,
    validity: Vec<u8>,
    poses: [Vec<f32>; 2],
    objects: Vec<f32>,
}

impl Data {
    fn read(store: &ZarrReader, range: Range<usize>) -> Result<Self> {
        let or_none = |name: &str| -> Result<Vec<f32>> {
            if store.has(name) { store.read_f32(name, range.clone()) } else { Ok(Vec::new()) }
        };
        let bytes = |name: &str| -> Result<Vec<u8>> {
            if store.has(name) { store.read_u8(name, range.clone()) } else { Ok(Vec::new()) }
        };
        Ok(Self {
            timestamps: store.read(TIMESTAMPS, range.clone())?.into_f64(),
            force: store.read_f32(MANO_FORCE, range.clone())?,
            mask: bytes(MANO_FORCE_VALID)?,
            validity: bytes(FRAME_VALIDITY)?,
            poses: [or_none(LEFT_HAND_POSE)?, or_none(RIGHT_HAND_POSE)?],
            objects: or_none(OBJECT_POSE)?,
        })
    }

    fn validity(&self, at: usize) -> Result<Validity> {
        Validity::from_code(FRAME_VALIDITY, self.validity.get(at).copied().unwrap_or(0))
    }

    /// Returns the parameters of both hands; zeros in the store mean an absent hand.
    fn poses(&self, at: usize) -> [Option<[f32; 61]>; 2] {
        self.poses.each_ref().map(|rows| {
            let row: [f32; 61] = rows.get(at * 61..(at + 1) * 61)?.try_into().ok()?;
            row.iter().any(|x| *x != 0.0).then_some(row)
        })
    }

    /// Returns the shape of the hands; zeros if no hand is ever present.
    fn betas(&self) -> [f32; N_BETAS] {
        let present = (0..self.timestamps.len()).flat_map(|at| self.poses(at)).flatten().next();
        present.map_or([0.0; N_BETAS], |row| HandParams::from_array(&row).betas)
    }

    /// Returns the poses of the named objects, in the order of the scene; NaN for one that the store lacks.
    fn objects(&self, at: usize, names: &[String]) -> Vec<ObjectPose> {
        let frames = self.timestamps.len().max(1);
        let width = self.objects.len() / frames; // 7 per object
        let pose = |(index, name): (usize, &String)| {
            let start = at * width + 7 * index;
            let row = self.objects.get(start..start + 7).filter(|_| 7 * (index + 1) <= width);
            let [x, y, z, w, i, j, k] = std::array::from_fn(|n| row.map_or(f64::NAN, |row| f64::from(row[n])));
            let orientation = DQuat::from_xyzw(i, j, k, w).normalize();
            ObjectPose { name: name.clone(), position: DVec3::new(x, y, z), orientation }
        };
        names.iter().enumerate().map(pose).collect()
    }
}
