//! DexYCB: eight fixed cameras per sequence, one recording each.

use std::path::{Path, PathBuf};

use glam::{DAffine3, DMat3, DVec3};
use serde::Deserialize;
use serde::de::DeserializeOwned;
use serde_json::{Value, json};

use crate::dataset::base_name;
use crate::dataset::source::SourceFrames;
use crate::error::{Error, Result};
use crate::file::{input, limits};
use crate::hand::{N_BETAS, Side};
use crate::import::input::arrays;
use crate::import::input::folders;
use crate::import::input::images::Images;
use crate::import::input::numbers::{self, vec3};
use crate::import::kind::{Found, Kind, Mano, Options};
use crate::import::recording::{
    Convention, ManoParams, Moment, PoseParams, Reader, RecordedHand, RecordedObject, Recording, View,
};
use crate::import::shapes::MeshFile;
use crate::numpy::{Array, Npz};

/// DexYCB.
pub const KIND: Kind = Kind {
    name: "dexycb",
    gives: "images of eight fixed cameras, one hand, objects, camera pose",
    mano: Mano::Required,
    origin: "DexYCB: SUBJECT/SEQUENCE/SERIAL, calibration, models",
    licence: "CC BY-NC 4.0; MANO's for the hands",
    find,
};
/// Images per second.
const FPS: f64 = 30.0;
/// Folders of the objects' meshes, by the objects' numbers from 1 on.
const OBJECTS: [&str; 21] = [
    "002_master_chef_can",
    "003_cracker_box",
    "004_sugar_box",
    "005_tomato_soup_can",
    "006_mustard_bottle",
    "007_tuna_fish_can",
    "008_pudding_box",
    "009_gelatin_box",
    "010_potted_meat_can",
    "011_banana",
    "019_pitcher_base",
    "021_bleach_cleanser",
    "024_bowl",
    "025_mug",
    "035_power_drill",
    "036_wood_block",
    "037_scissors",
    "040_large_marker",
    "051_large_clamp",
    "052_extra_large_clamp",
    "061_foam_brick",
];

/// `meta.yml` of a sequence, as far as it is used.
#[derive(Deserialize)]
struct Meta {
    extrinsics: String,
    mano_calib: Vec<String>,
    mano_sides: Vec<String>,
    ycb_ids: Vec<usize>,
    ycb_grasp_ind: Option<usize>,
}

/// `extrinsics.yml`: rows of `world_from_camera` by serial number.
#[derive(Deserialize)]
struct Extrinsics {
    extrinsics: std::collections::BTreeMap<String, Vec<f64>>,
}

/// `mano.yml` of a person.
#[derive(Deserialize)]
struct Shape {
    betas: Vec<f64>,
}

/// Intrinsics of a camera.
#[derive(Deserialize)]
struct Intrinsics {
    color: Pinhole,
}

#[derive(Deserialize)]
struct Pinhole {
    fx: f64,
    fy: f64,
    ppx: f64,
    ppy: f64,
}

fn find(source: &Path, options: &Options) -> Result<Found> {
    let objects = options.objects.clone().unwrap_or_else(|| source.join("models"));
    let mut found = Found::default();
    for subject in folders::folders(source)? {
        for sequence in folders::folders(&subject)? {
            if !sequence.join("meta.yml").is_file() {
                continue;
            }
            for camera in folders::folders(&sequence)? {
                let name = camera.strip_prefix(source).unwrap_or(&camera).display().to_string();
                found.add(name.clone(), Sequence::open(source, &sequence, &camera, name, &objects));
            }
        }
    }
    Ok(found)
}

/// One camera's images of a sequence.
struct Sequence {
    recording: Recording,
    images: Images,
    /// Files of the labels, one per image.
    labels: Vec<PathBuf>,
    side: Side,
    betas: [f32; N_BETAS],
    world_from_camera: Option<DAffine3>,
    /// Files that hold for the whole sequence.
    files: Vec<PathBuf>,
}

