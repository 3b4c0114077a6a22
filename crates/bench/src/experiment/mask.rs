//! Pixels of hands and objects in a simulated picture.

use egotac::camera::Intrinsics;
use egotac::hand::Side;
use egotac::sim::camera::CameraPose;
use egotac::sim::{Rollout, SimFrame};
use glam::{DVec3, Vec3};

/// Thing that a pixel shows.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Shown {
    /// Anything else.
    Other,
    /// A hand, without the forearm.
    Hand,
    /// An object that the scene names; distractors are none.
    Object,
}

/// Square map of what each pixel shows.
#[derive(Debug, Clone)]
pub struct Mask {
    side: usize,
    depth: Vec<f32>,
    shown: Vec<Shown>,
}

/// Projection of world points to places, as shares of the sides of a square picture.
struct Projection<'a> {
    camera: &'a CameraPose,
    intrinsics: &'a Intrinsics,
}

impl Mask {
    /// Draws the mask of a frame, `side` x `side` pixels.
    pub fn of(rollout: &Rollout, frame: &SimFrame, side: usize) -> Self {
        let mut mask = Self { side, depth: vec![f32::INFINITY; side * side], shown: vec![Shown::Other; side * side] };
        let projection = Projection { camera: &frame.camera, intrinsics: &rollout.intrinsics() };
        for hand in Side::BOTH {
            if let Some(params) = rollout.hand_params(hand) {
                let model = &rollout.rigs()[hand as usize].model;
                mask.mesh(&projection, &model.forward(&params).vertices, &model.faces, Shown::Hand);
            }
        }
        for (object, drawn) in rollout.objects().iter().zip(&rollout.episode().objects) {
            let shown = if drawn.name.starts_with("distractor_") { Shown::Other } else { Shown::Object };
            let parts =
                [(&drawn.shape.pieces, object.pose()), (&drawn.shape.base, (drawn.position, drawn.orientation))];
            for (pieces, (position, orientation)) in parts.into_iter().filter(|_| drawn.solid) {
                for piece in pieces.iter() {
                    let (vertices, faces) = piece.mesh();
                    let place = |v: &Vec3| {
                        let own = piece.position + piece.orientation * v.as_dvec3();
                        (position + orientation * own).as_vec3()
                    };
                    let vertices: Vec<Vec3> = vertices.iter().map(place).collect();
                    mask.mesh(&projection, &vertices, &faces, shown);
                }
            }
        }
        mask
    }

    /// Returns the share of the pixels of each patch that show `what`, `grid` x `grid` patches, row by row.
    pub fn shares(&self, what: Shown, grid: usize) -> Vec<f32> {
        let size = self.side / grid;
        let mut shares = vec![0.0; grid * grid];
        for (pixel, _) in self.shown.iter().enumerate().filter(|(_, shown)| **shown == what) {
            let [x, y] = [pixel % self.side / size, pixel / self.side / size];
            if x < grid && y < grid {
                shares[y * grid + x] += 1.0 / (size * size) as f32;
            }
        }
        shares
    }

    /// Draws triangles with their depth.
    fn mesh(&mut self, projection: &Projection, vertices: &[Vec3], faces: &[[u32; 3]], shown: Shown) {
        let corners: Vec<Option<[f32; 3]>> =
            vertices.iter().map(|vertex| projection.corner(*vertex, self.side)).collect();
        for face in faces {
            if let [Some(a), Some(b), Some(c)] = face.map(|vertex| corners[vertex as usize]) {
                self.triangle([a, b, c], shown);
            }
        }
    }

