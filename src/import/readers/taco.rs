//! TACO: videos, pickles of PyTorch tensors and numpy arrays, one set per sequence.

use std::path::{Path, PathBuf};

use glam::{DAffine3, Vec3};
use serde_json::{Value, json};

use crate::dataset::base_name;
use crate::dataset::source::SourceFrames;
use crate::error::{Error, Result};
use crate::file::{input, limits};
use crate::hand::{N_BETAS, Side};
use crate::import::input::arrays::{self, PickleFile};
use crate::import::input::folders;
use crate::import::input::images::{self, Images};
use crate::import::input::lazy::Lazy;
use crate::import::input::numbers::{self, exactly};
use crate::import::kind::{Found, Kind, Mano, Options};
use crate::import::recording::{
    Convention, ManoParams, Moment, PoseParams, Reader, RecordedHand, RecordedObject, Recording, Translation,
};
use crate::import::shapes::MeshFile;

/// TACO.
pub const KIND: Kind = Kind {
    name: "taco",
    gives: "video of the head camera, both hands, tool and target, camera pose",
    mano: Mano::Optional,
    origin: "TACO: Egocentric_RGB_Videos, Hand_Poses, Object_Poses, Object_Models, Egocentric_Camera_Parameters",
    licence: "CC BY 4.0; MANO's for the hands",
    find,
};
/// Length of the unit of the objects' meshes, m.
const CENTIMETRE: f32 = 0.01;

fn find(source: &Path, options: &Options) -> Result<Found> {
    let objects =
        options.objects.clone().or_else(|| folders::first_of(source, &["Object_Models", "object_models_released"]));
    let videos = source.join("Egocentric_RGB_Videos");
    if !videos.is_dir() {
        return Err(Error::file(source, "expected the folder Egocentric_RGB_Videos, got none"));
    }
    let mut found = Found::default();
    for triplet in folders::folders(&videos)? {
        for sequence in folders::folders(&triplet)? {
            let name = format!("{}/{}", base_name(&triplet), base_name(&sequence));
            let opened = Sequence::open(source, name.clone(), &sequence.join("color.mp4"), objects.as_deref());
            found.add(name, opened);
        }
    }
    Ok(found)
}

/// One sequence.
struct Sequence {
    recording: Recording,
    images: Images,
    fps: f64,
    /// Files of the objects' poses, in the order of the recording's objects.
    poses: Vec<PathBuf>,
    /// Folder of the hands' files.
    hands: PathBuf,
    extrinsic: PathBuf,
    tracks: [Lazy<HandTrack>; 2],
    objects: Lazy<Vec<Vec<DAffine3>>>,
    cameras: Lazy<Vec<DAffine3>>,
}

/// Parameters of one hand over time.
type HandTrack = Vec<ManoParams>;

impl Sequence {
    fn open(root: &Path, name: String, video: &Path, objects: Option<&Path>) -> Result<Self> {
        let folder = root.join("Object_Poses").join(&name);
        let poses: Vec<PathBuf> = folders::files(&folder, ".npy")?
            .into_iter()
            .filter(|path| ["tool_", "target_"].iter().any(|role| base_name(path).starts_with(role)))
            .collect();
        let Some(first) = poses.first() else {
            return Err(Error::file(&folder, "expected tool_*.npy and target_*.npy, got none"));
        };
        let frames = arrays::npy(first, &[0, 4, 4])?.shape[0];
        if frames == 0 {
            return Err(Error::file(first, "expected at least one pose, got none"));
        }
        limits::FRAMES.check(first, "poses", frames as u64)?;
        let fps = images::video(video, frames)?.fps;
        let parameters = root.join("Egocentric_Camera_Parameters").join(&name);
        let intrinsic = parameters.join("egocentric_intrinsic.txt");
        let camera = match intrinsic.is_file() {
            true => {
                let k: [f64; 9] = exactly(&intrinsic, "matrix", &numbers::read(&intrinsic)?)?;
                json!({ "fx": k[0], "fy": k[4], "cx": k[2], "cy": k[5], "distortion": [0, 0] })
            }
            false => Value::Null,
        };
        let object = |path: &PathBuf| {
            let name = base_name(path).trim_end_matches(".npy").to_string();
            let id = name.rsplit('_').next().unwrap_or_default();
            let mesh = objects.map(|folder| folder.join(format!("{id}_cm.obj"))).filter(|path| path.is_file());
            RecordedObject { mesh: mesh.map(|path| MeshFile::new(path, CENTIMETRE)), name }
        };
        Ok(Self {
            recording: Recording {
                path: video.to_path_buf(),
                frames,
                objects: poses.iter().map(object).collect(),
                convention: Convention { translation: Translation::OfWrist, ..Convention::PLAIN },
                camera,
                about: json!({ "triplet": name.split('/').next() }),
                name: name.clone(),
                ..Recording::default()
            },
            images: Images::Video(video.to_path_buf()),
            fps,
            poses,
            hands: root.join("Hand_Poses").join(name),
            extrinsic: parameters.join("egocentric_frame_extrinsic.npy"),
            tracks: Default::default(),
            objects: Lazy::default(),
            cameras: Lazy::default(),
        })
    }

