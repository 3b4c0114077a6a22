//! What the camera of a rollout records: a picture, blurred and noisy as a scene's camera is, and distances.

use ::image::RgbImage;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, Normal};

use super::effect::{Effect, EffectSet};
use super::lens::Lens;
use super::randomize::CameraDraw;
use crate::error::Result;
use crate::mujoco::{Renderer, World};

/// Pictures that are averaged while the shutter is open.
const EXPOSURES: usize = 4;

/// A camera that can be pointed at a world.
#[derive(Debug)]
pub struct View {
    renderer: Renderer,
    lens: Option<Lens>,
    /// Steps before a frame's instant at which the shutter is open, the earliest first.
    exposures: Vec<usize>,
    /// Sums of the exposures so far.
    open: Vec<u32>,
    taken: u32,
    noise: Option<Normal<f64>>,
    rng: ChaCha8Rng,
    size: (u32, u32),
    renders: usize,
}

/// How a camera takes its pictures.
#[derive(Debug, Clone)]
pub struct ViewOptions {
    /// Index of the camera in the world.
    pub camera: usize,
    /// Width and height of a picture, pixels.
    pub size: (u32, u32),
    /// What bends the picture.
    pub lens: Option<Lens>,
    /// Whether distances are wanted.
    pub depth: bool,
    /// Effects of the rollout.
    pub effects: EffectSet,
    /// Physics steps between two frames.
    pub steps_per_frame: usize,
    /// Fixes the noise.
    pub seed: u64,
}

impl View {
    /// Opens the camera.
    ///
    /// # Errors
    /// If there is no OpenGL.
    pub fn new(world: &World, draw: &CameraDraw, options: ViewOptions) -> Result<Self> {
        let ViewOptions { camera, size, lens, depth, effects, steps_per_frame, seed } = options;
        let (width, height) = lens.as_ref().map_or(size, Lens::straight);
        let renderer = Renderer::new(world, camera, width, height, depth)?;
        let exposures = match effects.contains(Effect::MotionBlur) {
            true => exposures((draw.shutter / world.options().timestep).round() as usize, steps_per_frame),
            false => Vec::new(),
        };
        let noise = Some(draw.noise).filter(|sigma| *sigma > 0.0 && effects.contains(Effect::SensorNoise));
        // A draw is finite and not negative, as the scene's check demands.
        let noise = noise.and_then(|sigma| Normal::new(0.0, sigma).ok());
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        rng.set_stream(1);
        Ok(Self { renderer, lens, exposures, open: Vec::new(), taken: 0, noise, rng, size, renders: 0 })
    }

    /// Pictures drawn so far.
    pub fn renders(&self) -> usize {
        self.renders
    }

    /// Whether the shutter takes a picture `steps` steps before a frame's instant.
    pub fn is_open(&self, steps: usize) -> bool {
        steps > 0 && self.exposures.contains(&steps)
    }

    /// Adds the world as it is to the picture that comes.
    ///
    /// # Errors
    /// If OpenGL fails.
    pub fn expose(&mut self, world: &mut World) -> Result<()> {
        let picture = self.renderer.render(world)?;
        self.renders += 1;
        let pixels = match &self.lens {
            Some(lens) => lens.bend(&picture),
            None => picture.into_raw(),
        };
        self.open.resize(pixels.len(), 0);
        self.open.iter_mut().zip(&pixels).for_each(|(sum, value)| *sum += u32::from(*value));
        self.taken += 1;
        Ok(())
    }

    /// The frame's picture and, where distances are wanted, metres per pixel; closes the shutter.
    ///
    /// # Errors
    /// If OpenGL fails.
    pub fn shoot(&mut self, world: &mut World) -> Result<(RgbImage, Vec<f32>)> {
        self.expose(world)?;
        let (count, sums) = (std::mem::take(&mut self.taken), std::mem::take(&mut self.open));
        let mean = sums.into_iter().map(|sum| f64::from(sum) / f64::from(count));
        let pixels = mean.map(|value| {
            let noise = self.noise.map_or(0.0, |noise| noise.sample(&mut self.rng));
            (value + noise).round().clamp(0.0, 255.0) as u8
        });
        let pixels: Vec<u8> = pixels.collect();
        let blank = || RgbImage::new(self.size.0, self.size.1);
        let picture = RgbImage::from_raw(self.size.0, self.size.1, pixels).unwrap_or_else(blank);
        let depth = self.renderer.depth();
        let bent = self.lens.as_ref().filter(|_| !depth.is_empty()).map(|lens| lens.bend_depth(&depth));
        Ok((picture, bent.unwrap_or(depth)))
    }
}

/// Steps before the frame's instant at which pictures are taken, evenly over the shutter's time; the frame's own is not
/// among them.
fn exposures(open: usize, steps_per_frame: usize) -> Vec<usize> {
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
    fn exposures_fill_the_shutters_time() {
        assert_eq!(exposures(9, 20), [9, 6, 3]);
        assert_eq!(exposures(100, 20), [19, 12, 6]);
        assert_eq!(exposures(1, 20), [1]);
        assert!(exposures(0, 20).is_empty());
    }
}
