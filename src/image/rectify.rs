//! Rectification: an image as a pinhole camera without distortion would see it.

use ::image::{Rgb, RgbImage};
use glam::{DMat3, DVec3};

use super::check_size;
use crate::error::{Error, Result};

/// Distortion models, with ROS's names.
const MODELS: [&str; 4] = ["plumb_bob", "rational_polynomial", "equidistant", "fisheye"];

/// Calibration of a camera, as in `sensor_msgs/CameraInfo`; matrices are row-major, lengths in pixels.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Calibration<'a> {
    /// Width of the calibrated image.
    pub width: u32,
    /// Height of the calibrated image.
    pub height: u32,
    /// Distortion model: `plumb_bob`, `rational_polynomial`, `equidistant` or `fisheye` (the same).
    pub model: &'a str,
    /// Distortion parameters in OpenCV's order: k1, k2, p1, p2, k3, k4, k5, k6, or the four of the fisheye model; missing ones
    /// are 0.
    pub d: &'a [f64],
    /// (3, 3) camera matrix.
    pub k: &'a [f64; 9],
    /// (3, 3) rotation from the camera to the rectified camera; all 0 = none.
    pub r: &'a [f64; 9],
    /// (3, 4) projection of the rectified camera; its last column is ignored. All 0 = the camera matrix.
    pub p: &'a [f64; 12],
}

/// Map from the pixels of a rectified image to places in the camera's image.
#[derive(Debug, Clone, PartialEq)]
pub struct Rectifier {
    width: u32,
    height: u32,
    /// Place of each rectified pixel, row by row: x to the right, y down.
    places: Vec<[f32; 2]>,
}

/// Distortion of a lens.
#[derive(Debug, Clone, Copy)]
enum Lens {
    /// k1, k2, p1, p2, k3, k4, k5, k6.
    Polynomial([f64; 8]),
    /// k1 to k4 of a polynomial in the angle from the axis.
    Fisheye([f64; 4]),
}

impl Rectifier {
    /// Prepares the rectification of a camera's images.
    ///
    /// # Errors
    /// If the model is unknown, the camera is not calibrated (focal lengths of 0), or a number is not finite.
    pub fn new(calibration: &Calibration) -> Result<Self> {
        let Calibration { width, height, k, p, .. } = *calibration;
        check_size(width.into(), height.into())?;
        let lens = Lens::new(calibration.model, calibration.d)?;
        let r = if calibration.r.iter().all(|x| *x == 0.0) { &IDENTITY } else { calibration.r };
        let projection = match p[0] == 0.0 {
            true => [k[0], k[1], k[2], k[3], k[4], k[5], 0.0, 0.0, 1.0],
            false => [p[0], p[1], p[2], p[4], p[5], p[6], p[8], p[9], p[10]],
        };
        if k.iter().chain(r).chain(&projection).any(|x| !x.is_finite()) || k[0] <= 0.0 || k[4] <= 0.0 {
            let got = format!("K {k:?}, R {r:?}, P {p:?}");
            return Err(Error::value("camera_info", "finite matrices and focal lengths above 0", got));
        }
        let rows = |m: &[f64; 9]| DMat3::from_cols_array(m).transpose();
        let to_ray = (rows(&projection) * rows(r)).inverse();
        if !to_ray.is_finite() {
            return Err(Error::value("camera_info", "an invertible P and R", format!("P {p:?}, R {r:?}")));
        }
        let place = |x: u32, y: u32| {
            let ray = to_ray * DVec3::new(x.into(), y.into(), 1.0);
            let [x, y] = lens.bend([ray.x / ray.z, ray.y / ray.z]);
            [(k[0] * x + k[1] * y + k[2]) as f32, (k[4] * y + k[5]) as f32]
        };
        let places = (0..height).flat_map(|y| (0..width).map(move |x| (x, y))).map(|(x, y)| place(x, y)).collect();
        Ok(Self { width, height, places })
    }

