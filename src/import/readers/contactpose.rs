//! ContactPose: grasps of one object in one hand or both, fitted MANO hands and, where downloaded, images of a fixed camera.

use std::path::{Path, PathBuf};

use glam::{DAffine3, DQuat, DVec3, Vec3};
use serde_json::{Value, json};

use crate::dataset::base_name;
use crate::dataset::source::SourceFrames;
use crate::error::{Error, Result};
use crate::file::{input, limits};
use crate::hand::{N_BETAS, Side};
use crate::import::input::folders;
use crate::import::input::images::Images;
use crate::import::input::json::Json;
use crate::import::input::lazy::Lazy;
use crate::import::kind::{Found, Kind, Mano, Options};
use crate::import::recording::{
    Convention, ManoParams, Moment, PoseParams, Reader, RecordedHand, RecordedObject, Recording, View,
};
use crate::import::shapes::MeshFile;

/// ContactPose.
pub const KIND: Kind = Kind {
    name: "contactpose",
    gives: "one hand or both, the object; images of a fixed camera where they were downloaded",
    mano: Mano::Required,
    origin: "ContactPose: contactpose_data/full*_{use, handoff}/OBJECT",
    licence: "its authors' terms of use; MANO's for the hands",
    find,
};
/// Fixed camera whose images are upright.
const CAMERA: &str = "kinect2_middle";
/// Images per second of the cameras.
const FPS: f64 = 30.0;
/// Folders of an object that hold no grasp of it.
const NO_GRASPS: [&str; 2] = ["hands", "palm_print"];

fn find(source: &Path, _: &Options) -> Result<Found> {
    let data = folders::first_of(source, &["contactpose_data"]).unwrap_or_else(|| source.to_path_buf());
    let mut found = Found::default();
    for session in folders::folders(&data)? {
        for path in folders::folders(&session)? {
            let object = base_name(&path);
            if NO_GRASPS.contains(&object.as_str()) {
                continue;
            }
            let name = format!("{}/{object}", base_name(&session));
            found.add(name.clone(), Grasp::open(&path, name, object));
        }
    }
    Ok(found)
}

/// One grasp.
struct Grasp {
    recording: Recording,
    images: Images,
    annotation: PathBuf,
    fits: PathBuf,
    content: Lazy<Content>,
}

/// Annotations of a grasp.
struct Content {
    frames: Vec<Frame>,
    /// Fitted hands, and `joints_from_hand` of their joints' frame.
    hands: [Option<(ManoParams, DAffine3)>; 2],
    world_from_camera: Option<DAffine3>,
}

/// One frame.
struct Frame {
    object_from_world: DAffine3,
    /// `object_from_joints` of both hands.
    hands: [DAffine3; 2],
}

impl Grasp {
    fn open(path: &Path, name: String, object: String) -> Result<Self> {
        let annotation = path.join("annotations.json");
        let fits = ["mano_fits_15.json", "mano_fits_10.json"].map(|name| path.join(name));
        let fits = fits.into_iter().find(|path| path.is_file()).unwrap_or_else(|| path.join("mano_fits_15.json"));
        let json = read(&annotation)?;
        let frames = json.get("frames").items().len();
        if frames == 0 {
            return Err(json.get("frames").expected("a list of frames"));
        }
        limits::FRAMES.check(&annotation, "frames", frames as u64)?;
        let mesh = path.join(format!("{object}.ply"));
        let color = path.join("images_full").join(CAMERA).join("color");
        let files: Vec<PathBuf> = (0..frames).map(|index| color.join(format!("frame{index:03}.png"))).collect();
        let has_images = files.iter().any(|path| path.is_file());
        let k = json.get("cameras").get(CAMERA).get("K");
        let number = |name: &str| k.get(name).value().clone();
        let camera = json!({
            "fx": number("fx"), "fy": number("fy"), "cx": number("cx"), "cy": number("cy"), "distortion": [0, 0],
        });
        Ok(Self {
            recording: Recording {
                path: path.to_path_buf(),
                frames,
                objects: vec![RecordedObject {
                    name: object,
                    mesh: mesh.is_file().then_some(MeshFile::new(mesh, 1.0)),
                }],
                convention: Convention { adds_mean: true, ..Convention::PLAIN },
                view: if has_images { View::ThirdPerson } else { View::None },
                camera: if has_images { camera } else { Value::Null },
                about: json!({ "session": name.split('/').next(), "stamps": "frame number / 30: the files hold none" }),
                name,
                ..Recording::default()
            },
            images: if has_images { Images::Files(files) } else { Images::Black(frames) },
            annotation,
            fits,
            content: Lazy::default(),
        })
    }

