//! Image sensor of a rollout's camera: pictures with lens distortion, motion blur, rolling shutter and noise, and depth.

use ::image::RgbImage;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, Normal};

use super::effect::{Effect, EffectSet};
use super::lens::Lens;
use super::photo::{Processing, mix_rows, shade};
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
    /// Sum of the exposures of the next picture, per pixel and channel; without a rolling shutter.
    exposure_sums: Vec<u32>,
    n_exposures: u32,
    /// Reading of rows one after the other.
    rolling: Option<Rolling>,
    /// Focal length, pixels, if creases get less light.
    shaded: Option<f64>,
    noise: Option<Normal<f64>>,
    processing: Option<Processing>,
    rng: ChaCha8Rng,
    size: (u32, u32),
    renders: usize,
}

/// Rolling shutter: exposures of the next picture, and how long rows are read and open, s.
#[derive(Debug)]
struct Rolling {
    exposures: Vec<Vec<u8>>,
    readout: f64,
    open: f64,
    timestep: f64,
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
    /// Time from the reading of the first row to that of the last, s; 0 = all at once.
    pub readout: f64,
    /// Seed of the noise.
    pub seed: u64,
}

impl ImageSensor {
    /// Opens a renderer for the camera.
    ///
    /// # Errors
    /// If there is no OpenGL.
    pub fn new(world: &World, draw: &CameraDraw, options: SensorOptions) -> Result<Self> {
        let SensorOptions { camera, size, lens, depth, effects, steps_per_frame, processing, readout, seed } = options;
        let (width, height) = lens.as_ref().map_or(size, Lens::source_size);
        let shaded = effects.contains(Effect::AmbientOcclusion);
        let renderer = Renderer::new(world, camera, width, height, depth || shaded)?;
        let timestep = world.options().timestep;
        let open = if effects.contains(Effect::MotionBlur) { draw.shutter } else { 0.0 };
        let exposure_steps = exposure_steps(((open + readout) / timestep).round() as usize, steps_per_frame);
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
            rolling: (readout > 0.0).then(|| Rolling { exposures: Vec::new(), readout, open, timestep }),
            shaded: shaded.then(|| 0.5 * f64::from(size.1) / (0.5 * draw.fovy).tan()),
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
        if let Some(rolling) = &mut self.rolling {
            rolling.exposures.push(pixels);
            return Ok(());
        }
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
        let depth = self.renderer.depth();
        let distorted = self.lens.as_ref().filter(|_| !depth.is_empty()).map(|lens| lens.distort_depth(&depth));
        let depth = distorted.unwrap_or(depth);
        let mut light = self.develop();
        if let Some(focal) = self.shaded {
            shade(&mut light, self.size, &depth, focal);
        }
        let pixels = light.into_iter().map(|value| {
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
        Ok((picture, depth))
    }

    /// Returns the light of the exposures so far per pixel and channel, 0 to 255, and begins the next picture.
    fn develop(&mut self) -> Vec<f64> {
        let row_length = 3 * self.size.0 as usize;
        if let Some(Rolling { exposures, readout, open, timestep }) = &mut self.rolling {
            let exposures = std::mem::take(exposures);
            // The first frame of an episode has no motion before it, hence only the exposure at its instant.
            let earlier = exposures.len().saturating_sub(1).min(self.exposure_steps.len());
            let steps = &self.exposure_steps[self.exposure_steps.len() - earlier..];
            let ages: Vec<f64> = steps.iter().map(|steps| *steps as f64 * *timestep).chain([0.0]).collect();
            return mix_rows(&exposures, &ages, *readout, *open, row_length);
        }
        let (count, sums) = (std::mem::take(&mut self.n_exposures), std::mem::take(&mut self.exposure_sums));
        sums.into_iter().map(|sum| f64::from(sum) / f64::from(count)).collect()
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
