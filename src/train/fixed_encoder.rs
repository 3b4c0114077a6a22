//! An encoder that does not learn: it is compiled, and encodes a frame once where no augmentation changes the frame.

use std::collections::HashMap;
use std::sync::{Mutex, PoisonError};

use candle_core::Tensor;

use super::batch::FrameKey;
use crate::error::Result;
use crate::model::EgoTac;

/// Memory for the tokens of frames, bytes. Frames beyond it are encoded each time.
const KEPT_BYTES: usize = 4 << 30;

/// An encoder with its initial weights, and the tokens that it has given.
pub struct FixedEncoder {
    network: EgoTac,
    /// Tokens `(P, dv)` by frame; None if augmentation changes the pixels from step to step.
    kept: Option<Mutex<HashMap<FrameKey, Tensor>>>,
    capacity: usize,
}

impl FixedEncoder {
    /// Creates an encoder from a compiled network; it keeps tokens if `keep`.
    pub fn new(network: EgoTac, keep: bool) -> Self {
        let config = network.config();
        let bytes = config.tokens() * config.vision_width * size_of::<f32>();
        Self { kept: keep.then(Mutex::default), capacity: KEPT_BYTES / bytes.max(1), network }
    }

    /// Encodes `images`, `(F, 3, H, W)`, or takes what it kept of these `frames`. Returns tokens `(F, P, dv)`, which have no gradient.
    ///
    /// # Errors
    /// If a shape is wrong or the device is out of memory.
    pub fn encode(&self, images: &Tensor, frames: &[FrameKey]) -> Result<Tensor> {
        let Some(kept) = &self.kept else { return Ok(self.network.encode(images)?.detach()) };
        // A map that a panicked thread left holds whole entries only.
        let mut kept = kept.lock().unwrap_or_else(PoisonError::into_inner);
        let missing: Vec<usize> = (0..frames.len()).filter(|i| !kept.contains_key(&frames[*i])).collect();
        let mut new = HashMap::new();
        if !missing.is_empty() {
            let places = missing.iter().map(|i| *i as u32).collect::<Vec<_>>();
            let places = Tensor::from_vec(places, missing.len(), images.device())?;
            let tokens = self.network.encode(&images.index_select(&places, 0)?)?.detach();
            for (row, i) in missing.iter().enumerate() {
                // In storage of its own: a view, and `copy` too, would keep the tokens of the whole batch.
                new.insert(frames[*i], tokens.get(row)?.force_contiguous()?);
            }
        }
        let of = |frame| kept.get(frame).or_else(|| new.get(frame)).cloned();
        let tokens = Tensor::stack(&frames.iter().filter_map(of).collect::<Vec<_>>(), 0)?;
        let room = self.capacity.saturating_sub(kept.len());
        kept.extend(new.into_iter().take(room));
        Ok(tokens)
    }
}

#[cfg(test)]
mod tests {
    use candle_core::Device;
    use candle_nn::VarMap;

    use super::*;
    use crate::model::{Config, init};

    #[test]
    fn tokens_that_are_kept_equal_those_of_the_batch_and_the_room_is_bounded() {
        let config = Config::toy();
        let network = || {
            EgoTac::new(&config, init::var_builder(&VarMap::new(), 3, &Device::Cpu)).and_then(EgoTac::freeze).unwrap()
        };
        let images = Tensor::rand(0f32, 1.0, (5, 3, config.image, config.image), &Device::Cpu).unwrap();
        let frames: Vec<FrameKey> = (0..5).map(|i| FrameKey { store: i % 2, frame: i, mirrored: i == 3 }).collect();
        let all = network().encode(&images).unwrap().to_vec3::<f32>().unwrap();
        for capacity in [100, 2, 0] {
            let encoder = FixedEncoder { capacity, ..FixedEncoder::new(network(), true) };
            for part in [vec![0, 1, 2], vec![2, 0, 4], vec![4, 3, 1, 0]] {
                let places = Tensor::new(part.as_slice(), &Device::Cpu).unwrap();
                let keys: Vec<FrameKey> = part.iter().map(|i: &u32| frames[*i as usize]).collect();
                let tokens = encoder.encode(&images.index_select(&places, 0).unwrap(), &keys).unwrap();
                let expected: Vec<_> = part.iter().map(|i| all[*i as usize].clone()).collect();
                assert_eq!(tokens.to_vec3::<f32>().unwrap(), expected);
            }
            let kept = encoder.kept.unwrap().into_inner().unwrap();
            assert_eq!(kept.len(), capacity.min(5));
            for tokens in kept.values() {
                let (storage, layout) = tokens.storage_and_layout();
                let candle_core::Storage::Cpu(candle_core::CpuStorage::F32(values)) = &*storage else { panic!() };
                assert_eq!(values.len(), layout.shape().elem_count(), "no storage is shared with other frames");
            }
        }
        // Kept tokens are given again, whatever the image.
        let encoder = FixedEncoder::new(network(), true);
        encoder.encode(&images, &frames).unwrap();
        let black = images.zeros_like().unwrap();
        assert_eq!(encoder.encode(&black, &frames).unwrap().to_vec3::<f32>().unwrap(), all);
        let without = FixedEncoder::new(network(), false);
        without.encode(&images, &frames).unwrap();
        assert_ne!(without.encode(&black, &frames).unwrap().to_vec3::<f32>().unwrap(), all);
    }
}
