//! EgoTac-SC as it is recorded: each stream has stamps of its own.

use std::path::Path;

use egotac::hand::Side;
use glam::{DAffine3, DQuat, DVec3};
use image::RgbImage;

use super::files::{png, write};
use super::h5::Node;
use super::take::{FRAMES, Take};

/// Time of the first image, ms, and the time between images.
const FIRST: f64 = 1_700_000_000_100.0;
const STEP: f64 = 1000.0 / 30.0;
/// Reading of every taxel without touch, N.
const REST: f64 = 0.3;
/// Start of the touch before the first image, ms.
const TOUCH: f64 = 60.0;

/// Time of an image, ms: whole milliseconds, as the names of the files are.
pub fn image_ms(index: usize) -> f64 {
    (FIRST + STEP * index as f64).round()
}

/// Force on a taxel at a time, N: it grows evenly while there is touch.
pub fn force(touch: f32, ms: f64) -> f64 {
    if ms < FIRST - TOUCH { 0.0 } else { f64::from(touch) * (1.0 + 1e-3 * (ms - FIRST)) }
}

/// Pose of the head's tracker at a time, ms: it turns evenly about a line.
pub fn head(ms: f64) -> DAffine3 {
    let (time, axis, through) = ((ms - FIRST) / 1e3, DVec3::new(0.2, 0.9, -0.3).normalize(), DVec3::new(0.1, 0.4, 0.0));
    let turn = DQuat::from_axis_angle(axis, 0.9 * time);
    let about = DAffine3::from_rotation_translation(turn, through - turn * through + axis * (0.1 * time));
    about * DAffine3::from_rotation_translation(DQuat::from_rotation_x(0.5), DVec3::new(0.3, -0.2, 1.5))
}

/// Stamps of a stream, ms: from 0.3 s before the first image to after the last, without those between the images `gap`.
pub fn stamps(step: f64, offset: f64, gap: Option<[usize; 2]>) -> Vec<f64> {
    let end = image_ms(FRAMES - 1) + 50.0;
    let all = (0..).map(|k| FIRST - 300.0 + offset + step * k as f64).take_while(|ms| *ms < end);
    all.filter(|ms| !gap.is_some_and(|[from, to]| (image_ms(from)..image_ms(to)).contains(ms))).collect()
}

/// Recording of a head camera, two gloves and the head's tracker.
pub struct RawRecording<'a> {
    /// Times, whole ms, and images.
    pub images: Vec<(f64, &'a RgbImage)>,
    /// Left and right glove.
    pub gloves: [GloveStream; 2],
    /// Times, ms, and poses of the head's tracker.
    pub head: (Vec<f64>, Vec<DAffine3>),
}

/// Samples of a glove with their times.
#[derive(Debug, Clone, PartialEq)]
pub struct GloveStream {
    /// ms.
    pub stamps: Vec<f64>,
    /// Readings of 132 taxels, thumb to little finger, then the palm, at each time.
    pub taxels: Vec<Vec<f32>>,
}

/// Writes a recording of a take: `touch` are the newtons of each hand's 132 taxels, thumb to little finger, then the palm, at the
/// first image; the left glove loses its samples between the images `gap`.
pub fn write_raw(root: &Path, id: &str, take: &Take, touch: &[Vec<f32>; 2], gap: Option<[usize; 2]>) {
    let glove = |side: Side| {
        let stamps = match side {
            // Neither clock has a sample at the time of an image.
            Side::Left => stamps(10.0, 3.7, gap),
            Side::Right => stamps(8.0, 1.3, None),
        };
        let sample = |ms: &f64| touch[side as usize].iter().map(|taxel| (REST + force(*taxel, *ms)) as f32).collect();
        GloveStream { taxels: stamps.iter().map(sample).collect(), stamps }
    };
    // The trackers have the stamps of the file.
    let common = stamps(11.0, 0.6, None);
    let poses = common.iter().map(|ms| head(*ms)).collect();
    let images = take.frames.iter().enumerate().map(|(index, frame)| (image_ms(index), &frame.image)).collect();
    write_recording(root, id, &RawRecording { images, gloves: Side::BOTH.map(glove), head: (common, poses) });
}

/// Writes a recording into the folder `id` of `root`.
pub fn write_recording(root: &Path, id: &str, recording: &RawRecording) {
    let folder = root.join(id);
    let mut state = Vec::new();
    for (side, glove) in Side::BOTH.into_iter().zip(&recording.gloves) {
        let n = glove.stamps.len() as u64;
        let mut channels = vec![("TimeStamps".to_string(), Node::f64s(&[n, 1], glove.stamps.iter().copied()))];
        for channel in 1..138usize {
            let taxel = match channel {
                1..=60 => {
                    // The left glove counts its fingers from the little one.
                    let (finger, within) = ((channel - 1) / 12, (channel - 1) % 12);
                    Some(12 * if side == Side::Left { 4 - finger } else { finger } + within)
                }
                66.. => Some(channel - 6),
                _ => None,
            };
            let value = |sample: &Vec<f32>| taxel.map_or(900.0, |taxel| sample[taxel]);
            channels.push((format!("data_{channel}"), Node::f32s(&[n], glove.taxels.iter().map(value))));
        }
        state.push((
            if side == Side::Left { "LeftPort" } else { "RightPort" }.to_string(),
            Node::Group(channels, Vec::new()),
        ));
    }
    let (common, poses) = &recording.head;
    let n = common.len() as u64;
    let quaternions = poses.iter().flat_map(|pose| DQuat::from_affine3(pose).to_array());
    let tracker = Node::group([
        ("pos", Node::f64s(&[n, 3], poses.iter().flat_map(|pose| pose.translation.to_array()))),
        ("quaternion", Node::f64s(&[n, 4], quaternions)),
    ]);
    state.push(("HeadTracker".to_string(), tracker));
    let file = Node::group([
        ("TimeStamps", Node::f64s(&[n], common.iter().copied())),
        ("state", Node::Group(state, Vec::new())),
    ]);
    write(&folder.join(format!("Data_{id}.hdf5")), file.file());
    write(&folder.join(format!("Camera_{id}.json")), r#"{"zedParams": {"cameraSerialNumber": 42}}"#);
    for (ms, image) in &recording.images {
        write(&folder.join(format!("Image_{id}/{ms}.png")), png(image));
    }
}
