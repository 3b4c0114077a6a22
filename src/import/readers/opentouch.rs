//! OpenTouch: HDF5 files of clips with JPEG images, glove pressure and hand landmarks.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use glam::DAffine3;
use serde_json::{Map, Value, json};

use crate::dataset::base_name;
use crate::dataset::source::{EncodedImage, SourceFrames};
use crate::error::{Error, Result};
use crate::hand::{N_KEYPOINTS, Side};
use crate::import::glove::GloveMap;
use crate::import::input::folders;
use crate::import::input::hdf5::{H5Array, Hdf5};
use crate::import::input::hdf5_images;
use crate::import::input::lazy::Lazy;
use crate::import::input::numbers::keypoints;
use crate::import::kind::{Found, Kind, Mano, Options};
use crate::import::recording::{Moment, Reader, RecordedHand, Recording};
use crate::import::sensors::Sensor;

/// OpenTouch.
pub const KIND: Kind = Kind {
    name: "opentouch",
    gives: "images of the head camera, both hands fitted to 21 landmarks, readings of the gloves (16 x 16): contact and a relative reading at the vertices, no newtons",
    mano: Mano::Fitted,
    origin: "OpenTouch: data/*.hdf5",
    licence: "MIT, as its code states",
    find,
};
/// Rows and columns of a glove's reading.
const CELLS: [usize; 2] = [16, 16];
/// Reading of a taxel without touch, counts of the converter.
const REST: f32 = 3072.0;
/// Nanoseconds per second: unit of the stamps.
const NANOSECONDS: i64 = 1_000_000_000;
/// Largest number of values of a calibration array that is kept.
const CALIBRATION: usize = 64;

/// Map of the glove.
const SENSOR: &str = "opentouch_169";

fn find(source: &Path, options: &Options) -> Result<Found> {
    let map = options.sensor.as_deref().unwrap_or(SENSOR);
    let map = GloveMap::open(map, CELLS[0] * CELLS[1], options.contact_share)?;
    let mut found = Found::default();
    let files = match source.is_file() {
        true => vec![source.to_path_buf()],
        false => [folders::files(&source.join("data"), ".hdf5")?, folders::files(source, ".hdf5")?].concat(),
    };
    for path in files {
        let scene = base_name(&path).trim_end_matches(".hdf5").to_string();
        match Hdf5::open(&path).and_then(|file| Ok((file.groups("data")?, file))) {
            Ok((clips, file)) => {
                for clip in clips {
                    let name = format!("{scene}/{clip}");
                    found.add(name.clone(), Clip::open(&path, &file, &clip, name, &map));
                }
            }
            Err(error) => found.unreadable.push((scene, error)),
        }
    }
    Ok(found)
}

/// One clip of a file.
struct Clip {
    recording: Recording,
    path: PathBuf,
    /// Path of the clip's group in the file.
    group: String,
    stamps: Vec<f64>,
    file: Lazy<Hdf5>,
}

impl Clip {
    fn open(path: &Path, file: &Hdf5, clip: &str, name: String, map: &Arc<GloveMap>) -> Result<Self> {
        let group = format!("data/{clip}");
        let frames = file.required(&format!("{group}/rgb_images_jpeg"))?.rows()?;
        let stamps = stamps(file, &format!("{group}/timestamps"), frames)?;
        let mut sensors = Vec::new();
        for side in Side::BOTH {
            if let Some(array) = file.array(&format!("{group}/{}_pressure", side.name()))? {
                array.expect(&[frames, CELLS[0], CELLS[1]])?;
                sensors.push(glove(side));
            }
        }
        Ok(Self {
            recording: Recording {
                name,
                path: path.to_path_buf(),
                frames,
                glove: (!sensors.is_empty()).then(|| Arc::clone(map)),
                sensors,
                camera: calibration(file)?,
                about: json!({ "clip": clip, "hand": "fitted to 21 landmarks, in the file's frame, which is not documented" }),
                ..Recording::default()
            },
            path: path.to_path_buf(),
            group,
            stamps,
            file: Lazy::default(),
        })
    }

    fn hand(&self, file: &Hdf5, side: Side, index: usize) -> Result<Option<RecordedHand>> {
        let Some(array) = file.array(&format!("{}/{}_hand_landmarks", self.group, side.name()))? else {
            return Ok(None);
        };
        let array = array.expect(&[self.recording.frames, N_KEYPOINTS, 3])?;
        Ok(keypoints(&array.numbers(index..index + 1)?).map(RecordedHand::Keypoints))
    }
}

