//! Head-mounted camera of a rollout: motion of the head, pictures, depth.

use ::image::RgbImage;

use super::hands::SimHands;
use crate::camera::{Distortion, Intrinsics};
use crate::error::Result;
use crate::mujoco::World;
use crate::sim::camera::CameraPose;
use crate::sim::effect::{Effect, EffectSet, Observation};
use crate::sim::image_sensor::{ImageSensor, SensorOptions};
use crate::sim::lens::Lens;
use crate::sim::mjcf::HEAD;
use crate::sim::photo::Processing;
use crate::sim::randomize::{CameraDraw, EpisodeDraw};

/// Optics of a camera before the world exists: the lens decides about the engine's field of view.
#[derive(Debug)]
pub(super) struct Optics {
    draw: CameraDraw,
    processing: Option<Processing>,
    /// Time from the first row of a picture to the last, s; 0 = all at once.
    readout: f64,
    /// Width and height of the picture, pixels; `None` = no pictures.
    size: Option<(u32, u32)>,
    lens: Option<Lens>,
}

impl Optics {
    /// Creates the optics of an episode's camera for pictures of `size` (width, height).
    ///
    /// # Errors
    /// As [`Lens::new`].
    pub fn new(episode: &EpisodeDraw, size: Option<(u32, u32)>, effects: EffectSet) -> Result<Self> {
        let draw = *episode.camera(effects);
        let processing = effects.contains(Effect::CameraProcessing).then_some(episode.photo.processing);
        let readout = if effects.contains(Effect::RollingShutter) { episode.photo.readout } else { 0.0 };
        let size = size.filter(|_| effects.contains(Effect::Rendering));
        let lens = match size.filter(|_| effects.contains(Effect::LensDistortion)) {
            Some(size) => Some(Lens::new(&draw, size)?),
            None => None,
        };
        Ok(Self { draw, processing, readout, size, lens })
    }

    /// Returns the vertical field of view that the engine renders, rad.
    pub fn fovy(&self) -> f64 {
        self.lens.as_ref().map_or(self.draw.fovy, Lens::fovy)
    }

    fn intrinsics(&self) -> Intrinsics {
        let (width, height) = self.size.unwrap_or((1, 1));
        let distortion = if self.lens.is_some() { self.draw.distortion } else { Distortion::default() };
        Intrinsics::new(width, height, self.draw.fovy).with_distortion(distortion)
    }
}

/// Head-mounted camera in a world.
#[derive(Debug)]
pub(super) struct HeadCamera {
    /// Projection of the camera.
    pub intrinsics: Intrinsics,
    draw: CameraDraw,
    /// `None` = no pictures.
    sensor: Option<ImageSensor>,
    observes_depth: bool,
    /// Index of the engine's camera.
    camera: usize,
    /// Index of the head's mocap body.
    head: usize,
}

impl HeadCamera {
    /// Opens the camera; `seed` fixes the sensor noise.
    ///
    /// # Errors
    /// If pictures are needed and there is no OpenGL.
    pub fn new(
        world: &World,
        optics: Optics,
        observed: &[Observation],
        effects: EffectSet,
        steps_per_frame: usize,
        seed: u64,
    ) -> Result<Self> {
        let (head, camera) = (world.mocap(HEAD)?, world.camera(HEAD)?);
        let (intrinsics, observes_depth) = (optics.intrinsics(), observed.contains(&Observation::Depth));
        let Optics { draw, processing, readout, size, lens } = optics;
        let sensor = match size {
            Some(size) => {
                let options = SensorOptions {
                    camera,
                    size,
                    lens,
                    depth: observes_depth,
                    effects,
                    steps_per_frame,
                    processing,
                    readout,
                    seed,
                };
                Some(ImageSensor::new(world, &draw, options)?)
            }
            None => None,
        };
        Ok(Self { intrinsics, draw, sensor, observes_depth, camera, head })
    }

    /// Returns the number of pictures rendered so far.
    pub fn renders(&self) -> usize {
        self.sensor.as_ref().map_or(0, ImageSensor::renders)
    }

    /// Returns the current pose.
    pub fn pose(&self, world: &World) -> CameraPose {
        CameraPose::from_engine(world.camera_pose(self.camera))
    }

    /// Moves the head to its pose at the world's time.
    pub fn turn_head(&self, world: &mut World) {
        let (eye, orientation) = self.draw.head(world.time());
        world.set_mocap(self.head, eye, orientation);
    }

    /// Adds an exposure to the next picture if one is due `steps_left` steps before the frame's instant.
    ///
    /// # Errors
    /// If OpenGL fails.
    pub fn expose(&mut self, world: &mut World, hands: &SimHands, steps_left: usize) -> Result<()> {
        if !self.sensor.as_ref().is_some_and(|sensor| sensor.is_exposure(steps_left)) || !world.is_finite() {
            return Ok(());
        }
        self.turn_head(world);
        world.forward();
        hands.update_skins(world)?;
        match &mut self.sensor {
            Some(sensor) => sensor.expose(world),
            None => Ok(()),
        }
    }

    /// Takes the frame's picture, and (H, W) distances from the camera plane in metres if they are observed.
    ///
    /// # Errors
    /// If OpenGL fails.
    pub fn shoot(&mut self, world: &mut World, hands: &SimHands) -> Result<(RgbImage, Option<Vec<f32>>)> {
        let Some(sensor) = &mut self.sensor else { return Ok((self.blank(), None)) };
        hands.update_skins(world)?;
        let (picture, depth) = sensor.shoot(world)?;
        Ok((picture, Some(depth).filter(|_| self.observes_depth)))
    }

    /// Returns a black picture, for frames without a usable state.
    pub fn blank(&self) -> RgbImage {
        RgbImage::new(self.intrinsics.width, self.intrinsics.height)
    }
}
