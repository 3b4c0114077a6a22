//! HOT3D clips: tar archives of JPEG and JSON files.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use ::image::imageops::rotate90;
use glam::{DAffine3, DMat3, DVec3, Vec3};
use serde_json::{Value, json};

use crate::dataset::base_name;
use crate::dataset::source::{EncodedImage, SourceFrame, SourceFrames};
use crate::error::{Error, Result};
use crate::file::limits;
use crate::hand::Side;
use crate::image;
use crate::import::input::folders;
use crate::import::input::json::Json;
use crate::import::input::lazy::Lazy;
use crate::import::input::tar::TarFile;
use crate::import::kind::{Found, Kind, Mano, Options};
use crate::import::recording::{
    Convention, ManoParams, Moment, PoseParams, Reader, RecordedHand, RecordedObject, Recording, Translation,
};
use crate::import::shapes::MeshFile;
use crate::import::umetrack::UmeTrack;

/// HOT3D clips.
pub const KIND: Kind = Kind {
    name: "hot3d",
    gives: "images of the head camera, both hands (by MANO's files; without them, fitted to the joints of UmeTrack), objects, camera pose",
    mano: Mano::Optional,
    origin: "HOT3D clips: clip-*.tar and object_models",
    licence: "HOT3D licence: images CC BY-SA, hands CC BY-NC-SA, objects CC BY-SA and not to be sold; MANO's for the hands",
    find,
};
/// Streams whose images are taken, the first that is there: RGB of Aria, left camera of Quest 3.
const STREAMS: [&str; 2] = ["214-1", "1201-1"];
/// Member with the shapes of the hands.
const SHAPES: &str = "__hand_shapes.json__";
/// Number of coefficients of a hand's pose.
const COEFFICIENTS: usize = 15;

fn find(source: &Path, options: &Options) -> Result<Found> {
    let mut clips = Vec::new();
    if source.is_file() {
        clips.push(source.to_path_buf());
    } else {
        for folder in std::iter::once(source.to_path_buf()).chain(folders::folders(source)?) {
            clips.extend(
                folders::files(&folder, ".tar")?.into_iter().filter(|path| base_name(path).starts_with("clip-")),
            );
        }
    }
    let usual = || {
        let around = source.ancestors().take(3);
        around.filter_map(|folder| folders::first_of(folder, &["object_models", "object_models_eval"])).next()
    };
    let objects = options.objects.clone().or_else(usual);
    let mut found = Found::default();
    for clip in clips {
        let name = base_name(&clip).trim_end_matches(".tar").to_string();
        found.add(name.clone(), Clip::open(name, &clip, objects.as_deref()));
    }
    Ok(found)
}

/// One clip. A data set has thousands: each keeps its archive open only while it is read.
struct Clip {
    recording: Recording,
    tar: Lazy<TarFile>,
    /// Name of the image stream.
    stream: &'static str,
    /// Keys of the frames, such as `000012`.
    keys: Vec<String>,
    /// Indices of the objects by id; several objects of one id follow each other.
    ids: BTreeMap<i64, Vec<usize>>,
    betas: Option<[f32; 10]>,
    /// The person's hand in UmeTrack.
    umetrack: Option<UmeTrack>,
    fault: Option<String>,
}

impl Clip {
    fn open(name: String, path: &Path, objects: Option<&Path>) -> Result<Self> {
        let tar = TarFile::open(path)?;
        let has_image = |stream: &&str| tar.names().any(|name| name.ends_with(&format!(".image_{stream}.jpg")));
        let Some(stream) = STREAMS.into_iter().find(has_image) else {
            return Err(Error::file(path, format!("expected images of stream {}, got none", STREAMS.join(" or "))));
        };
        let ending = format!(".image_{stream}.jpg");
        let keys: Vec<String> = tar.names().filter_map(|name| name.strip_suffix(&ending)).map(Into::into).collect();
        limits::FRAMES.check(path, "frames", keys.len() as u64)?;
        let mut clip = Self {
            recording: Recording {
                name,
                path: path.to_path_buf(),
                frames: keys.len(),
                convention: Convention {
                    adds_mean: true,
                    translation: Translation::AfterRotation,
                    fixes_left_shapedirs: true,
                },
                about: Value::Null,
                ..Recording::default()
            },
            tar: Lazy::default(),
            stream,
            keys,
            ids: BTreeMap::new(),
            betas: None,
            umetrack: None,
            fault: tar.fault().map(|fault| format!("archive: {fault}")),
        };
        clip.find_objects(&tar, objects);
        if let Some(shapes) = clip.json(&tar, SHAPES)? {
            clip.betas = Some(shapes.get("mano").exactly::<10>()?.map(|beta| beta as f32));
            clip.umetrack = UmeTrack::parse(&shapes.get("umetrack"))?;
        }
        (clip.recording.camera, clip.recording.about) = clip.description(&tar);
        Ok(clip)
    }

