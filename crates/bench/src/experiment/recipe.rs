//! Scene, seeds and size of a rendered store.

use std::path::PathBuf;

/// Scene and seeds of a store.
#[derive(Debug, Clone, PartialEq)]
pub struct Recipe {
    /// The store.
    pub path: PathBuf,
    /// Path of the scene file, or name of a shipped scene if there is no text.
    pub scene: PathBuf,
    /// Text of the scene file; empty for a shipped scene.
    pub text: String,
    /// Episodes.
    pub episodes: usize,
    /// Seed of the first episode.
    pub seed: u64,
    /// Width and height of the pictures, pixels.
    pub side: u32,
    /// MANO-format files of the hands, left first; `None` = the built-in hands.
    pub mano: Option<[PathBuf; 2]>,
}
