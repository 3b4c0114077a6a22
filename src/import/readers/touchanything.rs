//! TouchAnything (EgoTouch): one HDF5 file per trajectory, with a chest camera, wrist cameras and pressure grids.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use glam::DAffine3;
use serde_json::json;

use crate::dataset::source::{EncodedImage, SourceFrames};
use crate::error::{Error, Result};
use crate::hand::{N_KEYPOINTS, Side};
use crate::import::glove::GloveMap;
use crate::import::input::folders;
use crate::import::input::hdf5::Hdf5;
use crate::import::input::hdf5_images::{self, H5Images};
use crate::import::input::lazy::Lazy;
use crate::import::input::numbers::keypoints;
use crate::import::kind::{Found, Kind, Mano, Options};
use crate::import::recording::{Moment, Reader, RecordedHand, Recording};
use crate::import::sensors::Sensor;
use ::image::RgbImage;

/// TouchAnything.
pub const KIND: Kind = Kind {
    name: "touchanything",
    gives: "images of the chest camera and both wrist cameras, both hands fitted to 21 joints, readings of the gloves (21 x 21): contact and a relative reading at the vertices, no newtons",
    mano: Mano::Fitted,
    origin: "TouchAnything (EgoTouch): TASK/TRAJECTORY.hdf5",
    licence: "its authors' terms of use",
    find,
};
/// Images of the chest camera.
const IMAGES: &str = "images/chest_color";
/// Arrays of the wrist cameras in the store, and in the file.
const WRISTS: [(&str, &str); 2] =
    [("data/left_wrist_camera_rgb", "images/left_color"), ("data/right_wrist_camera_rgb", "images/right_color")];
/// Rows and columns of a glove's grid.
const GRID: [usize; 2] = [21, 21];
/// Microseconds per second: unit of the stamps.
const MICROSECONDS: f64 = 1e6;
/// Depth at which files lie, at most.
const MAX_DEPTH: usize = 4;
/// Distance from a hand's own middle, m, beyond which an estimated joint is an outlier of the estimator.
const OUTLIER: f32 = 0.5;

/// Map of the glove.
const SENSOR: &str = "touchanything_21x21";

fn find(source: &Path, options: &Options) -> Result<Found> {
    let map = options.sensor.as_deref().unwrap_or(SENSOR);
    let map = GloveMap::open(map, GRID[0] * GRID[1], options.contact_share)?;
    let mut found = Found::default();
    let mut folders = vec![source.to_path_buf()];
    if source.is_file() {
        add(&mut found, source.parent().unwrap_or(source), source, &map);
    }
    for _ in 0..MAX_DEPTH {
        for folder in &folders {
            for path in [folders::files(folder, ".hdf5")?, folders::files(folder, ".h5")?].concat() {
                add(&mut found, source, &path, &map);
            }
        }
        folders = folders.iter().map(|folder| folders::folders(folder)).collect::<Result<Vec<_>>>()?.concat();
    }
    Ok(found)
}

fn add(found: &mut Found, root: &Path, path: &Path, map: &Arc<GloveMap>) {
    let name = path.strip_prefix(root).unwrap_or(path).with_extension("").display().to_string();
    found.add(name.clone(), Trajectory::open(path, name, map));
}

/// One trajectory.
struct Trajectory {
    recording: Recording,
    path: PathBuf,
    stamps: Vec<f64>,
    file: Lazy<Hdf5>,
    wrists: [Lazy<H5Images>; 2],
}

