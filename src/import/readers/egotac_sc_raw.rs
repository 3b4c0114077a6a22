//! EgoTac-SC as it was recorded: HDF5 streams of gloves and trackers with clocks of their own, and images.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use glam::{DAffine3, DMat3, DQuat, DVec3};
use serde_json::{Value, json};

use crate::dataset::base_name;
use crate::dataset::source::SourceFrames;
use crate::error::{Error, Result};
use crate::file::{input, limits};
use crate::hand::{HandModel, Side};
use crate::import::glove::GloveMap;
use crate::import::input::folders;
use crate::import::input::hdf5::Hdf5;
use crate::import::input::images::Images;
use crate::import::input::lazy::Lazy;
use crate::import::kind::{Found, Kind, Mano, Options};
use crate::import::recording::{Moment, Reader, Recording};
use crate::sensor::streams::{Stream, filter};
use crate::tactile::{ForceKind, TactileField};

/// Recordings of EgoTac-SC.
pub const KIND: Kind = Kind {
    name: "egotac-sc-raw",
    gives: "images of the head camera, newtons of 132 taxels per hand on the vertices at the images' stamps, camera pose",
    mano: Mano::Optional,
    origin: "EgoTac-SC recordings: ID/{Data_ID.hdf5, Camera_ID.json}, and Image_ID with the images of Image_ID.svo2",
    licence: "not stated",
    find,
};
/// Map of the glove.
const SENSOR: &str = "aether_132";
/// Numbers of the channels: five fingers of 12, then five that measure bending and are left out, then the palm.
const FINGER_CHANNELS: usize = 12;
const PALM_CHANNELS: std::ops::Range<usize> = 66..138;
const CHANNELS: usize = 5 * FINGER_CHANNELS + PALM_CHANNELS.end - PALM_CHANNELS.start;
/// Times of a stream's samples, in its group; streams without have those of the file.
const STAMPS: &str = "TimeStamps";
/// Milliseconds per second: unit of the stamps.
const MILLISECONDS: f64 = 1e3;
/// Longest time between two samples that are interpolated, s.
const MAX_GAP: f64 = 0.1;
/// Pose of the head's tracker.
const HEAD: &str = "state/HeadTracker";

fn find(source: &Path, options: &Options) -> Result<Found> {
    let glove = GloveMap::open(options.sensor.as_deref().unwrap_or(SENSOR), CHANNELS, None)?;
    let kind = options.force_kind.unwrap_or(ForceKind::Reading);
    let mut found = Found::default();
    let files = match source.is_file() {
        true => vec![source.to_path_buf()],
        false => {
            let all = std::iter::once(source.to_path_buf()).chain(folders::folders(source)?);
            all.map(|folder| folders::files(&folder, ".hdf5")).collect::<Result<Vec<_>>>()?.concat()
        }
    };
    for path in files {
        let base = base_name(&path);
        let Some(id) = base.strip_prefix("Data_").and_then(|name| name.strip_suffix(".hdf5")) else { continue };
        found.add(id.to_string(), Take::open(&path, id, &glove, kind));
    }
    Ok(found)
}

/// One recording.
struct Take {
    recording: Recording,
    images: Images,
    /// (frames) time of each image, s.
    stamps: Vec<f64>,
    streams: Lazy<Streams>,
    glove: Arc<GloveMap>,
    kind: ForceKind,
    fault: Option<String>,
}

/// Streams of a recording.
struct Streams {
    /// (132) N of the left and the right hand's taxels; `None` = no glove.
    taxels: [Option<Stream<Vec<f32>>>; 2],
    /// `world_from_tracker` of the head.
    head: Option<Stream<DAffine3>>,
}

