//! Hands in the frame of their wrist, as pictures show them.

use glam::{Mat3, Vec3};

use crate::hand::{HandModel, HandParams, PosedHand, Side};

/// Distance of a wrist from the middle between both hands, m.
const APART: f32 = 0.12;
/// Distance of the wrists below the middle of the hands, m.
const BELOW: f32 = 0.09;

/// Returns the vertices in a frame that follows the wrist, m: x to the right, y along the fingers, z out of the palm, as one looks at
/// the palm. The origin lies at the wrist.
pub(super) fn wrist_frame(model: &HandModel, posed: &PosedHand) -> Vec<Vec3> {
    // In the rest pose the right hand's fingers point along -x and its palm faces -y; the left hand is its mirror image in x.
    let fingers = if model.side == Side::Right { Vec3::NEG_X } else { Vec3::X };
    let palm = Vec3::NEG_Y;
    let view_from_rest = Mat3::from_cols(fingers.cross(palm), fingers, palm).transpose();
    let view_from_world = view_from_rest * posed.rotations[0].transpose();
    let wrist = posed.joints[0];
    posed.vertices.iter().map(|vertex| view_from_world * (*vertex - wrist)).collect()
}

/// Returns the vertices of a hand beside the other one, m, with the axes of a camera (x right, y down, z to the front): palms to
/// the viewer, fingers up, the right hand on the right.
pub(super) fn side_by_side(model: &HandModel, params: &HandParams) -> Vec<Vec3> {
    let x = if model.side == Side::Right { APART } else { -APART };
    let place = |vertex: Vec3| Vec3::new(vertex.x + x, BELOW - vertex.y, -vertex.z);
    wrist_frame(model, &model.forward(params)).into_iter().map(place).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_frame_follows_the_wrist_and_shows_the_palm() {
        for side in Side::BOTH {
            let model = HandModel::builtin(side);
            let rest = wrist_frame(&model, &model.forward(&HandParams::default()));
            let turned = HandParams {
                global_orient: Vec3::new(0.3, -1.1, 0.8),
                transl: Vec3::new(0.2, 0.4, -0.1),
                ..HandParams::default()
            };
            let turned = wrist_frame(&model, &model.forward(&turned));
            assert!(rest.iter().zip(&turned).all(|(a, b)| a.distance(*b) < 1e-5));
            // The middle finger points up; the thumb of a right hand that shows its palm is on the right.
            let tip = |finger: usize| rest[model.tip_vertices[finger] as usize];
            assert!(tip(2).y > 0.1 && tip(2).x.abs() < 0.05);
            assert_eq!(tip(0).x > tip(4).x, side == Side::Right, "{side:?}: {} {}", tip(0), tip(4));
        }
    }

    #[cfg(feature = "ros")]
    #[test]
    fn hands_at_rest_lie_where_the_node_draws_them() {
        let models = Side::BOTH.map(HandModel::builtin);
        for (model, node) in models.iter().zip(crate::node::placed_hand::rest_hands(&models)) {
            let ours = side_by_side(model, &HandParams::default());
            assert!(ours.iter().zip(&node.posed.vertices).all(|(a, b)| a.distance(*b) < 1e-6));
        }
    }
}
