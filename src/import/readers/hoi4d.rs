//! HOI4D: videos, JSON files of object poses and pickles of the hands, one per frame.

use std::path::{Path, PathBuf};

use glam::{DAffine3, DMat3, DVec3, Vec3};
use serde_json::{Value, json};

use crate::dataset::source::SourceFrames;
use crate::error::{Error, Result};
use crate::file::{input, limits};
use crate::hand::{N_BETAS, Side};
use crate::import::input::arrays::{self, PickleFile};
use crate::import::input::folders;
use crate::import::input::images::{self, Images};
use crate::import::input::json::Json;
use crate::import::input::numbers;
use crate::import::kind::{Found, Kind, Mano, Options};
use crate::import::recording::{ManoParams, Moment, PoseParams, Reader, RecordedHand, RecordedObject, Recording};
use crate::import::shapes::MeshFile;

/// HOI4D.
pub const KIND: Kind = Kind {
    name: "hoi4d",
    gives: "video of the head camera, both hands where annotated, the rigid object",
    mano: Mano::Optional,
    origin: "HOI4D: HOI4D_release, HOI4D_annotations, handpose, camera_params, rigid CAD models",
    licence: "its authors' terms of use; MANO's for the hands",
    find,
};
/// Categories of objects by number; empty ones are not used.
const CATEGORIES: [&str; 21] = [
    "",
    "ToyCar",
    "Mug",
    "Laptop",
    "StorageFurniture",
    "Bottle",
    "Safe",
    "Bowl",
    "Bucket",
    "Scissors",
    "",
    "Pliers",
    "Kettle",
    "Knife",
    "TrashCan",
    "",
    "",
    "Lamp",
    "Stapler",
    "",
    "Chair",
];
/// Depth of a sequence's folder below its root: ZY*/H*/C*/N*/S*/s*/T*.
const DEPTH: usize = 7;

fn find(source: &Path, options: &Options) -> Result<Found> {
    let videos = folders::first_of(source, &["HOI4D_release"]).unwrap_or_else(|| source.to_path_buf());
    let mut sequences = vec![videos.clone()];
    for _ in 0..DEPTH {
        let below = sequences.iter().map(|folder| folders::folders(folder)).collect::<Result<Vec<_>>>()?;
        sequences = below.into_iter().flatten().collect();
    }
    let cad = options
        .objects
        .clone()
        .or_else(|| folders::first_of(source, &["HOI4D_CAD_Model_for_release", "HOI4D_CAD_models", "models"]));
    let mut found = Found::default();
    for sequence in sequences.iter().filter(|sequence| sequence.join("align_rgb").is_dir()) {
        let name = sequence.strip_prefix(&videos).unwrap_or(sequence).display().to_string();
        found.add(name.clone(), Sequence::open(source, name, sequence, cad.as_deref()));
    }
    Ok(found)
}

/// One sequence.
struct Sequence {
    recording: Recording,
    images: Images,
    fps: f64,
    /// Folder of the object's poses; `None` = not there.
    object: Option<PathBuf>,
    /// Folders of the left and the right hand's poses.
    hands: [Option<PathBuf>; 2],
}

impl Sequence {
    fn open(root: &Path, name: String, path: &Path, cad: Option<&Path>) -> Result<Self> {
        let video = path.join("align_rgb/image.mp4");
        let facts = images::video_alone(&video)?;
        let frames = facts.frames.filter(|frames| *frames > 0);
        let frames = frames.ok_or_else(|| Error::file(&video, "expected a video that states its number of frames"))?;
        limits::FRAMES.check(&video, "frames", frames as u64)?;
        let annotated = [root.join("HOI4D_annotations").join(&name), path.to_path_buf()];
        let object = annotated.iter().map(|folder| folder.join("objpose")).find(|folder| folder.is_dir());
        let hand = |side: Side| {
            let places = ["", "HOI4D_Hand_pose", "Hand_pose"].map(|place| root.join(place));
            let folder = format!("refinehandpose_{}", side.name());
            let inside =
                |place: &PathBuf| [place.join("handpose").join(&folder).join(&name), place.join(&folder).join(&name)];
            places.iter().flat_map(inside).find(|folder| folder.is_dir())
        };
        let hands = Side::BOTH.map(hand);
        let device = name.split('/').next().unwrap_or_default();
        let intrinsics = root.join("camera_params").join(device).join("intrin.npy");
        let camera = match intrinsics.is_file() {
            true => {
                let k = arrays::npy(&intrinsics, &[3, 3])?.data;
                json!({ "fx": k[0], "fy": k[4], "cx": k[2], "cy": k[5], "distortion": [0, 0] })
            }
            false => Value::Null,
        };
        let part = |letter: char| {
            let number = name.split('/').find_map(|part| part.strip_prefix(letter)?.parse::<usize>().ok());
            number.ok_or_else(|| Error::file(path, format!("expected a folder {letter} and a number on the way")))
        };
        let (category, instance) = (part('C')?, part('N')?);
        let category = CATEGORIES
            .get(category)
            .copied()
            .filter(|name| !name.is_empty())
            .ok_or_else(|| Error::file(path, format!("C{category}: expected a category of the data set")))?;
        let file = |cad: &Path| {
            let files = ["", "rigid"].map(|folder| cad.join(folder).join(category).join(format!("{instance:03}.obj")));
            files.into_iter().find(|path| path.is_file())
        };
        let mesh = cad.and_then(file).map(|path| MeshFile::new(path, 1.0));
        Ok(Self {
            recording: Recording {
                path: path.to_path_buf(),
                frames,
                objects: vec![RecordedObject { name: format!("{category} {instance:03}"), mesh }],
                camera,
                about: json!({ "category": category, "instance": instance }),
                name,
                ..Recording::default()
            },
            images: Images::Video(video),
            fps: facts.fps,
            object,
            hands,
        })
    }

