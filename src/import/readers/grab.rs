//! GRAB: one `.npz` file of pickled dictionaries per sequence, without images.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use glam::{DAffine3, DQuat, DVec3};
use serde_json::json;

use crate::dataset::base_name;
use crate::dataset::source::SourceFrames;
use crate::error::{Error, Result};
use crate::file::{input, limits, mesh};
use crate::hand::{N_BETAS, Side};
use crate::import::input::arrays::{Node, PickleFile};
use crate::import::input::folders;
use crate::import::input::images::Images;
use crate::import::input::lazy::Lazy;
use crate::import::input::numbers::vec3;
use crate::import::kind::{Found, Kind, Mano, Options};
use crate::import::recording::{ManoParams, Moment, PoseParams, Reader, RecordedHand, RecordedObject, Recording, View};
use crate::import::shapes::MeshFile;
use crate::numpy::{Array, Npz};

/// GRAB.
pub const KIND: Kind = Kind {
    name: "grab",
    gives: "both hands in their scanned shape, the object; no images",
    mano: Mano::Optional,
    origin: "GRAB: grab/s*/*.npz, tools/object_meshes, tools/subject_meshes",
    licence: "GRAB licence, for non-commercial research; MANO's for the hands",
    find,
};
/// Frames per second.
const FPS: f64 = 120.0;

fn find(source: &Path, options: &Options) -> Result<Found> {
    let sequences = folders::first_of(source, &["grab"]).unwrap_or_else(|| source.to_path_buf());
    let root = sequences.parent().unwrap_or(source).to_path_buf();
    let objects = options.objects.clone().unwrap_or_else(|| root.join("tools/object_meshes/contact_meshes"));
    let mut found = Found::default();
    for subject in [vec![sequences.clone()], folders::folders(&sequences)?].concat() {
        for path in folders::files(&subject, ".npz")? {
            let name = path.strip_prefix(&sequences).unwrap_or(&path).with_extension("").display().to_string();
            found.add(name.clone(), Sequence::open(&path, name, &root, &objects));
        }
    }
    Ok(found)
}

/// One sequence.
struct Sequence {
    recording: Recording,
    path: PathBuf,
    images: Images,
    hands: [Lazy<Vec<ManoParams>>; 2],
    object: Lazy<Vec<DAffine3>>,
    /// Files of the hands' scanned shapes that were read.
    scans: Vec<PathBuf>,
}

impl Sequence {
    fn open(path: &Path, name: String, root: &Path, objects: &Path) -> Result<Self> {
        let content = member(path, "object")?;
        let file = PickleFile::parse_npy(path, &content).map_err(|error| named(path, "object", error))?;
        let transl = file.root().get("params")?.get("transl")?.shaped(&[0, 3])?;
        let frames = transl.shape[0];
        if frames == 0 {
            return Err(Error::file(path, "object.params.transl: expected at least one frame, got none"));
        }
        limits::FRAMES.check(path, "frames", frames as u64)?;
        // The path in the file refers to the data set's root; only its name is taken from it.
        let mesh = file.root().get("object_mesh").ok().and_then(|node| node.text());
        let mesh = mesh.map(|mesh| objects.join(base_name(Path::new(&mesh)))).filter(|path| path.is_file());
        let object = base_name(path).split('_').next().unwrap_or_default().to_string();
        let (mut templates, mut scans) = ([None, None], Vec::new());
        for side in Side::BOTH {
            let Some(scan) = scan(path, root, side)? else { continue };
            let (vertices, _) = mesh::read(&scan)?;
            templates[side as usize] = Some(Arc::new(vertices));
            scans.push(scan);
        }
        Ok(Self {
            recording: Recording {
                name,
                path: path.to_path_buf(),
                frames,
                objects: vec![RecordedObject { name: object, mesh: mesh.map(|path| MeshFile::new(path, 1.0)) }],
                view: View::None,
                templates,
                about: json!({ "subject": path.parent().map(base_name) }),
                ..Recording::default()
            },
            path: path.to_path_buf(),
            images: Images::Black(frames),
            hands: Default::default(),
            object: Lazy::default(),
            scans,
        })
    }