/// Returns the sensor of one glove.
fn glove(side: Side) -> Sensor {
    Sensor {
        side,
        shape: CELLS.to_vec(),
        model: "OpenTouch glove",
        unit: "ADC counts",
        falls: true,
        rest: Some(REST),
        full: 0.0,
        unused: unused(),
    }
}

/// Returns the cells that the authors' layout erases: no taxel lies there.
fn unused() -> Vec<usize> {
    let erased = |row: usize, column: usize| match row {
        0..=8 => [2, 5, 8].contains(&column) || column >= 11,
        9..=11 => column >= 11,
        _ => false,
    };
    (0..CELLS[0] * CELLS[1]).filter(|cell| erased(cell / CELLS[1], cell % CELLS[1])).collect()
}

/// Reads stamps, s: whole numbers are nanoseconds, real numbers are seconds.
fn stamps(file: &Hdf5, name: &str, frames: usize) -> Result<Vec<f64>> {
    let array = file.required(name)?.expect(&[frames])?;
    if let Ok(whole) = array.whole(0..frames) {
        // The division of whole numbers first keeps all digits.
        let secs = |nanos: i64| (nanos / NANOSECONDS) as f64 + (nanos % NANOSECONDS) as f64 / NANOSECONDS as f64;
        return Ok(whole.into_iter().map(secs).collect());
    }
    let stamps = array.numbers(0..frames)?;
    match stamps.iter().position(|stamp| !stamp.is_finite()) {
        Some(at) => Err(array.damaged(&format!("expected finite stamps, entry {at} is {}", stamps[at]))),
        None => Ok(stamps),
    }
}

/// Returns the small arrays of the camera's calibration as they are; null without them.
fn calibration(file: &Hdf5) -> Result<Value> {
    const GROUP: &str = "calibration/rgb";
    let mut values = Map::new();
    for name in file.arrays(GROUP)? {
        let array = file.required(&format!("{GROUP}/{name}"))?;
        let shape = array.shape();
        let count = shape.iter().try_fold(1u64, |product, length| product.checked_mul(*length)).unwrap_or(u64::MAX);
        if count <= CALIBRATION as u64
            && let Ok(numbers) = array.numbers(0..shape.first().copied().unwrap_or(1) as usize)
        {
            values.insert(name, json!({ "shape": shape, "values": numbers }));
        }
    }
    Ok(if values.is_empty() { Value::Null } else { Value::Object(values) })
}

impl Reader for Clip {
    fn recording(&self) -> &Recording {
        &self.recording
    }

    fn files(&self) -> Result<Vec<PathBuf>> {
        Ok(vec![self.path.clone()])
    }

    fn moment(&self, index: usize) -> Result<Moment> {
        let file = self.file.get(&self.path, || Hdf5::open(&self.path))?;
        let reading = |sensor: &Sensor| {
            let array = file.required(&format!("{}/{}_pressure", self.group, sensor.side.name()))?;
            let values: Vec<f32> = array.numbers(index..index + 1)?.into_iter().map(|value| value as f32).collect();
            Ok::<_, Error>(Some(values))
        };
        Ok(Moment {
            stamp_secs: self.stamps[index],
            world_from_reference: DAffine3::IDENTITY,
            world_from_camera: None,
            hands: [self.hand(&file, Side::Left, index)?, self.hand(&file, Side::Right, index)?],
            objects: Vec::new(),
            forces: [None, None],
            readings: self.recording.sensors.iter().map(reading).collect::<Result<_>>()?,
        })
    }

    fn images(&self, from: usize) -> Result<SourceFrames<'_>> {
        let name = format!("{}/rgb_images_jpeg", self.group);
        let open = |file: &Hdf5| file.required(&name);
        let read = |array: &Arc<H5Array>, index| array.bytes(index).map(EncodedImage::File);
        hdf5_images::frames(&self.path, from..self.recording.frames, open, read, |index| self.stamps[index])
    }

    fn release(&self) {
        self.file.release();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_layout_leaves_169_of_256_cells() {
        let unused = unused();
        assert_eq!((unused.len(), 256 - unused.len()), (87, 169));
        assert!(unused.contains(&(11 * 16 + 15)) && !unused.contains(&(9 * 16 + 2)));
    }
}
