//! H2O: folders of PNG and text files, one per frame.

use std::path::{Path, PathBuf};

use glam::DAffine3;
use serde_json::{Value, json};

use crate::dataset::base_name;
use crate::dataset::source::SourceFrames;
use crate::error::{Error, Result};
use crate::file::limits;
use crate::hand::Side;
use crate::import::input::folders;
use crate::import::input::images::Images;
use crate::import::input::numbers::{self, exactly, vec3};
use crate::import::kind::{Found, Kind, Mano, Options};
use crate::import::recording::{ManoParams, Moment, PoseParams, Reader, RecordedHand, RecordedObject, Recording};
use crate::import::shapes::MeshFile;

/// H2O.
pub const KIND: Kind = Kind {
    name: "h2o",
    gives: "images of the head camera, both hands, the object, camera pose",
    mano: Mano::Optional,
    origin: "H2O: subject*/*/*/cam4 and object",
    licence: "its authors' terms of use; MANO's for the hands",
    find,
};
/// Folder of the head camera.
const CAMERA: &str = "cam4";
/// Images per second.
const FPS: f64 = 30.0;
/// Names of the objects by class; class 0 is not an object.
const OBJECTS: [&str; 9] = ["", "book", "espresso", "lotion", "spray", "milk", "cocoa", "chips", "cappuccino"];
/// Numbers of one hand: valid, translation 3, pose 48, shape 10.
const HAND: usize = 62;
/// Depth at which folders of the head camera lie, at most.
const MAX_DEPTH: usize = 5;

fn find(source: &Path, options: &Options) -> Result<Found> {
    let mut cameras = Vec::new();
    cameras_below(source, 0, &mut cameras)?;
    let usual = || source.ancestors().take(5).map(|folder| folder.join("object")).find(|folder| folder.is_dir());
    let objects = options.objects.clone().or_else(usual);
    let mut found = Found::default();
    for camera in cameras {
        let above = camera.parent().unwrap_or(source);
        let name = above.strip_prefix(source).unwrap_or(above).display().to_string();
        let name = if name.is_empty() { base_name(above) } else { name };
        found.add(name.clone(), Sequence::open(name, &camera, objects.as_deref()));
    }
    Ok(found)
}

/// Finds the folders of the head camera at or below `folder`.
fn cameras_below(folder: &Path, depth: usize, found: &mut Vec<PathBuf>) -> Result<()> {
    if base_name(folder) == CAMERA {
        found.push(folder.to_path_buf());
    } else if depth < MAX_DEPTH {
        for below in folders::folders(folder)? {
            cameras_below(&below, depth + 1, found)?;
        }
    }
    Ok(())
}

/// One sequence, seen by the head camera.
struct Sequence {
    recording: Recording,
    images: Images,
    /// Numbers of the frames in the names of their files.
    numbers: Vec<usize>,
    /// Folders of hands, object and camera; `None` = not there.
    hands: Option<PathBuf>,
    object: Option<PathBuf>,
    camera: Option<PathBuf>,
    /// Class of the object.
    class: Option<usize>,
}

impl Sequence {
    fn open(name: String, path: &Path, objects: Option<&Path>) -> Result<Self> {
        let folder = folders::first_of(path, &["rgb", "rgb256"])
            .ok_or_else(|| Error::file(path, "expected a folder rgb or rgb256, got none"))?;
        let mut files = Vec::new();
        for ending in [".png", ".jpg"] {
            files.extend(folders::files(&folder, ending)?);
        }
        let numbers: Vec<usize> = files.iter().filter_map(|file| folders::number(file)).collect();
        if files.is_empty() || numbers.len() != files.len() {
            return Err(Error::file(&folder, "expected images with numbers as names"));
        }
        limits::FRAMES.check(&folder, "frames", files.len() as u64)?;
        let intrinsics = path.join("cam_intrinsics.txt");
        let camera = match intrinsics.is_file() {
            true => {
                let [fx, fy, cx, cy, width, height] = exactly(&intrinsics, "intrinsics", &numbers::read(&intrinsics)?)?;
                json!({ "fx": fx, "fy": fy, "cx": cx, "cy": cy, "width": width, "height": height, "distortion": [0, 0] })
            }
            false => Value::Null,
        };
        let mut sequence = Self {
            recording: Recording {
                name,
                path: path.to_path_buf(),
                frames: files.len(),
                camera,
                about: json!({ "images": base_name(&folder) }),
                ..Recording::default()
            },
            images: Images::Files(files),
            numbers,
            hands: folders::first_of(path, &["hand_pose_MANO", "hand_pose_mano"]),
            object: folders::first_of(path, &["obj_pose_RT", "obj_pose_rt"]),
            camera: folders::first_of(path, &["cam_pose"]),
            class: None,
        };
        // One object per sequence; the first annotation that can be read tells which.
        let classes = (0..sequence.numbers.len()).filter_map(|index| sequence.object(index).ok().flatten());
        sequence.class = classes.map(|(class, _)| class).find(|class| *class > 0);
        if let Some(class) = sequence.class {
            let mesh = objects.and_then(|folder| mesh(folder, OBJECTS[class]));
            sequence.recording.objects.push(RecordedObject { name: OBJECTS[class].into(), mesh });
        }
        Ok(sequence)
    }