    fn hand_files(&self, side: Side) -> [PathBuf; 2] {
        ["hand", "hand_shape"].map(|part| self.hands.join(format!("{}_{part}.pkl", side.name())))
    }

    /// Reads the parameters of one hand; `None` without files.
    fn hand(&self, side: Side, index: usize) -> Result<Option<RecordedHand>> {
        let [poses, shape] = self.hand_files(side);
        if !poses.is_file() {
            return Ok(None);
        }
        let track = self.tracks[side as usize].get(&poses, || self.track(&poses, &shape))?;
        Ok(Some(RecordedHand::Mano(track[index].clone())))
    }

    fn track(&self, poses: &Path, shape: &Path) -> Result<HandTrack> {
        // The toolkit takes the mean shape where there is no file.
        let betas = match shape.is_file() {
            true => {
                let content = input::read(shape, limits::FILE)?;
                let file = PickleFile::parse(shape, &content)?;
                file.root().get("hand_shape")?.numbers::<N_BETAS>()?.map(|beta| beta as f32)
            }
            false => [0.0; N_BETAS],
        };
        let content = input::read(poses, limits::FILE)?;
        let file = PickleFile::parse(poses, &content)?;
        let mut entries = file.root().entries()?;
        entries.sort_by(|a, b| a.0.cmp(&b.0));
        if entries.len() != self.recording.frames {
            let expected =
                format!("expected {} frames, as the objects' poses, got {}", self.recording.frames, entries.len());
            return Err(Error::file(poses, expected));
        }
        let params = |(_, frame): &(String, arrays::Node)| {
            let pose = frame.get("hand_pose")?.numbers::<48>()?.map(|angle| angle as f32);
            let transl = frame.get("hand_trans")?.numbers::<3>()?.map(|x| x as f32);
            Ok(ManoParams {
                betas,
                global_orient: Vec3::from_slice(&pose),
                hand_pose: PoseParams::AxisAngle(std::array::from_fn(|joint| Vec3::from_slice(&pose[3 + 3 * joint..]))),
                transl: Vec3::from_array(transl),
            })
        };
        entries.iter().map(params).collect()
    }

    /// Reads the rigid motions in an array of 4 x 4 matrices, one per frame.
    fn motions(&self, path: &Path) -> Result<Vec<DAffine3>> {
        let array = arrays::npy(path, &[self.recording.frames, 4, 4])?;
        let matrices = array.data.as_chunks::<16>().0.iter().enumerate();
        matrices.map(|(index, rows)| numbers::rigid(path, &format!("matrix {index}"), rows, 1.0)).collect()
    }
}

impl Reader for Sequence {
    fn recording(&self) -> &Recording {
        &self.recording
    }

    fn files(&self) -> Result<Vec<PathBuf>> {
        let mut files = Vec::new();
        files.extend(self.images.paths());
        files.extend(self.poses.clone());
        files.extend(Side::BOTH.into_iter().flat_map(|side| self.hand_files(side)));
        files.extend([self.extrinsic.clone()]);
        Ok(files)
    }

    fn moment(&self, index: usize) -> Result<Moment> {
        let read = || self.poses.iter().map(|path| self.motions(path)).collect::<Result<Vec<_>>>();
        let objects = self.objects.get(&self.recording.path, read)?;
        let world_from_camera = match self.extrinsic.is_file() {
            true => Some(self.cameras.get(&self.extrinsic, || self.motions(&self.extrinsic))?[index].inverse()),
            false => None,
        };
        Ok(Moment {
            stamp_secs: index as f64 / self.fps,
            world_from_reference: DAffine3::IDENTITY,
            world_from_camera,
            hands: [self.hand(Side::Left, index)?, self.hand(Side::Right, index)?],
            objects: objects.iter().map(|poses| Some(poses[index])).collect(),
            forces: [None, None],
            readings: Vec::new(),
        })
    }

    fn images(&self, from: usize) -> Result<SourceFrames<'_>> {
        self.images.frames(from, |index| index as f64 / self.fps)
    }

    fn release(&self) {
        self.tracks.iter().for_each(Lazy::release);
        self.objects.release();
        self.cameras.release();
    }
}
