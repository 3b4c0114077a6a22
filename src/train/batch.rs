//! Batches: input and targets of one step, made from clips.

use std::ops::Range;

use candle_core::{Device, Tensor};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

use super::augment::Augmentation;
use super::config::AugmentConfig;
use super::data::{Block, Dataset};
use super::keypoints::{self, Points};
use super::loss::Targets;
use super::sampler::{self, Clip, Share};
use crate::error::Result;
use crate::hand::N_VERTICES;
use crate::image::Preparation;
use crate::tactile::N_FIELD;

/// Input and targets of one step, in host memory.
#[derive(Debug, Clone)]
pub struct Batch {
    /// (F, 3, side, side) normalised images, each frame once.
    pub frames: Vec<f32>,
    /// (B T) indices into `frames`, window by window, oldest frame first.
    pub windows: Vec<u32>,
    /// (B, K, 1556) true force, normalised units.
    pub force: Vec<f32>,
    /// (B, K, 1556) true contact, 0 or 1.
    pub contact: Vec<f32>,
    /// (B, K, 1556) weight of a supervised force, above 0 to 1; 0 = not supervised.
    pub mask_force: Vec<f32>,
    /// (B, K, 1556) 1 = the contact is supervised.
    pub mask_contact: Vec<f32>,
    /// (F) keypoints of each frame; empty without the keypoint task.
    pub points: Vec<Points>,
    /// (F) identity of each frame.
    pub keys: Vec<FrameKey>,
}

/// Identity of a frame in a batch: frames with equal keys have equal pixels if augmentation at most mirrors them.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct FrameKey {
    /// Index of the store.
    pub store: usize,
    /// Frame within the store.
    pub frame: usize,
    /// True if the image is mirrored.
    pub mirrored: bool,
}

/// Settings that turn clips into batches.
#[derive(Debug, Clone)]
pub struct Collate {
    /// Frames of a window, T.
    pub horizon: usize,
    /// Predicted steps, K.
    pub predict: usize,
    /// Seconds between observation steps.
    pub frame_dt: f64,
    /// N per normalised unit.
    pub force_scale: f32,
    /// Image augmentation.
    pub augment: AugmentConfig,
    /// Seed of the run.
    pub seed: u64,
}

impl Dataset {
    /// Makes batch `index` of a run from its clips.
    ///
    /// # Errors
    /// If a store can't be read.
    pub fn batch(&self, collate: &Collate, index: usize, clips: &[Clip]) -> Result<Batch> {
        self.batch_of(Share::WHOLE, collate, index, clips)
    }