    /// Places in the camera's image of the rectified pixels, row by row: x to the right, y down.
    pub fn places(&self) -> &[[f32; 2]] {
        &self.places
    }

    /// Rectifies an image, with linear interpolation. Pixels beyond the image are black.
    ///
    /// # Errors
    /// If the image has another size than the calibration.
    pub fn apply(&self, image: &RgbImage) -> Result<RgbImage> {
        if image.dimensions() != (self.width, self.height) {
            let expected = format!("{} x {} pixels, as in camera_info", self.width, self.height);
            return Err(Error::value("image size", expected, format!("{} x {}", image.width(), image.height())));
        }
        let mut places = self.places.iter();
        Ok(RgbImage::from_fn(self.width, self.height, |_, _| {
            places.next().map_or(Rgb([0; 3]), |place| interpolate(image, *place))
        }))
    }
}

const IDENTITY: [f64; 9] = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0];

impl Lens {
    fn new(model: &str, d: &[f64]) -> Result<Self> {
        let most = match model {
            "plumb_bob" | "rational_polynomial" => 8,
            "equidistant" | "fisheye" => 4,
            other => return Err(Error::unknown("distortion model", other, MODELS)),
        };
        if d.iter().skip(most).any(|x| *x != 0.0) || d.iter().any(|x| !x.is_finite()) {
            return Err(Error::value(
                "distortion parameters",
                format!("at most {most} numbers for {model}"),
                format!("{d:?}"),
            ));
        }
        let at = |index: usize| d.get(index).copied().unwrap_or(0.0);
        Ok(match most {
            8 => Self::Polynomial(std::array::from_fn(at)),
            _ => Self::Fisheye(std::array::from_fn(at)),
        })
    }

    /// Returns where a lens shows the direction (x, y, 1).
    fn bend(&self, [x, y]: [f64; 2]) -> [f64; 2] {
        let s = x * x + y * y;
        match *self {
            Self::Polynomial([k1, k2, p1, p2, k3, k4, k5, k6]) => {
                let radial = (1.0 + s * (k1 + s * (k2 + s * k3))) / (1.0 + s * (k4 + s * (k5 + s * k6)));
                let tangential = [2.0 * p1 * x * y + p2 * (s + 2.0 * x * x), p1 * (s + 2.0 * y * y) + 2.0 * p2 * x * y];
                [x * radial + tangential[0], y * radial + tangential[1]]
            }
            Self::Fisheye([k1, k2, k3, k4]) => {
                let r = s.sqrt();
                let angle = r.atan();
                let t = angle * angle;
                let bent = angle * (1.0 + t * (k1 + t * (k2 + t * (k3 + t * k4))));
                let scale = if r > 1e-8 { bent / r } else { 1.0 };
                [x * scale, y * scale]
            }
        }
    }
}

/// Returns the colour at a place between pixels; what lies outside of the image is black.
fn interpolate(image: &RgbImage, [x, y]: [f32; 2]) -> Rgb<u8> {
    let (left, top) = (x.floor(), y.floor());
    let (right_share, lower_share) = (x - left, y - top);
    let pixel = |dx: f32, dy: f32| -> [u8; 3] {
        let (x, y) = (left + dx, top + dy);
        let is_inside = x >= 0.0 && y >= 0.0 && x < image.width() as f32 && y < image.height() as f32;
        if is_inside { image.get_pixel(x as u32, y as u32).0 } else { [0; 3] }
    };
    let corners = [
        ((1.0 - right_share) * (1.0 - lower_share), pixel(0.0, 0.0)),
        (right_share * (1.0 - lower_share), pixel(1.0, 0.0)),
        ((1.0 - right_share) * lower_share, pixel(0.0, 1.0)),
        (right_share * lower_share, pixel(1.0, 1.0)),
    ];
    Rgb(std::array::from_fn(|channel| {
        corners.iter().map(|(share, colour)| share * f32::from(colour[channel])).sum::<f32>().round() as u8
    }))
}
