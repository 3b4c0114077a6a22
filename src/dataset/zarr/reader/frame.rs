//! One frame of a store: image, field, masks and hand poses.

use super::super::*;
use super::ZarrReader;
use crate::dataset::{Attributes, EpisodeReader, Frame};
use crate::error::{Error, Result};
use crate::hand::HandParams;
use crate::tactile::{N_FIELD, TactileField, Validity};

impl ZarrReader {
    fn hand_pose(&self, name: &str, index: usize) -> Result<Option<HandParams>> {
        let Some(column) = self.arrays.get(name) else { return Ok(None) };
        let row = column.read_frame(index, &self.path)?.into_f32();
        let array: [f32; 61] = row.try_into().map_err(|row: Vec<f32>| Error::shape(name, "[61]", [row.len()]))?;
        Ok(array.iter().any(|x| *x != 0.0).then(|| HandParams::from_array(&array)))
    }

    /// Reads one frame of a (T, 1556) array; `missing` everywhere without such an array.
    fn field(&self, name: Option<&str>, index: usize, missing: f32) -> Result<Vec<f32>> {
        match name.and_then(|name| self.arrays.get(name)) {
            Some(column) => Ok(column.read_frame(index, &self.path)?.into_f32()),
            None => Ok(vec![missing; N_FIELD]),
        }
    }

    fn mask(&self, name: &str, label: Option<&str>, index: usize) -> Result<Vec<u8>> {
        match self.arrays.get(name) {
            Some(column) => self.bytes(name, column.read_frame(index, &self.path)?),
            None => Ok(vec![u8::from(label.is_some_and(|label| self.has(label))); N_FIELD]),
        }
    }
}

impl EpisodeReader for ZarrReader {
    fn attributes(&self) -> &Attributes {
        &self.attributes
    }

    fn episode_ends(&self) -> &[usize] {
        &self.episode_ends
    }

    fn frame(&self, index: usize) -> Result<Frame> {
        let one = |name: &str| self.column(name)?.read_frame(index, &self.path);
        let code = match self.has(FRAME_VALIDITY) {
            true => self.bytes(FRAME_VALIDITY, one(FRAME_VALIDITY)?)?.first().copied().unwrap_or(0),
            false => 0,
        };
        let validity = Validity::from_code(format_args!("{FRAME_VALIDITY}[{index}]"), code);
        let validity = validity.map_err(|error| self.named(error))?;
        Ok(Frame {
            timestamp: one(TIMESTAMPS)?.into_f64().first().copied().unwrap_or(f64::NAN),
            camera_ego_rgb: self.image(index)?,
            field: TactileField {
                topology: self.attributes.topology,
                force: self.field(Some(MANO_FORCE), index, f32::NAN)?,
                contact: self.field(self.contact_name(), index, f32::NAN)?,
            },
            force_valid: self.mask(MANO_FORCE_VALID, Some(MANO_FORCE), index)?,
            contact_valid: self.mask(MANO_CONTACT_VALID, self.contact_name(), index)?,
            validity,
            left_hand_pose: self.hand_pose(LEFT_HAND_POSE, index)?,
            right_hand_pose: self.hand_pose(RIGHT_HAND_POSE, index)?,
        })
    }
}
