//! The network that an experiment starts from.

use std::path::{Path, PathBuf};

use egotac::error::Result;
use egotac::file::{self, input, limits};
use egotac::model::{self, checkpoint, shipped};
use serde::Serialize;

/// Network that all arms start from, or that is measured.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Network {
    /// Name in the checkpoint.
    pub name: String,
    /// SHA-256 of the checkpoint; empty for random weights.
    pub sha256: String,
    /// Frames, steps and data that it has seen.
    pub has_seen: String,
    /// Path of the checkpoint; `None` = random weights.
    #[serde(skip)]
    pub path: Option<PathBuf>,
    /// Geometry.
    #[serde(skip)]
    pub geometry: model::Config,
}

impl Network {
    /// Reads a checkpoint; `None` = the shipped one.
    ///
    /// # Errors
    /// If it can't be read.
    pub fn load(path: Option<&Path>) -> Result<Self> {
        let shipped = shipped::path();
        let is_shipped = path.is_none_or(|path| shipped.as_ref().is_ok_and(|own| own == path));
        let path = path.map_or(shipped, |path| Ok(path.to_path_buf()))?;
        let (geometry, metadata, _) = checkpoint::load_tensors(&path)?;
        let sha256 = file::sha256(&input::read(&path, limits::WEIGHTS)?);
        let has_seen = match is_shipped {
            true => "all nineteen shipped scenes with force and contact, with their own cameras and look: those that are held \
                     out here too, but neither the shapes nor the camera nor the look of the split `ood`"
                .into(),
            false => seen(&metadata.training),
        };
        Ok(Self { name: metadata.name, sha256, has_seen, path: Some(path), geometry })
    }

    /// Returns a network that is small enough for a test, with random weights.
    pub fn toy() -> Self {
        let geometry = model::Config { predict: 1, ..model::Config::toy() };
        let has_seen = "nothing: its weights are random".into();
        Self { name: "toy".into(), sha256: String::new(), has_seen, path: None, geometry }
    }
}

/// Tells from a checkpoint's record of its training what it has seen.
fn seen(record: &str) -> String {
    let Ok(record) = serde_json::from_str::<serde_json::Value>(record) else { return "not recorded in it".into() };
    let stores: Vec<String> = record["config"]["data"].as_array().into_iter().flatten().flat_map(stores).collect();
    match (record["steps"].as_u64(), record["frames"].as_u64()) {
        (Some(steps), Some(frames)) => format!("{steps} steps on {frames} frames of {}", stores.join(", ")),
        _ => "not recorded in it".into(),
    }
}

/// Returns the names of the stores of a source.
fn stores(source: &serde_json::Value) -> Vec<String> {
    let name = |path: &serde_json::Value| {
        let path = Path::new(path.as_str().unwrap_or("?"));
        path.file_name().map_or_else(String::new, |name| name.to_string_lossy().into_owned())
    };
    match source["stores"].as_array() {
        Some(paths) => paths.iter().map(name).collect(),
        None => vec![name(source)],
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_shipped_network_says_that_it_knows_the_scenes_and_others_name_their_stores() {
        let shipped = Network::load(None).unwrap();
        assert!(shipped.has_seen.contains("nineteen") && shipped.sha256.len() == 64);
        let record =
            r#"{"steps": 5, "frames": 70, "config": {"data": ["a/b.zarr", {"stores": ["c.zarr"], "mirror": true}]}}"#;
        assert_eq!(seen(record), "5 steps on 70 frames of b.zarr, c.zarr");
        assert_eq!(seen("by hand"), "not recorded in it");
    }
}
