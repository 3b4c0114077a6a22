//! Another program on the same vectors.

use std::collections::HashMap;

use glam::DVec3;
use safetensors::tensor::{Dtype, TensorView};
use serde::{Deserialize, Serialize};

use super::objective::Setup;
use crate::bench::peer;
use crate::error::{Error, Result};
use crate::file;
use crate::retarget::Robot;

/// What a peer printed.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Timing {
    /// The peer's name and version.
    pub name: String,
    /// Time per frame, median, microseconds.
    pub median_us: f64,
    /// Time per frame that 99 of 100 frames keep, microseconds.
    pub p99_us: f64,
    /// Jerk without smoothing, rad/s³.
    pub jerk: f64,
    /// Jerk with a low pass that lags by 50 ms, rad/s³.
    pub jerk_50ms: f64,
}

/// Runs `command --input FILE` and reads the JSON object on its last line.
///
/// # Errors
/// If it can't be started, fails, or prints something else.
pub fn run(command: &str, robot: &Robot, setup: &Setup, vectors: &[Vec<DVec3>]) -> Result<Timing> {
    let folder = tempfile::tempdir().map_err(Error::io("temporary folder"))?;
    let path = folder.path().join("vectors.safetensors");
    let bytes: Vec<u8> = vectors.iter().flatten().flat_map(|v| v.to_array()).flat_map(|x| x.to_le_bytes()).collect();
    let shape = vec![vectors.len(), setup.tips.len(), 3];
    let view = TensorView::new(Dtype::F64, shape, &bytes).map_err(|error| Error::file(&path, error))?;
    let tips = serde_json::to_string(&setup.tips).map_err(|error| Error::file(&path, error))?;
    let metadata = HashMap::from([
        ("urdf".to_owned(), robot.origin.clone()),
        ("wrist".to_owned(), setup.wrist.clone()),
        ("tips".to_owned(), tips),
        ("scale".to_owned(), setup.scale.to_string()),
    ]);
    let content = safetensors::serialize([("vectors", view)], Some(metadata)).map_err(|e| Error::file(&path, e))?;
    file::write(&path, &content)?;
    peer::ask(command, &["--input".into(), path.into_os_string()], 1)
}
