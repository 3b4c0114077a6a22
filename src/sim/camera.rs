//! Pose and motion of the head-mounted camera.

use std::f64::consts::TAU;

use glam::{DMat3, DQuat, DVec3};

use super::randomize::CameraDraw;

/// Pose `world_from_camera`.
///
/// The camera frame is the optical frame: x to the right, y down, z forward.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CameraPose {
    /// Position in the world, m.
    pub position: DVec3,
    /// Rotation from the optical frame to the world.
    pub orientation: DQuat,
}

impl CameraPose {
    /// Converts the pose of an engine camera, which looks along -z with y up.
    pub(crate) fn from_engine((position, axes): (DVec3, DMat3)) -> Self {
        let optical = DMat3::from_cols(axes.x_axis, -axes.y_axis, -axes.z_axis);
        Self { position, orientation: DQuat::from_mat3(&optical).normalize() }
    }

    /// Transforms a world point to the optical frame, m.
    pub fn camera_from_world(&self, point: DVec3) -> DVec3 {
        self.orientation.inverse() * (point - self.position)
    }
}

impl CameraDraw {
    /// Returns the pose of the head's body at `time`, s, in the engine's camera convention: a slow sway about the mean.
    pub(crate) fn head(&self, time: f64) -> (DVec3, DQuat) {
        // Frequencies of a sitting person's head, without a common period.
        const HERTZ: [f64; 6] = [0.31, 0.43, 0.23, 0.37, 0.53, 0.29];
        let wave = |i: usize| (TAU * HERTZ[i] * time + self.phases[i]).sin();
        let eye = self.eye + self.sway * DVec3::new(wave(0), wave(1), 0.5 * wave(2));
        let target = self.target + self.sway * DVec3::new(wave(3), wave(4), wave(5));
        let back = (eye - target).normalize_or(DVec3::Z);
        let right = DVec3::Z.cross(back).normalize_or(DVec3::X);
        let level = DMat3::from_cols(right, back.cross(right), back);
        (eye, (DQuat::from_mat3(&level) * DQuat::from_rotation_z(self.roll)).normalize())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::{Distortion, Intrinsics};

    #[test]
    fn target_projects_to_the_centre_and_points_above_it_project_higher() {
        let camera = CameraDraw {
            eye: DVec3::new(0.1, -0.4, 0.4),
            target: DVec3::new(0.0, 0.0, 0.05),
            fovy: 1.0,
            distortion: Distortion::default(),
            roll: 0.0,
            sway: 0.0,
            phases: [0.0; 6],
            noise: 0.0,
            shutter: 0.0,
        };
        let (eye, orientation) = camera.head(0.7);
        let pose = CameraPose::from_engine((eye, DMat3::from_quat(orientation)));
        let intrinsics = Intrinsics::new(224, 224, camera.fovy);
        let [x, y] = intrinsics.project(pose.camera_from_world(camera.target)).unwrap();
        assert!((x - 112.0).abs() < 1e-6 && (y - 112.0).abs() < 1e-6, "{x} {y}");
        let above = camera.target + DVec3::Z * 0.05;
        assert!(intrinsics.project(pose.camera_from_world(above)).unwrap()[1] < 112.0);
        assert!(intrinsics.project(pose.camera_from_world(eye + DVec3::Y * -0.1)).is_none());
    }
}
