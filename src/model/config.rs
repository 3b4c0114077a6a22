//! Geometry of the network.

use serde::{Deserialize, Serialize};

use crate::error::{Error, Result};

/// Geometry of the network.
///
/// The JSON form has exactly these keys, all required but `registers`; an unknown key is an error. [`Config::from_json`] and
/// the constructors of the network run [`Config::check`].
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Config {
    /// dv: width of the vision encoder.
    pub vision_width: usize,
    /// Layers of the vision encoder.
    pub vision_depth: usize,
    /// Attention heads of the vision encoder.
    pub vision_heads: usize,
    /// d: width of temporal fusion and decoder.
    pub width: usize,
    /// Layers of the decoder.
    pub depth: usize,
    /// Attention heads of temporal fusion and decoder.
    pub heads: usize,
    /// Side of the square input image, pixels.
    pub image: usize,
    /// Side of a patch, pixels.
    pub patch: usize,
    /// Side of the image whose patch grid the position embeddings were learned on, pixels.
    pub pretrain_image: usize,
    /// T: frames in the observation window.
    pub horizon: usize,
    /// K: tactile steps predicted.
    pub predict: usize,
    /// Register tokens of the vision encoder; an encoder with registers resamples its position embeddings with antialiasing.
    /// 0 for an encoder without; the JSON form then lacks the key.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub registers: usize,
}

fn is_zero(value: &usize) -> bool {
    *value == 0
}

impl Config {
    /// Names of the presets, for [`Config::preset`].
    pub const PRESETS: [&'static str; 5] = ["toy", "pocket", "tiny", "small", "base"];

    /// Returns the preset of this name.
    ///
    /// # Errors
    /// If the name is unknown.
    pub fn preset(name: &str) -> Result<Self> {
        match name {
            "toy" => Ok(Self::toy()),
            "pocket" => Ok(Self::pocket()),
            "tiny" => Ok(Self::tiny()),
            "small" => Ok(Self::small()),
            "base" => Ok(Self::base()),
            _ => Err(Error::unknown("preset", name, Self::PRESETS)),
        }
    }

    /// Network for tests: 0.24 M parameters.
    pub fn toy() -> Self {
        Self {
            vision_width: 48,
            vision_depth: 2,
            vision_heads: 3,
            width: 32,
            depth: 2,
            heads: 4,
            image: 56,
            patch: 14,
            pretrain_image: 70,
            horizon: 3,
            predict: 2,
            registers: 0,
        }
    }

    /// Network for small machines, from which the shipped checkpoint was grown: 2.7 M parameters (10.6 MB in f32), 65 tokens
    /// per frame.
    ///
    /// Small enough to be trained from scratch on two CPU cores: one frame costs the encoder 0.16 GFLOP.
    pub fn pocket() -> Self {
        Self {
            vision_width: 128,
            vision_depth: 6,
            vision_heads: 4,
            width: 128,
            depth: 3,
            heads: 4,
            image: 112,
            patch: 14,
            pretrain_image: 112,
            horizon: 3,
            predict: 1,
            registers: 0,
        }
    }

    /// Network with an encoder of the size of ViT-Ti, 257 tokens per frame: 8.7 M parameters.
    pub fn tiny() -> Self {
        Self { vision_width: 192, vision_heads: 3, width: 192, depth: 4, heads: 3, ..Self::base() }
    }

    /// Network with the published DINOv2 small encoder.
    pub fn small() -> Self {
        Self { vision_width: 384, vision_heads: 6, width: 384, heads: 6, ..Self::base() }
    }

    /// Network with the published DINOv2 base encoder.
    pub fn base() -> Self {
        Self {
            vision_width: 768,
            vision_depth: 12,
            vision_heads: 12,
            width: 768,
            depth: 12,
            heads: 12,
            image: 224,
            patch: 14,
            pretrain_image: 518,
            horizon: 4,
            predict: 1,
            registers: 0,
        }
    }

    /// Returns the JSON form that [`Config::from_json`] reads.
    pub fn to_json(&self) -> String {
        // Serialising a struct of integers cannot fail.
        serde_json::to_string(self).unwrap_or_default()
    }

    /// Patches along one side of the input image.
    pub fn grid(&self) -> usize {
        self.image / self.patch
    }

    /// Patches along one side of the image that the position embeddings were learned on.
    pub fn pretrain_grid(&self) -> usize {
        self.pretrain_image / self.patch
    }

    /// P: vision tokens per frame that the encoder returns, CLS included, registers not.
    pub fn tokens(&self) -> usize {
        self.grid() * self.grid() + 1
    }
}
