//! ARCTIC: JPEG files of the head camera, numpy files of hands and articulated objects, one set per sequence.

use std::path::{Path, PathBuf};

use glam::{DAffine3, DMat3, DQuat, DVec3, Vec3};
use serde_json::{Value, json};

use crate::dataset::base_name;
use crate::dataset::source::SourceFrames;
use crate::error::{Error, Result};
use crate::file::{input, limits};
use crate::hand::{N_BETAS, Side};
use crate::import::input::arrays::{self, PickleFile};
use crate::import::input::folders;
use crate::import::input::images::Images;
use crate::import::input::json::Json;
use crate::import::input::lazy::Lazy;
use crate::import::input::numbers;
use crate::import::kind::{Found, Kind, Mano, Options};
use crate::import::recording::{
    Convention, ManoParams, Moment, PoseParams, Reader, RecordedHand, RecordedObject, Recording,
};
use crate::import::shapes::MeshFile;
use crate::numpy::Array;

/// ARCTIC.
pub const KIND: Kind = Kind {
    name: "arctic",
    gives: "images of the head camera, both hands, both parts of the articulated object, camera pose",
    mano: Mano::Required,
    origin: "ARCTIC: raw_seqs, images (or cropped_images), meta",
    licence: "ARCTIC licence, for non-commercial research; MANO's for the hands",
    find,
};
/// Images per second.
const FPS: f64 = 30.0;
/// Length of the unit of object positions and meshes, m.
const MILLIMETRE: f64 = 0.001;
/// Axis that an object's top part turns about, in the object's frame.
const HINGE: DVec3 = DVec3::NEG_Z;
/// Folder of the head camera among the views.
const VIEW: &str = "0";

fn find(source: &Path, options: &Options) -> Result<Found> {
    let raw = source.join("raw_seqs");
    if !raw.is_dir() {
        return Err(Error::file(source, "expected the folder raw_seqs, got none"));
    }
    let meta = source.join("meta");
    let misc = meta.join("misc.json");
    let subjects = Json::parse(&misc, &input::read(&misc, limits::TEXT)?)?;
    let objects = options.objects.clone().unwrap_or_else(|| meta.join("object_vtemplates"));
    let mut found = Found::default();
    for subject in folders::folders(&raw)? {
        let offset = subjects.get(&base_name(&subject)).get("ioi_offset");
        for hands in folders::files(&subject, ".mano.npy")? {
            let sequence = base_name(&hands).trim_end_matches(".mano.npy").to_string();
            let name = format!("{}/{sequence}", base_name(&subject));
            let opened =
                offset.whole().and_then(|offset| Sequence::open(source, name.clone(), &hands, offset, &objects));
            found.add(name, opened);
        }
    }
    Ok(found)
}

/// One sequence.
struct Sequence {
    recording: Recording,
    images: Images,
    /// Indices of the annotations of the images; negative before the first one.
    annotations: Vec<i64>,
    hands: PathBuf,
    object: PathBuf,
    camera: PathBuf,
    hand_tracks: Lazy<[Option<HandTrack>; 2]>,
    object_track: Lazy<Array>,
    camera_track: Lazy<[Array; 2]>,
}

/// Parameters of one hand over time.
#[derive(Debug)]
struct HandTrack {
    rot: Array,
    pose: Array,
    trans: Array,
    /// (10), or (T, 10).
    shape: Array,
}

