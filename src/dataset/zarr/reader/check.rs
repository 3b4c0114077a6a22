//! Checks of a store when it is opened: attributes, episodes, shapes.

use std::collections::BTreeMap;
use std::path::Path;

use super::super::files::StoreFiles;
use super::super::stored::StoredArray;
use super::super::*;
use super::{Camera, ZarrReader};
use crate::dataset::Attributes;
use crate::error::{Error, Result};
use crate::file::limits;
use crate::hand::Topology;
use crate::image::check_size;
use crate::tactile::N_FIELD;

/// Number of frames up to which a store may leave out all chunks of its images, as if they were black.
const UNCHECKED: usize = 1024;

impl ZarrReader {
    /// Reads the ends of the episodes: frames counted from the start of the store, growing.
    pub(super) fn read_episode_ends(&self) -> Result<Vec<usize>> {
        let column = self.column(EPISODE_ENDS)?;
        let [_] = column.info().shape[..] else {
            return Err(self.named(Error::shape(EPISODE_ENDS, "(E)", column.info().shape)));
        };
        let fail = |message: String| Error::file(&self.path, format!("{EPISODE_ENDS}: {message}"));
        let episodes = column.info().shape.first().copied().unwrap_or(0);
        limits::EPISODES.check(&self.path, EPISODE_ENDS, episodes as u64)?;
        let values = self.read(EPISODE_ENDS, 0..episodes)?;
        let Values::I64(ends) = values else {
            return Err(fail(format!("expected integers, got {}", values.dtype())));
        };
        let mut before = 0;
        for end in &ends {
            if *end <= before {
                return Err(fail(format!("expected ends that grow from above 0, got {end} after {before}")));
            }
            before = *end;
        }
        if ends.is_empty() {
            return Err(fail("the store has no episode".into()));
        }
        limits::FRAMES.check(&self.path, EPISODE_ENDS, before as u64)?;
        Ok(ends.into_iter().map(|end| end as usize).collect())
    }

    /// Checks the number of frames of all arrays, and the shapes of known arrays.
    pub(super) fn check_shapes(&self) -> Result<()> {
        let n_frames = self.len();
        for column in self.arrays.values().filter(|column| column.name.starts_with("data/")) {
            let shape = column.info().shape;
            if shape.first() != Some(&n_frames) {
                let expected = format!("({n_frames}, ..), the last of {EPISODE_ENDS}");
                return Err(self.named(Error::shape(&column.name, expected, shape)));
            }
        }
        let fields = [MANO_FORCE, MANO_CONTACT, MANO_CONTACT_SCORE, MANO_FORCE_VALID, MANO_CONTACT_VALID];
        let known = fields.into_iter().map(|name| (name, vec![n_frames, N_FIELD])).chain([
            (FRAME_VALIDITY, vec![n_frames]),
            (TIMESTAMPS, vec![n_frames]),
            (LEFT_HAND_POSE, vec![n_frames, 61]),
            (RIGHT_HAND_POSE, vec![n_frames, 61]),
        ]);
        for (name, expected) in known {
            if let Some(column) = self.arrays.get(name)
                && column.info().shape != expected
            {
                return Err(self.named(Error::shape(name, format!("{expected:?}"), column.info().shape)));
            }
        }
        self.column(TIMESTAMPS)?;
        Ok(())
    }

    /// Finds the images of the array `name`, and their layout.
    pub(super) fn find_camera(&self, name: &str) -> Result<Camera> {
        let info = self.column(name)?.info();
        let (height, width, planar) = match info.shape[..] {
            [_, height, width, 3] => (height, width, false),
            [_, 3, height, width] => (height, width, true),
            _ => (0, 0, false),
        };
        if height == 0 || width == 0 {
            return Err(self.named(Error::shape(name, "(T, H, W, 3)", info.shape)));
        }
        check_size(width as u64, height as u64).map_err(|error| self.named(error))?;
        // An intact image takes at least a byte; a shape by itself is not a recording.
        let frames = self.len();
        if frames > UNCHECKED && self.files.bytes_below(name, frames as u64)? < frames as u64 {
            let message =
                format!("{name}: expected {frames} images, as {EPISODE_ENDS} states, got fewer bytes than that");
            return Err(Error::file(&self.path, message));
        }
        Ok(Camera { name: name.to_string(), size: (height, width), planar })
    }
}

/// Returns the names of the arrays in `data/` and `meta/`.
pub(super) fn array_names(files: &StoreFiles) -> Result<Vec<String>> {
    let mut names = Vec::new();
    for group in ["data/", "meta/"] {
        for array in files.folders_in(group)? {
            let name = format!("{group}{array}");
            let has = |file: &str| files.has(&format!("{name}/{file}"));
            if has(".zarray")? || (has("zarr.json")? && !has(".zgroup")?) {
                names.push(name);
            }
        }
    }
    Ok(names)
}

/// Returns the fixed attributes; a store without labels needs none of them.
pub(super) fn attributes(
    path: &Path,
    raw: &serde_json::Map<String, serde_json::Value>,
    arrays: &BTreeMap<String, StoredArray>,
) -> Result<Attributes> {
    let mut map = raw.clone();
    // Stores by other programs may hold values of other types under these descriptive names: ignore them.
    map.retain(|name, value| match name.as_str() {
        "scene" | "producer" | "version" => value.is_string(),
        "seed" => value.is_u64(),
        "sigma" => value.is_number(),
        "thresholds" => value.get("contact_force").is_none_or(serde_json::Value::is_number) && value.is_object(),
        _ => true,
    });
    if !map.contains_key("topology") {
        let labels: Vec<&str> =
            arrays.keys().filter(|name| name.starts_with("data/mano_")).map(String::as_str).collect();
        if !labels.is_empty() {
            let labels = labels.join(", ");
            return Err(Error::file(
                path,
                format!("attribute topology is missing: it states the vertex numbering of {labels}"),
            ));
        }
        map.insert("topology".into(), Topology::default().id().into());
    }
    serde_json::from_value(map.into()).map_err(|e| Error::file(path, format!("attributes: {e}")))
}
