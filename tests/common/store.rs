//! Stores that tests write.

use std::path::Path;

use egotac::dataset::zarr::{Compression, Contact, ZarrWriter};
use egotac::dataset::{Attributes, EpisodeWriter, Frame};
use egotac::hand::Topology;
use egotac::tactile::{N_FIELD, TactileField, Validity};
use image::{Rgb, RgbImage};

/// Writes a store of valid truth, with the compression that `egotac` writes; `episodes`: number of frames of each, `step_secs`
/// apart over all; `frame` gives image and touch of frame `index` of all.
pub fn write_store(path: &Path, episodes: &[usize], step_secs: f64, frame: impl Fn(usize) -> (RgbImage, TactileField)) {
    fill(create(path), episodes, step_secs, frame);
}

/// As [`write_store`], without compression: files have the same size whatever they hold.
pub fn write_plain_store(
    path: &Path,
    episodes: &[usize],
    step_secs: f64,
    frame: impl Fn(usize) -> (RgbImage, TactileField),
) {
    fill(create(path).with_compression(Compression::None), episodes, step_secs, frame);
}

/// Writes a store of one episode at 25 Hz in which the brightness of the image is proportional to the force on the first 50
/// vertices.
pub fn write_bright_store(path: &Path, frames: usize) {
    write_store(path, &[frames], 0.04, |index| {
        let level = (index * 37 % 11) as f32 / 10.0;
        let force = (0..N_FIELD).map(|v| if v < 50 { level } else { 0.0 }).collect();
        let image = RgbImage::from_pixel(64, 64, Rgb([(200.0 * level) as u8, 90, 90]));
        (image, TactileField::from_force(Topology::EgotacHand1, force).unwrap())
    });
}

fn create(path: &Path) -> ZarrWriter {
    let attributes: Attributes = serde_json::from_value(serde_json::json!({ "topology": "egotac-hand-1" })).unwrap();
    ZarrWriter::create(path, attributes, Contact::Truth, Vec::new()).unwrap()
}

fn fill(mut writer: ZarrWriter, episodes: &[usize], step_secs: f64, frame: impl Fn(usize) -> (RgbImage, TactileField)) {
    let mut index = 0;
    for &frames in episodes {
        for _ in 0..frames {
            let (camera_ego_rgb, field) = frame(index);
            let frame = Frame {
                timestamp: step_secs * index as f64,
                camera_ego_rgb,
                field,
                force_valid: vec![1; N_FIELD],
                contact_valid: vec![1; N_FIELD],
                validity: Validity::Valid,
                left_hand_pose: None,
                right_hand_pose: None,
            };
            writer.push(frame).unwrap();
            index += 1;
        }
        writer.end_episode().unwrap();
    }
    writer.finish().unwrap();
}
