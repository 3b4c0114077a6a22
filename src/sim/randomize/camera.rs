//! Drawn values of the camera.

use std::f64::consts::{PI, SQRT_2};

use glam::DVec3;
use rand::Rng;

use crate::camera::Distortion;
use crate::sim::scene::CameraSpec;

/// Number of draws of a lens before one that folds the picture is accepted.
const MAX_LENS_DRAWS: usize = 100;

/// Drawn values of the camera.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CameraDraw {
    /// Mean position of the eye, m.
    pub eye: DVec3,
    /// Point in the middle of the picture, m.
    pub target: DVec3,
    /// Vertical field of view, rad.
    pub fovy: f64,
    /// Radial distortion of the lens.
    pub distortion: Distortion,
    /// Tilt, rad.
    pub roll: f64,
    /// Amplitude of the head's motion, m.
    pub sway: f64,
    /// Phases of the head's motion, rad.
    pub phases: [f64; 6],
    /// Standard deviation of the sensor noise, in units of the 8-bit picture.
    pub noise: f64,
    /// Exposure time, s.
    pub shutter: f64,
}

impl CameraDraw {
    /// Draws a camera.
    pub(super) fn sample(spec: &CameraSpec, rng: &mut impl Rng) -> Self {
        let mut draw = Self {
            eye: DVec3::from_array(spec.eye.each_ref().map(|s| s.sample(rng))),
            target: DVec3::from_array(spec.target.each_ref().map(|s| s.sample(rng))),
            fovy: spec.fovy.sample(rng).to_radians(),
            roll: spec.roll.sample(rng),
            sway: spec.sway.sample(rng),
            phases: std::array::from_fn(|_| rng.random_range(0.0..2.0 * PI)),
            noise: spec.noise.sample(rng),
            shutter: spec.shutter.sample(rng),
            distortion: Distortion::default(),
        };
        // A lens that folds the picture is drawn again. The test assumes a square picture, so that a seed gives one
        // lens for all picture sizes. If nearly all lenses of the ranges fold, the lens itself is refused later.
        for _ in 0..MAX_LENS_DRAWS {
            draw.distortion = Distortion(spec.distortion.each_ref().map(|s| s.sample(rng)));
            if draw.distortion.unbend(SQRT_2 * (0.5 * draw.fovy).tan()).is_some() {
                break;
            }
        }
        draw
    }
}
