//! Writer of stores, frame by frame in constant memory.

use std::collections::BTreeMap;
use std::path::Path;

use serde_json::{Map, Value};

use super::column::ArrayWriter;
use super::folder::StoreFolder;
use super::*;
use crate::dataset::{Attributes, EpisodeWriter, Frame};
use crate::error::{Error, Result};
use crate::hand::HandParams;
use crate::tactile::{ForceKind, N_FIELD};

/// Meaning of the frames' contact.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Contact {
    /// Truth: 0 or 1, stored as `data/mano_contact`; unknown (NaN) only where `contact_valid` is 0.
    #[default]
    Truth,
    /// Predicted probability, stored as `data/mano_contact_score`.
    Score,
}

/// Atomic writer of one store: [`ZarrWriter::finish`] gives the complete store its name.
#[derive(Debug)]
pub struct ZarrWriter {
    // Declared before the folder, so that dropping ends the writing threads before it removes the folder.
    columns: Vec<ArrayWriter>,
    folder: StoreFolder,
    compression: Compression,
    attributes: Attributes,
    more_attributes: Map<String, Value>,
    contact: Contact,
    extra: Vec<ArraySpec>,
    /// Width and height; None before the first frame.
    image_size: Option<(u32, u32)>,
    n_frames: usize,
    episode_ends: Vec<i64>,
}

impl ZarrWriter {
    /// Starts the store `path`; `extra` declares arrays beside the fixed ones.
    ///
    /// # Errors
    /// If `path` exists, its folder can't be written, or the name of an extra array is not `data/NAME` or not unique.
    pub fn create(path: &Path, attributes: Attributes, contact: Contact, extra: Vec<ArraySpec>) -> Result<Self> {
        let writer = Self {
            columns: Vec::new(),
            folder: StoreFolder::create(path)?,
            compression: Compression::default(),
            attributes,
            more_attributes: Map::new(),
            contact,
            extra,
            image_size: None,
            n_frames: 0,
            episode_ends: Vec::new(),
        };
        writer.check_extra()?;
        Ok(writer)
    }

    /// Sets the compression of the chunks; must precede the first frame.
    #[must_use]
    pub fn with_compression(mut self, compression: Compression) -> Self {
        self.compression = compression;
        self
    }

    /// Sets an attribute beside the fixed ones, such as the camera's intrinsics, or `force_kind`, which is `spread` otherwise.
    pub fn set_attribute(&mut self, name: &str, value: Value) {
        self.more_attributes.insert(name.to_string(), value);
    }

    /// Returns the number of frames so far, over all episodes.
    pub fn n_frames(&self) -> usize {
        self.n_frames
    }

    /// Returns true if a frame has the topology of the store and the image size of its first frame.
    pub fn fits(&self, frame: &Frame) -> bool {
        let has_size = self.image_size.is_none_or(|size| size == frame.camera_ego_rgb.dimensions());
        has_size && self.attributes.topology == frame.field.topology
    }

    /// Appends one frame and the values of all extra arrays, by name.
    ///
    /// # Errors
    /// If the frame or an extra value does not fit the store (image size, topology, shape, dtype, range), an extra
    /// array is missing or unknown, or writing fails.
    pub fn push_with(&mut self, frame: Frame, extra: Vec<(&str, Values)>) -> Result<()> {
        self.attributes.topology.must_match(frame.field.topology)?;
        let size = frame.camera_ego_rgb.dimensions();
        if *self.image_size.get_or_insert(size) != size {
            let (w, h) = self.image_size.unwrap_or(size);
            return Err(Error::shape(CAMERA_EGO_RGB, format!("({h}, {w}, 3)"), (size.1, size.0, 3)));
        }
        if size.0 == 0 || size.1 == 0 {
            return Err(Error::shape(CAMERA_EGO_RGB, "(H, W, 3)", (size.1, size.0, 3)));
        }
        if self.columns.is_empty() {
            self.columns = self.specs(size).into_iter().map(|spec| ArrayWriter::new(spec, self.compression)).collect();
        }
        let mut values = fixed_values(frame, self.contact)?;
        for (name, value) in extra {
            if !self.extra.iter().any(|spec| spec.name == name) {
                return Err(Error::unknown("extra array", name, self.extra.iter().map(|s| s.name.as_str())));
            }
            values.insert(name.to_string(), value);
        }
        // Check all values before the first push, so that a refused frame leaves no part of itself.
        for column in &self.columns {
            column.check(values.get(&column.spec.name), self.folder.path())?;
        }
        for column in &mut self.columns {
            if let Some(values) = values.remove(&column.spec.name) {
                column.push(values, self.folder.root())?;
            }
        }
        self.n_frames += 1;
        Ok(())
    }

    /// Writes the open chunks and gives the store its name.
    ///
    /// # Errors
    /// If an episode is still open, there is no episode, another process created `path`, or writing fails.
    pub fn finish(mut self) -> Result<()> {
        let ended = self.episode_ends.last().copied().unwrap_or(0);
        if ended != self.n_frames as i64 {
            return Err(Error::file(self.folder.path(), "an episode is still open; end it before finishing"));
        }
        if self.n_frames == 0 {
            return Err(Error::file(self.folder.path(), "no episode was written"));
        }
        for column in &mut self.columns {
            column.finish(self.folder.root())?;
        }
        for column in &mut self.columns {
            column.wait(self.folder.path())?;
        }
        let kind = self.more_attributes.entry(ForceKind::ATTRIBUTE);
        kind.or_insert_with(|| ForceKind::default().id().into());
        self.folder.finish(&self.attributes, self.more_attributes, &self.episode_ends)
    }

