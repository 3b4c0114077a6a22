//! Any source as an OXT store: images, times and labels.

use std::fs;
use std::path::Path;
use std::sync::Arc;

use ::image::RgbImage;
use ::image::imageops::{FilterType, resize};

use super::journal::Label;
use super::output::{Journals, Output};
use super::provenance::NAME;
use super::source::{Shot, Source};
use super::store;
use super::summary::About;
use crate::dataset::zarr::{Contact, ZarrWriter};
use crate::dataset::{Attributes, EpisodeWriter, Frame};
use crate::error::{Error, Result};
use crate::hand::Topology;
use crate::tactile::{N_FIELD, TactileField, Validity};

/// Writes a store.
pub struct ToStore {
    /// Where images come from.
    pub source: Arc<dyn Source>,
    /// Shorter side that images have in the store at most, pixels; None = as they are.
    pub side: Option<u32>,
}

impl Output for ToStore {
    fn assemble(&self, journals: &Journals, about: &mut About, at: &Path, out: &Path) -> Result<()> {
        remove(at)?;
        let attributes = Attributes {
            topology: journals.topology(),
            sigma: 0.0,
            contact_force: about.provenance.thresholds.contact_force,
            producer: about.provenance.producer.clone(),
            version: about.provenance.version.clone(),
            scene: about.provenance.source.first().cloned().unwrap_or_default(),
            seed: 0,
        };
        let mut writer = ZarrWriter::create(at, attributes, Contact::Score, Vec::new())?;
        writer.set_attribute(NAME, serde_json::to_value(&*about).unwrap_or_default());
        let mut size = None;
        for unit in 0..self.source.units().len() {
            let before = writer.n_frames();
            let mut labels = journals.labels(unit)?;
            let mut time = 0.0;
            for shot in self.source.shots(unit, 0)? {
                let Some(label) = labels.next() else {
                    let name = &self.source.units()[unit].name;
                    return Err(Error::value(name, "the images that were labelled", "more of them"));
                };
                let size = match size {
                    Some(size) => size,
                    None => *size.insert(self.size(unit, &shot)?),
                };
                // A frame without a time stands where the one before it does.
                time = if shot.stamp_secs.is_finite() { shot.stamp_secs } else { time };
                writer.push(Frame { timestamp: time, ..frame(shot, label?, size, journals.topology()) })?;
            }
            // A file without images is no episode.
            if writer.n_frames() > before {
                writer.end_episode()?;
            }
        }
        if writer.n_frames() == 0 {
            return Err(Error::file(out, "would be a store without an image"));
        }
        writer.finish()
    }

    fn about(&self, out: &Path) -> Option<About> {
        store::about(out)
    }
}

impl ToStore {
    /// Size of the store's images: that of the first one that can be decoded, made smaller.
    fn size(&self, unit: usize, first: &Shot) -> Result<(u32, u32)> {
        let decoded = |shot: &Shot| shot.picture.as_ref().ok()?.clone().decode().ok();
        let found = decoded(first).or_else(|| {
            let units = unit..self.source.units().len();
            units.flat_map(|unit| self.source.shots(unit, 0).into_iter().flatten()).find_map(|shot| decoded(&shot))
        });
        let (width, height) = found.map(|image| image.dimensions()).ok_or_else(|| {
            Error::value(&self.source.units()[unit].name, "at least one image that can be read", "none")
        })?;
        let short = width.min(height);
        Ok(match self.side {
            Some(side) if side < short => {
                let scaled = |length: u32| (u64::from(length) * u64::from(side)).div_ceil(u64::from(short)) as u32;
                (scaled(width), scaled(height))
            }
            _ => (width, height),
        })
    }
}

fn frame(shot: Shot, label: Label, size: (u32, u32), topology: Topology) -> Frame {
    let image = shot.picture.ok().and_then(|picture| picture.decode().ok());
    // What can't be read is black, and has no label.
    let image = image.unwrap_or_else(|| RgbImage::new(size.0, size.1));
    let camera_ego_rgb = match image.dimensions() == size {
        true => image,
        false => resize(&image, size.0, size.1, FilterType::Triangle),
    };
    let known = u8::from(label.touch.is_ok());
    let field = label.touch.unwrap_or_else(|_| TactileField {
        topology,
        force: vec![f32::NAN; N_FIELD],
        contact: vec![f32::NAN; N_FIELD],
    });
    Frame {
        timestamp: shot.stamp_secs,
        camera_ego_rgb,
        force_valid: field.force.iter().map(|force| u8::from(!force.is_nan())).collect(),
        contact_valid: vec![known; N_FIELD],
        field,
        validity: Validity::Valid,
        left_hand_pose: None,
        right_hand_pose: None,
    }
}

/// Removes what an earlier, killed attempt left.
pub(super) fn remove(at: &Path) -> Result<()> {
    let gone = match at.symlink_metadata() {
        Ok(there) if there.is_dir() => fs::remove_dir_all(at),
        Ok(_) => fs::remove_file(at),
        Err(_) => Ok(()),
    };
    gone.map_err(Error::io(at))
}
