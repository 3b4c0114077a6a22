//! EgoTac-SC in the OXT release: Zarr stores with the taxels of AetherGloveV1, one trajectory per episode.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use glam::{DAffine3, DQuat, DVec3};
use serde_json::{Value, json};

use crate::dataset::source::SourceFrames;
use crate::dataset::zarr::{Store, StoreLocation, TIMESTAMPS, ZarrReader};
use crate::dataset::{EpisodeReader, ImageSource};
use crate::error::{Error, Result};
use crate::hand::{HandModel, Side};
use crate::import::glove::GloveMap;
use crate::import::input::folders;
use crate::import::kind::{Found, Kind, Mano, Options};
use crate::import::recording::{Convention, Moment, Reader, Recording};
use crate::tactile::{ForceKind, TactileField};

/// EgoTac-SC.
pub const KIND: Kind = Kind {
    name: "egotac-sc",
    gives: "images of the head camera, newtons of 132 taxels per hand on the vertices, camera pose",
    mano: Mano::Optional,
    origin: "EgoTac-SC-OXT: OXT stores (*.zarr, or zip files of them) with AetherGloveV1",
    licence: "not stated on the card",
    find,
};
/// Map of the glove.
const SENSOR: &str = "aether_132";
/// Channels: 60 of the fingers, 72 of the palm.
const CHANNELS: usize = 132;
/// Shape of a frame of the fingers: thumb to little finger, rows from the tip, columns.
const FINGERS: [usize; 3] = [5, 4, 3];
/// Shape of a frame of the palm: its first row has 12 taxels and 3 zeros.
const PALM: [usize; 3] = [1, 5, 15];
/// Zeros in the first row of the palm: the last cells of the left hand, the first ones of the right.
const PADDING: usize = 3;
/// Array of the camera's pose: position, m, and rotation vector, rad.
const CAMERA: &str = "data/camera_ego_pose";

fn find(source: &Path, options: &Options) -> Result<Found> {
    let map = GloveMap::open(options.sensor.as_deref().unwrap_or(SENSOR), CHANNELS, None)?;
    let mut found = Found::default();
    for place in places(source)? {
        // A bundle holds stores of the same names as others: the bundle's name keeps them apart.
        let name = match &place.inside {
            Some(_) if place.path != source => format!("{}/{}", stem(&place.path), place.name()),
            _ => place.name(),
        };
        let name = name.trim_end_matches(".zarr").to_string();
        match Trajectory::of_store(&place, &name, &map, options) {
            Ok(trajectories) => trajectories.into_iter().for_each(|(name, reader)| found.add(name, Ok(reader))),
            Err(error) => found.unreadable.push((name, error)),
        }
    }
    Ok(found)
}

/// Returns the stores at `source`, or in its folders: the release has its bundles in one.
fn places(source: &Path) -> Result<Vec<StoreLocation>> {
    let first = StoreLocation::find(source);
    if first.is_ok() || !source.is_dir() {
        return first;
    }
    let below = folders::folders(source)?;
    let all: Vec<StoreLocation> =
        below.iter().filter_map(|folder| StoreLocation::find(folder).ok()).flatten().collect();
    if all.is_empty() { first } else { Ok(all) }
}

fn stem(path: &Path) -> String {
    path.file_stem().unwrap_or_default().to_string_lossy().into_owned()
}

/// One episode of a store.
struct Trajectory {
    recording: Recording,
    store: Arc<Store>,
    reader: Arc<ZarrReader>,
    place: StoreLocation,
    unit: usize,
    /// First frame in the store.
    start: usize,
    glove: Arc<GloveMap>,
    kind: ForceKind,
}

impl Trajectory {
    /// Opens the episodes of a store, with their names.
    fn of_store(
        place: &StoreLocation,
        name: &str,
        glove: &Arc<GloveMap>,
        options: &Options,
    ) -> Result<Vec<(String, Self)>> {
        let store = Arc::new(Store::open(place, None, None)?);
        let reader = Arc::new(ZarrReader::open_at(place)?);
        check(&reader)?;
        let mut start = 0;
        let mut all = Vec::new();
        let ends = reader.episode_ends().to_vec();
        for (unit, end) in ends.iter().enumerate() {
            let name = if ends.len() == 1 { name.to_string() } else { format!("{name}_{unit}") };
            let recording = Recording {
                name: name.clone(),
                path: place.path.clone(),
                frames: end - start,
                objects: Vec::new(),
                convention: Convention::PLAIN,
                measures_force: false,
                camera: Value::Null,
                about: json!({
                    "glove": "AetherGloveV1",
                    "taxel_map": glove.layout().name,
                    "taxel_places": glove.layout().placement.name(),
                    "hand": "unknown: the release has joint angles that do not invert to MANO's",
                    "episode": unit,
                }),
                ..Recording::default()
            };
            all.push((
                name,
                Self {
                    recording,
                    store: store.clone(),
                    reader: reader.clone(),
                    place: place.clone(),
                    unit,
                    start,
                    glove: glove.clone(),
                    kind: options.force_kind.unwrap_or(ForceKind::Reading),
                },
            ));
            start = *end;
        }
        Ok(all)
    }

