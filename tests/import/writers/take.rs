//! A simulated take: both hands carry a box, and the distance of each vertex from the box is known in closed form.

use egotac::hand::{HandModel, HandParams, N_BETAS, Side};
use egotac::sim::object::PieceShape;
use egotac::sim::{Rollout, RolloutOptions, Scene};
use glam::{DAffine3, DMat4, DQuat, DVec3, Vec3};
use image::{Rgb, RgbImage};

/// Number of frames of a take.
pub const FRAMES: usize = 9;
/// Distance of contact, m.
const CONTACT: f64 = 0.01;

/// Frames of two hands and a box.
pub struct Take {
    /// Half edges of the box, m.
    pub half: DVec3,
    pub frames: Vec<TakeFrame>,
}

#[derive(Clone)]
pub struct TakeFrame {
    pub image: RgbImage,
    /// Left and right hand in the world.
    pub hands: [TakeHand; 2],
    /// `world_from_box`.
    pub object: DAffine3,
    /// `world_from_camera`.
    pub camera: DAffine3,
}

#[derive(Clone)]
pub struct TakeHand {
    pub params: HandParams,
    /// Position of the wrist joint, m.
    pub wrist: DVec3,
    pub vertices: Vec<Vec3>,
    /// (778) true force, N.
    pub forces: Vec<f32>,
    /// 21 keypoints, m.
    pub keypoints: [Vec3; 21],
}

impl Take {
    /// Simulates hands of a person's shape.
    pub fn simulated() -> Self {
        Self::of_shape(std::array::from_fn(|beta| [0.9, -0.6, 0.4, 0.0][beta % 4]))
    }

    /// Simulates hands of the mean shape, whose girth follows from their joints.
    pub fn of_mean_shape() -> Self {
        Self::of_shape([0.0; N_BETAS])
    }

    /// Simulates two hands that press a box between their palms; every other frame from the first touch on is kept.
    fn of_shape(betas: [f32; N_BETAS]) -> Self {
        let options = RolloutOptions { picture: None, betas, ..RolloutOptions::default() };
        let mut rollout = Rollout::new(&Scene::load("carry_box").unwrap(), 3, &options).unwrap();
        let pieces = &rollout.episode().objects[0].shape.pieces;
        let [PieceShape::Box(half)] = [&pieces[0].shape] else { panic!("{:?}", pieces[0].shape) };
        let half = *half;
        assert!(pieces.len() == 1 && pieces[0].position == DVec3::ZERO && pieces[0].orientation == DQuat::IDENTITY);
        let models = Side::BOTH.map(HandModel::builtin);
        let mut frames = Vec::new();
        let mut touching = 0;
        while let Some(frame) = rollout.next_frame().unwrap() {
            let touches = Side::BOTH.iter().all(|side| frame.frame.field.total_force(*side) > 0.2);
            touching += usize::from(touches);
            if !touches || touching % 2 == 0 {
                continue;
            }
            let of_sides = [&frame.frame.left_hand_pose, &frame.frame.right_hand_pose];
            let hand = |side: Side| {
                let params = of_sides[side as usize].clone().unwrap();
                let posed = models[side as usize].forward(&params);
                let keypoints = models[side as usize].keypoints(&posed);
                let forces = frame.frame.field.force[side.range()].to_vec();
                TakeHand { wrist: posed.joints[0].as_dvec3(), forces, vertices: posed.vertices, keypoints, params }
            };
            let object = &frame.objects[0];
            frames.push(TakeFrame {
                image: picture(frames.len()),
                hands: Side::BOTH.map(hand),
                object: DAffine3::from_rotation_translation(object.orientation, object.position),
                camera: DAffine3::from_rotation_translation(frame.camera.orientation, frame.camera.position),
            });
            if frames.len() == FRAMES {
                return Self { half, frames };
            }
        }
        panic!("{} frames in which both hands touch", frames.len());
    }

    /// Corners of the box in its own frame, m, and its triangles, counter-clockwise seen from outside.
    pub fn box_mesh(&self) -> (Vec<DVec3>, Vec<[usize; 3]>) {
        cuboid(self.half)
    }
}

impl TakeFrame {
    pub fn hand(&self, side: Side) -> &TakeHand {
        &self.hands[side as usize]
    }

    /// Tells of each vertex whether the surface of the box is within 1 cm.
    pub fn touched(&self, take: &Take, side: Side) -> Vec<bool> {
        let from_world = self.object.inverse();
        let distance = |vertex: &Vec3| {
            let beyond = from_world.transform_point3(vertex.as_dvec3()).abs() - take.half;
            let outside = beyond.max(DVec3::ZERO).length();
            if outside > 0.0 { outside } else { -beyond.max_element() }
        };
        self.hand(side).vertices.iter().map(|vertex| distance(vertex) <= CONTACT).collect()
    }
}

/// Returns corners and triangles of a cuboid about the origin.
pub fn cuboid(half: DVec3) -> (Vec<DVec3>, Vec<[usize; 3]>) {
    let sign = |bit: usize| if bit == 0 { -1.0 } else { 1.0 };
    let corners = (0..8).map(|c| half * DVec3::new(sign(c & 1), sign(c >> 1 & 1), sign(c >> 2 & 1))).collect();
    let quads = [[0, 4, 6, 2], [1, 3, 7, 5], [0, 1, 5, 4], [2, 6, 7, 3], [0, 2, 3, 1], [4, 5, 7, 6]];
    let triangles = quads.iter().flat_map(|[a, b, c, d]| [[*a, *b, *c], [*a, *c, *d]]).collect();
    (corners, triangles)
}

/// Returns a picture that no other frame has.
fn picture(index: usize) -> RgbImage {
    RgbImage::from_fn(64, 48, |x, y| Rgb([4 * x as u8, 5 * y as u8, (31 * index + (x * y) as usize) as u8]))
}

/// Moves hand parameters by a rigid motion about their wrist joint.
pub fn moved(hand: &TakeHand, to_from: DAffine3) -> HandParams {
    let rotation = DQuat::from_affine3(&to_from);
    let orient = rotation * DQuat::from_scaled_axis(hand.params.global_orient.as_dvec3());
    let rest = hand.wrist - hand.params.transl.as_dvec3();
    HandParams {
        global_orient: orient.to_scaled_axis().as_vec3(),
        transl: (to_from.transform_point3(hand.wrist) - rest).as_vec3(),
        ..hand.params.clone()
    }
}

/// Returns the rows of a rigid motion's 4 x 4 matrix.
pub fn rows(pose: DAffine3) -> [f64; 16] {
    DMat4::from(pose).transpose().to_cols_array()
}
