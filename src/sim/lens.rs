//! A lens before the engine's pinhole camera: a wider picture is drawn, and bent.

use ::image::RgbImage;

use super::mjcf::MAX_PICTURE;
use super::randomize::CameraDraw;
use crate::camera::Intrinsics;
use crate::error::{Error, Result};

/// Where each pixel of a bent picture comes from.
#[derive(Debug, Clone)]
pub struct Lens {
    /// Width and height of the straight picture, pixels.
    straight: (u32, u32),
    /// Vertical field of view of the straight picture, rad.
    fovy: f64,
    taps: Vec<Tap>,
}

/// A place between four pixels.
#[derive(Debug, Clone, Copy)]
struct Tap {
    /// The upper left one.
    at: usize,
    /// How far to the right and down, 0 to 1.
    right: f32,
    down: f32,
}

impl Lens {
    /// The lens of a drawn camera, for pictures of `size` (width, height).
    ///
    /// # Errors
    /// If the lens folds the picture within its corners, or sees so wide that the straight picture would be larger than
    /// the engine draws.
    pub fn new(draw: &CameraDraw, (width, height): (u32, u32)) -> Result<Self> {
        let camera = Intrinsics::new(width, height, draw.fovy).with_distortion(draw.distortion);
        let mut places = Vec::with_capacity(width as usize * height as usize);
        for (x, y) in (0..height).flat_map(|y| (0..width).map(move |x| (x, y))) {
            let direction = camera.direction([f64::from(x) + 0.5, f64::from(y) + 0.5]).ok_or_else(|| {
                let expected = "a lens that shows something in the picture's corners, as weaker distortion does";
                Error::value("camera.distortion", expected, format!("{:?}", draw.distortion.0))
            })?;
            places.push([camera.fx * direction.x, camera.fy * direction.y]);
        }
        // Pixels from the axis to the edge; one more, so that the outermost place lies between pixels.
        let reach = |axis: usize| places.iter().map(|place| place[axis].abs()).fold(0.0, f64::max).ceil() as u32 + 1;
        let straight = (2 * reach(0), 2 * reach(1));
        if straight.0.max(straight.1) > 2 * MAX_PICTURE {
            let got = format!("{:?}, with a straight picture of {straight:?} pixels", draw.distortion.0);
            let expected = format!("a straight picture of at most {0} x {0} pixels", 2 * MAX_PICTURE);
            return Err(Error::value("camera.distortion", expected, got));
        }
        let tap = |[x, y]: [f64; 2]| {
            let (x, y) = (x + f64::from(straight.0 / 2) - 0.5, y + f64::from(straight.1 / 2) - 0.5);
            let at = y.floor() as usize * straight.0 as usize + x.floor() as usize;
            Tap { at, right: x.fract() as f32, down: y.fract() as f32 }
        };
        let fovy = 2.0 * (0.5 * f64::from(straight.1) / camera.fy).atan();
        Ok(Self { straight, fovy, taps: places.into_iter().map(tap).collect() })
    }

    /// Width and height of the straight picture, pixels.
    pub fn straight(&self) -> (u32, u32) {
        self.straight
    }

    /// Vertical field of view of the straight picture, rad.
    pub fn fovy(&self) -> f64 {
        self.fovy
    }

    /// The bent picture's bytes, row by row, from a straight one.
    pub fn bend(&self, straight: &RgbImage) -> Vec<u8> {
        let (bytes, row) = (straight.as_raw(), 3 * self.straight.0 as usize);
        let mut bent = Vec::with_capacity(3 * self.taps.len());
        for Tap { at, right, down } in &self.taps {
            for channel in 0..3 {
                let value = |offset: usize| f32::from(bytes[3 * at + offset + channel]);
                let mix = |offset: usize| value(offset) + right * (value(offset + 3) - value(offset));
                let (above, below) = (mix(0), mix(row));
                bent.push((above + down * (below - above)).round() as u8);
            }
        }
        bent
    }

    /// Distances of the bent picture, each that of the nearest pixel: between two surfaces there is none.
    pub fn bend_depth(&self, straight: &[f32]) -> Vec<f32> {
        let width = self.straight.0 as usize;
        let nearest = |tap: &Tap| tap.at + usize::from(tap.right >= 0.5) + width * usize::from(tap.down >= 0.5);
        self.taps.iter().map(|tap| straight[nearest(tap)]).collect()
    }
}