    /// Reads the taxels of a hand, (132) N; `None` = the store has none of it.
    fn taxels(&self, side: Side, index: usize) -> Result<Option<Vec<f32>>> {
        let [fingers, palm] = arrays(side);
        if !self.reader.has(&fingers) {
            return Ok(None);
        }
        let at = self.start + index;
        let mut taxels = self.reader.read_f32(&fingers, at..at + 1)?;
        let palm = self.reader.read_f32(&palm, at..at + 1)?;
        let columns = PALM[2];
        let padding = if side == Side::Left { columns - PADDING..columns } else { 0..PADDING };
        taxels.extend(
            palm.into_iter().enumerate().filter(|(cell, _)| !padding.contains(cell)).map(|(_, newtons)| newtons),
        );
        // Sensors read slightly below zero without touch; what is not finite is unknown.
        taxels.iter_mut().for_each(|newtons| *newtons = if newtons.is_finite() { newtons.max(0.0) } else { f32::NAN });
        Ok(Some(taxels))
    }

    fn camera(&self, index: usize) -> Result<Option<DAffine3>> {
        if !self.reader.has(CAMERA) {
            return Ok(None);
        }
        let at = self.start + index;
        let pose = self.reader.read(CAMERA, at..at + 1)?.into_f64();
        if pose.len() != 6 {
            return Err(Error::file(self.reader.path(), Error::shape(CAMERA, "(T, 6)", [1, pose.len()])));
        }
        if pose.iter().any(|value| !value.is_finite()) {
            return Ok(None);
        }
        let (position, turn) = (DVec3::from_slice(&pose[..3]), DVec3::from_slice(&pose[3..]));
        Ok(Some(DAffine3::from_rotation_translation(DQuat::from_scaled_axis(turn), position)))
    }
}

/// Names of the arrays of a hand's taxels: fingers and palm.
fn arrays(side: Side) -> [String; 2] {
    ["fingers", "palm"].map(|group| format!("data/{}_tactile_data_{group}", side.name()))
}

/// Checks that the store has the glove's arrays.
fn check(reader: &ZarrReader) -> Result<()> {
    let present = Side::BOTH.map(|side| arrays(side).map(|name| reader.has(&name)));
    if !present.iter().flatten().any(|has| *has) {
        let names = reader.arrays().into_iter().map(|array| array.name).collect::<Vec<_>>().join(", ");
        let place = reader.path().display().to_string();
        return Err(Error::Missing { name: arrays(Side::Right).join(" and "), place, present: names });
    }
    for (side, [fingers, palm]) in Side::BOTH.into_iter().zip(present) {
        if fingers != palm {
            let expected = format!("both of {}, or neither", arrays(side).join(" and "));
            return Err(Error::file(reader.path(), format!("expected {expected}, got one")));
        }
    }
    for array in reader.arrays() {
        for side in Side::BOTH {
            for (name, shape) in arrays(side).iter().zip([FINGERS, PALM]) {
                if array.name == *name && array.shape[1..] != shape {
                    return Err(Error::file(
                        reader.path(),
                        Error::shape(name, format!("(T, {shape:?})"), &array.shape),
                    ));
                }
            }
        }
    }
    Ok(())
}

impl Reader for Trajectory {
    fn recording(&self) -> &Recording {
        &self.recording
    }

    fn files(&self) -> Result<Vec<PathBuf>> {
        if self.place.inside.is_some() {
            return Ok(vec![self.place.path.clone()]);
        }
        // Chunks of arrays: those of the labels and of the images.
        let names =
            Side::BOTH.iter().flat_map(|side| arrays(*side)).chain([TIMESTAMPS.into(), self.store.camera().into()]);
        let mut files = Vec::new();
        for name in names {
            let folder = self.place.path.join(&name);
            if folder.is_dir() {
                files.extend(folders::files(&folder, "")?);
            }
        }
        Ok(files)
    }

    fn moment(&self, index: usize) -> Result<Moment> {
        let at = self.start + index;
        let stamp = self.reader.read(TIMESTAMPS, at..at + 1)?.into_f64();
        Ok(Moment {
            stamp_secs: stamp.first().copied().unwrap_or(f64::NAN) * self.store.time_unit(),
            world_from_reference: DAffine3::IDENTITY,
            world_from_camera: self.camera(index)?,
            hands: [None, None],
            objects: Vec::new(),
            forces: [None, None],
            readings: Vec::new(),
        })
    }

    fn touch(&self, index: usize, hands: [&HandModel; 2]) -> Result<Option<TactileField>> {
        let taxels = [self.taxels(Side::Left, index)?, self.taxels(Side::Right, index)?];
        let taxels = taxels.each_ref().map(|taxels| taxels.as_deref());
        self.glove.touch(taxels, self.kind, hands, &self.recording.path).map(Some)
    }

    fn force_kind(&self) -> Option<ForceKind> {
        Some(self.kind)
    }

    fn images(&self, from: usize) -> Result<SourceFrames<'_>> {
        self.store.frames(self.unit, from)
    }
}