    /// Lists the objects. All are annotated in every frame, so the first, middle and last one name them.
    fn find_objects(&mut self, tar: &TarFile, folder: Option<&Path>) {
        let last = self.keys.len() - 1;
        let mut counts = BTreeMap::<i64, usize>::new();
        for index in [0, last / 2, last] {
            let mut here = BTreeMap::<i64, usize>::new();
            // A damaged annotation is reported with its frame.
            for (id, _) in self.instances(tar, index).ok().flatten().unwrap_or_default() {
                *here.entry(id).or_default() += 1;
            }
            here.into_iter().for_each(|(id, count)| {
                let most = counts.entry(id).or_default();
                *most = count.max(*most);
            });
        }
        for (id, count) in counts {
            for instance in 0..count {
                let name = match instance {
                    0 => format!("obj_{id:06}"),
                    _ => format!("obj_{id:06}#{instance}"),
                };
                let path = folder.map(|folder| folder.join(format!("obj_{id:06}.glb"))).filter(|path| path.is_file());
                self.ids.entry(id).or_default().push(self.recording.objects.len());
                let mesh = path.map(|path| MeshFile::new(path, 1.0));
                self.recording.objects.push(RecordedObject { name, mesh });
            }
        }
    }

    /// Returns the camera's calibration and the facts about the clip, as far as the first frame states them.
    fn description(&self, tar: &TarFile) -> (Value, Value) {
        let first = |member: &str| self.json(tar, &format!("{}.{member}.json", self.keys[0])).ok().flatten();
        let calibration = first("cameras").map(|cameras| cameras.get(self.stream).get("calibration").value().clone());
        let info = first("info");
        let fact = |name: &str| info.as_ref().map_or(Value::Null, |info| info.value()[name].clone());
        let about = json!({
            "sequence_id": fact("sequence_id"),
            "device": fact("device"),
            "stream": self.stream,
            "images": "turned upright, 90 degrees clockwise; the calibration is of the sensor's images",
        });
        (calibration.unwrap_or_default(), about)
    }

    fn json(&self, tar: &TarFile, member: &str) -> Result<Option<Json>> {
        let content = tar.read(member, limits::TEXT)?;
        content.map(|content| Json::parse(&self.recording.path.join(member), &content)).transpose()
    }

    fn required(&self, tar: &TarFile, member: &str) -> Result<Json> {
        let missing = || Error::file(self.recording.path.join(member), "expected this member of the clip, got none");
        self.json(tar, member)?.ok_or_else(missing)
    }

    /// Returns ids and annotations of the objects in a frame; `None` if the frame is not annotated, as in test clips.
    fn instances(&self, tar: &TarFile, index: usize) -> Result<Option<Vec<(i64, Json)>>> {
        let Some(objects) = self.json(tar, &format!("{}.objects.json", self.keys[index]))? else { return Ok(None) };
        let mut found = Vec::new();
        for instance in objects.entries().iter().flat_map(|(_, list)| list.items()) {
            let id = instance.get("object_bop_id");
            let id = match id.value().as_str().and_then(|text| text.parse().ok()) {
                Some(id) => id,
                None => id.whole()?,
            };
            found.push((id, instance));
        }
        Ok(Some(found))
    }

