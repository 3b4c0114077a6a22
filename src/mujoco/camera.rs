//! A free camera, and the projection of world points into its picture.

use glam::DVec3;

use super::World;

/// A camera outside of the model that looks at a point, z up.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FreeCamera {
    /// Point in the middle of the picture, world frame, m.
    pub point: DVec3,
    /// Direction from that point to the camera; any length above zero.
    pub toward: DVec3,
    /// Distance from the point to the camera, m.
    pub distance: f64,
}

impl FreeCamera {
    /// Unit direction in which the camera looks.
    pub(super) fn forward(&self) -> DVec3 {
        -self.toward.normalize_or_zero()
    }

    /// Projects a world point into a picture of `width` x `height` pixels: pixels to the right and down. Returns `None`
    /// for a point behind the camera.
    pub fn pixel(&self, world: &World, point: DVec3, (width, height): (f64, f64)) -> Option<(f64, f64)> {
        let forward = self.forward();
        let right = forward.cross(DVec3::Z).try_normalize()?;
        let up = right.cross(forward);
        let from_camera = point - (self.point - self.distance * forward);
        let depth = from_camera.dot(forward);
        let fovy = f64::from(world.model().vis().global.fovy);
        let pixels_per_metre = 0.5 * height / (0.5 * fovy).to_radians().tan() / depth;
        let (x, y) = (pixels_per_metre * from_camera.dot(right), pixels_per_metre * from_camera.dot(up));
        (depth > 0.0).then_some((0.5 * width + x, 0.5 * height - y))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mujoco::{PhysicsOptions, Renderer};

    #[test]
    fn a_ball_is_drawn_at_its_projected_pixel() {
        let xml = r#"<mujoco><worldbody><light pos="0 0 3"/>
            <geom type="sphere" size="0.02" pos="0.05 -0.08 0.21" rgba="1 0 0 1"/></worldbody></mujoco>"#;
        let mut world = World::from_mjcf(xml, &PhysicsOptions::default()).unwrap();
        let ball = DVec3::new(0.05, -0.08, 0.21);
        for toward in [DVec3::X, DVec3::new(-0.3, 0.8, 0.4), DVec3::new(0.5, -0.5, -0.2)] {
            let camera = FreeCamera { point: DVec3::new(0.0, 0.0, 0.15), toward, distance: 0.6 };
            let mut renderer = Renderer::free(&world, &camera, (320, 240), false).unwrap();
            world.forward();
            let picture = renderer.render(&mut world).unwrap();
            let red: Vec<_> = picture.enumerate_pixels().filter(|(.., p)| p[0] > 40 && p[1] < p[0] / 4).collect();
            let count = red.len() as f64;
            assert!(count > 50.0, "{count} pixels");
            let mean = red.iter().fold((0.0, 0.0), |at, (x, y, _)| (at.0 + f64::from(*x), at.1 + f64::from(*y)));
            let (x, y) = camera.pixel(&world, ball, (320.0, 240.0)).unwrap();
            assert!((mean.0 / count - x).abs() < 2.0 && (mean.1 / count - y).abs() < 2.0, "{x} {y} {mean:?} {count}");
        }
        let camera = FreeCamera { point: DVec3::ZERO, toward: DVec3::X, distance: 0.1 };
        assert!(camera.pixel(&world, DVec3::X, (320.0, 240.0)).is_none());
    }
}
