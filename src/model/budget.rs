//! The best network that keeps a latency budget on this machine.

use std::fmt;
use std::path::{Path, PathBuf};
use std::time::Instant;

use ::image::RgbImage;

use super::predictor::{Options, Predictor};
use super::{Checkpoint, Precision, checkpoint};
use crate::error::{Error, Result};

/// Size of the images that a candidate is tried on.
const PICTURE: (u32, u32) = (640, 480);
/// Images per candidate; the first does not count, of the others the median does.
const TRIES: usize = 6;

/// A configuration that was tried.
#[derive(Debug, Clone, PartialEq)]
pub struct Tried {
    /// Its file.
    pub path: PathBuf,
    /// Number format.
    pub precision: Precision,
    /// Median latency of one image, ms.
    pub latency_ms: f64,
}

/// What was chosen, and from what.
#[derive(Debug, Clone, PartialEq)]
pub struct Choice {
    /// The budget, ms.
    pub budget_ms: f64,
    /// The chosen one.
    pub chosen: Tried,
    /// Better ones, which were too slow.
    pub too_slow: Vec<Tried>,
    /// Whether the chosen one keeps the budget; if not, nothing does, and it is the fastest.
    pub fits: bool,
}

/// Tries the checkpoints from the best to the cheapest, and takes the first whose median latency keeps the budget; if none
/// does, the fastest.
///
/// A network with more parameters counts as better than one with fewer, and among those of one checkpoint f32 as better
/// than int8. bf16 saves memory and not time, so it is not tried. On another device than the CPU only f32 is there.
///
/// # Errors
/// If there is no checkpoint, or one can't be used.
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
            let mut predictor = load(path, *precision, options)?;
            let latency_ms = latency_ms(&mut predictor)?;
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

/// The checkpoints that a path names: itself, or the safetensors files of a folder.
///
/// # Errors
/// If it is a folder that can't be read or has none.
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

/// Median over a few images; the stream is forgotten afterwards.
fn latency_ms(predictor: &mut Predictor) -> Result<f64> {
    let picture = RgbImage::new(PICTURE.0, PICTURE.1);
    let mut times = Vec::new();
    for i in 0..TRIES {
        let begun = Instant::now();
        predictor.push(&picture, i as f64 * 1e-3)?;
        times.push(begun.elapsed().as_secs_f64() * 1e3);
    }
    predictor.reset();
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
