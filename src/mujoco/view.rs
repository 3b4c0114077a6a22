//! From where a world is seen, and where its points then lie in the picture.

use glam::DVec3;

use super::World;
use super::renderer::Renderer;
use crate::error::Result;

/// A camera that looks at a point, z up.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct View {
    /// What is in the middle, in the world frame, m.
    pub point: DVec3,
    /// Direction from there to the camera.
    pub toward: DVec3,
    /// From the point to the camera, m.
    pub distance: f64,
}

impl View {
    /// Opens a renderer for `width` x `height` pixels, with distances where `depth` says so.
    ///
    /// # Errors
    /// As [`Renderer::new`].
    pub fn renderer(&self, world: &World, width: u32, height: u32, depth: bool) -> Result<Renderer> {
        Renderer::around(world, self, (width, height), depth)
    }

    /// Where a point of the world lies in a picture of `width` x `height` pixels, x to the right and y down; None = behind
    /// the camera.
    pub fn pixel(&self, world: &World, place: DVec3, (width, height): (f64, f64)) -> Option<(f64, f64)> {
        let look = -self.toward.normalize_or_zero();
        let right = look.cross(DVec3::Z).try_normalize()?;
        let up = right.cross(look);
        let from_camera = place - (self.point - self.distance * look);
        let depth = from_camera.dot(look);
        let fovy = f64::from(world.model().vis().global.fovy);
        let pixels = 0.5 * height / (0.5 * fovy).to_radians().tan() / depth;
        (depth > 0.0)
            .then(|| (0.5 * width + pixels * from_camera.dot(right), 0.5 * height - pixels * from_camera.dot(up)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mujoco::PhysicsOptions;

    #[test]
    fn a_ball_is_drawn_where_its_pixel_is() {
        let xml = r#"<mujoco><worldbody><light pos="0 0 3"/>
            <geom type="sphere" size="0.02" pos="0.05 -0.08 0.21" rgba="1 0 0 1"/></worldbody></mujoco>"#;
        let mut world = World::from_mjcf(xml, &PhysicsOptions::default()).unwrap();
        let ball = DVec3::new(0.05, -0.08, 0.21);
        for toward in [DVec3::X, DVec3::new(-0.3, 0.8, 0.4), DVec3::new(0.5, -0.5, -0.2)] {
            let view = View { point: DVec3::new(0.0, 0.0, 0.15), toward, distance: 0.6 };
            let mut renderer = view.renderer(&world, 320, 240, false).unwrap();
            world.forward();
            let picture = renderer.render(&mut world).unwrap();
            let red: Vec<_> = picture.enumerate_pixels().filter(|(.., p)| p[0] > 40 && p[1] < p[0] / 4).collect();
            let count = red.len() as f64;
            assert!(count > 50.0, "{count} pixels");
            let mean = red.iter().fold((0.0, 0.0), |at, (x, y, _)| (at.0 + f64::from(*x), at.1 + f64::from(*y)));
            let (x, y) = view.pixel(&world, ball, (320.0, 240.0)).unwrap();
            assert!((mean.0 / count - x).abs() < 2.0 && (mean.1 / count - y).abs() < 2.0, "{x} {y} {mean:?} {count}");
        }
        let view = View { point: DVec3::ZERO, toward: DVec3::X, distance: 0.1 };
        assert!(view.pixel(&world, DVec3::X, (320.0, 240.0)).is_none());
    }
}