impl Trajectory {
    fn open(path: &Path, name: String, map: &Arc<GloveMap>) -> Result<Self> {
        let file = Hdf5::open(path)?;
        let frames = H5Images::open(&file, IMAGES)?.len();
        let stamps = file.required("timestamps")?.expect(&[frames])?.whole(0..frames)?;
        let (mut sensors, mut views) = (Vec::new(), Vec::new());
        for side in Side::BOTH {
            if let Some(array) = file.array(&grid(side))? {
                array.expect(&[frames, GRID[0], GRID[1]])?;
                sensors.push(Sensor {
                    side,
                    shape: GRID.to_vec(),
                    model: "TouchAnything glove",
                    unit: "part of the largest reading, 0 to 1; NaN where the grid has no taxel",
                    falls: false,
                    rest: Some(0.0),
                    full: 1.0,
                    unused: Vec::new(),
                });
            }
            let (view, array) = WRISTS[side as usize];
            if file.array(array)?.is_some() {
                H5Images::open(&file, array)?;
                views.push(view);
            }
        }
        let about = json!({
            "task": file.text("metadata", "task_name"),
            "hand": "fitted to 21 joints that WiLoR estimated in the chest camera's frame",
            "tactile_max": Side::BOTH.map(|side| file.number("pressure", &format!("tactile_max_{}", side.name()))),
        });
        Ok(Self {
            recording: Recording {
                name,
                path: path.to_path_buf(),
                frames,
                glove: (!sensors.is_empty()).then(|| Arc::clone(map)),
                sensors,
                further_views: views,
                about,
                ..Recording::default()
            },
            path: path.to_path_buf(),
            stamps: stamps.into_iter().map(|micros| micros as f64 / MICROSECONDS).collect(),
            file: Lazy::default(),
            wrists: Default::default(),
        })
    }

    /// Reads the joints of a hand; `None` where the estimator found none.
    fn hand(&self, file: &Hdf5, side: Side, index: usize) -> Result<Option<RecordedHand>> {
        let array = |part: &str| file.array(&format!("hands/wilor_{}_{part}", side.name()));
        let (Some(joints), Some(valid)) = (array("joint_xyz")?, array("valid")?) else { return Ok(None) };
        let frames = self.recording.frames;
        if valid.expect(&[frames])?.numbers(index..index + 1)? != [1.0] {
            return Ok(None);
        }
        let joints = joints.expect(&[frames, N_KEYPOINTS, 3])?.numbers(index..index + 1)?;
        let Some(points) = keypoints(&joints) else { return Ok(None) };
        let middle = points.iter().sum::<glam::Vec3>() / N_KEYPOINTS as f32;
        let is_hand = points.iter().all(|point| point.distance(middle) < OUTLIER);
        Ok(is_hand.then_some(RecordedHand::Keypoints(points)))
    }
}

/// Returns the path of a glove's grids in the file.
fn grid(side: Side) -> String {
    format!("pressure/{}_pressure_grid", side.name())
}

impl Reader for Trajectory {
    fn recording(&self) -> &Recording {
        &self.recording
    }

    fn files(&self) -> Result<Vec<PathBuf>> {
        Ok(vec![self.path.clone()])
    }

    fn moment(&self, index: usize) -> Result<Moment> {
        let file = self.file.get(&self.path, || Hdf5::open(&self.path))?;
        let reading = |sensor: &Sensor| {
            let values = file.required(&grid(sensor.side))?.numbers(index..index + 1)?;
            Ok::<_, Error>(Some(values.into_iter().map(|value| value as f32).collect()))
        };
        Ok(Moment {
            stamp_secs: self.stamps[index],
            world_from_reference: DAffine3::IDENTITY,
            world_from_camera: Some(DAffine3::IDENTITY),
            hands: [self.hand(&file, Side::Left, index)?, self.hand(&file, Side::Right, index)?],
            objects: Vec::new(),
            forces: [None, None],
            readings: self.recording.sensors.iter().map(reading).collect::<Result<_>>()?,
        })
    }

    fn images(&self, from: usize) -> Result<SourceFrames<'_>> {
        let open = |file: &Hdf5| H5Images::open(file, IMAGES);
        let read = |images: &H5Images, index| images.image(index).map(EncodedImage::Pixels);
        hdf5_images::frames(&self.path, from..self.recording.frames, open, read, |index| self.stamps[index])
    }

    fn further_image(&self, view: &'static str, index: usize) -> Result<RgbImage> {
        let found = WRISTS.iter().zip(&self.wrists).find(|((name, _), _)| *name == view);
        let Some(((_, array), images)) = found else {
            return Err(Error::unknown("view", view, WRISTS.map(|(name, _)| name)));
        };
        images.get(&self.path, || H5Images::open(&Hdf5::open(&self.path)?, array))?.image(index)
    }

    fn release(&self) {
        self.file.release();
        self.wrists.iter().for_each(Lazy::release);
    }
}