    /// Returns the file of a frame: its number with or without leading zeros.
    fn file(folder: Option<&PathBuf>, index: usize, ending: &str) -> Option<PathBuf> {
        let names = [format!("{index}.{ending}"), format!("{index:05}.{ending}"), format!("{index:03}.{ending}")];
        names.iter().find_map(|name| Some(folder?.join(name)).filter(|path| path.is_file()))
    }

    /// Reads `camera_from_object`; `None` without an annotation.
    fn object(&self, index: usize) -> Result<Option<DAffine3>> {
        let Some(path) = Self::file(self.object.as_ref(), index, "json") else { return Ok(None) };
        let json = Json::parse(&path, &input::read(&path, limits::TEXT)?)?;
        let list = ["dataList", "objects"].map(|name| json.get(name)).into_iter().find(|list| !list.is_null());
        let Some(first) = list.and_then(|list| list.items().into_iter().next()) else {
            return Err(json.expected("dataList or objects with one object at least"));
        };
        let vector = |name: &str| -> Result<DVec3> {
            let part = |axis| first.get(name).get(axis).number();
            Ok(DVec3::new(part("x")?, part("y")?, part("z")?))
        };
        let (angles, centre) = (vector("rotation")?, vector("center")?);
        // Euler angles about the moving axes x, y, z, in this order.
        let rotation =
            DMat3::from_rotation_x(angles.x) * DMat3::from_rotation_y(angles.y) * DMat3::from_rotation_z(angles.z);
        numbers::motion(&path, "rotation", rotation, centre).map(Some)
    }

    fn hand(&self, side: Side, index: usize) -> Result<Option<RecordedHand>> {
        let Some(path) = Self::file(self.hands[side as usize].as_ref(), index, "pickle") else { return Ok(None) };
        let content = input::read(&path, limits::FILE)?;
        let file = PickleFile::parse(&path, &content)?;
        let root = file.root();
        let pose = root.get("poseCoeff")?.numbers::<48>()?.map(|angle| angle as f32);
        let betas = root.get("beta")?.numbers::<N_BETAS>()?.map(|beta| beta as f32);
        let transl = root.get("trans")?.numbers::<3>()?.map(|x| x as f32);
        Ok(Some(RecordedHand::Mano(ManoParams {
            betas,
            global_orient: Vec3::from_slice(&pose),
            hand_pose: PoseParams::AxisAngle(std::array::from_fn(|joint| Vec3::from_slice(&pose[3 + 3 * joint..]))),
            transl: Vec3::from_array(transl),
        })))
    }
}

impl Reader for Sequence {
    fn recording(&self) -> &Recording {
        &self.recording
    }

    fn files(&self) -> Result<Vec<PathBuf>> {
        let mut files = Vec::new();
        files.extend(self.images.paths());
        if let Some(folder) = &self.object {
            files.extend(folders::files(folder, ".json")?);
        }
        for folder in self.hands.iter().flatten() {
            files.extend(folders::files(folder, ".pickle")?);
        }
        Ok(files)
    }

    fn moment(&self, index: usize) -> Result<Moment> {
        Ok(Moment {
            stamp_secs: index as f64 / self.fps,
            // Annotations are in the camera's frame, which stands for the world.
            world_from_reference: DAffine3::IDENTITY,
            world_from_camera: Some(DAffine3::IDENTITY),
            hands: [self.hand(Side::Left, index)?, self.hand(Side::Right, index)?],
            objects: vec![self.object(index)?],
            forces: [None, None],
            readings: Vec::new(),
        })
    }

    fn images(&self, from: usize) -> Result<SourceFrames<'_>> {
        self.images.frames(from, |index| index as f64 / self.fps)
    }
}
