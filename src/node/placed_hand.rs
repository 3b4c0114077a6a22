//! Hands in a common frame, for display.

use glam::{Mat3, Vec3};

use crate::hand::{HandModel, HandParams, PosedHand, Side};

/// A posed hand in the frame of a message.
#[derive(Debug, Clone)]
pub(crate) struct PlacedHand {
    /// Side of the hand.
    pub(crate) side: Side,
    /// Vertices, joints and rotations in the frame, m.
    pub(crate) posed: PosedHand,
}

/// Returns both hands in the rest pose, in a frame of their own with the axes of a camera (z to the front, x right, y down): palms
/// to the viewer, fingers up, the right hand on the right. Shows the field while the poses of the hands are unknown.
pub(crate) fn rest_hands(models: &[HandModel; 2]) -> Vec<PlacedHand> {
    let place = |model: &HandModel| {
        let posed = model.forward(&HandParams::default());
        let wrist = posed.joints[0];
        // In the rest pose the right hand's fingers point along -x and its palm faces -y; the left hand is its mirror image in x.
        let sign = if model.side == Side::Right { 1.0 } else { -1.0 };
        let rotation = Mat3::from_cols(sign * Vec3::Y, Vec3::Z, sign * Vec3::X);
        let place = |point: Vec3| rotation * (point - wrist) + Vec3::new(sign * 0.12, 0.09, 0.0);
        let posed = PosedHand {
            vertices: posed.vertices.into_iter().map(place).collect(),
            joints: posed.joints.map(place),
            rotations: posed.rotations.map(|joint| rotation * joint),
        };
        PlacedHand { side: model.side, posed }
    };
    models.iter().map(place).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn hands_at_rest_do_not_overlap_and_point_up() {
        let hands = rest_hands(&Side::BOTH.map(HandModel::builtin));
        let xs = |hand: &PlacedHand| {
            let xs = hand.posed.vertices.iter().map(|v| v.x);
            (xs.clone().fold(f32::MAX, f32::min), xs.fold(f32::MIN, f32::max))
        };
        assert!(xs(&hands[0]).1 < 0.0 && xs(&hands[1]).0 > 0.0);
        for hand in &hands {
            // The fingers, the longest part, lie above the wrist; y points down.
            let ys = || hand.posed.vertices.iter().map(|v| v.y);
            let (highest, lowest) = (ys().fold(f32::MAX, f32::min), ys().fold(f32::MIN, f32::max));
            assert!(0.09 - highest > 0.12 && lowest - 0.09 < 0.06, "{highest} {lowest}");
            assert!((hand.posed.rotations[0].determinant() - 1.0).abs() < 1e-6, "a mirrored hand");
        }
    }
}
