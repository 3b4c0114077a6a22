//! Hinges of fingers: the rotations that a person's joints allow, as residuals for a fit.

use glam::{DQuat, DVec3};

use super::{HandModel, HandParams, N_JOINTS, Side};

/// Bases of the fingers' joints, index to little, and of the thumb's, in MANO's order.
const FINGERS: [usize; 4] = [1, 4, 10, 7];
const THUMB: usize = 13;
/// Number of residuals: one per knuckle, two per further joint of a finger.
pub(super) const N_RESIDUALS: usize = 4 * (1 + 2 + 2) + 2 * 2;

/// Axes of a hand's finger joints at rest.
#[derive(Debug, Clone)]
pub(super) struct FingerHinges {
    /// Knuckles: joint, axis of abduction, axis of flexion.
    knuckles: Vec<(usize, DVec3, DVec3)>,
    /// Further joints, and their axes of flexion.
    hinges: Vec<(usize, DVec3)>,
}

impl FingerHinges {
    /// Derives the axes from the joints of the mean shape. Flexion moves a bone towards the palm, and that of the thumb towards
    /// the fingers as well; abduction moves it towards the thumb.
    pub(super) fn of(model: &HandModel) -> Self {
        let rest = model.forward(&HandParams::default());
        let joints = rest.joints.map(|joint| joint.as_dvec3());
        let tips = model.tip_vertices.map(|vertex| rest.vertices[vertex as usize].as_dvec3());
        let knuckles = FINGERS.iter().map(|joint| joints[*joint]).sum::<DVec3>() / 4.0;
        let along = (knuckles - joints[0]).normalize_or_zero();
        let thumb = (joints[1] - joints[7]).reject_from(along).normalize_or_zero();
        let palm = if model.side == Side::Right { thumb.cross(along) } else { along.cross(thumb) };
        let bones = |base: usize, tip: DVec3| {
            [joints[base + 1] - joints[base], joints[base + 2] - joints[base + 1], tip - joints[base + 2]]
        };
        let flexion = |bone: DVec3, pad: DVec3| bone.cross(pad).normalize_or_zero();
        let mut found = Self { knuckles: Vec::new(), hinges: Vec::new() };
        for (base, tip) in FINGERS.into_iter().zip(&tips[1..]) {
            let bones = bones(base, *tip);
            found.knuckles.push((base, bones[0].cross(thumb).normalize_or_zero(), flexion(bones[0], palm)));
            found.hinges.extend([1, 2].map(|link| (base + link, flexion(bones[link], palm))));
        }
        // The pad of the thumb faces the fingers more than the palm does.
        let pad = 0.55 * palm - 0.85 * thumb;
        let bones = bones(THUMB, tips[0]);
        found.hinges.extend([1, 2].map(|link| (THUMB + link, flexion(bones[link], pad))));
        found
    }

    /// Returns how far rotations, axis-angle by joint from 1 on, rad, leave what the joints allow: two turns of a knuckle,
    /// abduction before flexion, and one of each further joint. Zero = allowed.
    pub(super) fn residuals(&self, pose: &[DVec3; N_JOINTS - 1]) -> Vec<f64> {
        let mut residuals = Vec::with_capacity(N_RESIDUALS);
        for (joint, abduction, flexion) in &self.knuckles {
            // Abduction turns the axis of flexion about that of abduction, which keeps its component along the latter.
            let turned = DQuat::from_scaled_axis(pose[joint - 1]) * *flexion;
            residuals.push(turned.dot(*abduction) - flexion.dot(*abduction));
        }
        for (joint, flexion) in &self.hinges {
            let first = flexion.any_orthonormal_vector();
            residuals.extend([first, flexion.cross(first)].map(|across| pose[joint - 1].dot(across)));
        }
        residuals
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn abduction_then_flexion_is_allowed_and_twist_is_not() {
        for side in Side::BOTH {
            let hinges = FingerHinges::of(&HandModel::builtin(side));
            let mut pose = [DVec3::ZERO; N_JOINTS - 1];
            for (joint, abduction, flexion) in &hinges.knuckles {
                let turn = DQuat::from_axis_angle(*abduction, 0.25) * DQuat::from_axis_angle(*flexion, 1.2);
                pose[joint - 1] = turn.to_scaled_axis();
            }
            for (joint, flexion) in &hinges.hinges {
                pose[joint - 1] = 0.9 * *flexion;
            }
            let allowed = hinges.residuals(&pose);
            assert!(
                allowed.len() == N_RESIDUALS && allowed.iter().all(|residual| residual.abs() < 1e-9),
                "{allowed:?}"
            );
            let (joint, abduction, flexion) = hinges.knuckles[0];
            pose[joint - 1] = 0.3 * abduction.cross(flexion);
            assert!(hinges.residuals(&pose)[0].abs() > 0.2);
        }
    }
}