impl Sequence {
    fn open(root: &Path, name: String, hands: &Path, offset: i64, objects: &Path) -> Result<Self> {
        let views = ["images", "cropped_images"].map(|folder| root.join(folder).join(&name).join(VIEW));
        let Some(folder) = views.iter().find(|folder| folder.is_dir()) else {
            return Err(Error::file(&views[0], "expected a folder of the head camera's images, got none"));
        };
        let files = folders::files(folder, ".jpg")?;
        let numbers: Vec<usize> = files.iter().filter_map(|file| folders::number(file)).collect();
        if files.is_empty() || numbers.len() != files.len() {
            return Err(Error::file(folder, "expected images with numbers as names"));
        }
        limits::FRAMES.check(folder, "frames", files.len() as u64)?;
        let sibling = |ending: &str| hands.with_file_name(base_name(hands).replace(".mano.npy", ending));
        let object = base_name(hands).split('_').next().unwrap_or_default().to_string();
        let part = |part: &str| {
            let path = objects.join(&object).join(format!("{part}.obj"));
            let mesh = path.is_file().then_some(MeshFile::new(path, MILLIMETRE as f32));
            RecordedObject { name: format!("{object} {part}"), mesh }
        };
        let mut sequence = Self {
            recording: Recording {
                path: hands.to_path_buf(),
                frames: files.len(),
                objects: vec![part("top"), part("bottom")],
                joints: vec![[0, 1]],
                convention: Convention { adds_mean: true, ..Convention::PLAIN },
                about: json!({ "object": object, "images": folder.strip_prefix(root).unwrap_or(folder).display().to_string() }),
                name,
                ..Recording::default()
            },
            images: Images::Files(files),
            annotations: numbers.iter().map(|number| *number as i64 - offset).collect(),
            hands: hands.to_path_buf(),
            object: sibling(".object.npy"),
            camera: sibling(".egocam.dist.npy"),
            hand_tracks: Lazy::default(),
            object_track: Lazy::default(),
            camera_track: Lazy::default(),
        };
        sequence.recording.camera = sequence.intrinsics()?;
        Ok(sequence)
    }

    fn intrinsics(&self) -> Result<Value> {
        if !self.camera.is_file() {
            return Ok(Value::Null);
        }
        let content = input::read(&self.camera, limits::FILE)?;
        let file = PickleFile::parse_npy(&self.camera, &content)?;
        let k = file.root().get("intrinsics")?.numbers::<9>()?;
        let distortion = file.root().get("dist8")?.numbers::<8>()?;
        Ok(
            json!({ "fx": k[0], "fy": k[4], "cx": k[2], "cy": k[5], "model": "rational_polynomial", "distortion": distortion }),
        )
    }

    fn hand_tracks(&self) -> Result<[Option<HandTrack>; 2]> {
        let content = input::read(&self.hands, limits::FILE)?;
        let file = PickleFile::parse_npy(&self.hands, &content)?;
        let sides = file.root().entries()?;
        let track = |side: Side| {
            let Some((_, hand)) = sides.iter().find(|(name, _)| name == side.name()) else { return Ok(None) };
            let rot = hand.get("rot")?.shaped(&[0, 3])?;
            let frames = rot.shape[0];
            let shape = hand.get("shape")?.array()?;
            if ![vec![N_BETAS], vec![1, N_BETAS], vec![frames, N_BETAS]].contains(&shape.shape) {
                let got = format!("{}.shape: expected [10] or [{frames}, 10], got {:?}", side.name(), shape.shape);
                return Err(Error::file(&self.hands, got));
            }
            let (pose, trans) = (hand.get("pose")?.shaped(&[frames, 45])?, hand.get("trans")?.shaped(&[frames, 3])?);
            Ok(Some(HandTrack { rot, pose, trans, shape }))
        };
        Ok([track(Side::Left)?, track(Side::Right)?])
    }

    /// Returns `world_from_object` of the top and the bottom part at an annotation.
    fn parts(&self, at: usize) -> Result<Vec<Option<DAffine3>>> {
        let track = self.object_track.get(&self.object, || arrays::npy(&self.object, &[0, 7]))?;
        let Some(row) = track.data.as_chunks::<7>().0.get(at) else { return Ok(vec![None, None]) };
        let rotation = DQuat::from_scaled_axis(DVec3::from_slice(&row[1..4]));
        let bottom = DAffine3::from_rotation_translation(rotation, DVec3::from_slice(&row[4..7]) * MILLIMETRE);
        let top = bottom * DAffine3::from_quat(DQuat::from_axis_angle(HINGE, row[0]));
        Ok(vec![Some(top), Some(bottom)])
    }