    fn check_extra(&self) -> Result<()> {
        let mut names: Vec<String> = self.specs((1, 1)).into_iter().map(|spec| spec.name).collect();
        names.sort();
        if let Some(twice) = names.windows(2).find(|pair| pair[0] == pair[1]) {
            return Err(Error::value("extra array", "a name that is not taken", &twice[0]));
        }
        for spec in &self.extra {
            let leaf = spec.name.strip_prefix("data/").unwrap_or("");
            if leaf.is_empty() || leaf.contains(['/', '.']) {
                return Err(Error::value("extra array", "a name of the form data/NAME", &spec.name));
            }
            if spec.item.contains(&0) {
                return Err(Error::shape(&spec.name, "no empty dimension", &spec.item));
            }
        }
        Ok(())
    }

    fn specs(&self, (width, height): (u32, u32)) -> Vec<ArraySpec> {
        let contact = match self.contact {
            Contact::Truth => ArraySpec::new(MANO_CONTACT, [N_FIELD], Dtype::U8),
            Contact::Score => ArraySpec::new(MANO_CONTACT_SCORE, [N_FIELD], Dtype::F32),
        };
        let fixed = [
            ArraySpec::new(CAMERA_EGO_RGB, [height as usize, width as usize, 3], Dtype::U8),
            ArraySpec::new(TIMESTAMPS, [], Dtype::F64),
            ArraySpec::new(MANO_FORCE, [N_FIELD], Dtype::F32),
            contact,
            ArraySpec::new(MANO_FORCE_VALID, [N_FIELD], Dtype::U8),
            ArraySpec::new(MANO_CONTACT_VALID, [N_FIELD], Dtype::U8),
            ArraySpec::new(FRAME_VALIDITY, [], Dtype::U8),
            ArraySpec::new(LEFT_HAND_POSE, [61], Dtype::F32),
            ArraySpec::new(RIGHT_HAND_POSE, [61], Dtype::F32),
        ];
        fixed.into_iter().chain(self.extra.iter().cloned()).collect()
    }
}

impl EpisodeWriter for ZarrWriter {
    fn push(&mut self, frame: Frame) -> Result<()> {
        self.push_with(frame, Vec::new())
    }

    fn end_episode(&mut self) -> Result<()> {
        if self.episode_ends.last().copied().unwrap_or(0) == self.n_frames as i64 {
            return Err(Error::file(self.folder.path(), "the episode to end has no frame"));
        }
        self.episode_ends.push(self.n_frames as i64);
        Ok(())
    }
}

/// Returns the values of all fixed arrays.
fn fixed_values(frame: Frame, contact: Contact) -> Result<BTreeMap<String, Values>> {
    let left = frame.left_hand_pose.as_ref().map_or([0.0; 61], HandParams::to_array).to_vec();
    let right = frame.right_hand_pose.as_ref().map_or([0.0; 61], HandParams::to_array).to_vec();
    let contact = match contact {
        Contact::Score => (MANO_CONTACT_SCORE, Values::F32(frame.field.contact)),
        Contact::Truth => {
            let truth = contact_truth(&frame.field.contact, &frame.contact_valid)?;
            (MANO_CONTACT, Values::U8(truth))
        }
    };
    if !frame.timestamp.is_finite() {
        return Err(Error::value(TIMESTAMPS, "finite seconds", frame.timestamp));
    }
    let force = frame.field.force;
    if let Some(bad) = force.iter().position(|f| *f < 0.0 || f.is_infinite()) {
        return Err(Error::value(format!("{MANO_FORCE}[{bad}]"), "a number >= 0, or NaN for unknown", force[bad]));
    }
    let values = [
        (CAMERA_EGO_RGB, Values::U8(frame.camera_ego_rgb.into_raw())),
        (TIMESTAMPS, Values::F64(vec![frame.timestamp])),
        (MANO_FORCE, Values::F32(force)),
        contact,
        (MANO_FORCE_VALID, Values::U8(frame.force_valid)),
        (MANO_CONTACT_VALID, Values::U8(frame.contact_valid)),
        (FRAME_VALIDITY, Values::U8(vec![frame.validity.code()])),
        (LEFT_HAND_POSE, Values::F32(left)),
        (RIGHT_HAND_POSE, Values::F32(right)),
    ];
    Ok(values.into_iter().map(|(name, values)| (name.to_string(), values)).collect())
}

fn contact_truth(contact: &[f32], valid: &[u8]) -> Result<Vec<u8>> {
    let one = |(vertex, contact): (usize, &f32)| match contact {
        0.0 => Ok(0),
        1.0 => Ok(1),
        c if c.is_nan() && valid.get(vertex) == Some(&0) => Ok(0),
        c => Err(Error::value(format!("{MANO_CONTACT}[{vertex}]"), "0 or 1, or unsupervised and NaN", c)),
    };
    contact.iter().enumerate().map(one).collect()
}