    /// As [`Dataset::batch`], with the clips of one rank only: they look the same whatever the number of ranks.
    ///
    /// # Errors
    /// If a store can't be read.
    pub fn batch_of(&self, share: Share, collate: &Collate, index: usize, clips: &[Clip]) -> Result<Batch> {
        let Preparation { side, mean, std, .. } = *self.preparation();
        let (pixels, item) = (3 * side * side, collate.predict * N_FIELD);
        let n_windows: usize = share.of(clips).map(|(_, clip)| clip.newest.len()).sum();
        let mut batch = Batch {
            frames: Vec::new(),
            windows: Vec::with_capacity(n_windows * collate.horizon),
            force: vec![0.0; n_windows * item],
            contact: vec![0.0; n_windows * item],
            mask_force: vec![0.0; n_windows * item],
            mask_contact: vec![0.0; n_windows * item],
            points: Vec::new(),
            keys: Vec::new(),
        };
        let mut rows = (0..).step_by(N_FIELD).map(|start| start..start + N_FIELD);
        for (place, clip) in share.of(clips) {
            let times = self.timestamps(clip.store);
            let windows: Vec<Vec<usize>> = clip
                .newest
                .iter()
                .map(|newest| sampler::window(times, clip.episode.start, *newest, collate.horizon, collate.frame_dt))
                .collect();
            let targets: Vec<Option<usize>> = clip
                .newest
                .iter()
                .flat_map(|newest| {
                    sampler::targets(times, clip.episode.end, *newest, collate.predict, collate.frame_dt)
                })
                .collect();
            let mut needed: Vec<usize> = windows.iter().flatten().copied().collect();
            needed.sort_unstable();
            needed.dedup();
            let (first, last) =
                (needed[0], needed[needed.len() - 1].max(targets.iter().flatten().copied().max().unwrap_or(0)));
            let block = self.read(clip.store, first..last + 1, true)?;

            let before = (batch.frames.len() / pixels) as u32;
            let place_of = |frame: &usize| before + needed.partition_point(|other| other < frame) as u32;
            batch.windows.extend(windows.iter().flatten().map(place_of));

            // One generator per clip of each step, so that the result depends neither on the loading order nor on the ranks.
            let mut rng = ChaCha8Rng::seed_from_u64(collate.seed ^ 0x6175_676d_656e_7400);
            rng.set_stream(((index as u64) << 16) | place as u64);
            let augmentation = Augmentation::draw(&collate.augment, self.mirrorable(clip.store), &mut rng);
            let start = batch.frames.len();
            batch.frames.resize(start + needed.len() * pixels, 0.0);
            for (out, frame) in batch.frames[start..].chunks_exact_mut(pixels).zip(&needed) {
                let at = (frame - first) * pixels;
                augmentation.apply(&block.images[at..at + pixels], side, mean, std, out);
            }
            let key = |frame: &usize| FrameKey { store: clip.store, frame: *frame, mirrored: augmentation.mirrored };
            batch.keys.extend(needed.iter().map(key));
            if let Some(points) = self.keypoints(clip.store) {
                let augmented = |frame: &usize| keypoints::augmented(points[*frame], &augmentation);
                batch.points.extend(needed.iter().map(augmented));
            }
            for target in targets {
                let Some(row) = rows.next() else { break };
                if let Some(target) = target {
                    batch.supervise(row, &block, target - first, augmentation.mirrored, collate.force_scale);
                }
            }
        }
        Ok(batch)
    }
}

impl Batch {
    /// Fills one step of one window with the labels of a frame.
    fn supervise(&mut self, row: Range<usize>, block: &Block, frame: usize, mirrored: bool, force_scale: f32) {
        let labels = &block.labels;
        for (v, entry) in row.enumerate() {
            // In a mirrored image the left hand becomes the right one; both hands share one numbering.
            let v = if mirrored { (v + N_VERTICES) % N_FIELD } else { v };
            let at = frame * N_FIELD + v;
            // Skips masked labels instead of multiplying by 0: they may be NaN, and NaN times 0 is NaN.
            if labels.mask_force[at] == 1 {
                self.mask_force[entry] = block.force_weights.get(at).copied().unwrap_or(1.0);
                self.force[entry] = labels.force[at] / force_scale;
            }
            if labels.mask_contact[at] == 1 {
                self.mask_contact[entry] = 1.0;
                self.contact[entry] = labels.contact[at];
            }
        }
    }

    /// Returns the number of frames of `side` x `side` pixels.
    pub fn n_frames(&self, side: usize) -> usize {
        self.frames.len() / (3 * side * side)
    }

    /// Moves images `(F, 3, side, side)`, window indices `(B T)` and targets to a device.
    ///
    /// # Errors
    /// If the device is out of memory.
    pub fn to_device(self, side: usize, predict: usize, device: &Device) -> Result<(Tensor, Tensor, Targets)> {
        let frames = self.n_frames(side);
        let truth_shape = (self.force.len() / (predict * N_FIELD), predict, N_FIELD);
        let field = |values: Vec<f32>| Tensor::from_vec(values, truth_shape, device);
        let truth = Targets {
            force: field(self.force)?,
            contact: field(self.contact)?,
            mask_force: field(self.mask_force)?,
            mask_contact: field(self.mask_contact)?,
        };
        let images = Tensor::from_vec(self.frames, (frames, 3, side, side), device)?;
        let n_places = self.windows.len();
        Ok((images, Tensor::from_vec(self.windows, n_places, device)?, truth))
    }
}
