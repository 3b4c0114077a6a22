//! New stores from the images and labels of any source.

use std::path::Path;
use std::sync::Arc;

use ::image::RgbImage;

use super::{ArraySpec, Contact, Dtype, FAMILIARITY, PREDICTED_KEYPOINTS, PRESENCE, Values, ZarrWriter};
use crate::dataset::copy::remove;
use crate::dataset::label_frame::LabelFrame;
use crate::dataset::label_info::LabelInfo;
use crate::dataset::labels::{LabelOutput, SourceLabels, next_label};
use crate::dataset::provenance::{DoubtRule, PROVENANCE_KEY};
use crate::dataset::source::{ImageSource, SourceFrame};
use crate::dataset::{Attributes, EpisodeWriter, Frame};
use crate::error::{Error, Result};
use crate::hand::{N_KEYPOINTS, Topology};
use crate::image::scaled as resampled;
use crate::tactile::{ForceKind, TactileField, Validity};

/// Writes images, times and labels into a new store.
pub struct StoreOutput {
    /// Source of the images.
    pub source: Arc<dyn ImageSource>,
    /// Upper limit of the images' shorter side, pixels; None = original size.
    pub side: Option<u32>,
}

impl LabelOutput for StoreOutput {
    fn assemble(&self, labels: &dyn SourceLabels, info: &mut LabelInfo, at: &Path, out: &Path) -> Result<()> {
        remove(at)?;
        let topology = labels.topology();
        let estimates = DoubtRule::estimates(info.provenance.doubt.as_ref());
        let [familiarity, presence] = estimates;
        let there = [familiarity, presence, info.provenance.keypoints];
        let specs = [
            ArraySpec::new(FAMILIARITY, [], Dtype::F32),
            ArraySpec::new(PRESENCE, [2], Dtype::F32),
            ArraySpec::new(PREDICTED_KEYPOINTS, [2, N_KEYPOINTS, 3], Dtype::F32),
        ];
        let arrays = specs.into_iter().zip(there).filter(|(_, there)| *there).map(|(spec, _)| spec).collect();
        let mut writer = ZarrWriter::create(at, attributes(topology, info), Contact::Score, arrays)?;
        writer.set_attribute(ForceKind::ATTRIBUTE, info.provenance.force_kind.id().into());
        writer.set_attribute(PROVENANCE_KEY, serde_json::to_value(&*info).unwrap_or_default());
        let mut size = None;
        for (index, unit) in self.source.units().iter().enumerate() {
            let before = writer.n_frames();
            let mut labels = labels.labels(index)?;
            let mut time = 0.0;
            for image in self.source.frames(index, 0)? {
                let image = image?;
                let label = next_label(&mut labels, &unit.name)?;
                let size = match size {
                    Some(size) => size,
                    None => *size.insert(image_size(self.source.as_ref(), index, &image, self.side)?),
                };
                // A frame without a time takes that of the frame before it.
                time = if image.stamp_secs.is_finite() { image.stamp_secs } else { time };
                let [familiarity, presence @ ..] = label.estimates();
                let keypoints = label.keypoints();
                let (frame, scale) = frame(time, image, label, size, topology)?;
                let values = [
                    (FAMILIARITY, vec![familiarity]),
                    (PRESENCE, presence.to_vec()),
                    (PREDICTED_KEYPOINTS, scaled_keypoints(keypoints, scale)),
                ];
                let values = values.into_iter().zip(there).filter(|(_, there)| *there);
                let further = values.map(|((name, values), _)| (name, Values::F32(values))).collect();
                writer.push_with(frame, further)?;
            }
            // A unit without images is not an episode.
            if writer.n_frames() > before {
                writer.end_episode()?;
            }
        }
        if writer.n_frames() == 0 {
            return Err(Error::file(out, "would be a store without an image"));
        }
        writer.finish()
    }

    fn info(&self, out: &Path) -> Option<LabelInfo> {
        super::labels::read_info(out)
    }
}

/// Returns width and height of a store's images: the size of the first decodable image of `source` from `first` in unit
/// `unit` on, scaled down so that the shorter side has at most `side` pixels.
///
/// # Errors
/// If no image can be decoded.
pub(crate) fn image_size(
    source: &dyn ImageSource,
    unit: usize,
    first: &SourceFrame,
    side: Option<u32>,
) -> Result<(u32, u32)> {
    let decoded = |frame: &SourceFrame| frame.image.as_ref().ok()?.clone().decode().ok();
    let mut found = decoded(first);
    for unit in unit..source.units().len() {
        let mut frames = if found.is_none() { source.frames(unit, 0)? } else { break };
        while let (None, Some(frame)) = (&found, frames.next()) {
            found = decoded(&frame?);
        }
    }
    let (width, height) = found
        .map(|image| image.dimensions())
        .ok_or_else(|| Error::value(&source.units()[unit].name, "at least one image that can be read", "none"))?;
    Ok(scaled((width, height), side))
}

/// Returns the size of an image whose shorter side is scaled down to `side` pixels; `None` = not scaled.
pub(crate) fn scaled((width, height): (u32, u32), side: Option<u32>) -> (u32, u32) {
    let short = width.min(height);
    match side {
        Some(side) if side < short => {
            let scaled = |length: u32| (u64::from(length) * u64::from(side)).div_ceil(u64::from(short)) as u32;
            (scaled(width), scaled(height))
        }
        _ => (width, height),
    }
}

/// Scales an image to the size of a store's images, if it has another.
///
/// # Errors
/// If the image or the size is empty.
pub(crate) fn fitted(image: RgbImage, size: (u32, u32)) -> Result<RgbImage> {
    match image.dimensions() == size {
        true => Ok(image),
        false => resampled(&image, size),
    }
}

fn attributes(topology: Topology, info: &LabelInfo) -> Attributes {
    let provenance = &info.provenance;
    Attributes {
        topology,
        sigma: 0.0,
        contact_force: provenance.thresholds.contact_force,
        producer: provenance.producer.clone(),
        version: provenance.version.clone(),
        scene: provenance.source.first().cloned().unwrap_or_default(),
        seed: 0,
    }
}

/// Scales the positions of keypoints, (2, 21, 3), like their image.
fn scaled_keypoints(mut keypoints: Vec<f32>, scale: [f32; 2]) -> Vec<f32> {
    for [x, y, _] in keypoints.as_chunks_mut::<3>().0 {
        (*x, *y) = (*x * scale[0], *y * scale[1]);
    }
    keypoints
}

/// Returns the frame with an image of this size, and by how much its width and height were scaled.
fn frame(
    timestamp: f64,
    source: SourceFrame,
    label: LabelFrame,
    size: (u32, u32),
    topology: Topology,
) -> Result<(Frame, [f32; 2])> {
    let image = source.image.ok().and_then(|image| image.decode().ok());
    // Unreadable images are black and have no label.
    let image = image.unwrap_or_else(|| RgbImage::new(size.0, size.1));
    let scale = [size.0 as f32 / image.width() as f32, size.1 as f32 / image.height() as f32];
    let camera_ego_rgb = fitted(image, size)?;
    let [force_valid, contact_valid] = label.masks();
    let (force, contact) = label.into_values();
    let frame = Frame {
        timestamp,
        camera_ego_rgb,
        force_valid,
        contact_valid,
        field: TactileField { topology, force, contact },
        validity: Validity::Valid,
        left_hand_pose: None,
        right_hand_pose: None,
    };
    Ok((frame, scale))
}
