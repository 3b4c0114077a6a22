//! Lens distortion: resamples a wider pinhole picture of the engine.

use ::image::RgbImage;

use super::mjcf::MAX_PICTURE;
use super::randomize::CameraDraw;
use crate::camera::Intrinsics;
use crate::error::{Error, Result};

/// Map from the pixels of a distorted picture to places in the engine's pinhole picture.
#[derive(Debug, Clone)]
pub struct Lens {
    /// Width and height of the pinhole picture, pixels.
    source_size: (u32, u32),
    /// Vertical field of view of the pinhole picture, rad.
    fovy: f64,
    taps: Vec<Tap>,
}

/// Place between four pixels, for bilinear interpolation.
#[derive(Debug, Clone, Copy)]
struct Tap {
    /// Index of the upper left pixel.
    at: usize,
    /// Offset to the right and down, pixels, 0 to 1.
    right: f32,
    down: f32,
}

impl Lens {
    /// Creates the lens of a drawn camera for pictures of `size` (width, height).
    ///
    /// # Errors
    /// If the distortion folds the picture within its corners, or the pinhole picture would be larger than the engine
    /// renders.
    pub fn new(draw: &CameraDraw, (width, height): (u32, u32)) -> Result<Self> {
        let camera = Intrinsics::new(width, height, draw.fovy).with_distortion(draw.distortion);
        let mut places = Vec::with_capacity(width as usize * height as usize);
        for (x, y) in (0..height).flat_map(|y| (0..width).map(move |x| (x, y))) {
            let direction = camera.direction([f64::from(x) + 0.5, f64::from(y) + 0.5]).ok_or_else(|| {
                let expected = "weaker distortion, with which the picture's corners show something";
                Error::value("camera.distortion", expected, format!("{:?}", draw.distortion.0))
            })?;
            places.push([camera.fx * direction.x, camera.fy * direction.y]);
        }
        // Pixels from the axis to the edge; one more, so that the outermost place has pixels on all sides.
        let reach = |axis: usize| places.iter().map(|place| place[axis].abs()).fold(0.0, f64::max).ceil() as u32 + 1;
        let source_size = (2 * reach(0), 2 * reach(1));
        if source_size.0.max(source_size.1) > 2 * MAX_PICTURE {
            let got = format!("{:?}, with a pinhole picture of {source_size:?} pixels", draw.distortion.0);
            let expected = format!("a pinhole picture of at most {0} x {0} pixels", 2 * MAX_PICTURE);
            return Err(Error::value("camera.distortion", expected, got));
        }
        let tap = |[x, y]: [f64; 2]| {
            let (x, y) = (x + f64::from(source_size.0 / 2) - 0.5, y + f64::from(source_size.1 / 2) - 0.5);
            let at = y.floor() as usize * source_size.0 as usize + x.floor() as usize;
            Tap { at, right: x.fract() as f32, down: y.fract() as f32 }
        };
        let fovy = 2.0 * (0.5 * f64::from(source_size.1) / camera.fy).atan();
        Ok(Self { source_size, fovy, taps: places.into_iter().map(tap).collect() })
    }

    /// Returns width and height of the pinhole picture, pixels.
    pub(crate) fn source_size(&self) -> (u32, u32) {
        self.source_size
    }

    /// Returns the vertical field of view of the pinhole picture, rad.
    pub(crate) fn fovy(&self) -> f64 {
        self.fovy
    }

    /// Returns the distorted picture's bytes, row by row, from a pinhole picture.
    pub(crate) fn distort(&self, source: &RgbImage) -> Vec<u8> {
        let (bytes, row) = (source.as_raw(), 3 * self.source_size.0 as usize);
        let mut distorted = Vec::with_capacity(3 * self.taps.len());
        for Tap { at, right, down } in &self.taps {
            for channel in 0..3 {
                let value = |offset: usize| f32::from(bytes[3 * at + offset + channel]);
                let mix = |offset: usize| value(offset) + right * (value(offset + 3) - value(offset));
                let (above, below) = (mix(0), mix(row));
                distorted.push((above + down * (below - above)).round() as u8);
            }
        }
        distorted
    }

    /// Returns the distances of the distorted picture, each from the nearest pixel: an interpolation between two
    /// surfaces would be a distance where nothing is.
    pub(crate) fn distort_depth(&self, source: &[f32]) -> Vec<f32> {
        let width = self.source_size.0 as usize;
        let nearest = |tap: &Tap| tap.at + usize::from(tap.right >= 0.5) + width * usize::from(tap.down >= 0.5);
        self.taps.iter().map(|tap| source[nearest(tap)]).collect()
    }
}