    fn hand(&self, hands: &Json, side: Side) -> Result<Option<RecordedHand>> {
        let hand = hands.get(side.name());
        let (pose, tracked) = (hand.get("mano_pose"), hand.get("umetrack_pose"));
        let keypoints = match &self.umetrack {
            Some(profile) if !tracked.is_null() => {
                let wrist = tracked.get("T_world_from_wrist").motion()?;
                Some(profile.keypoints(side, &tracked.get("joint_angles"), wrist)?)
            }
            _ => None,
        };
        // The registration of MANO failed in some frames.
        if pose.is_null() {
            return Ok(keypoints.map(RecordedHand::Keypoints));
        }
        let Some(betas) = self.betas else {
            return Err(Error::file(self.recording.path.join(SHAPES), "expected the hands' shape, got none"));
        };
        let thetas: [f64; COEFFICIENTS] = pose.get("thetas").exactly()?;
        let wrist: [f64; 6] = pose.get("wrist_xform").exactly()?;
        let wrist = wrist.map(|value| value as f32);
        let params = ManoParams {
            betas,
            global_orient: Vec3::from_slice(&wrist[..3]),
            hand_pose: PoseParams::Coefficients(thetas.iter().map(|theta| *theta as f32).collect()),
            transl: Vec3::from_slice(&wrist[3..]),
        };
        Ok(Some(match keypoints {
            Some(keypoints) => RecordedHand::Either(params, keypoints),
            None => RecordedHand::Mano(params),
        }))
    }

    fn stamp(&self, tar: &TarFile, index: usize) -> Result<f64> {
        let info = self.required(tar, &format!("{}.info.json", self.keys[index]))?;
        Ok(info.get("image_timestamps_ns").get(self.stream).number()? / 1e9)
    }
}

impl Reader for Clip {
    fn recording(&self) -> &Recording {
        &self.recording
    }

    fn files(&self) -> Result<Vec<PathBuf>> {
        Ok(vec![self.recording.path.clone()])
    }

    fn damage(&self) -> Option<String> {
        self.fault.clone()
    }

    fn moment(&self, index: usize) -> Result<Moment> {
        let path = &self.recording.path;
        let tar = &*self.tar.get(path, || TarFile::open(path))?;
        let mut objects = vec![None; self.recording.objects.len()];
        let mut used = BTreeMap::<i64, usize>::new();
        for (id, instance) in self.instances(tar, index)?.unwrap_or_default() {
            let nth = used.entry(id).or_default();
            let Some(place) = self.ids.get(&id).and_then(|places| places.get(*nth)) else {
                return Err(instance.get("object_bop_id").expected("an object of the first, middle or last frame"));
            };
            *nth += 1;
            objects[*place] = Some(instance.get("T_world_from_object").motion()?);
        }
        let mut hands = [None, None];
        if let Some(annotated) = self.json(tar, &format!("{}.hands.json", self.keys[index]))? {
            for side in Side::BOTH {
                hands[side as usize] = self.hand(&annotated, side)?;
            }
        }
        let cameras = self.json(tar, &format!("{}.cameras.json", self.keys[index]))?;
        let pose = cameras.map(|cameras| cameras.get(self.stream).get("T_world_from_camera").motion()).transpose()?;
        Ok(Moment {
            stamp_secs: self.stamp(tar, index)?,
            world_from_reference: DAffine3::IDENTITY,
            world_from_camera: pose.map(|pose| pose * sensor_from_upright()),
            hands,
            objects,
            forces: [None, None],
            readings: Vec::new(),
        })
    }

    fn images(&self, from: usize) -> Result<SourceFrames<'_>> {
        let tar = TarFile::open(&self.recording.path)?;
        let frame = move |index: usize| {
            let member = format!("{}.image_{}.jpg", self.keys[index], self.stream);
            let content = match tar.read(&member, limits::CHUNK) {
                Err(error) if error.is_of_medium() => return Err(error),
                content => content.map_err(|error| error.to_string()),
            };
            let upright = |content: Option<Vec<u8>>| {
                let place: PathBuf = self.recording.path.join(&member);
                let content = content.ok_or_else(|| format!("{}: missing", place.display()))?;
                let image = image::decode(&content).map_err(|error| format!("{}: {error}", place.display()))?;
                Ok(EncodedImage::Pixels(rotate90(&image)))
            };
            Ok(SourceFrame::new(self.stamp(&tar, index).unwrap_or(f64::NAN), content.and_then(upright)))
        };
        Ok(Box::new((from..self.keys.len()).map(frame)))
    }
    fn release(&self) {
        self.tar.release();
    }
}

/// Returns `sensor_from_upright`: the axes of an image turned clockwise, in the frame of the camera.
fn sensor_from_upright() -> DAffine3 {
    // Right in the upright image is up in the sensor's image, and down is right.
    let axes = DMat3::from_cols(DVec3::NEG_Y, DVec3::X, DVec3::Z);
    DAffine3::from_mat3(axes)
}
