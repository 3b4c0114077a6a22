//! Image sensor of a rollout's camera: pictures with lens distortion, motion blur and noise, and depth.

use ::image::RgbImage;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, Normal};

use super::effect::{Effect, EffectSet};
use super::lens::Lens;
use super::photo::Processing;
use super::randomize::CameraDraw;
use crate::error::Result;
use crate::mujoco::{Renderer, World};

/// Number of rendered pictures that are averaged over the exposure time.
const EXPOSURES: usize = 4;

/// Camera of a world, with its renderer.
#[derive(Debug)]
pub struct ImageSensor {
    renderer: Renderer,
    lens: Option<Lens>,
    /// Numbers of steps before a frame's instant at which exposures are taken, largest first.
    exposure_steps: Vec<usize>,
    /// Sum of the exposures of the next picture, per pixel and channel.
    exposure_sums: Vec<u32>,
    n_exposures: u32,
    noise: Option<Normal<f64>>,
    processing: Option<Processing>,
    rng: ChaCha8Rng,
    size: (u32, u32),
    renders: usize,
}

/// Options of an image sensor.
#[derive(Debug, Clone)]
pub struct SensorOptions {
    /// Index of the engine's camera.
    pub camera: usize,
    /// Width and height of a picture, pixels.
    pub size: (u32, u32),
    /// Lens that distorts the picture.
    pub lens: Option<Lens>,
    /// True to record distances as well.
    pub depth: bool,
    /// Effects of the rollout.
    pub effects: EffectSet,
    /// Physics steps between two frames.
    pub steps_per_frame: usize,
    /// Processing of the pictures.
    pub processing: Option<Processing>,
    /// Seed of the noise.
    pub seed: u64,
}

impl ImageSensor {
    /// Opens a renderer for the camera.
    ///
    /// # Errors
    /// If there is no OpenGL.
    pub fn new(world: &World, draw: &CameraDraw, options: SensorOptions) -> Result<Self> {
        let SensorOptions { camera, size, lens, depth, effects, steps_per_frame, processing, seed } = options;
        let (width, height) = lens.as_ref().map_or(size, Lens::source_size);
        let renderer = Renderer::new(world, camera, width, height, depth)?;
        let exposure_steps = match effects.contains(Effect::MotionBlur) {
            true => exposure_steps((draw.shutter / world.options().timestep).round() as usize, steps_per_frame),
            false => Vec::new(),
        };
        let noise = Some(draw.noise).filter(|sigma| *sigma > 0.0 && effects.contains(Effect::SensorNoise));
        // The scene's check guarantees a finite noise that is not negative.
        let noise = noise.and_then(|sigma| Normal::new(0.0, sigma).ok());
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        rng.set_stream(1);
        Ok(Self {
            renderer,
            lens,
            exposure_steps,
            exposure_sums: Vec::new(),
            n_exposures: 0,
            noise,
            processing,
            rng,
            size,
            renders: 0,
        })
    }

    /// Returns the number of pictures rendered so far.
    pub fn renders(&self) -> usize {
        self.renders
    }

    /// Returns true if an exposure is due `steps` steps before a frame's instant.
    pub fn is_exposure(&self, steps: usize) -> bool {
        steps > 0 && self.exposure_steps.contains(&steps)
    }

    /// Adds an exposure of the current world to the next picture.
    ///
    /// # Errors
    /// If OpenGL fails.
    pub fn expose(&mut self, world: &mut World) -> Result<()> {
        let picture = self.renderer.render(world)?;
        self.renders += 1;
        let pixels = match &self.lens {
            Some(lens) => lens.distort(&picture),
            None => picture.into_raw(),
        };
        self.exposure_sums.resize(pixels.len(), 0);
        self.exposure_sums.iter_mut().zip(&pixels).for_each(|(sum, value)| *sum += u32::from(*value));
        self.n_exposures += 1;
        Ok(())
    }

    /// Takes a frame's picture, which ends the exposure; returns it with the distances in metres, if they are recorded.
    ///
    /// # Errors
    /// If OpenGL fails.
    pub fn shoot(&mut self, world: &mut World) -> Result<(RgbImage, Vec<f32>)> {
        self.expose(world)?;
        let (count, sums) = (std::mem::take(&mut self.n_exposures), std::mem::take(&mut self.exposure_sums));
        let mean = sums.into_iter().map(|sum| f64::from(sum) / f64::from(count));
        let pixels = mean.map(|value| {
            let noise = self.noise.map_or(0.0, |noise| noise.sample(&mut self.rng));
            (value + noise).round().clamp(0.0, 255.0) as u8
        });
        let pixels: Vec<u8> = pixels.collect();
        let blank = || RgbImage::new(self.size.0, self.size.1);
        let picture = RgbImage::from_raw(self.size.0, self.size.1, pixels).unwrap_or_else(blank);
        let picture = match &self.processing {
            Some(processing) => processing.apply(picture),
            None => picture,
        };
        let depth = self.renderer.depth();
        let distorted = self.lens.as_ref().filter(|_| !depth.is_empty()).map(|lens| lens.distort_depth(&depth));
        Ok((picture, distorted.unwrap_or(depth)))
    }
}

/// Returns the numbers of steps before the frame's instant at which exposures are taken, evenly spread over the
/// exposure time of `open` steps; the exposure at the instant itself is not among them.
fn exposure_steps(open: usize, steps_per_frame: usize) -> Vec<usize> {
    let open = open.min(steps_per_frame.saturating_sub(1));
    let mut steps: Vec<usize> = (1..EXPOSURES).rev().map(|i| open * i / (EXPOSURES - 1)).collect();
    steps.dedup();
    steps.retain(|step| *step > 0);
    steps
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn exposures_spread_over_the_exposure_time() {
        assert_eq!(exposure_steps(9, 20), [9, 6, 3]);
        assert_eq!(exposure_steps(100, 20), [19, 12, 6]);
        assert_eq!(exposure_steps(1, 20), [1]);
        assert!(exposure_steps(0, 20).is_empty());
    }
}
