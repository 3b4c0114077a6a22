//! The state of a model's frames without dynamics: what inverse kinematics needs, with nothing allocated.

use glam::{DMat3, DVec3};

use super::world::World;

impl World {
    /// Finds poses of bodies, geoms, joints and sites from the positions; nothing else.
    pub fn update_poses(&mut self) {
        self.data_mut().kinematics();
    }

    /// Finds the lengths of tendons and actuators; after [`Self::update_poses`].
    pub fn update_lengths(&mut self) {
        self.data_mut().com_pos();
        self.data_mut().tendon_comp();
        self.data_mut().transmission();
    }

    /// Origin and orientation (body to world) of a body, by the engine's index.
    pub fn body_pose(&self, body: usize) -> (DVec3, DMat3) {
        let m = &self.data().xmat()[body];
        (DVec3::from_array(self.data().xpos()[body]), DMat3::from_cols_array(m).transpose())
    }

    /// Centre of a geom, by the engine's index.
    pub fn geom_place(&self, geom: usize) -> DVec3 {
        DVec3::from_array(self.data().geom_xpos()[geom])
    }

    /// Centre and orientation (geom to world) of a geom, by the engine's index.
    pub fn geom_pose(&self, geom: usize) -> (DVec3, DMat3) {
        let m = &self.data().geom_xmat()[geom];
        (DVec3::from_array(self.data().geom_xpos()[geom]), DMat3::from_cols_array(m).transpose())
    }

    /// A joint's anchor and axis in the world, by the engine's index.
    pub fn joint_axis(&self, joint: usize) -> (DVec3, DVec3) {
        (DVec3::from_array(self.data().xanchor()[joint]), DVec3::from_array(self.data().xaxis()[joint]))
    }

    /// Length of each actuator's transmission; after [`Self::update_lengths`].
    pub fn actuator_lengths(&self) -> &[f64] {
        self.data().actuator_length()
    }

    /// Length of each tendon; after [`Self::update_lengths`].
    pub fn tendon_lengths(&self) -> &[f64] {
        self.data().ten_length()
    }

    /// Signed distance of two geoms (negative: penetration), m, and the nearest points on both; where they are further
    /// apart than `most`, `most` and no points.
    pub fn geom_distance(&mut self, geoms: [usize; 2], most: f64) -> (f64, Option<[DVec3; 2]>) {
        let mut line = [0.0; 6];
        let distance = self.data_mut().try_geom_distance(geoms[0], geoms[1], most, Some(&mut line)).unwrap_or(most);
        let points = (distance < most).then(|| [DVec3::from_slice(&line[..3]), DVec3::from_slice(&line[3..])]);
        (distance, points)
    }
}
