//! OakInk2: JPEG files of four cameras, and one pickle of arrays and tensors per sequence.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use glam::{DAffine3, DQuat, Vec3};
use serde_json::{Value, json};

use crate::dataset::base_name;
use crate::dataset::source::SourceFrames;
use crate::error::{Error, Result};
use crate::file::{input, limits};
use crate::hand::{N_BETAS, Side};
use crate::import::input::arrays::{Node, PickleFile};
use crate::import::input::folders;
use crate::import::input::images::Images;
use crate::import::input::lazy::Lazy;
use crate::import::input::numbers;
use crate::import::kind::{Found, Kind, Mano, Options};
use crate::import::recording::{
    Convention, ManoParams, Moment, PoseParams, Reader, RecordedHand, RecordedObject, Recording, Translation,
};
use crate::import::shapes::MeshFile;

/// OakInk2.
pub const KIND: Kind = Kind {
    name: "oakink2",
    gives: "images of the head camera, both hands, objects, camera pose",
    mano: Mano::Optional,
    origin: "OakInk2: data, anno_preview, object_raw",
    licence: "its authors' terms of use; MANO's for the hands",
    find,
};
/// Name of the head camera in `cam_def`.
const CAMERA: &str = "egocentric";
/// Frame numbers per second: those of motion capture.
const RATE: f64 = 120.0;
/// Prefixes of the left and the right hand's fields.
const PREFIX: [&str; 2] = ["lh", "rh"];
/// Largest deviation of a quaternion's length from 1.
const MAX_STRETCH: f64 = 1e-2;

fn find(source: &Path, options: &Options) -> Result<Found> {
    let annotations = folders::first_of(source, &["anno_preview", "anno"])
        .ok_or_else(|| Error::file(source, "expected the folder anno_preview, got none"))?;
    let objects = options
        .objects
        .clone()
        .or_else(|| folders::first_of(source, &["object_raw/align_ds", "object_repair/align_ds"]));
    let mut found = Found::default();
    for annotation in folders::files(&annotations, ".pkl")? {
        let name = base_name(&annotation).trim_end_matches(".pkl").to_string();
        let images = source.join("data").join(&name);
        found.add(name.clone(), Sequence::open(name, &images, &annotation, objects.as_deref()));
    }
    Ok(found)
}

/// One sequence.
struct Sequence {
    recording: Recording,
    images: Images,
    annotation: PathBuf,
    /// Frame numbers of the images.
    numbers: Vec<usize>,
    track: Lazy<Track>,
}

/// Annotations by frame number.
#[derive(Debug, Default)]
struct Track {
    hands: [BTreeMap<String, ManoParams>; 2],
    objects: Vec<BTreeMap<String, DAffine3>>,
    cameras: BTreeMap<String, DAffine3>,
}

impl Sequence {
    fn open(name: String, images: &Path, annotation: &Path, objects: Option<&Path>) -> Result<Self> {
        let content = input::read(annotation, limits::FILE)?;
        let file = PickleFile::parse(annotation, &content)?;
        let root = file.root();
        let cameras = root.get("cam_def")?.entries()?;
        let serial = cameras.iter().find(|(_, camera)| camera.text().as_deref() == Some(CAMERA));
        let Some((serial, _)) = serial else {
            return Err(Error::file(annotation, format!("cam_def: expected a camera {CAMERA:?}, got none")));
        };
        let serial = serial.clone();
        let folder = images.join(&serial);
        let files: Vec<PathBuf> =
            [".jpg", ".png"].iter().map(|ending| folders::files(&folder, ending)).collect::<Result<Vec<_>>>()?.concat();
        let numbers: Vec<usize> = files.iter().filter_map(|file| folders::number(file)).collect();
        if files.is_empty() || numbers.len() != files.len() {
            return Err(Error::file(&folder, "expected images with frame numbers as names"));
        }
        limits::FRAMES.check(&folder, "frames", files.len() as u64)?;
        let object = |node: &Node| -> Result<RecordedObject> {
            let name = node.text().ok_or_else(|| Error::file(annotation, "obj_list: expected names of objects"))?;
            let plain = !name.contains(['/', '\\']) && name != "..";
            let mesh = objects.filter(|_| plain).and_then(|folder| mesh(&folder.join(&name)));
            Ok(RecordedObject { name, mesh })
        };
        let objects = root.get("obj_list")?.items()?.iter().map(object).collect::<Result<Vec<_>>>()?;
        let intrinsics = root.get("cam_intr")?.get(CAMERA)?.entries()?;
        let camera = match intrinsics.first() {
            Some((_, matrix)) => {
                let k = matrix.numbers::<9>()?;
                json!({ "fx": k[0], "fy": k[4], "cx": k[2], "cy": k[5], "distortion": [0, 0] })
            }
            None => Value::Null,
        };
        Ok(Self {
            recording: Recording {
                name,
                path: annotation.to_path_buf(),
                frames: files.len(),
                objects,
                convention: Convention { translation: Translation::OfWrist, ..Convention::PLAIN },
                camera,
                about: json!({ "camera": serial }),
                ..Recording::default()
            },
            images: Images::Files(files),
            annotation: annotation.to_path_buf(),
            numbers,
            track: Lazy::default(),
        })
    }