impl Take {
    fn open(path: &Path, id: &str, glove: &Arc<GloveMap>, kind: ForceKind) -> Result<Self> {
        let folder = path.with_file_name(format!("Image_{id}"));
        let (files, stamps) = images(&folder)?;
        limits::FRAMES.check(&folder, "images", files.len() as u64)?;
        let file = Hdf5::open(path)?;
        let groups = Side::BOTH.map(port);
        let present = groups.iter().filter(|group| file.array(&format!("{group}/data_1")).is_ok_and(|a| a.is_some()));
        if present.count() == 0 {
            return Err(Error::file(
                path,
                format!("{}: expected the channels of a glove, got none", groups.join(" or ")),
            ));
        }
        let mut faults = Vec::new();
        for group in groups.iter().map(String::as_str).chain([HEAD]) {
            let stamps = seconds(&file, group)?;
            let late = stamps.len() - growing(&stamps).len();
            if late > 0 && file.arrays(group)?.iter().any(|name| name != STAMPS) {
                faults.push(format!("{group}: {late} samples whose stamps do not grow are left out"));
            }
        }
        let camera = path.with_file_name(format!("Camera_{id}.json"));
        let camera = match camera.is_file() {
            true => serde_json::from_str(&input::read_text(&camera, limits::TEXT)?)
                .map_err(|error| Error::file(&camera, format!("not JSON: {error}")))?,
            false => Value::Null,
        };
        Ok(Self {
            recording: Recording {
                name: id.to_string(),
                path: path.to_path_buf(),
                frames: files.len(),
                camera,
                about: json!({
                    "glove": "AetherGloveV1",
                    "taxel_map": glove.layout().name,
                    "taxel_places": glove.layout().placement.name(),
                    "filter": "mean of the first 10 samples subtracted, below 0.2 N cut off, mean of 3 samples",
                    "resampling": format!("forces linear, poses along screw motions, between samples at most {MAX_GAP} s apart"),
                    "hand": "unknown: the trackers are not on the wrists, and their offsets are not published",
                }),
                ..Recording::default()
            },
            images: Images::Files(files),
            stamps,
            streams: Lazy::default(),
            glove: Arc::clone(glove),
            kind,
            fault: (!faults.is_empty()).then(|| faults.join("; ")),
        })
    }

    fn streams(&self) -> Result<Arc<Streams>> {
        let path = &self.recording.path;
        self.streams.get(path, || {
            let file = Hdf5::open(path)?;
            Ok(Streams { taxels: [taxels(&file, Side::Left)?, taxels(&file, Side::Right)?], head: head(&file)? })
        })
    }
}

/// Returns the images of a folder in order of their stamps, which are their names, and the stamps, s.
fn images(folder: &Path) -> Result<(Vec<PathBuf>, Vec<f64>)> {
    let mut stamped = Vec::new();
    for path in folders::files(folder, "")? {
        let stem = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        match stem.parse::<f64>() {
            Ok(stamp) if stamp.is_finite() => stamped.push((stamp / MILLISECONDS, path)),
            _ => return Err(Error::file(&path, "expected an image named by its time stamp in milliseconds")),
        }
    }
    if stamped.is_empty() {
        let expected = "expected one image per frame, named by its time stamp in milliseconds (the ZED SDK extracts them from the \
                        .svo2 file), got none";
        return Err(Error::file(folder, expected));
    }
    stamped.sort_by(|a, b| a.0.total_cmp(&b.0));
    let (stamps, files) = stamped.into_iter().unzip();
    Ok((files, stamps))
}

/// Returns the group with a glove's channels.
fn port(side: Side) -> String {
    format!("state/{}Port", if side == Side::Left { "Left" } else { "Right" })
}

/// Reads the times of a stream, s: its own, or those of the file.
fn seconds(file: &Hdf5, group: &str) -> Result<Vec<f64>> {
    let array = match file.array(&format!("{group}/{STAMPS}"))? {
        Some(own) => own,
        None => file.required(STAMPS)?,
    };
    let stamps = array.numbers(0..array.rows()?)?;
    match stamps.iter().position(|stamp| !stamp.is_finite()) {
        Some(at) => Err(array.damaged(&format!("expected finite stamps, entry {at} is {}", stamps[at]))),
        None => Ok(stamps.into_iter().map(|stamp| stamp / MILLISECONDS).collect()),
    }
}

/// Returns the indices of the stamps that are newer than all before them.
fn growing(stamps: &[f64]) -> Vec<usize> {
    let mut newest = f64::NEG_INFINITY;
    let is_newer = |index: &usize| {
        let newer = stamps[*index] > newest;
        newest = newest.max(stamps[*index]);
        newer
    };
    (0..stamps.len()).filter(is_newer).collect()
}

/// Reads an array with one row of `width` numbers per stamp, (T, width) or, of width 1, (T).
fn column(file: &Hdf5, name: &str, rows: usize, width: usize) -> Result<Vec<f64>> {
    let array = file.required(name)?;
    let shape = array.shape();
    let fits = shape.first() == Some(&(rows as u64)) && shape.iter().skip(1).product::<u64>() == width as u64;
    match fits {
        true => array.numbers(0..rows),
        false => Err(array.damaged(&format!("expected {rows} rows of {width}, one per stamp, got {shape:?}"))),
    }
}

