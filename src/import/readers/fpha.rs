//! FPHA, first-person hand actions: JPEG files, joints and object poses as text.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use glam::{DAffine3, DMat3, DVec3, Vec3};
use serde_json::json;

use crate::dataset::base_name;
use crate::dataset::source::SourceFrames;
use crate::error::{Error, Result};
use crate::file::{input, limits};
use crate::hand::N_KEYPOINTS;
use crate::import::input::folders;
use crate::import::input::images::Images;
use crate::import::input::lazy::Lazy;
use crate::import::input::numbers::{self, exactly};
use crate::import::kind::{Found, Kind, Mano, Options};
use crate::import::recording::{Moment, Reader, RecordedHand, RecordedObject, Recording};
use crate::import::shapes::MeshFile;

/// FPHA.
pub const KIND: Kind = Kind {
    name: "fpha",
    gives: "images of the head camera, the right hand fitted to 21 joints, 4 objects, camera pose",
    mano: Mano::Fitted,
    origin: "FPHA: Video_files, Hand_pose_annotation_v1, Object_6D_pose_annotation_v1, Object_models",
    licence: "academic research alone, not to be passed on",
    find,
};
/// Images per second.
const FPS: f64 = 30.0;
/// Length of the unit of joints and object poses, m.
const MILLIMETRE: f64 = 0.001;
/// Objects with a mesh; the actions with them contain their names.
const OBJECTS: [&str; 4] = ["juice_bottle", "liquid_soap", "milk", "salt"];
/// Place of each of our keypoints among the joints of a line: wrist, five knuckles, then three joints per finger.
const JOINTS: [usize; N_KEYPOINTS] = [0, 1, 6, 7, 8, 2, 9, 10, 11, 3, 12, 13, 14, 4, 15, 16, 17, 5, 18, 19, 20];

fn find(source: &Path, options: &Options) -> Result<Found> {
    let videos = source.join("Video_files");
    if !videos.is_dir() {
        return Err(Error::file(source, "expected the folder Video_files, got none"));
    }
    let objects = options.objects.clone().or_else(|| folders::first_of(source, &["Object_models"]));
    let mut found = Found::default();
    for subject in folders::folders(&videos)? {
        for action in folders::folders(&subject)? {
            for repetition in folders::folders(&action)? {
                let name = repetition.strip_prefix(&videos).unwrap_or(&repetition).display().to_string();
                let opened = Sequence::open(source, name.clone(), &repetition, objects.as_deref());
                found.add(name, opened);
            }
        }
    }
    Ok(found)
}

/// One repetition of an action.
struct Sequence {
    recording: Recording,
    images: Images,
    /// Numbers of the frames in the names of their images.
    numbers: Vec<usize>,
    skeleton: Option<PathBuf>,
    object: Option<PathBuf>,
    joints: Lazy<BTreeMap<usize, String>>,
    poses: Lazy<BTreeMap<usize, String>>,
}

impl Sequence {
    fn open(root: &Path, name: String, path: &Path, objects: Option<&Path>) -> Result<Self> {
        let folder = path.join("color");
        let mut files = Vec::new();
        for ending in [".jpeg", ".jpg", ".png"] {
            files.extend(folders::files(&folder, ending)?);
        }
        let numbers: Vec<usize> = files.iter().filter_map(|file| folders::number(file)).collect();
        if files.is_empty() || numbers.len() != files.len() {
            return Err(Error::file(&folder, "expected images with numbers at the end of their names"));
        }
        limits::FRAMES.check(&folder, "frames", files.len() as u64)?;
        let annotation = |folders: [&str; 2], file: &str| {
            folders.iter().map(|folder| root.join(folder).join(&name).join(file)).find(|path| path.is_file())
        };
        let skeleton = annotation(["Hand_pose_annotation_v1_1", "Hand_pose_annotation_v1"], "skeleton.txt");
        let object = annotation(["Object_6D_pose_annotation_v1_1", "Object_6D_pose_annotation_v1"], "object_pose.txt");
        let action = path.parent().map(base_name).unwrap_or_default();
        let touched = OBJECTS.iter().filter(|name| object.is_some() && action.contains(**name));
        let touched = touched.map(|name| {
            let file = |folder: &Path| folder.join(format!("{name}_model/{name}_model.ply"));
            let path = objects.map(file).filter(|path| path.is_file());
            RecordedObject { name: (*name).into(), mesh: path.map(|path| MeshFile::new(path, 1.0)) }
        });
        Ok(Self {
            recording: Recording {
                path: path.to_path_buf(),
                frames: files.len(),
                objects: touched.collect(),
                // Colour camera of the data set's documentation.
                camera: json!({
                    "fx": 1395.749023, "fy": 1395.749268, "cx": 935.732544, "cy": 540.681030,
                    "width": 1920, "height": 1080, "distortion": [0, 0],
                }),
                about: json!({ "action": action, "hand": "fitted to 21 joints" }),
                name,
                ..Recording::default()
            },
            images: Images::Files(files),
            numbers,
            skeleton,
            object,
            joints: Lazy::default(),
            poses: Lazy::default(),
        })
    }

