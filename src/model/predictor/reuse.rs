//! Encoder passes that are saved: an image that hardly differs from the last encoded one takes its tokens.

use std::sync::Arc;

use crate::error::{Error, Result};
use crate::model::Config;
use crate::model::stages::FrameTokens;

/// Levels of a channel of 8 bits.
const LEVELS: f32 = 255.0;

/// Last encoded image of a stream, and the change up to which its tokens are used again.
///
/// Images are compared with the last one that was *encoded*, not with the last one that came: slow changes add up until they count.
#[derive(Debug, Clone)]
pub(super) struct Reuse {
    /// Mean absolute change of a patch, grey levels; 0 = every image is encoded.
    below: f32,
    /// Prepared image, `(3, side, side)`, and its tokens.
    last: Option<(Arc<[f32]>, Arc<FrameTokens>)>,
}

impl Reuse {
    /// Creates the memory of a stream that reuses tokens up to the change `below`, grey levels.
    ///
    /// # Errors
    /// If `below` is negative or not a number.
    pub fn new(below: f32) -> Result<Self> {
        match below >= 0.0 {
            true => Ok(Self { below, last: None }),
            false => Err(Error::value("reuse_below", "grey levels >= 0", below)),
        }
    }

    /// Returns the tokens of the last encoded image if no patch of `input` differs more from it. `std`: deviation by which
    /// the channels of both were divided, for values in 0..1.
    pub fn tokens(&self, input: &[f32], config: &Config, std: [f32; 3]) -> Option<Arc<FrameTokens>> {
        let (last, tokens) = self.last.as_ref().filter(|_| self.below > 0.0)?;
        (largest_change(last, input, config, std) <= self.below).then(|| Arc::clone(tokens))
    }

    /// Keeps an image that was encoded.
    pub fn keep(&mut self, input: &[f32], tokens: &Arc<FrameTokens>) {
        if self.below > 0.0 {
            self.last = Some((input.into(), Arc::clone(tokens)));
        }
    }

    /// Forgets the last image.
    pub fn forget(&mut self) {
        self.last = None;
    }
}

/// Returns the largest mean absolute difference of a patch between two prepared images, grey levels; NaN if a value is.
fn largest_change(a: &[f32], b: &[f32], config: &Config, std: [f32; 3]) -> f32 {
    let (side, patch) = (config.image, config.patch);
    let grid = side / patch;
    let mut sums = vec![0.0f32; grid * grid];
    for ((a, b), std) in a.chunks_exact(side * side).zip(b.chunks_exact(side * side)).zip(std) {
        for (y, (a, b)) in a.chunks_exact(side).zip(b.chunks_exact(side)).enumerate() {
            let row = &mut sums[y / patch * grid..][..grid];
            for (sum, (a, b)) in row.iter_mut().zip(a.chunks_exact(patch).zip(b.chunks_exact(patch))) {
                let differences = a.iter().zip(b).map(|(a, b)| (a - b).abs());
                *sum += std * differences.sum::<f32>();
            }
        }
    }
    let scale = LEVELS / (3 * patch * patch) as f32;
    sums.into_iter()
        .map(|sum| sum * scale)
        .fold(0.0, |most, change| if most.is_nan() || change <= most { most } else { change })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_change_is_that_of_the_patch_that_changes_most() {
        let config = Config { image: 28, patch: 14, ..Config::toy() };
        let (side, std) = (28, [0.25, 0.5, 0.2]);
        let a = vec![0.5f32; 3 * side * side];
        assert_eq!(largest_change(&a, &a, &config, std), 0.0);
        let mut b = a.clone();
        // All pixels of the lower right patch by 10 levels in red, one pixel of the upper left one by 255 in blue.
        for y in 14..28 {
            b[side * y + 14..side * (y + 1)].iter_mut().for_each(|value| *value += 10.0 / 255.0 / 0.25);
        }
        b[2 * side * side] -= 1.0 / 0.2;
        assert!((largest_change(&a, &b, &config, std) - 10.0 / 3.0).abs() < 1e-4);
        b[0] = f32::NAN;
        assert!(largest_change(&a, &b, &config, std).is_nan());
    }
}
