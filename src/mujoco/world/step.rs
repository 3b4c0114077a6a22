//! Advancing a world and recomputing what follows from its state.

use mujoco_rs::prelude::*;

use super::World;
use crate::error::{Error, Result};

impl World {
    /// Advances by one timestep.
    pub fn step(&mut self) {
        self.data.step();
    }

    /// Gives access to the engine's own data, which holds the model too.
    ///
    /// For the benchmarks, which measure [`Self::step`] against the engine's C function.
    #[doc(hidden)]
    pub fn engine_data_mut(&mut self) -> &mut MjData<Box<MjModel>> {
        &mut self.data
    }

    /// Computes everything that follows from the state: poses, contacts, forces, accelerations.
    pub fn forward(&mut self) {
        self.data.forward();
    }

    /// Computes poses and centres of mass, as [`Self::jacobian`] needs them.
    pub fn kinematics(&mut self) {
        self.data.kinematics();
        self.data.com_pos();
    }

    /// Computes the poses of bodies, geoms, joints and sites alone.
    pub fn update_poses(&mut self) {
        self.data.kinematics();
    }

    /// Computes the lengths of tendons and actuators; requires [`Self::update_poses`] first.
    pub fn update_lengths(&mut self) {
        self.data.com_pos();
        self.data.tendon_comp();
        self.data.transmission();
    }

    /// Computes poses and contact pairs without dynamics, and sets the clock to `time`, s.
    pub fn detect(&mut self, time: f64) {
        self.place(time);
        self.data.collision();
    }

    /// Computes poses, cameras and lights without collision detection, and sets the clock to `time`, s.
    pub fn place(&mut self, time: f64) {
        self.kinematics();
        self.data.camlight();
        self.data.set_time(time);
    }

    /// Returns to the initial state at time 0.
    pub fn reset(&mut self) {
        self.data.reset();
    }

    /// Returns the full integration state, for [`Self::set_state`].
    pub fn state(&self) -> Vec<f64> {
        self.data.state(MjtState::mjSTATE_INTEGRATION as u32).into_vec()
    }

    /// Restores a state of [`Self::state`].
    ///
    /// # Errors
    /// If the state is of another model.
    pub fn set_state(&mut self, state: &[f64]) -> Result<()> {
        self.data.set_state(state, MjtState::mjSTATE_INTEGRATION as u32).map_err(|e| Error::Engine(e.to_string()))
    }

    /// Returns the simulated time, s.
    pub fn time(&self) -> f64 {
        self.data.time()
    }

    /// Returns true if every position, velocity and acceleration is finite.
    pub fn is_finite(&self) -> bool {
        [self.data.qpos(), self.data.qvel(), self.data.qacc()].iter().all(|array| array.iter().all(|x| x.is_finite()))
    }

    /// Returns the number of engine warnings since the start (bad state, full memory, ...).
    pub fn warnings(&self) -> usize {
        self.data.warning().iter().map(|warning| warning.number.max(0) as usize).sum()
    }

    /// Returns true if the solver used all its iterations in the last step.
    pub fn hit_iteration_cap(&self) -> bool {
        let islands = (self.data.nisland().max(1) as usize).min(self.data.solver_niter().len());
        self.data.solver_niter()[..islands].iter().any(|n| *n >= self.options.iterations as i32)
    }

    /// Returns the largest share of the arena (memory for contacts and scratch) used so far, 0 to 1.
    pub fn arena_use(&self) -> f64 {
        self.data.maxuse_arena() as f64 / (self.data.narena() as f64).max(1.0)
    }
}