    /// Draws a triangle of corners (x, y in pixels, reciprocal of the depth).
    fn triangle(&mut self, [a, b, c]: [[f32; 3]; 3], shown: Shown) {
        let edge =
            |p: [f32; 3], q: [f32; 3], at: [f32; 2]| (q[0] - p[0]) * (at[1] - p[1]) - (q[1] - p[1]) * (at[0] - p[0]);
        let area = edge(a, b, [c[0], c[1]]);
        if area.abs() < 1e-9 {
            return;
        }
        let span = |axis: usize| {
            let low = a[axis].min(b[axis]).min(c[axis]).floor().clamp(0.0, self.side as f32) as usize;
            let high = a[axis].max(b[axis]).max(c[axis]).ceil().clamp(0.0, self.side as f32) as usize;
            low..high
        };
        for (x, y) in span(1).flat_map(|y| span(0).map(move |x| (x, y))) {
            let at = [x as f32 + 0.5, y as f32 + 0.5];
            let weights = [edge(b, c, at), edge(c, a, at), edge(a, b, at)].map(|weight| weight / area);
            if weights.iter().any(|weight| *weight < 0.0) {
                continue;
            }
            // In perspective the reciprocal of the depth is linear in the picture.
            let depth = 1.0 / (weights[0] * a[2] + weights[1] * b[2] + weights[2] * c[2]);
            let pixel = y * self.side + x;
            if depth < self.depth[pixel] {
                self.depth[pixel] = depth;
                self.shown[pixel] = shown;
            }
        }
    }
}

impl Projection<'_> {
    /// Returns pixel and reciprocal depth of a world point in a picture of `side` pixels; `None` behind the camera.
    fn corner(&self, point: Vec3, side: usize) -> Option<[f32; 3]> {
        let local: DVec3 = self.camera.camera_from_world(point.as_dvec3());
        let [x, y] = self.intrinsics.project(local)?;
        let scale = side as f64 / f64::from(self.intrinsics.width.max(1));
        Some([(x * scale) as f32, (y * scale) as f32, (1.0 / local.z) as f32])
    }
}

/// Returns the pixel, as shares of the picture's sides, of each vertex of both hands with more than `force` newtons.
pub fn touched(rollout: &Rollout, frame: &SimFrame, force: f32) -> Vec<[f32; 2]> {
    let projection = Projection { camera: &frame.camera, intrinsics: &rollout.intrinsics() };
    let mut places = Vec::new();
    for hand in Side::BOTH {
        let Some(params) = rollout.hand_params(hand) else { continue };
        let vertices = rollout.rigs()[hand as usize].model.forward(&params).vertices;
        let forces = &frame.frame.field.force[hand.range()];
        let pressed = vertices.iter().zip(forces).filter(|(_, own)| **own > force);
        places.extend(pressed.filter_map(|(vertex, _)| projection.corner(*vertex, 1).map(|[x, y, _]| [x, y])));
    }
    places
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_nearer_of_two_triangles_is_shown_and_shares_count_its_pixels() {
        let mut mask = Mask { side: 8, depth: vec![f32::INFINITY; 64], shown: vec![Shown::Other; 64] };
        let square = |mask: &mut Mask, [low, high]: [f32; 2], depth: f32, shown: Shown| {
            let corner = |x: f32, y: f32| [x, y, 1.0 / depth];
            mask.triangle([corner(low, low), corner(high, low), corner(high, high)], shown);
            mask.triangle([corner(low, low), corner(high, high), corner(low, high)], shown);
        };
        square(&mut mask, [0.0, 4.0], 1.0, Shown::Hand);
        square(&mut mask, [0.0, 8.0], 2.0, Shown::Object);
        assert_eq!(mask.shares(Shown::Hand, 2), [1.0, 0.0, 0.0, 0.0]);
        assert_eq!(mask.shares(Shown::Object, 2), [0.0, 1.0, 1.0, 1.0]);
        assert_eq!(mask.shares(Shown::Other, 2), [0.0; 4]);
    }

    #[test]
    fn hand_and_object_of_a_scene_are_where_the_camera_looks() {
        use egotac::sim::{RolloutOptions, Scene};
        let options = RolloutOptions { picture: None, ..RolloutOptions::default() };
        let mut rollout = Rollout::new(&Scene::load("lift_mug").unwrap(), 3, &options).unwrap();
        let frame = rollout.next_frame().unwrap().unwrap();
        // Without pictures the projection is that of one pixel: shares of its side.
        let mask = Mask::of(&rollout, &frame, 112);
        let count = |what: Shown| mask.shares(what, 1)[0];
        assert!((0.01..0.4).contains(&count(Shown::Hand)), "{}", count(Shown::Hand));
        assert!((0.005..0.3).contains(&count(Shown::Object)), "{}", count(Shown::Object));
    }
}