    fn content(&self) -> Result<Content> {
        let annotation = read(&self.annotation)?;
        let hands = annotation.get("hands").items();
        let is = |hand: usize, field: &str| {
            hands.get(hand).is_some_and(|hand| hand.get(field).value().as_bool().unwrap_or(false))
        };
        let frame = |frame: &Json| {
            let mut joints = [DAffine3::IDENTITY; 2];
            for (hand, joint) in joints.iter_mut().enumerate() {
                if is(hand, "valid") && is(hand, "moving") {
                    let poses = frame.get("hTo");
                    let pose = poses.items().into_iter().nth(hand);
                    *joint = motion(&pose.ok_or_else(|| poses.expected("the object's pose in both hands"))?)?.inverse();
                }
            }
            Ok(Frame { object_from_world: motion(&frame.get("oTw"))?, hands: joints })
        };
        let frames = annotation.get("frames").items().iter().map(frame).collect::<Result<_>>()?;
        let camera = annotation.get("cameras").get(CAMERA);
        let world_from_camera = match camera.get("wTc").is_null() {
            true => None,
            false => Some(motion(&camera.get("wTc"))?),
        };
        let mut found = [None, None];
        if self.fits.is_file() {
            for (hand, fit) in read(&self.fits)?.items().iter().enumerate().take(2) {
                if is(hand, "valid") && fit.get("valid").value().as_bool() == Some(true) {
                    found[hand] = Some(fitted(fit)?);
                }
            }
        }
        Ok(Content { frames, hands: found, world_from_camera })
    }
}

fn read(path: &Path) -> Result<Json> {
    Json::parse(path, &input::read(path, limits::TEXT)?)
}

/// Reads a rigid motion of `translation`, m, and `rotation`, a quaternion (w, x, y, z).
fn motion(json: &Json) -> Result<DAffine3> {
    let [w, x, y, z] = json.get("rotation").exactly()?;
    let rotation = DQuat::from_xyzw(x, y, z, w);
    if (rotation.length() - 1.0).abs() > 1e-2 {
        return Err(json.get("rotation").expected("a quaternion of length 1"));
    }
    let translation = DVec3::from_array(json.get("translation").exactly()?);
    Ok(DAffine3::from_rotation_translation(rotation.normalize(), translation))
}

/// Reads a fitted hand and `joints_from_hand`.
fn fitted(fit: &Json) -> Result<(ManoParams, DAffine3)> {
    let pose = fit.get("pose").numbers()?;
    let Some((orient, coefficients)) = pose.split_first_chunk::<3>() else {
        return Err(fit.get("pose").expected("a rotation and coefficients"));
    };
    let params = ManoParams {
        betas: fit.get("betas").exactly::<N_BETAS>()?.map(|beta| beta as f32),
        global_orient: DVec3::from_array(*orient).as_vec3(),
        hand_pose: PoseParams::Coefficients(coefficients.iter().map(|value| *value as f32).collect()),
        transl: Vec3::ZERO,
    };
    Ok((params, motion(&fit.get("mTc"))?.inverse()))
}

impl Reader for Grasp {
    fn recording(&self) -> &Recording {
        &self.recording
    }

    fn files(&self) -> Result<Vec<PathBuf>> {
        Ok([self.images.paths(), vec![self.annotation.clone(), self.fits.clone()]].concat())
    }

    fn moment(&self, index: usize) -> Result<Moment> {
        let content = self.content.get(&self.annotation, || self.content())?;
        let frame = content.frames.get(index);
        let frame = frame.ok_or_else(|| Error::file(&self.annotation, format!("frames: expected frame {index}")))?;
        let hand = |side: Side| {
            let (params, joints_from_hand) = content.hands[side as usize].clone()?;
            Some(RecordedHand::Placed(params, frame.hands[side as usize] * joints_from_hand))
        };
        Ok(Moment {
            stamp_secs: index as f64 / FPS,
            world_from_reference: frame.object_from_world.inverse(),
            world_from_camera: content.world_from_camera,
            hands: Side::BOTH.map(hand),
            objects: vec![Some(DAffine3::IDENTITY)],
            forces: [None, None],
            readings: Vec::new(),
        })
    }

    fn images(&self, from: usize) -> Result<SourceFrames<'_>> {
        self.images.frames(from, |index| index as f64 / FPS)
    }

    fn release(&self) {
        self.content.release();
    }
}
