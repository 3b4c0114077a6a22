//! Another retargeting program, timed on the same vectors.

use std::collections::HashMap;

use egotac::error::{Error, Result};
use egotac::file;
use egotac::retarget::Robot;
use glam::DVec3;
use safetensors::tensor::{Dtype, TensorView};
use serde::{Deserialize, Serialize};

use super::objective::{Compared, Setup, compare};
use crate::peer;

/// Results that a peer printed.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Timing {
    /// The peer's name and version.
    pub name: String,
    /// Time per frame, median, microseconds.
    pub median_us: f64,
    /// Time per frame, 99th percentile, microseconds.
    pub p99_us: f64,
    /// Jerk without smoothing, rad/s³.
    pub jerk: f64,
    /// Jerk with a low pass that lags by 50 ms, rad/s³.
    pub jerk_50ms: f64,
    /// Joints of the positions that the peer wrote; `None` if it solves another objective.
    #[serde(default, skip_serializing)]
    joint_names: Option<Vec<String>>,
    /// The peer's objective over ours from the same last pose.
    #[serde(default)]
    pub objective: Option<Compared>,
}

/// Runs `command --input FILE --qpos FILE`, reads the JSON object on the last line of its output, and compares the poses
/// in the second file with ours.
///
/// # Errors
/// If the peer can't be started, fails, or prints or writes something else.
pub fn run(command: &str, robot: &mut Robot, setup: &Setup, vectors: &[Vec<DVec3>]) -> Result<Timing> {
    let folder = tempfile::tempdir().map_err(Error::io("temporary folder"))?;
    let path = folder.path().join("vectors.safetensors");
    let bytes: Vec<u8> = vectors.iter().flatten().flat_map(|v| v.to_array()).flat_map(|x| x.to_le_bytes()).collect();
    let shape = vec![vectors.len(), setup.tips.len(), 3];
    let view = TensorView::new(Dtype::F64, shape, &bytes).map_err(|error| Error::file(&path, error))?;
    let tips = serde_json::to_string(&setup.tips).map_err(|error| Error::file(&path, error))?;
    let free = robot.coupling.masters.iter().map(|joint| robot.parts.joints[*joint].name.as_str());
    let joints = serde_json::to_string(&free.collect::<Vec<_>>()).map_err(|error| Error::file(&path, error))?;
    let metadata = HashMap::from([
        ("joints".to_owned(), joints),
        ("urdf".to_owned(), robot.origin.clone()),
        ("wrist".to_owned(), setup.wrist.clone()),
        ("tips".to_owned(), tips),
        ("scale".to_owned(), setup.scale.to_string()),
    ]);
    let content = safetensors::serialize([("vectors", view)], Some(metadata)).map_err(|e| Error::file(&path, e))?;
    file::write(&path, &content)?;
    let written = folder.path().join("qpos.f64");
    let arguments = ["--input".into(), path.into_os_string(), "--qpos".into(), written.clone().into_os_string()];
    let mut timing: Timing = peer::ask(command, &arguments, 1)?;
    if let Some(names) = &timing.joint_names {
        let bytes = std::fs::read(&written).map_err(Error::io(&written))?;
        let values: Vec<f64> = bytes.as_chunks::<8>().0.iter().map(|x| f64::from_le_bytes(*x)).collect();
        let poses: Vec<Vec<f64>> = values.chunks_exact(names.len().max(1)).map(<[f64]>::to_vec).collect();
        timing.objective = Some(compare(robot, setup, vectors, names, &poses)?);
    }
    Ok(timing)
}
