//! CDR of every message.

use std::path::Path;

use egotac::message::*;
use egotac::{Error, HandModel, Result, Side};

use super::{repository, seed};
use crate::case::Case;
use crate::mutate::{Rng, bytes, pick};

/// Changes a payload of the tests.
pub fn make(rng: &mut Rng) -> Case {
    let mut names: Vec<String> = std::fs::read_dir(repository("tests/data/message"))
        .into_iter()
        .flatten()
        .flatten()
        .map(|entry| entry.file_name().to_string_lossy().into_owned())
        .filter(|name| name.ends_with(".cdr"))
        .collect();
    names.sort();
    let mut payload = seed(&format!("tests/data/message/{}", pick(rng, &names)));
    for _ in 0..*pick(rng, &[1, 1, 2, 4]) {
        bytes::change(rng, &mut payload);
    }
    Case::File(payload)
}

/// Reads the payload as each message, and converts what was read.
pub fn read(path: &Path, _scratch: &Path) -> Result<()> {
    let payload = std::fs::read(path).map_err(Error::io(path))?;
    let payload = &payload[..];
    let hand = HandModel::builtin(Side::Right);
    let results = [
        TactileFrame::from_cdr(payload).and_then(|message| message.to_field().map(drop)),
        TactileTruth::from_cdr(payload).and_then(|message| message.validity().map(drop)),
        HandPose::from_cdr(payload).and_then(|message| message.to_params(&hand).map(drop)),
        HandPoses::from_cdr(payload).and_then(|message| message.into_poses().map(drop)),
        TactileRegions::from_cdr(payload).map(drop),
        TFMessage::from_cdr(payload).map(drop),
        Image::from_cdr(payload).and_then(|message| super::image::decode(&message)),
        CompressedImage::from_cdr(payload).and_then(|message| egotac::image::decode(&message.data).map(drop)),
        HandModelInfo::from_cdr(payload).map(drop),
        TactileMetrics::from_cdr(payload).map(drop),
        RobotTouch::from_cdr(payload).map(drop),
        TrainerStatus::from_cdr(payload).map(drop),
        GloveReading::from_cdr(payload).map(drop),
        Float32MultiArray::from_cdr(payload).map(drop),
        PoseArray::from_cdr(payload).map(drop),
        PoseStamped::from_cdr(payload).map(drop),
        JointState::from_cdr(payload).map(drop),
        JointTrajectory::from_cdr(payload).map(drop),
        CameraInfo::from_cdr(payload).map(drop),
        PointCloud2::from_cdr(payload).map(drop),
        DiagnosticArray::from_cdr(payload).map(drop),
        Clock::from_cdr(payload).map(drop),
        Log::from_cdr(payload).map(drop),
    ];
    results.into_iter().reduce(Result::or).unwrap_or(Ok(()))
}