    fn track(&self, side: Side) -> Result<Vec<ManoParams>> {
        let field = member_name(side);
        let content = member(&self.path, field)?;
        let file = PickleFile::parse_npy(&self.path, &content).map_err(|error| named(&self.path, field, error))?;
        let params = file.root().get("params")?;
        let shaped = |name: &str, width: usize| params.get(name)?.shaped(&[self.recording.frames, width]);
        let (orient, transl, pose) = (shaped("global_orient", 3)?, shaped("transl", 3)?, pose(&params)?);
        let width = pose.shape[1];
        if pose.shape[0] != self.recording.frames {
            let expected = format!("{field}.params: expected {} frames, got {}", self.recording.frames, pose.shape[0]);
            return Err(Error::file(&self.path, expected));
        }
        let hand = |frame: usize| {
            let angles = &pose.data[frame * width..][..width];
            ManoParams {
                betas: [0.0; N_BETAS],
                global_orient: vec3(&orient.data[3 * frame..]),
                hand_pose: match width {
                    45 => PoseParams::AxisAngle(std::array::from_fn(|joint| vec3(&angles[3 * joint..]))),
                    _ => PoseParams::Coefficients(angles.iter().map(|value| *value as f32).collect()),
                },
                transl: vec3(&transl.data[3 * frame..]),
            }
        };
        Ok((0..self.recording.frames).map(hand).collect())
    }

    fn motions(&self) -> Result<Vec<DAffine3>> {
        let content = member(&self.path, "object")?;
        let file = PickleFile::parse_npy(&self.path, &content).map_err(|error| named(&self.path, "object", error))?;
        let params = file.root().get("params")?;
        let orient = params.get("global_orient")?.shaped(&[self.recording.frames, 3])?;
        let transl = params.get("transl")?.shaped(&[self.recording.frames, 3])?;
        let motion = |frame: usize| {
            let [turn, place] = [&orient, &transl].map(|array| DVec3::from_slice(&array.data[3 * frame..]));
            // The data set multiplies vertices as rows, so its rotations are the inverse ones.
            DAffine3::from_rotation_translation(DQuat::from_scaled_axis(-turn), place)
        };
        Ok((0..self.recording.frames).map(motion).collect())
    }
}

/// Returns the pose of a hand over time: all 45 angles, or coefficients of MANO's components.
fn pose(params: &Node) -> Result<Array> {
    if let Ok(full) = params.get("fullpose").and_then(|node| node.shaped(&[0, 45])) {
        return Ok(full);
    }
    params.get("hand_pose")?.shaped(&[0, 0])
}

/// Returns the file of a hand's scanned shape, if the data set has it.
fn scan(path: &Path, root: &Path, side: Side) -> Result<Option<PathBuf>> {
    let field = member_name(side);
    let content = member(path, field)?;
    let file = PickleFile::parse_npy(path, &content).map_err(|error| named(path, field, error))?;
    let Some(text) = file.root().get("vtemp")?.text() else { return Ok(None) };
    let scan = Path::new(&text);
    let gender = scan.parent().map(base_name).unwrap_or_default();
    let scan = root.join("tools/subject_meshes").join(gender).join(base_name(scan));
    Ok(scan.is_file().then_some(scan))
}

fn member_name(side: Side) -> &'static str {
    match side {
        Side::Left => "lhand",
        Side::Right => "rhand",
    }
}

/// Reads a member of the archive, a `.npy` file of one pickled dictionary.
fn member(path: &Path, name: &str) -> Result<Vec<u8>> {
    let archive = Npz::new(std::io::BufReader::new(input::open(path)?));
    let content = archive.and_then(|mut archive| archive.member(name)).map_err(|error| Error::library(path, error))?;
    content.ok_or_else(|| Error::file(path, format!("{name}: expected this member, got none")))
}

/// Adds the member to an error of its content.
fn named(path: &Path, member: &str, error: Error) -> Error {
    match error {
        Error::File { message, .. } => Error::file(path, format!("{member}: {message}")),
        other => other,
    }
}

impl Reader for Sequence {
    fn recording(&self) -> &Recording {
        &self.recording
    }

    fn files(&self) -> Result<Vec<PathBuf>> {
        Ok([vec![self.path.clone()], self.scans.clone()].concat())
    }

    fn moment(&self, index: usize) -> Result<Moment> {
        let mut hands = [None, None];
        for side in Side::BOTH {
            let track = self.hands[side as usize].get(&self.path, || self.track(side))?;
            hands[side as usize] = Some(RecordedHand::Mano(track[index].clone()));
        }
        let object = self.object.get(&self.path, || self.motions())?;
        Ok(Moment {
            stamp_secs: index as f64 / FPS,
            world_from_reference: DAffine3::IDENTITY,
            world_from_camera: None,
            hands,
            objects: vec![Some(object[index])],
            forces: [None, None],
            readings: Vec::new(),
        })
    }

    fn images(&self, from: usize) -> Result<SourceFrames<'_>> {
        self.images.frames(from, |index| index as f64 / FPS)
    }

    fn release(&self) {
        self.hands.iter().for_each(Lazy::release);
        self.object.release();
    }
}