impl Sequence {
    fn open(root: &Path, sequence: &Path, camera: &Path, name: String, objects: &Path) -> Result<Self> {
        let images: Vec<PathBuf> =
            folders::files(camera, ".jpg")?.into_iter().filter(|path| base_name(path).starts_with("color_")).collect();
        let labels: Option<Vec<PathBuf>> = images.iter().map(|path| label(path)).collect();
        let Some(labels) = labels.filter(|labels| !labels.is_empty()) else {
            return Err(Error::file(camera, "expected images color_*.jpg with numbers as names, got none"));
        };
        limits::FRAMES.check(camera, "frames", images.len() as u64)?;
        let (meta_path, calibration) = (sequence.join("meta.yml"), root.join("calibration"));
        let meta: Meta = yaml(&meta_path)?;
        let side = match meta.mano_sides.first().map(String::as_str) {
            Some("left") => Side::Left,
            Some("right") => Side::Right,
            other => {
                let message = format!("mano_sides: expected left or right, got {}", other.unwrap_or("nothing"));
                return Err(Error::file(&meta_path, message));
            }
        };
        let folder = |kind: &str, name: &str| calibration.join(format!("{kind}_{}", base_name(Path::new(name))));
        let shape_path = folder("mano", meta.mano_calib.first().map_or("", String::as_str)).join("mano.yml");
        let shape: Shape = yaml(&shape_path)?;
        let betas: [f64; N_BETAS] = numbers::exactly(&shape_path, "betas", &shape.betas)?;
        let extrinsics_path = folder("extrinsics", &meta.extrinsics).join("extrinsics.yml");
        let serial = base_name(camera);
        let world_from_camera = match extrinsics_path.is_file() {
            true => {
                let all: Extrinsics = yaml(&extrinsics_path)?;
                let rows = all.extrinsics.get(&serial).ok_or_else(|| {
                    Error::file(&extrinsics_path, format!("extrinsics: expected the camera {serial}, got none"))
                })?;
                Some(placed(&extrinsics_path, &format!("extrinsics.{serial}"), rows)?)
            }
            false => None,
        };
        let intrinsics_path = calibration.join(format!("intrinsics/{serial}_640x480.yml"));
        let intrinsics = match intrinsics_path.is_file() {
            true => {
                let Intrinsics { color: Pinhole { fx, fy, ppx, ppy } } = yaml(&intrinsics_path)?;
                json!({ "fx": fx, "fy": fy, "cx": ppx, "cy": ppy, "width": 640, "height": 480, "distortion": [0, 0] })
            }
            false => Value::Null,
        };
        let object = |id: &usize| {
            let name = id.checked_sub(1).and_then(|index| OBJECTS.get(index)).copied();
            let name = name.ok_or_else(|| Error::file(&meta_path, format!("ycb_ids: expected 1 to 21, got {id}")))?;
            let path = objects.join(name).join("textured_simple.obj");
            let mesh = path.is_file().then_some(MeshFile::new(path, 1.0));
            Ok(RecordedObject { name: name.into(), mesh })
        };
        Ok(Self {
            recording: Recording {
                path: camera.to_path_buf(),
                frames: images.len(),
                objects: meta.ycb_ids.iter().map(object).collect::<Result<_>>()?,
                convention: Convention { adds_mean: true, ..Convention::PLAIN },
                view: View::ThirdPerson,
                camera: intrinsics,
                about: json!({ "camera": serial, "grasped_object": meta.ycb_grasp_ind, "hand": side.name() }),
                name,
                ..Recording::default()
            },
            images: Images::Files(images),
            labels,
            side,
            betas: betas.map(|beta| beta as f32),
            world_from_camera,
            files: vec![meta_path, shape_path, extrinsics_path, intrinsics_path],
        })
    }

    /// Reads an array of a label.
    fn array(
        &self,
        path: &Path,
        archive: &mut Npz<std::io::Cursor<&[u8]>>,
        name: &str,
        shape: &[usize],
    ) -> Result<Array> {
        let array = archive.array(name).map_err(|message| Error::file(path, format!("{name}: {message}")))?;
        let array = array.ok_or_else(|| Error::file(path, format!("{name}: expected this array, got none")))?;
        arrays::check(path, name, array, shape)
    }
}

/// Returns the file of the label of an image.
fn label(image: &Path) -> Option<PathBuf> {
    Some(image.with_file_name(format!("labels_{:06}.npz", folders::number(image)?)))
}

fn yaml<T: DeserializeOwned>(path: &Path) -> Result<T> {
    let text = input::read_text(path, limits::TEXT)?;
    crate::text::parse_yaml(&text).map_err(|error| Error::file(path, error))
}

/// Creates a rigid motion from the rows of a 3 x 4 matrix.
fn placed(path: &Path, field: &str, rows: &[f64]) -> Result<DAffine3> {
    let rows: [f64; 12] = numbers::exactly(path, field, rows)?;
    let column = |k: usize| DVec3::new(rows[k], rows[4 + k], rows[8 + k]);
    numbers::motion(path, field, DMat3::from_cols(column(0), column(1), column(2)), column(3))
}

impl Reader for Sequence {
    fn recording(&self) -> &Recording {
        &self.recording
    }

    fn files(&self) -> Result<Vec<PathBuf>> {
        Ok([self.images.paths(), self.labels.clone(), self.files.clone()].concat())
    }

    fn moment(&self, index: usize) -> Result<Moment> {
        let path = &self.labels[index];
        let mut moment = Moment {
            stamp_secs: index as f64 / FPS,
            world_from_reference: self.world_from_camera.unwrap_or(DAffine3::IDENTITY),
            world_from_camera: self.world_from_camera,
            hands: [None, None],
            objects: vec![None; self.recording.objects.len()],
            forces: [None, None],
            readings: Vec::new(),
        };
        // The test set comes without labels.
        if !path.is_file() {
            return Ok(moment);
        }
        let content = input::read(path, limits::FILE)?;
        let mut archive = Npz::open(&content).map_err(|message| Error::file(path, message))?;
        let objects = self.array(path, &mut archive, "pose_y", &[self.recording.objects.len(), 3, 4])?;
        for (object, rows) in moment.objects.iter_mut().zip(objects.data.chunks_exact(12)) {
            if rows.iter().any(|value| *value != 0.0) {
                *object = Some(placed(path, "pose_y", rows)?);
            }
        }
        let pose = self.array(path, &mut archive, "pose_m", &[1, 51])?.data;
        if pose.iter().any(|value| *value != 0.0) {
            moment.hands[self.side as usize] = Some(RecordedHand::Mano(ManoParams {
                betas: self.betas,
                global_orient: vec3(&pose),
                hand_pose: PoseParams::Coefficients(pose[3..48].iter().map(|value| *value as f32).collect()),
                transl: vec3(&pose[48..]),
            }));
        }
        Ok(moment)
    }

    fn images(&self, from: usize) -> Result<SourceFrames<'_>> {
        self.images.frames(from, |index| index as f64 / FPS)
    }
}
