//! Topics `~/wrench/<side>_<part>`: force and torque on each finger and on the palm, and their frames on `/tf`.

use glam::{DMat3, DQuat, DVec3};

use crate::hand::{HandModel, N_JOINTS, Region, vertex_normals};
use crate::message::{Header, Quaternion, TFMessage, Transform, TransformStamped, Vector3, Wrench, WrenchStamped};
use crate::node::placed_hand::PlacedHand;
use crate::node::predictor::camera::Camera;
use crate::node::publisher::Publisher;
use crate::node::qos;
use crate::node::runtime::Runtime;
use crate::tactile::TactileField;

/// Parts of a hand with the joint, in MANO's order, at which their frame lies: that of the last phalanx, and the wrist.
const PARTS: [(&str, usize); 6] =
    [("thumb", 15), ("index", 3), ("middle", 6), ("ring", 12), ("little", 9), ("palm", 0)];
/// Index of the palm, to which the back of the hand belongs.
const PALM: usize = 5;

/// Publishes the wrenches, and the frames that they are in.
pub(super) struct Wrenches {
    /// Six parts of the left hand, then those of the right.
    publishers: Vec<Publisher<WrenchStamped>>,
    /// Names of the frames, in the same order.
    frames: Vec<String>,
    tf: Publisher<TFMessage>,
    /// Part of each vertex of the left and the right hand.
    parts: [Vec<usize>; 2],
}

impl Wrenches {
    /// Creates the publishers of a camera.
    ///
    /// # Errors
    /// If ROS refuses a topic.
    pub(super) fn create(runtime: &mut Runtime, camera: &Camera, models: &[HandModel; 2]) -> anyhow::Result<Self> {
        let prefix: String = runtime.parameters().get("frame_prefix");
        let (mut publishers, mut frames) = (Vec::new(), Vec::new());
        for model in models {
            for (part, _) in PARTS {
                let name = format!("{}_{part}", model.side.name());
                publishers.push(runtime.publisher(&camera.output(&format!("wrench/{name}")), qos::output())?);
                frames.push(camera.frame(&prefix, &name));
            }
        }
        let parts = [0, 1].map(|side: usize| models[side].regions().into_iter().map(part_of).collect());
        Ok(Self { publishers, frames, tf: runtime.publisher("/tf", qos::transforms())?, parts })
    }

    /// Returns true if a wrench has a subscriber.
    pub(super) fn are_wanted(&self) -> bool {
        self.publishers.iter().any(|publisher| publisher.subscriber_count() > 0)
    }

    /// Publishes the frames and wrenches of `hands`, which are in `header.frame_id`, if a wrench has a subscriber.
    ///
    /// # Errors
    /// If the node is gone or the middleware refuses a message.
    pub(super) fn publish(
        &self,
        header: &Header,
        field: &TactileField,
        hands: &[PlacedHand],
        models: &[HandModel; 2],
    ) -> anyhow::Result<()> {
        if !self.are_wanted() {
            return Ok(());
        }
        let mut transforms = Vec::new();
        let mut messages = Vec::new();
        for hand in hands {
            let side = hand.side as usize;
            let wrenches = wrenches(&field.force[hand.side.range()], hand, &models[side], &self.parts[side]);
            for (part, (wrench, (_, joint))) in wrenches.into_iter().zip(PARTS).enumerate() {
                let index = side * PARTS.len() + part;
                transforms.push(TransformStamped {
                    header: header.clone(),
                    child_frame_id: self.frames[index].clone(),
                    transform: frame_at(hand, joint),
                });
                let header = Header { stamp: header.stamp, frame_id: self.frames[index].clone() };
                messages.push((index, WrenchStamped { header, wrench }));
            }
        }
        // The frames first, so that receivers can place a wrench when it arrives.
        self.tf.publish(&TFMessage { transforms })?;
        for (index, message) in &messages {
            if self.publishers[*index].subscriber_count() > 0 {
                self.publishers[*index].publish(message)?;
            }
        }
        Ok(())
    }
}

/// Returns the index of the part that a region belongs to.
fn part_of(region: Region) -> usize {
    match region {
        Region::Palm | Region::Dorsal => PALM,
        _ => region.index() / 3,
    }
}

