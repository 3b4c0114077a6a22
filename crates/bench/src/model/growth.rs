//! Growth of memory along a long stream.

use egotac::error::Result;
use egotac::model::Predictor;
use serde::{Deserialize, Serialize};

use super::measure::memory_mb;

/// Memory along a long stream.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Growth {
    /// Name of the preset.
    pub preset: String,
    /// Frames sent.
    pub frames: usize,
    /// Resident memory after the first tenth of the frames, MB (2²⁰), when all that is kept between frames is allocated.
    pub warm_mb: f64,
    /// Resident memory at the end, MB.
    pub end_mb: f64,
    /// Time of all frames, s.
    pub seconds: f64,
}

impl Growth {
    /// Returns the growth after the first tenth, MB.
    pub fn mb(&self) -> f64 {
        self.end_mb - self.warm_mb
    }
}

/// Sends `frames` pictures of changing brightness through `predictor`.
///
/// # Errors
/// If the network refuses a picture, or the system does not report memory.
pub fn measure(predictor: &mut Predictor, preset: &str, frames: usize) -> Result<Growth> {
    let side = predictor.config().image as u32;
    let dt = predictor.metadata().frame_dt;
    let mut picture = ::image::RgbImage::new(side, side);
    let begun = std::time::Instant::now();
    let mut warm_mb = memory_mb("VmRSS:")?;
    for frame in 0..frames {
        picture.as_mut()[frame % (side * side * 3) as usize] = (frame % 256) as u8;
        predictor.push(&picture, frame as f64 * dt)?;
        if frame == frames / 10 {
            warm_mb = memory_mb("VmRSS:")?;
        }
    }
    let end_mb = memory_mb("VmRSS:")?;
    Ok(Growth { preset: preset.into(), frames, warm_mb, end_mb, seconds: begun.elapsed().as_secs_f64() })
}
