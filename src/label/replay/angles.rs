//! Wrist displacements and hinge angles of a recorded hand pose.

use glam::{DQuat, DVec3, EulerRot};
use nalgebra::{Matrix3, Vector3};

use crate::hand::{HandParams, N_JOINTS};
use crate::sim::rig::{HandRig, rotation_vector};

/// Steps of the search for hinge angles; angles of neighbouring frames are near, so that few are needed.
const STEPS: usize = 12;
/// Damping of the search: two hinges of a thumb can be parallel.
const DAMPING: f64 = 1e-9;

/// Inverse of [`HandRig::params`]: recorded poses to positions of servos, frame by frame.
pub(super) struct HandAngles<'a> {
    rig: &'a HandRig,
    /// Position, m, and orientation of the wrist with its servos at zero.
    zero: (DVec3, DQuat),
    /// Hinges of each joint, the outermost first.
    hinges: Vec<Vec<usize>>,
    /// Angles of the last frame, from which the search starts, rad.
    last: Vec<f64>,
    /// Sum of the rotations that the angles miss of the recorded joints, rad, and their number.
    pub missed: (f64, u32),
}

impl<'a> HandAngles<'a> {
    pub fn new(rig: &'a HandRig, wrist: DVec3, orientation: DQuat) -> Self {
        let of_joint = |joint: usize| (0..rig.hinges.len()).filter(|i| rig.hinges[*i].joint == joint).collect();
        let hinges = (0..N_JOINTS).map(of_joint).collect();
        Self { rig, zero: (wrist, orientation), hinges, last: vec![0.0; rig.hinges.len()], missed: (0.0, 0) }
    }

    /// Returns the positions of wrist (three slides, three hinges) and hinges, m and rad, nearest to a pose.
    pub fn of(&mut self, pose: &HandParams) -> Vec<f64> {
        let (origin, orientation) = self.zero;
        let moved = pose.transl.as_dvec3() + self.rig.joints[0] - origin;
        let turn = DQuat::from_scaled_axis(pose.global_orient.as_dvec3());
        // The wrist's hinges turn about the hand's axes, the first outermost.
        let (x, y, z) = (orientation.inverse() * turn).to_euler(EulerRot::XYZ);
        for joint in 1..N_JOINTS {
            let wanted = DQuat::from_scaled_axis(pose.hand_pose[joint - 1].as_dvec3());
            self.missed.0 += self.search(joint, wanted);
            self.missed.1 += 1;
        }
        [moved.x, moved.y, moved.z, x, y, z].into_iter().chain(self.last.iter().copied()).collect()
    }

    /// Searches the angles of a joint's hinges whose product is nearest to the rotation `wanted`, by Gauss-Newton steps. Returns the
    /// angle between both, rad.
    fn search(&mut self, joint: usize, wanted: DQuat) -> f64 {
        let mut missed = 0.0;
        for _ in 0..STEPS {
            let (mut turn, mut axes) = (DQuat::IDENTITY, Vec::new());
            for index in &self.hinges[joint] {
                let axis = self.rig.hinges[*index].axis;
                axes.push(turn * axis);
                turn *= DQuat::from_axis_angle(axis, self.last[*index]);
            }
            let off = rotation_vector(wanted * turn.inverse());
            missed = off.length();
            // At most three hinges: missing ones are columns of zeros, and stay where they are.
            let column = |k: usize| Vector3::from(axes.get(k).copied().unwrap_or(DVec3::ZERO).to_array());
            let jacobian = Matrix3::from_columns(&[column(0), column(1), column(2)]);
            let normal = jacobian.transpose() * jacobian + Matrix3::identity() * DAMPING;
            let Some(inverse) = normal.try_inverse() else { return missed };
            let step = inverse * jacobian.transpose() * Vector3::from(off.to_array());
            for (k, index) in self.hinges[joint].iter().enumerate().take(3) {
                self.last[*index] += step[k];
            }
            if step.norm() < 1e-12 {
                break;
            }
        }
        missed
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::hand::{HandModel, N_BETAS, Side};

    #[test]
    fn angles_of_a_posed_hand_are_those_it_was_posed_with() {
        for side in Side::BOTH {
            let rig = HandRig::new(HandModel::builtin(side), [0.0; N_BETAS]).unwrap();
            let zero = (DVec3::new(0.1, -0.2, 0.3), DQuat::from_euler(EulerRot::XYZ, 0.4, -0.8, 1.1));
            let mut angles = HandAngles::new(&rig, zero.0, zero.1);
            for scale in [0.0, 0.3, 0.9] {
                let hinges: Vec<f64> = rig
                    .hinges
                    .iter()
                    .enumerate()
                    .map(|(i, hinge)| {
                        let share = 0.5 + 0.5 * scale * (i as f64).sin();
                        hinge.range[0] + share * (hinge.range[1] - hinge.range[0])
                    })
                    .collect();
                let own = DQuat::from_euler(EulerRot::XYZ, 0.2 * scale, -0.3 * scale, 0.1);
                let params = rig.params(zero.0 + DVec3::splat(scale), zero.1 * own, &hinges);
                let found = angles.of(&params);
                let wanted = [scale, scale, scale, 0.2 * scale, -0.3 * scale, 0.1];
                for (found, wanted) in found.iter().zip(wanted.iter().chain(&hinges)) {
                    assert!((found - wanted).abs() < 1e-5, "{found} for {wanted}");
                }
            }
        }
    }
}
