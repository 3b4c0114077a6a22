//! Sections of a training configuration and their defaults.

use serde::{Deserialize, Serialize};

/// Sampling of the sources: p ~ n^temperature for a source of n windows (paper, Dataset sampling).
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SamplingConfig {
    /// 1 = in proportion to the size of the sources, 0 = all equal.
    pub temperature: f64,
    /// Windows of an epoch; by default the number of frames.
    pub epoch: Option<usize>,
}

impl Default for SamplingConfig {
    fn default() -> Self {
        Self { temperature: 0.5, epoch: None }
    }
}

/// Size of a step: `clips` pieces of episodes with up to `windows` windows each. Each frame of a clip is encoded once,
/// although several windows contain it.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct BatchConfig {
    /// Clips per step, of each rank that the run begins with (one without a launcher such as `mpirun`).
    pub clips: usize,
    /// Windows per clip.
    pub windows: usize,
    /// Batches per step, whose mean gradient is used; allows steps that do not fit into memory at once.
    pub accumulate: usize,
}

impl Default for BatchConfig {
    fn default() -> Self {
        Self { clips: 4, windows: 12, accumulate: 1 }
    }
}

/// AdamW with linear warm-up and cosine decay.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct OptimizerConfig {
    /// Peak learning rate.
    pub learning_rate: f64,
    /// Learning rate of the last step.
    pub final_learning_rate: f64,
    /// Factor on the encoder's learning rate; by default 0.1 with trained initial weights (`init`, `encoder`), else 1. With 0
    /// the encoder keeps its weights, no gradient is computed for it, and without augmentation (mirroring is allowed) each frame is
    /// encoded once: steps then take a fraction of their time.
    pub encoder_factor: Option<f64>,
    /// Share of the steps in which the learning rate grows to its peak.
    pub warmup: f64,
    /// Decoupled weight decay, applied to matrices only.
    pub weight_decay: f64,
    /// Norm that larger gradients are scaled down to.
    pub max_grad_norm: f64,
}

impl Default for OptimizerConfig {
    fn default() -> Self {
        Self {
            learning_rate: 1e-4,
            final_learning_rate: 1e-5,
            encoder_factor: None,
            warmup: 0.05,
            weight_decay: 1e-5,
            max_grad_norm: 5.0,
        }
    }
}

/// Weights of the objective (paper, Training objective).
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct LossWeights {
    /// Weight of the squared error of the normalised force.
    pub force: f64,
    /// Weight of the cross-entropy of contact.
    pub contact: f64,
    /// Weight of the Smooth-L1 error of the normalised force where the true force is above 0.05 N.
    pub active: f64,
    /// Weight of the disagreement between force and contact.
    pub consistency: f64,
    /// Weight of the auxiliary keypoint task, which helps a network with random initial weights; needs stores of the
    /// built-in hand with camera and hand poses. Its heads are not saved.
    pub keypoints: f64,
    /// Weight of a vertex in contact relative to one without contact, in the cross-entropy.
    pub positive_weight: f64,
}

impl Default for LossWeights {
    fn default() -> Self {
        Self { force: 1.0, contact: 1.0, active: 0.2, consistency: 0.05, keypoints: 0.0, positive_weight: 2.0 }
    }
}

/// Image augmentation, drawn once per clip: the same for all frames of a window.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct AugmentConfig {
    /// Brightness factor within 1 ± this.
    pub brightness: f64,
    /// Contrast factor within 1 ± this.
    pub contrast: f64,
    /// Saturation factor within 1 ± this.
    pub saturation: f64,
    /// Largest rotation of the hue in either direction, rad.
    pub hue: f64,
    /// Side of the crop as a share of the image, from 1 - this to 1, at a random place.
    pub crop: f64,
    /// View scale within 1 ± this.
    pub view_scale: f64,
    /// Probability that the view is scaled.
    pub view_scale_probability: f64,
    /// Probability that a clip is mirrored, if its source allows it.
    pub mirror: f64,
}

impl Default for AugmentConfig {
    fn default() -> Self {
        Self {
            brightness: 0.2,
            contrast: 0.2,
            saturation: 0.2,
            hue: 0.1,
            crop: 0.1,
            view_scale: 0.1,
            view_scale_probability: 0.8,
            mirror: 0.5,
        }
    }
}

impl AugmentConfig {
    /// Returns settings that change nothing.
    pub fn none() -> Self {
        Self {
            brightness: 0.0,
            contrast: 0.0,
            saturation: 0.0,
            hue: 0.0,
            crop: 0.0,
            view_scale: 0.0,
            view_scale_probability: 0.0,
            mirror: 0.0,
        }
    }

    /// Returns true if an image changes at most by mirroring.
    pub fn keeps_pixels(&self) -> bool {
        Self { mirror: 0.0, view_scale_probability: 0.0, ..*self } == Self::none()
    }
}
