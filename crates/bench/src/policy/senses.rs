//! Senses of a policy: small pictures, touch on the regions of both hands, and the hand's own commands.

use egotac::crates::image::RgbImage;
use egotac::error::Result;
use egotac::hand::{HandModel, Region, Side};
use egotac::model::shipped;
use egotac::model::{Predictor, Unknown, predictor};
use egotac::sim::SimFrame;

use super::task::Trial;

/// Side of the rendered pictures, pixels: the predictor's training pictures have a similar size.
pub const RENDERED: u32 = 192;
/// Side of a policy's pictures, pixels.
pub const SIDE: usize = 64;
/// Values of a picture: rows, columns, channels.
pub const PICTURE: usize = SIDE * SIDE * 3;
/// Values of touch: total force on 17 regions per hand, left hand first, N.
pub const TOUCH: usize = 34;
/// Values of a hand's own state: commanded grip, N, and commanded height of the lift, m.
pub const OWN: usize = 2;

/// Observation at one instant.
#[derive(Debug, Clone, PartialEq)]
pub struct Senses {
    /// (64, 64, 3) picture.
    pub picture: Vec<u8>,
    /// (34) force on the regions from the simulator's contacts, N.
    pub true_touch: Vec<f32>,
    /// (34) force on the regions that the shipped network predicts from the pictures so far, N.
    pub predicted_touch: Vec<f32>,
    /// (2) own commands.
    pub own: [f32; OWN],
}

/// Turns frames into observations.
#[derive(Debug, Clone)]
pub struct Senser {
    predictor: Predictor,
    regions: [Vec<Region>; 2],
}

impl Senser {
    /// Loads the shipped network.
    ///
    /// # Errors
    /// If there is none, or it can't be read.
    pub fn new() -> Result<Self> {
        let predictor =
            Predictor::load(&shipped::path()?, predictor::Options { unknown: Unknown::Guess, ..Default::default() })?;
        Ok(Self { predictor, regions: Side::BOTH.map(|side| HandModel::builtin(side).regions()) })
    }

    /// Returns the SHA-256 of the network's file.
    pub fn sha256(&self) -> &str {
        self.predictor.sha256()
    }

    /// Forgets the pictures so far: the next one starts a new trial.
    pub fn reset(&mut self) {
        self.predictor.reset();
    }

    /// Returns the observation of a trial's instant. With `predicts` false the predicted touch is zero, which saves the
    /// network's time.
    ///
    /// # Errors
    /// If the network fails.
    pub fn sense(&mut self, trial: &Trial, predicts: bool) -> Result<Senses> {
        let SimFrame { frame, .. } = trial.frame();
        let picture = &frame.camera_ego_rgb;
        let predicted_touch = match predicts {
            true => self.predictor.push(picture, frame.timestamp)?.field.region_forces(&self.regions),
            false => vec![0.0; TOUCH],
        };
        Ok(Senses {
            picture: shrink(picture),
            true_touch: frame.field.region_forces(&self.regions),
            predicted_touch,
            own: [trial.grip() as f32, trial.lift() as f32],
        })
    }
}

/// Averages blocks of pixels down to [`SIDE`].
fn shrink(picture: &RgbImage) -> Vec<u8> {
    let block = RENDERED as usize / SIDE;
    let (pixels, row) = (picture.as_raw(), 3 * picture.width() as usize);
    let mut small = Vec::with_capacity(PICTURE);
    for y in 0..SIDE {
        for x in 0..SIDE {
            for channel in 0..3 {
                let at = |i: usize| (y * block + i / block) * row + 3 * (x * block + i % block) + channel;
                let sum: u32 = (0..block * block).map(|i| u32::from(pixels[at(i)])).sum();
                small.push((sum / (block * block) as u32) as u8);
            }
        }
    }
    small
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_small_picture_holds_the_means_of_blocks() {
        let picture = RgbImage::from_fn(RENDERED, RENDERED, |x, y| {
            // Means over three columns and rows are those of the middle ones.
            egotac::crates::image::Rgb([x as u8, y as u8, 7])
        });
        let small = shrink(&picture);
        assert_eq!(small.len(), PICTURE);
        for (x, y) in [(0, 0), (5, 9), (63, 63)] {
            let at = 3 * (y * SIDE + x);
            assert_eq!(small[at..at + 3], [(3 * x + 1) as u8, (3 * y + 1) as u8, 7]);
        }
    }
}
