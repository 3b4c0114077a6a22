//! Poses, velocities and Jacobians of a world's elements.

use glam::{DMat3, DQuat, DVec3};
use mujoco_rs::prelude::*;

use super::{Body, FreeJoint, Servo, World};

/// Bodies by name; see [`World::body`].
impl World {
    /// Returns the origin of a body, m.
    pub fn position(&self, Body(body): Body) -> DVec3 {
        DVec3::from_array(self.data.xpos()[body])
    }

    /// Returns the orientation of a body.
    pub fn orientation(&self, Body(body): Body) -> DQuat {
        let [w, x, y, z] = self.data.xquat()[body];
        DQuat::from_xyzw(x, y, z, w).normalize()
    }

    /// Returns the name of a body; empty if it has none.
    pub fn body_name(&self, Body(body): Body) -> &str {
        self.data.model().id_to_name(MjtObjBase::mjOBJ_BODY, body).unwrap_or_default()
    }

    /// Returns the mass of a body without its children, kg.
    pub fn mass(&self, Body(body): Body) -> f64 {
        self.data.model().body_mass()[body]
    }

    /// Returns the index of a body's kinematic tree; `None` if the body cannot move.
    pub fn tree(&self, Body(body): Body) -> Option<usize> {
        usize::try_from(self.data.model().body_treeid()[body]).ok()
    }

    /// Returns all bodies that can move.
    pub(in crate::mujoco) fn moving_bodies(&self) -> Vec<Body> {
        let trees = self.data.model().body_treeid();
        (0..trees.len()).filter(|body| trees[*body] >= 0).map(Body).collect()
    }

    /// Returns true if a body takes part in the simulation; a sleeping body's contacts are missing from the list.
    pub fn is_awake(&self, body: Body) -> bool {
        self.tree(body).is_none_or(|tree| self.data.tree_asleep()[tree] < 0)
    }

    /// Returns the velocity of a body's material point, m/s, world frame.
    pub fn point_velocity(&self, Body(body): Body, point: DVec3) -> DVec3 {
        let root = self.data.model().body_rootid()[body] as usize;
        // The engine's body velocity refers to the centre of mass of the whole tree.
        let [wx, wy, wz, vx, vy, vz] = self.data.cvel()[body];
        let arm = point - DVec3::from_array(self.data.subtree_com()[root]);
        DVec3::new(vx, vy, vz) + DVec3::new(wx, wy, wz).cross(arm)
    }

    /// Returns the speed of a body's centre of mass, m/s, in the state before the last step or at the last
    /// [`Self::forward`].
    pub fn speed(&self, Body(body): Body) -> f64 {
        self.point_velocity(Body(body), DVec3::from_array(self.data.xipos()[body])).length()
    }

    /// Returns the velocity of a world point fixed to `body` per unit velocity of each servo: one column per servo.
    ///
    /// Valid after [`Self::kinematics`] or [`Self::forward`].
    pub fn jacobian(&self, Body(body): Body, point: DVec3, servos: &[Servo]) -> Vec<DVec3> {
        let (jacp, _) = self.data.jac(true, false, &point.to_array(), body);
        columns(&jacp, servos)
    }

    /// Returns the angular velocity of `body` per unit velocity of each servo; valid as [`Self::jacobian`].
    pub fn angular_jacobian(&self, Body(body): Body, servos: &[Servo]) -> Vec<DVec3> {
        let (_, jacr) = self.data.jac(false, true, &[0.0; 3], body);
        columns(&jacr, servos)
    }

    /// Returns the body of a free joint.
    pub fn body_of(&self, joint: FreeJoint) -> Body {
        joint.body
    }

    /// Returns the linear velocity of a free body's origin, m/s.
    pub fn velocity(&self, joint: FreeJoint) -> DVec3 {
        DVec3::from_slice(&self.data.qvel()[joint.dof..joint.dof + 3])
    }

    /// Returns the acceleration of a free body's centre of mass, m/s²; valid after [`Self::forward`].
    pub fn acceleration(&self, joint: FreeJoint) -> DVec3 {
        let rotation = self.orientation(joint.body);
        let arm = DVec3::from_array(self.data.xipos()[joint.body.0]) - self.position(joint.body);
        let omega = rotation * DVec3::from_slice(&self.data.qvel()[joint.dof + 3..joint.dof + 6]);
        let alpha = rotation * DVec3::from_slice(&self.data.qacc()[joint.dof + 3..joint.dof + 6]);
        let origin = DVec3::from_slice(&self.data.qacc()[joint.dof..joint.dof + 3]);
        origin + alpha.cross(arm) + omega.cross(omega.cross(arm))
    }

    /// Returns position and orientation of a camera; it looks along -z, +y is up.
    pub fn camera_pose(&self, camera: usize) -> (DVec3, DMat3) {
        pose(&self.data.cam_xpos()[camera], &self.data.cam_xmat()[camera])
    }
}

/// Elements by the engine's index, as [`World::parts`] lists them.
impl World {
    /// Returns origin and orientation (body to world) of a body.
    pub fn body_pose(&self, body: usize) -> (DVec3, DMat3) {
        pose(&self.data.xpos()[body], &self.data.xmat()[body])
    }

    /// Returns the centre of a geom, m.
    pub fn geom_place(&self, geom: usize) -> DVec3 {
        DVec3::from_array(self.data.geom_xpos()[geom])
    }

    /// Returns centre and orientation (geom to world) of a geom.
    pub fn geom_pose(&self, geom: usize) -> (DVec3, DMat3) {
        pose(&self.data.geom_xpos()[geom], &self.data.geom_xmat()[geom])
    }

    /// Returns anchor and axis of a joint in the world frame.
    pub fn joint_axis(&self, joint: usize) -> (DVec3, DVec3) {
        (DVec3::from_array(self.data.xanchor()[joint]), DVec3::from_array(self.data.xaxis()[joint]))
    }

    /// Returns the length of each actuator's transmission; requires [`Self::update_lengths`] first.
    pub fn actuator_lengths(&self) -> &[f64] {
        self.data.actuator_length()
    }

    /// Returns the length of each tendon; requires [`Self::update_lengths`] first.
    pub fn tendon_lengths(&self) -> &[f64] {
        self.data.ten_length()
    }

    /// Returns the signed distance of two geoms (negative: penetration), m, and the nearest points on both. Beyond
    /// `most` it returns `most` without points.
    pub fn geom_distance(&mut self, geoms: [usize; 2], most: f64) -> (f64, Option<[DVec3; 2]>) {
        let mut line = [0.0; 6];
        let distance = self.data.try_geom_distance(geoms[0], geoms[1], most, Some(&mut line)).unwrap_or(most);
        let points = (distance < most).then(|| [DVec3::from_slice(&line[..3]), DVec3::from_slice(&line[3..])]);
        (distance, points)
    }
}

/// Position and rotation from the engine's row-major matrix.
fn pose(position: &[f64; 3], matrix: &[f64; 9]) -> (DVec3, DMat3) {
    (DVec3::from_array(*position), DMat3::from_cols_array(matrix).transpose())
}

/// Columns of a (3, nv) row-major Jacobian that belong to `servos`.
fn columns(jacobian: &[f64], servos: &[Servo]) -> Vec<DVec3> {
    let nv = jacobian.len() / 3;
    servos.iter().map(|s| DVec3::new(jacobian[s.dof], jacobian[nv + s.dof], jacobian[2 * nv + s.dof])).collect()
}