/// Pose of a joint: its position, and the rotation of its link from rest.
fn frame_at(hand: &PlacedHand, joint: usize) -> Transform {
    let DVec3 { x, y, z } = hand.posed.joints[joint].as_dvec3();
    let rotation = DQuat::from_mat3(&hand.posed.rotations[joint].as_dmat3());
    Transform {
        translation: Vector3 { x, y, z },
        rotation: Quaternion { x: rotation.x, y: rotation.y, z: rotation.z, w: rotation.w },
    }
}

/// Returns the wrench on each part in its own frame, about the frame's origin. The world presses against the skin: the force on a
/// vertex points inwards, along its normal. Friction is unknown and left out.
fn wrenches(force: &[f32], hand: &PlacedHand, model: &HandModel, parts: &[usize]) -> [Wrench; PARTS.len()] {
    let normals = vertex_normals(&hand.posed.vertices, &model.faces);
    let mut sums = [(DVec3::ZERO, DVec3::ZERO); PARTS.len()];
    for (vertex, newtons) in force.iter().enumerate().filter(|(_, newtons)| **newtons != 0.0) {
        let part = parts[vertex];
        let origin = hand.posed.joints[PARTS[part].1].as_dvec3();
        let force = -normals[vertex].as_dvec3() * f64::from(*newtons);
        sums[part].0 += force;
        sums[part].1 += (hand.posed.vertices[vertex].as_dvec3() - origin).cross(force);
    }
    let vector = |DVec3 { x, y, z }: DVec3| Vector3 { x, y, z };
    let mut parts = PARTS.iter().zip(sums).map(|((_, joint), (force, torque))| {
        debug_assert!(*joint < N_JOINTS);
        let part_from_frame: DMat3 = hand.posed.rotations[*joint].as_dmat3().transpose();
        Wrench { force: vector(part_from_frame * force), torque: vector(part_from_frame * torque) }
    });
    std::array::from_fn(|_| parts.next().unwrap_or_default())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::hand::{HandParams, N_VERTICES, Side};
    use glam::Vec3;

    fn length(Vector3 { x, y, z }: Vector3) -> f64 {
        DVec3::new(x, y, z).length()
    }

    #[test]
    fn a_wrench_in_its_own_frame_does_not_change_when_the_whole_hand_moves() {
        let model = HandModel::builtin(Side::Right);
        let parts: Vec<usize> = model.regions().into_iter().map(part_of).collect();
        let mut force = vec![0.0; N_VERTICES];
        force[model.tip_vertices[1] as usize] = 2.0;
        let at = |global_orient, transl| {
            let params = HandParams { global_orient, transl, ..HandParams::default() };
            wrenches(&force, &PlacedHand { side: Side::Right, posed: model.forward(&params) }, &model, &parts)
        };
        let (rest, moved) = (at(Vec3::ZERO, Vec3::ZERO), at(Vec3::new(0.3, -1.0, 2.0), Vec3::new(1.0, 2.0, 3.0)));
        for (a, b) in rest.iter().zip(&moved) {
            let difference = |a: Vector3, b: Vector3| length(Vector3 { x: a.x - b.x, y: a.y - b.y, z: a.z - b.z });
            assert!(difference(a.force, b.force) < 1e-4, "{a:?} {b:?}");
            assert!(difference(a.torque, b.torque) < 1e-5, "{a:?} {b:?}");
        }
        // One vertex of the index finger: its whole force, with the lever of a phalanx; nothing on the other parts.
        assert!((length(rest[1].force) - 2.0).abs() < 1e-5);
        assert!(length(rest[1].torque) < 2.0 * 0.04);
        assert!([0, 2, 3, 4, 5].iter().all(|part| length(rest[*part].force) == 0.0));
    }

    #[test]
    fn a_force_on_the_palm_pushes_it_towards_the_back() {
        let model = HandModel::builtin(Side::Right);
        let regions = model.regions();
        let parts: Vec<usize> = regions.iter().map(|region| part_of(*region)).collect();
        let force: Vec<f32> = regions.iter().map(|region| f32::from(u8::from(*region == Region::Palm))).collect();
        let posed = model.forward(&HandParams::default());
        let palm = wrenches(&force, &PlacedHand { side: Side::Right, posed }, &model, &parts)[PALM];
        // The palm faces -y at rest.
        assert!(palm.force.y > 0.5 * length(palm.force) && palm.force.y > 10.0, "{palm:?}");
    }
}