    fn file(&self, folder: &Option<PathBuf>, index: usize) -> Option<PathBuf> {
        Some(folder.as_ref()?.join(format!("{:06}.txt", self.numbers[index]))).filter(|path| path.is_file())
    }

    /// Reads class and pose of the object, `camera_from_object`.
    fn object(&self, index: usize) -> Result<Option<(usize, DAffine3)>> {
        let Some(path) = self.file(&self.object, index) else { return Ok(None) };
        let values: [f64; 17] = exactly(&path, "class and pose", &numbers::read(&path)?)?;
        let class = values[0];
        if class.fract() != 0.0 || !(0.0..OBJECTS.len() as f64).contains(&class) {
            let expected = format!("class: expected 0 to {}, got {class}", OBJECTS.len() - 1);
            return Err(Error::file(&path, expected));
        }
        if class == 0.0 {
            return Ok(None);
        }
        let rows: [f64; 16] = exactly(&path, "pose", &values[1..])?;
        Ok(Some((class as usize, numbers::rigid(&path, "pose", &rows, 1.0)?)))
    }

    fn hands(&self, index: usize) -> Result<[Option<RecordedHand>; 2]> {
        let Some(path) = self.file(&self.hands, index) else { return Ok([None, None]) };
        let values: [f64; 2 * HAND] = exactly(&path, "both hands", &numbers::read(&path)?)?;
        let hand = |side: Side| {
            let values = &values[HAND * side as usize..][..HAND];
            (values[0] != 0.0).then(|| {
                RecordedHand::Mano(ManoParams {
                    betas: std::array::from_fn(|beta| values[52 + beta] as f32),
                    global_orient: vec3(&values[4..]),
                    hand_pose: PoseParams::AxisAngle(std::array::from_fn(|joint| vec3(&values[7 + 3 * joint..]))),
                    transl: vec3(&values[1..]),
                })
            })
        };
        Ok(Side::BOTH.map(hand))
    }

    fn stamp(&self, index: usize) -> f64 {
        self.numbers[index] as f64 / FPS
    }
}

/// Returns the mesh of an object: usually called as its folder, in one case otherwise.
fn mesh(folder: &Path, name: &str) -> Option<MeshFile> {
    let folder = folder.join(name);
    let usual = folder.join(format!("{name}.obj"));
    let path = if usual.is_file() { usual } else { folders::files(&folder, ".obj").ok()?.into_iter().next()? };
    Some(MeshFile::new(path, 1.0))
}

impl Reader for Sequence {
    fn recording(&self) -> &Recording {
        &self.recording
    }

    fn files(&self) -> Result<Vec<PathBuf>> {
        let mut files = Vec::new();
        files.extend(self.images.paths());
        for folder in [&self.hands, &self.object, &self.camera].into_iter().flatten() {
            files.extend(folders::files(folder, ".txt")?);
        }
        files.extend([self.recording.path.join("cam_intrinsics.txt")]);
        Ok(files)
    }

    fn moment(&self, index: usize) -> Result<Moment> {
        let world_from_camera = match self.file(&self.camera, index) {
            Some(path) => {
                let rows = exactly(&path, "camera pose", &numbers::read(&path)?)?;
                Some(numbers::rigid(&path, "camera pose", &rows, 1.0)?)
            }
            None => None,
        };
        let object = self.object(index)?;
        if let (Some((class, _)), Some(expected), Some(path)) = (object, self.class, self.file(&self.object, index))
            && class != expected
        {
            return Err(Error::file(path, format!("class: expected {expected}, as in the frames before, got {class}")));
        }
        Ok(Moment {
            stamp_secs: self.stamp(index),
            world_from_reference: world_from_camera.unwrap_or(DAffine3::IDENTITY),
            world_from_camera,
            hands: self.hands(index)?,
            objects: self.class.iter().map(|_| object.map(|(_, pose)| pose)).collect(),
            forces: [None, None],
            readings: Vec::new(),
        })
    }

    fn images(&self, from: usize) -> Result<SourceFrames<'_>> {
        self.images.frames(from, |index| self.stamp(index))
    }
}
