//! Encoded frames of one stream.

use candle_core::Tensor;

use crate::model::window;

/// Frames kept per observation step, at most. Bounds the memory under a camera much faster than `frame_dt`.
const KEPT_PER_STEP: usize = 8;

/// Observation steps of a network.
#[derive(Debug, Clone, Copy)]
pub(super) struct Steps {
    /// T: frames of a window.
    pub horizon: usize,
    /// Interval between observation steps, s.
    pub frame_dt: f64,
}

/// Frames that later windows may need, oldest first; their stamps increase strictly.
#[derive(Debug, Clone, Default)]
pub(super) struct Frames(Vec<CachedFrame>);

#[derive(Debug, Clone)]
struct CachedFrame {
    stamp_secs: f64,
    tokens: Tensor, // (1, P, d), projected
}

impl Frames {
    /// Number of frames.
    pub fn len(&self) -> usize {
        self.0.len()
    }

    /// Stamps, s, oldest first.
    pub fn stamps(&self) -> impl Iterator<Item = f64> {
        self.0.iter().map(|frame| frame.stamp_secs)
    }

    /// Drops all frames.
    pub fn clear(&mut self) {
        self.0.clear();
    }

    /// Returns the frames from the time `secs` on.
    pub fn since(&self, secs: f64) -> Self {
        Self(self.0.iter().filter(|frame| frame.stamp_secs >= secs).cloned().collect())
    }

    /// Returns the frames with one more, without those that no later window can contain; a frame of the same stamp is replaced.
    /// The tokens are shared.
    pub fn with(&self, stamp_secs: f64, tokens: Tensor, steps: Steps) -> Self {
        let mut frames = self.0.clone();
        if frames.last().is_some_and(|newest| newest.stamp_secs == stamp_secs) {
            frames.pop();
        }
        frames.push(CachedFrame { stamp_secs, tokens });
        let mut frames = Self(frames);
        frames.forget(steps);
        frames
    }

    /// Returns the tokens of the window at the newest frame, oldest first.
    pub fn window(&self, steps: Steps) -> Vec<&Tensor> {
        let stamps: Vec<f64> = self.stamps().collect();
        let places = window::window(&stamps, steps.horizon, steps.frame_dt);
        places.iter().map(|place| &self.0[*place].tokens).collect()
    }

    /// True if the frames do not reach back to the start of the window.
    pub fn are_warming_up(&self, steps: Steps) -> bool {
        let stamps: Vec<f64> = self.stamps().collect();
        window::is_warming_up(&stamps, steps.horizon, steps.frame_dt)
    }

    /// Drops frames that no later window can contain, and thins out the frames of a camera far faster than the steps.
    fn forget(&mut self, steps: Steps) {
        let mut stamps: Vec<f64> = self.stamps().collect();
        let obsolete = window::obsolete(&stamps, steps.horizon, steps.frame_dt);
        self.0.drain(..obsolete);
        stamps.drain(..obsolete);
        if stamps.len() > KEPT_PER_STEP * steps.horizon {
            // The frame whose neighbours are closest leaves the smallest gap; the newest and oldest stay.
            let gap = |i: &usize| stamps[i + 1] - stamps[i - 1];
            if let Some(least) = (1..stamps.len() - 1).min_by(|a, b| gap(a).total_cmp(&gap(b))) {
                self.0.remove(least);
            }
        }
    }
}