    /// Returns the numbers of a frame's line after its number; `None` without such a line.
    fn line<const N: usize>(
        &self,
        path: &Path,
        lines: &Lazy<BTreeMap<usize, String>>,
        index: usize,
    ) -> Result<Option<[f64; N]>> {
        let lines = lines.get(path, || read_lines(path))?;
        let Some(line) = lines.get(&self.numbers[index]) else { return Ok(None) };
        let frame = format!("frame {}", self.numbers[index]);
        let values =
            numbers::parse(path, line).map_err(|error| Error::file(path, format!("{frame}: {}", message(&error))))?;
        exactly(path, &frame, &values).map(Some)
    }

    fn hand(&self, index: usize) -> Result<Option<RecordedHand>> {
        let Some(path) = &self.skeleton else { return Ok(None) };
        let Some(values) = self.line::<63>(path, &self.joints, index)? else { return Ok(None) };
        let joint = |place: usize| DVec3::from_slice(&values[3 * place..]) * MILLIMETRE;
        let keypoints: [Vec3; N_KEYPOINTS] = JOINTS.map(|place| joint(place).as_vec3());
        Ok(Some(RecordedHand::Keypoints(keypoints)))
    }

    fn object(&self, index: usize) -> Result<Option<DAffine3>> {
        let Some(path) = &self.object else { return Ok(None) };
        let Some(columns) = self.line::<16>(path, &self.poses, index)? else { return Ok(None) };
        let rows = std::array::from_fn(|k| columns[4 * (k % 4) + k / 4]);
        numbers::rigid(path, &format!("frame {}", self.numbers[index]), &rows, MILLIMETRE).map(Some)
    }

    fn stamp(&self, index: usize) -> f64 {
        self.numbers[index] as f64 / FPS
    }
}

/// Reads the lines of a file by the frame number at their beginning.
fn read_lines(path: &Path) -> Result<BTreeMap<usize, String>> {
    let text = input::read_text(path, limits::TEXT)?;
    let mut lines = BTreeMap::new();
    for (number, line) in text.lines().enumerate().filter(|(_, line)| !line.trim().is_empty()) {
        let (frame, values) = line.trim().split_once(char::is_whitespace).unwrap_or((line.trim(), ""));
        // Some writers give the frame as a real number.
        let frame = frame.parse::<f64>().ok().filter(|frame| frame.fract() == 0.0 && (0.0..1e9).contains(frame));
        let frame = frame.ok_or_else(|| Error::file(path, format!("line {}: expected a frame number", number + 1)))?;
        lines.insert(frame as usize, values.to_string());
    }
    Ok(lines)
}

/// Returns the message of an error of a file without its path.
fn message(error: &Error) -> String {
    match error {
        Error::File { message, .. } => message.clone(),
        other => other.to_string(),
    }
}

/// Returns `world_from_camera`: the colour camera in the frame of joints and objects, from the data set's documentation.
fn world_from_camera() -> DAffine3 {
    let rotation = DMat3::from_cols_array(&[
        0.999988496304,
        0.00469115935266,
        -0.000969709653873,
        -0.00468848412856,
        0.999985218048,
        0.00274303671904,
        0.000982563360594,
        -0.00273845880292,
        0.99999576807,
    ]);
    let camera_from_world = DAffine3::from_mat3_translation(rotation, DVec3::new(25.7, 1.22, 3.902) * MILLIMETRE);
    camera_from_world.inverse()
}

impl Reader for Sequence {
    fn recording(&self) -> &Recording {
        &self.recording
    }

    fn files(&self) -> Result<Vec<PathBuf>> {
        let mut files = Vec::new();
        files.extend(self.images.paths());
        files.extend([&self.skeleton, &self.object].into_iter().flatten().cloned());
        Ok(files)
    }

    fn moment(&self, index: usize) -> Result<Moment> {
        let objects = match self.recording.objects.is_empty() {
            true => Vec::new(),
            false => vec![self.object(index)?],
        };
        Ok(Moment {
            stamp_secs: self.stamp(index),
            world_from_reference: DAffine3::IDENTITY,
            world_from_camera: Some(world_from_camera()),
            hands: [None, self.hand(index)?],
            objects,
            forces: [None, None],
            readings: Vec::new(),
        })
    }

    fn images(&self, from: usize) -> Result<SourceFrames<'_>> {
        self.images.frames(from, |index| self.stamp(index))
    }

    fn release(&self) {
        self.joints.release();
        self.poses.release();
    }
}