/// Reads the taxels of a hand, filtered; `None` = no glove.
fn taxels(file: &Hdf5, side: Side) -> Result<Option<Stream<Vec<f32>>>> {
    let group = port(side);
    if file.array(&format!("{group}/data_1"))?.is_none() {
        return Ok(None);
    }
    let stamps = seconds(file, &group)?;
    let finger = |finger: usize| finger * FINGER_CHANNELS + 1..(finger + 1) * FINGER_CHANNELS + 1;
    // Both hands count from thumb to little finger after this.
    let fingers: Vec<usize> = match side {
        Side::Left => (0..5).rev().flat_map(finger).collect(),
        Side::Right => (0..5).flat_map(finger).collect(),
    };
    let mut samples = vec![Vec::with_capacity(CHANNELS); stamps.len()];
    for channel in fingers.into_iter().chain(PALM_CHANNELS) {
        let values = column(file, &format!("{group}/data_{channel}"), stamps.len(), 1)?;
        samples.iter_mut().zip(values).for_each(|(sample, value)| sample.push(value as f32));
    }
    let kept = growing(&stamps);
    let mut samples: Vec<Vec<f32>> = kept.iter().map(|index| std::mem::take(&mut samples[*index])).collect();
    filter(&mut samples);
    Ok(Some(Stream::new(kept.into_iter().map(|index| stamps[index]).collect(), samples)?))
}

/// Reads the poses of the head's tracker; `None` = there are none. Poses without a rotation are left out.
fn head(file: &Hdf5) -> Result<Option<Stream<DAffine3>>> {
    if file.array(&format!("{HEAD}/pos"))?.is_none() {
        return Ok(None);
    }
    let stamps = seconds(file, HEAD)?;
    let positions = column(file, &format!("{HEAD}/pos"), stamps.len(), 3)?;
    let turns = column(file, &format!("{HEAD}/quaternion"), stamps.len(), 4)?;
    let mut stream = Stream::default();
    for (index, stamp) in stamps.into_iter().enumerate() {
        let position = DVec3::from_slice(&positions[3 * index..]);
        let turn = DQuat::from_slice(&turns[4 * index..]);
        if position.is_finite() && turn.is_finite() && (turn.length() - 1.0).abs() < 1e-2 {
            stream.push(stamp, DAffine3::from_rotation_translation(turn.normalize(), position));
        }
    }
    Ok(Some(stream))
}

/// Returns `tracker_from_camera`: x and y of the tracker point to the left and up in the image.
fn tracker_from_camera() -> DAffine3 {
    DAffine3::from_mat3(DMat3::from_diagonal(DVec3::new(-1.0, -1.0, 1.0)))
}

impl Reader for Take {
    fn recording(&self) -> &Recording {
        &self.recording
    }

    fn files(&self) -> Result<Vec<PathBuf>> {
        Ok(std::iter::once(self.recording.path.clone()).chain(self.images.paths()).collect())
    }

    fn damage(&self) -> Option<String> {
        self.fault.clone()
    }

    fn moment(&self, index: usize) -> Result<Moment> {
        let stamp = self.stamps[index];
        let streams = self.streams()?;
        let head = streams.head.as_ref().and_then(|head| head.rigid(stamp, MAX_GAP));
        Ok(Moment {
            stamp_secs: stamp,
            world_from_reference: DAffine3::IDENTITY,
            world_from_camera: head.map(|tracker| tracker * tracker_from_camera()),
            hands: [None, None],
            objects: Vec::new(),
            forces: [None, None],
            readings: Vec::new(),
        })
    }

    fn touch(&self, index: usize, hands: [&HandModel; 2]) -> Result<Option<TactileField>> {
        let streams = self.streams()?;
        let at = |stream: &Option<Stream<Vec<f32>>>| stream.as_ref()?.linear(self.stamps[index], MAX_GAP);
        let newtons = streams.taxels.each_ref().map(at);
        let newtons = newtons.each_ref().map(|newtons| newtons.as_deref());
        self.glove.touch(newtons, self.kind, hands, &self.recording.path).map(Some)
    }

    fn force_kind(&self) -> Option<ForceKind> {
        Some(self.kind)
    }

    fn images(&self, from: usize) -> Result<SourceFrames<'_>> {
        self.images.frames(from, |index| self.stamps[index])
    }

    fn release(&self) {
        self.streams.release();
    }
}
