//! Camera model: a pinhole with optional radial distortion.

use glam::DVec3;
use serde::{Deserialize, Serialize};

/// Radial distortion of ROS's model `plumb_bob`: a direction whose angle from the axis has the tangent r is projected to
/// r (1 + k1 r² + k2 r⁴).
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct Distortion(
    /// Coefficients k1 and k2.
    pub [f64; 2],
);

/// Intrinsics of a camera, pixels. As JSON: `width`, `height`, `fx`, `fy`, `cx`, `cy` and `distortion` (k1, k2).
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Intrinsics {
    /// Image width; 0 if unknown.
    #[serde(default)]
    pub width: u32,
    /// Image height; 0 if unknown.
    #[serde(default)]
    pub height: u32,
    /// Focal length in x, to the right.
    pub fx: f64,
    /// Focal length in y, down.
    pub fy: f64,
    /// Principal point in x, from the top left corner of the image.
    pub cx: f64,
    /// Principal point in y, from the top left corner of the image.
    pub cy: f64,
    /// Distortion of the lens.
    #[serde(default)]
    pub distortion: Distortion,
}

impl Intrinsics {
    /// Creates intrinsics without distortion from image size and vertical field of view, rad.
    pub fn new(width: u32, height: u32, fovy: f64) -> Self {
        let focal = 0.5 * f64::from(height) / (0.5 * fovy).tan();
        let [cx, cy] = [width, height].map(|size| 0.5 * f64::from(size));
        Self { width, height, fx: focal, fy: focal, cx, cy, distortion: Distortion::default() }
    }

    /// Returns the same intrinsics with another distortion.
    #[must_use]
    pub fn with_distortion(self, distortion: Distortion) -> Self {
        Self { distortion, ..self }
    }

    /// Projects a point in the camera's optical frame to a pixel; `None` behind the camera or beyond the field of the lens.
    pub fn project(&self, point: DVec3) -> Option<[f64; 2]> {
        if point.z <= 1e-6 {
            return None;
        }
        let (x, y) = (point.x / point.z, point.y / point.z);
        let r = x.hypot(y);
        let bent = (r < self.distortion.limit()).then(|| self.distortion.factor(r))?;
        Some([self.cx + self.fx * bent * x, self.cy + self.fy * bent * y])
    }

    /// Returns the direction of a pixel in the camera's optical frame, with z = 1; `None` beyond the field of the lens.
    pub fn direction(&self, [x, y]: [f64; 2]) -> Option<DVec3> {
        let (x, y) = ((x - self.cx) / self.fx, (y - self.cy) / self.fy);
        let seen = x.hypot(y);
        let straight = self.distortion.unbend(seen)?;
        let scale = if seen > 0.0 { straight / seen } else { 1.0 };
        Some(DVec3::new(scale * x, scale * y, 1.0))
    }
}

impl Distortion {
    /// Factor by which the distance `r` of a direction from the axis grows.
    fn factor(self, r: f64) -> f64 {
        let (Self([k1, k2]), s) = (self, r * r);
        1.0 + s * (k1 + s * k2)
    }

    /// Limit of the field: the least r > 0 with 1 + 3 k1 r² + 5 k2 r⁴ = 0. Beyond it the image would fold back.
    pub(crate) fn limit(self) -> f64 {
        let Self([k1, k2]) = self;
        let (a, b) = (5.0 * k2, 3.0 * k1);
        let root = (b * b - 4.0 * a).sqrt();
        // This form does not divide by `a`, which may be small. NaN if there is no root.
        let roots = [2.0 / (-b + root), 2.0 / (-b - root)].into_iter().filter(|s| *s > 0.0);
        roots.fold(f64::INFINITY, f64::min).sqrt()
    }

    /// Inverts the distortion: returns the distance from the axis that is projected to `seen`; `None` beyond the limit.
    pub(crate) fn unbend(self, seen: f64) -> Option<f64> {
        let at = |r: f64| r * self.factor(r);
        let mut high = self.limit();
        if high.is_infinite() {
            high = 1.0;
            while at(high) < seen {
                high *= 2.0;
            }
        }
        if !(0.0..=at(high)).contains(&seen) {
            return None;
        }
        // Bisection: the function grows up to the limit, and 60 halvings exhaust the digits of an f64.
        let mut low = 0.0;
        for _ in 0..60 {
            let middle = 0.5 * (low + high);
            if at(middle) < seen { low = middle } else { high = middle }
        }
        Some(0.5 * (low + high))
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn a_point_off_the_axis_is_projected_by_the_formula() {
        let straight = Intrinsics::new(200, 100, 2.0 * 0.5f64.atan());
        let point = DVec3::new(0.3, -0.4, 1.0) * 2.0;
        // f = 100 pixels
        let [x, y] = straight.project(point).unwrap();
        assert!((x - 130.0).abs() < 1e-12 && (y - 10.0).abs() < 1e-12, "{x} {y}");
        let bent = straight.with_distortion(Distortion([-0.2, 0.1]));
        // r² = 0.25: 1 - 0.05 + 0.00625
        let [x, y] = bent.project(point).unwrap();
        assert!((x - (100.0 + 30.0 * 0.95625)).abs() < 1e-12 && (y - (50.0 - 40.0 * 0.95625)).abs() < 1e-12);
        assert!(bent.project(-point).is_none());
    }

    #[test]
    fn points_beyond_the_limit_are_not_projected() {
        let fold = Distortion([-0.3, 0.0]);
        // 1 - 0.9 r² = 0
        assert!((fold.limit() - (1.0f64 / 0.9).sqrt()).abs() < 1e-12);
        assert_eq!(Distortion::default().limit(), f64::INFINITY);
        assert_eq!(Distortion([0.3, 0.1]).limit(), f64::INFINITY);
        let camera = Intrinsics::new(100, 100, 1.0).with_distortion(fold);
        assert!(camera.project(DVec3::new(1.1, 0.0, 1.0)).is_none());
        assert!(camera.project(DVec3::new(1.0, 0.0, 1.0)).is_some());
        assert!(fold.unbend(0.71).is_none() && fold.unbend(0.7).is_some());
    }

    proptest! {
        #[test]
        fn direction_inverts_project(
            k1 in -0.4..0.4f64, k2 in -0.1..0.1f64, x in -1.0..1.0f64, y in -1.0..1.0f64,
        ) {
            let camera = Intrinsics::new(640, 480, 1.2).with_distortion(Distortion([k1, k2]));
            if let Some(pixel) = camera.project(DVec3::new(x, y, 1.0)) {
                let back = camera.direction(pixel).unwrap();
                // Near the limit, a pixel covers many directions.
                let slope = 1.0 + 3.0 * k1 * (x * x + y * y) + 5.0 * k2 * (x * x + y * y).powi(2);
                prop_assume!(slope > 0.01);
                prop_assert!((back - DVec3::new(x, y, 1.0)).length() < 1e-9, "{back}");
            }
        }
    }
}
