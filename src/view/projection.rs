//! Hands as the camera sees them.

use glam::{DQuat, DVec3, Vec3};

use crate::camera::Intrinsics;

/// The camera's lens, and its pose in the frame of the hands.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sight {
    /// The lens; pixels of the image.
    pub intrinsics: Intrinsics,
    /// Position of the camera in the frame of the hands, m.
    pub position: DVec3,
    /// Rotation from the optical frame (x right, y down, z forward) to the frame of the hands.
    pub orientation: DQuat,
}

impl Sight {
    /// Returns where a point appears: x from -1 (left edge of the image) to 1, y from -1 (lower edge) to 1, and its distance from
    /// the camera along the axis, m. NaN if it is behind the camera or beyond the lens.
    pub fn of(&self, point: Vec3) -> [f32; 3] {
        let seen = self.orientation.inverse() * (point.as_dvec3() - self.position);
        let Intrinsics { width, height, .. } = self.intrinsics;
        match self.intrinsics.project(seen) {
            Some([x, y]) if width > 0 && height > 0 => {
                [(2.0 * x / f64::from(width) - 1.0) as f32, (1.0 - 2.0 * y / f64::from(height)) as f32, seen.z as f32]
            }
            _ => [f32::NAN; 3],
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_point_on_the_axis_is_in_the_middle_and_one_at_the_edge_of_the_field_at_the_edge() {
        let intrinsics = Intrinsics::new(640, 480, std::f64::consts::FRAC_PI_2);
        // A camera at height 2 that looks down: its x is the world's x, its y the world's -y.
        let orientation = DQuat::from_rotation_x(std::f64::consts::PI);
        let sight = Sight { intrinsics, position: DVec3::new(0.0, 0.0, 2.0), orientation };
        let near = |got: [f32; 3], want: [f32; 3]| got.iter().zip(want).all(|(a, b)| (a - b).abs() < 1e-6);
        assert!(near(sight.of(Vec3::ZERO), [0.0, 0.0, 2.0]));
        // The vertical field is 90 degrees: at distance 2 its edge is 2 away.
        assert!(near(sight.of(Vec3::new(0.0, 2.0, 0.0)), [0.0, 1.0, 2.0]));
        assert!(near(sight.of(Vec3::new(2.0, 0.0, 0.0)), [0.75, 0.0, 2.0]));
        assert!(sight.of(Vec3::new(0.0, 0.0, 3.0))[0].is_nan());
    }
}