    /// Returns `world_from_camera` at an annotation.
    fn camera(&self, at: usize) -> Result<Option<DAffine3>> {
        if !self.camera.is_file() {
            return Ok(None);
        }
        let track = self.camera_track.get(&self.camera, || {
            let content = input::read(&self.camera, limits::FILE)?;
            let file = PickleFile::parse_npy(&self.camera, &content)?;
            let rotations = file.root().get("R_k_cam_np")?.shaped(&[0, 3, 3])?;
            let frames = rotations.shape[0];
            let translations = file.root().get("T_k_cam_np")?.array()?;
            match translations.data.len() == 3 * frames {
                true => Ok([rotations, translations]),
                false => Err(Error::file(
                    &self.camera,
                    format!("T_k_cam_np: expected {frames} translations, got {:?}", translations.shape),
                )),
            }
        })?;
        let [rotations, translations] = track.as_ref();
        let Some(rows) = rotations.data.as_chunks::<9>().0.get(at) else { return Ok(None) };
        let rotation = DMat3::from_cols_array(rows).transpose();
        let translation = DVec3::from_slice(&translations.data[3 * at..]);
        numbers::motion(&self.camera, &format!("R_k_cam_np[{at}]"), rotation, translation)
            .map(|pose| Some(pose.inverse()))
    }
}

impl HandTrack {
    fn params(&self, at: usize) -> Option<ManoParams> {
        let row = |array: &Array, width: usize| -> Option<Vec<f32>> {
            Some(array.data.get(width * at..width * (at + 1))?.iter().map(|value| *value as f32).collect())
        };
        let (rot, pose, trans) = (row(&self.rot, 3)?, row(&self.pose, 45)?, row(&self.trans, 3)?);
        let betas = match self.shape.data.len() {
            N_BETAS => self.shape.data.iter().map(|beta| *beta as f32).collect(),
            _ => row(&self.shape, N_BETAS)?,
        };
        Some(ManoParams {
            betas: betas.try_into().ok()?,
            global_orient: Vec3::from_slice(&rot),
            hand_pose: PoseParams::AxisAngle(std::array::from_fn(|joint| Vec3::from_slice(&pose[3 * joint..]))),
            transl: Vec3::from_slice(&trans),
        })
    }
}

impl Reader for Sequence {
    fn recording(&self) -> &Recording {
        &self.recording
    }

    fn files(&self) -> Result<Vec<PathBuf>> {
        let mut files = Vec::new();
        files.extend(self.images.paths());
        files.extend([self.hands.clone(), self.object.clone(), self.camera.clone()]);
        Ok(files)
    }

    fn moment(&self, index: usize) -> Result<Moment> {
        let mut moment = Moment {
            stamp_secs: index as f64 / FPS,
            world_from_reference: DAffine3::IDENTITY,
            world_from_camera: None,
            hands: [None, None],
            objects: vec![None, None],
            forces: [None, None],
            readings: Vec::new(),
        };
        // Images before the first and after the last annotation have none.
        let Ok(at) = usize::try_from(self.annotations[index]) else { return Ok(moment) };
        let tracks = self.hand_tracks.get(&self.hands, || self.hand_tracks())?;
        for side in Side::BOTH {
            let params = tracks[side as usize].as_ref().and_then(|track| track.params(at));
            moment.hands[side as usize] = params.map(RecordedHand::Mano);
        }
        moment.objects = self.parts(at)?;
        moment.world_from_camera = self.camera(at)?;
        Ok(moment)
    }

    fn images(&self, from: usize) -> Result<SourceFrames<'_>> {
        self.images.frames(from, |index| index as f64 / FPS)
    }

    fn release(&self) {
        self.hand_tracks.release();
        self.object_track.release();
        self.camera_track.release();
    }
}
