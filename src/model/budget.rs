//! Choice of the best network that meets a latency budget on this machine.

use std::fmt;
use std::path::{Path, PathBuf};
use std::time::Instant;

use ::image::RgbImage;

use super::Unknown;
use super::predictor::{Options, Predictor};
use super::{Checkpoint, Precision, checkpoint};
use crate::error::{Error, Result};

/// Width and height of the test image, pixels: a common camera.
const PICTURE: (u32, u32) = (640, 480);
/// Test images per candidate. The first one warms up the network; the latency is the median of the others.
const TRIES: usize = 6;

/// A candidate whose latency was measured.
#[derive(Debug, Clone, PartialEq)]
pub struct Tried {
    /// Checkpoint file.
    pub path: PathBuf,
    /// Number format.
    pub precision: Precision,
    /// Median latency of one image, ms.
    pub latency_ms: f64,
}

/// Result of the choice.
#[derive(Debug, Clone, PartialEq)]
pub struct Choice {
    /// Latency budget, ms.
    pub budget_ms: f64,
    /// The chosen candidate.
    pub chosen: Tried,
    /// Better candidates that were too slow.
    pub too_slow: Vec<Tried>,
    /// True if the chosen candidate meets the budget; otherwise none does, and it is the fastest.
    pub fits: bool,
}

/// Measures the checkpoints from the best to the smallest, and chooses the first whose median latency meets the budget; if
/// none does, the fastest.
///
/// A network with more parameters ranks higher; of one checkpoint, f32 ranks above int8. bf16 saves memory but no time, and
/// is left out. Devices other than the CPU have f32 only.
///
/// # Errors
/// If there is no checkpoint, or one can't be loaded.
pub fn pick(paths: &[PathBuf], budget_ms: f64, options: &Options) -> Result<(Predictor, Choice)> {
    let mut sized = Vec::new();
    for path in paths {
        let parameters = checkpoint::parameter_count(Checkpoint::load(path, &options.device)?.model.config())?;
        sized.push((parameters, path));
    }
    sized.sort_by(|a, b| b.0.cmp(&a.0).then(a.1.cmp(b.1)));
    let precisions: &[Precision] = match options.device.is_cpu() {
        true => &[Precision::F32, Precision::Int8],
        false => &[Precision::F32],
    };
    let mut tried: Vec<Tried> = Vec::new();
    for (_, path) in sized {
        for precision in precisions {
            let predictor = load(path, *precision, options)?;
            let latency_ms = latency_ms(&predictor)?;
            let now = Tried { path: path.clone(), precision: *precision, latency_ms };
            if latency_ms <= budget_ms {
                return Ok((predictor, Choice { budget_ms, chosen: now, too_slow: tried, fits: true }));
            }
            tried.push(now);
        }
    }
    let fastest = (0..tried.len()).min_by(|a, b| tried[*a].latency_ms.total_cmp(&tried[*b].latency_ms));
    let Some(fastest) = fastest else { return Err(Error::value("checkpoints", "at least one", "none")) };
    let chosen = tried.remove(fastest);
    let predictor = load(&chosen.path, chosen.precision, options)?;
    Ok((predictor, Choice { budget_ms, chosen, too_slow: tried, fits: false }))
}

/// Returns the checkpoints that a path names: the file itself, or the safetensors files of a folder.
///
/// # Errors
/// If the folder can't be read or has no such file.
pub fn candidates(path: &Path) -> Result<Vec<PathBuf>> {
    if !path.is_dir() {
        return Ok(vec![path.to_path_buf()]);
    }
    let mut files = Vec::new();
    for entry in std::fs::read_dir(path).map_err(Error::io(path))? {
        let file = entry.map_err(Error::io(path))?.path();
        if file.extension().is_some_and(|extension| extension == "safetensors") {
            files.push(file);
        }
    }
    files.sort();
    match files.is_empty() {
        true => Err(Error::file(path, "has no *.safetensors")),
        false => Ok(files),
    }
}

fn load(path: &Path, precision: Precision, options: &Options) -> Result<Predictor> {
    Predictor::load(path, Options { precision, ..options.clone() })
}

/// Measures the median latency of a few images, ms.
fn latency_ms(predictor: &Predictor) -> Result<f64> {
    // A copy that looks for the hands whatever the picture shows.
    let mut predictor = predictor.another_stream().with_unknown(Unknown::Guess);
    let picture = RgbImage::new(PICTURE.0, PICTURE.1);
    let mut times = Vec::new();
    for i in 0..TRIES {
        let begun = Instant::now();
        predictor.push(&picture, i as f64 * 1e-3)?;
        times.push(begun.elapsed().as_secs_f64() * 1e3);
    }
    let mut counted = times.split_off(1);
    counted.sort_by(f64::total_cmp);
    Ok(counted[counted.len() / 2])
}

impl fmt::Display for Tried {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} in {} ({:.1} ms)", self.path.display(), self.precision, self.latency_ms)
    }
}

impl fmt::Display for Choice {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Choice { budget_ms, chosen, .. } = self;
        match self.fits {
            true => write!(f, "{chosen} is the best that keeps the budget of {budget_ms} ms")?,
            false => write!(f, "nothing keeps the budget of {budget_ms} ms; {chosen} is the fastest")?,
        }
        for (i, tried) in self.too_slow.iter().enumerate() {
            write!(f, "{}{tried}", if i == 0 { "; too slow: " } else { ", " })?;
        }
        Ok(())
    }
}