    /// Reads the annotations of the frames that have images.
    fn track(&self) -> Result<Track> {
        let content = input::read(&self.annotation, limits::FILE)?;
        let file = PickleFile::parse(&self.annotation, &content)?;
        let root = file.root();
        let wanted: BTreeSet<String> = self.numbers.iter().map(ToString::to_string).collect();
        let motions = |node: Node| -> Result<BTreeMap<String, DAffine3>> {
            let motion = |(frame, matrix): (String, Node)| {
                let pose = numbers::rigid(&self.annotation, matrix.place(), &matrix.numbers()?, 1.0)?;
                Ok((frame, pose))
            };
            of_frames(&node, &wanted)?.into_iter().map(motion).collect()
        };
        let mut track = Track { cameras: motions(root.get("cam_extr")?.get(CAMERA)?)?, ..Track::default() };
        let poses = root.get("obj_transf")?;
        for object in &self.recording.objects {
            track.objects.push(motions(poses.get(&object.name)?)?);
        }
        for (frame, values) in of_frames(&root.get("raw_mano")?, &wanted)? {
            for side in Side::BOTH {
                if let Some(params) = self.params(&values, PREFIX[side as usize])? {
                    track.hands[side as usize].insert(frame.clone(), params);
                }
            }
        }
        Ok(track)
    }

    /// Reads the parameters of one hand in a frame; `None` if the frame does not have them.
    fn params(&self, frame: &Node, prefix: &str) -> Result<Option<ManoParams>> {
        let Ok(pose) = frame.get(&format!("{prefix}__pose_coeffs")) else { return Ok(None) };
        let quaternions = pose.numbers::<64>()?;
        let mut rotations = [Vec3::ZERO; 16];
        for (rotation, q) in rotations.iter_mut().zip(quaternions.as_chunks::<4>().0) {
            let quaternion = DQuat::from_xyzw(q[1], q[2], q[3], q[0]);
            if (quaternion.length() - 1.0).abs() > MAX_STRETCH {
                let got = format!("{}: expected quaternions of length 1, got {}", pose.place(), quaternion.length());
                return Err(Error::file(&self.annotation, got));
            }
            *rotation = quaternion.normalize().to_scaled_axis().as_vec3();
        }
        Ok(Some(ManoParams {
            betas: frame.get(&format!("{prefix}__betas"))?.numbers::<N_BETAS>()?.map(|beta| beta as f32),
            global_orient: rotations[0],
            hand_pose: PoseParams::AxisAngle(std::array::from_fn(|joint| rotations[joint + 1])),
            transl: Vec3::from_array(frame.get(&format!("{prefix}__tsl"))?.numbers::<3>()?.map(|x| x as f32)),
        }))
    }

    fn stamp(&self, index: usize) -> f64 {
        self.numbers[index] as f64 / RATE
    }
}

/// Returns the values of the wanted frames in a dictionary by frame number.
fn of_frames<'a>(node: &Node<'a>, wanted: &BTreeSet<String>) -> Result<Vec<(String, Node<'a>)>> {
    Ok(node.entries()?.into_iter().filter(|(frame, _)| wanted.contains(frame)).collect())
}

/// Returns the mesh in an object's folder.
fn mesh(folder: &Path) -> Option<MeshFile> {
    let files = [".obj", ".ply"].iter().filter_map(|ending| folders::files(folder, ending).ok()).flatten();
    files.into_iter().next().map(|path| MeshFile::new(path, 1.0))
}

impl Reader for Sequence {
    fn recording(&self) -> &Recording {
        &self.recording
    }

    fn files(&self) -> Result<Vec<PathBuf>> {
        let mut files = Vec::new();
        files.extend(self.images.paths());
        files.extend([self.annotation.clone()]);
        Ok(files)
    }

    fn moment(&self, index: usize) -> Result<Moment> {
        let track = self.track.get(&self.annotation, || self.track())?;
        let frame = self.numbers[index].to_string();
        let hand = |side: Side| track.hands[side as usize].get(&frame).cloned().map(RecordedHand::Mano);
        Ok(Moment {
            stamp_secs: self.stamp(index),
            world_from_reference: DAffine3::IDENTITY,
            world_from_camera: track.cameras.get(&frame).map(DAffine3::inverse),
            hands: Side::BOTH.map(hand),
            objects: track.objects.iter().map(|poses| poses.get(&frame).copied()).collect(),
            forces: [None, None],
            readings: Vec::new(),
        })
    }

    fn images(&self, from: usize) -> Result<SourceFrames<'_>> {
        self.images.frames(from, |index| self.stamp(index))
    }

    fn release(&self) {
        self.track.release();
    }
}
