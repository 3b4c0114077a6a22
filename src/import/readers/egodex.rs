//! EgoDex: a video and an HDF5 file of joint transforms per episode.

use std::path::{Path, PathBuf};

use glam::{DAffine3, Vec3};
use serde_json::{Value, json};

use crate::dataset::source::SourceFrames;
use crate::error::{Error, Result};
use crate::hand::{N_KEYPOINTS, Side};
use crate::import::input::folders;
use crate::import::input::hdf5::Hdf5;
use crate::import::input::images::{self, Images};
use crate::import::input::lazy::Lazy;
use crate::import::input::numbers;
use crate::import::kind::{Found, Kind, Mano, Options};
use crate::import::recording::{Moment, Reader, RecordedHand, Recording};

/// EgoDex.
pub const KIND: Kind = Kind {
    name: "egodex",
    gives: "video of the head camera to be labelled, both hands fitted to 21 joints, camera pose",
    mano: Mano::Fitted,
    origin: "EgoDex: {part*, extra, test}/TASK/N.{hdf5, mp4}",
    licence: "CC BY-NC-ND 4.0: for labelling, not for derived data sets",
    find,
};
/// Pose of the camera's optical frame in the world.
const CAMERA: &str = "transforms/camera";
/// Joints of a hand in the order of our keypoints, without the side.
const JOINTS: [&str; N_KEYPOINTS] = [
    "Hand",
    "ThumbKnuckle",
    "ThumbIntermediateBase",
    "ThumbIntermediateTip",
    "ThumbTip",
    "IndexFingerKnuckle",
    "IndexFingerIntermediateBase",
    "IndexFingerIntermediateTip",
    "IndexFingerTip",
    "MiddleFingerKnuckle",
    "MiddleFingerIntermediateBase",
    "MiddleFingerIntermediateTip",
    "MiddleFingerTip",
    "RingFingerKnuckle",
    "RingFingerIntermediateBase",
    "RingFingerIntermediateTip",
    "RingFingerTip",
    "LittleFingerKnuckle",
    "LittleFingerIntermediateBase",
    "LittleFingerIntermediateTip",
    "LittleFingerTip",
];
/// Confidence in the wrist below which a hand is unknown: the tracker then extrapolates an unseen hand.
const CONFIDENT: f64 = 0.5;
/// Depth at which episodes lie, at most.
const MAX_DEPTH: usize = 4;

fn find(source: &Path, _: &Options) -> Result<Found> {
    let mut found = Found::default();
    let mut folders = vec![source.to_path_buf()];
    for _ in 0..MAX_DEPTH {
        for folder in &folders {
            for path in folders::files(folder, ".hdf5")? {
                let name = path.strip_prefix(source).unwrap_or(&path).with_extension("").display().to_string();
                found.add(name.clone(), Episode::open(&path, name));
            }
        }
        folders = folders.iter().map(|folder| folders::folders(folder)).collect::<Result<Vec<_>>>()?.concat();
    }
    Ok(found)
}

/// One episode.
struct Episode {
    recording: Recording,
    images: Images,
    path: PathBuf,
    fps: f64,
    file: Lazy<Hdf5>,
}

impl Episode {
    fn open(path: &Path, name: String) -> Result<Self> {
        let file = Hdf5::open(path)?;
        let frames = file.required(CAMERA)?.expect(&[0, 4, 4])?.rows()?;
        let video = path.with_extension("mp4");
        if !video.is_file() {
            return Err(Error::file(&video, "expected the video of this episode, got none"));
        }
        let fps = images::video(&video, frames)?.fps;
        let camera = match file.array("camera/intrinsic")? {
            Some(array) => {
                let k = array.expect(&[3, 3])?.numbers(0..3)?;
                json!({ "fx": k[0], "fy": k[4], "cx": k[2], "cy": k[5], "distortion": [0, 0] })
            }
            None => Value::Null,
        };
        // Of a task that can be done in both directions, one of two descriptions holds.
        let second = file.text("", "which_llm_description").is_some_and(|which| which.trim() == "2")
            || file.number("", "which_llm_description") == Some(2.0);
        let description = if second { "llm_description2" } else { "llm_description" };
        Ok(Self {
            recording: Recording {
                path: path.to_path_buf(),
                frames,
                camera,
                about: json!({
                    "task": path.parent().map(crate::dataset::base_name),
                    "description": file.text("", description),
                    "hand": "fitted to 21 joints",
                }),
                name,
                ..Recording::default()
            },
            images: Images::Video(video),
            path: path.to_path_buf(),
            fps,
            file: Lazy::default(),
        })
    }

    /// Reads one transform of a frame; `None` if the file has none of this name.
    fn transform(&self, file: &Hdf5, name: &str, index: usize) -> Result<Option<[f64; 16]>> {
        let Some(array) = file.array(name)? else { return Ok(None) };
        let values = array.expect(&[self.recording.frames, 4, 4])?.numbers(index..index + 1)?;
        let rows = <[f64; 16]>::try_from(values).ok();
        Ok(rows.filter(|rows| rows.iter().all(|value| value.is_finite())))
    }

    fn hand(&self, file: &Hdf5, side: Side, index: usize) -> Result<Option<RecordedHand>> {
        let side = side.name();
        if let Some(confidence) = file.array(&format!("confidences/{side}Hand"))? {
            let confidence = confidence.expect(&[self.recording.frames])?.numbers(index..index + 1)?;
            if confidence.first().is_none_or(|confidence| confidence.is_nan() || *confidence < CONFIDENT) {
                return Ok(None);
            }
        }
        let mut keypoints = [Vec3::ZERO; N_KEYPOINTS];
        for (keypoint, joint) in keypoints.iter_mut().zip(JOINTS) {
            let Some(rows) = self.transform(file, &format!("transforms/{side}{joint}"), index)? else {
                return Ok(None);
            };
            *keypoint = Vec3::new(rows[3] as f32, rows[7] as f32, rows[11] as f32);
        }
        Ok(Some(RecordedHand::Keypoints(keypoints)))
    }
}

impl Reader for Episode {
    fn recording(&self) -> &Recording {
        &self.recording
    }

    fn files(&self) -> Result<Vec<PathBuf>> {
        Ok([self.images.paths(), vec![self.path.clone()]].concat())
    }

    fn moment(&self, index: usize) -> Result<Moment> {
        let file = self.file.get(&self.path, || Hdf5::open(&self.path))?;
        let world_from_camera = match self.transform(&file, CAMERA, index)? {
            Some(rows) => Some(numbers::rigid(&self.path, &format!("{CAMERA}[{index}]"), &rows, 1.0)?),
            None => None,
        };
        Ok(Moment {
            stamp_secs: index as f64 / self.fps,
            world_from_reference: DAffine3::IDENTITY,
            world_from_camera,
            hands: [self.hand(&file, Side::Left, index)?, self.hand(&file, Side::Right, index)?],
            objects: Vec::new(),
            forces: [None, None],
            readings: Vec::new(),
        })
    }

    fn images(&self, from: usize) -> Result<SourceFrames<'_>> {
        self.images.frames(from, |index| index as f64 / self.fps)
    }

    fn release(&self) {
        self.file.release();
    }
}
