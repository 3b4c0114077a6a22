//! Environment: a scene whose acting hand follows commands, frame by frame, in place of the scene's script.

use super::frame::SimFrame;
use super::rollout::{Rollout, RolloutOptions};
use super::scene::Scene;
use super::timeline::ChannelValues;
use crate::error::{Error, Result};
use crate::mujoco::World;

/// A scene under closed-loop control: [`Self::reset`] draws an episode, [`Self::step`] takes a command and returns the next
/// observation.
///
/// A command sets the channels of the scene's acts (see [`ChannelValues`]); the hand's servos move towards them linearly
/// until the next frame. Forces are open loop: a `squeeze` of 1 sets the servos to the goals' forces at the planned
/// contact, and the force that acts depends on where the object really is. The control of the measured force, which
/// scripts have, is off. The episode has the length of the script. Opening and closing reach as far as the script's.
///
/// The same scene, seed, options and commands give the same frames, bit for bit.
///
/// ```
/// use egotac::sim::{ChannelValues, Environment, RolloutOptions, Scene};
///
/// # fn main() -> egotac::Result<()> {
/// let options = RolloutOptions { picture: None, ..RolloutOptions::default() };
/// let mut environment = Environment::new(Scene::load("pinch_cube")?, options);
/// let first = environment.reset(7)?;
/// assert_eq!(first.frame.timestamp, 0.0);
/// let mut command = ChannelValues { opening: 0.02, ..ChannelValues::default() };
/// for _ in 0..3 {
///     command.opening -= 0.005; // m in each frame of 0.04 s
///     let Some(frame) = environment.step(command)? else { break }; // `None` = end of the episode
///     println!("{:.2} s: {:?}", frame.frame.timestamp, frame.objects[0].position);
/// }
/// # Ok(())
/// # }
/// ```
#[derive(Debug)]
pub struct Environment {
    scene: Scene,
    options: RolloutOptions,
    /// Running episode; `None` before the first reset.
    rollout: Option<Rollout>,
}

impl Environment {
    /// Creates an environment without an episode.
    pub fn new(scene: Scene, options: RolloutOptions) -> Self {
        Self { scene, options, rollout: None }
    }

    /// Draws the episode of `seed` and returns its first frame, at 0 s.
    ///
    /// # Errors
    /// As [`Rollout::new`], and if the scene's first hand has no act.
    pub fn reset(&mut self, seed: u64) -> Result<SimFrame> {
        self.rollout = None;
        let mut rollout = Rollout::new(&self.scene, seed, &self.options)?;
        if rollout.episode().hands.first().is_none_or(|hand| hand.act.is_none()) {
            let expected = format!("a hand with an act in scene {}, which commands replace", self.scene.name);
            return Err(Error::value("hands[0].act", expected, "none"));
        }
        let first = rollout.next_frame()?;
        self.rollout = Some(rollout);
        first.ok_or_else(|| Error::value("episode", "at least one frame", 0))
    }

    /// Moves the acting hand towards `command` until the next frame, and returns that frame; `None` at the end of the
    /// episode, or after a frame whose state was lost.
    ///
    /// # Errors
    /// If there was no [`Self::reset`], a channel is not finite, or rendering fails.
    pub fn step(&mut self, command: ChannelValues) -> Result<Option<SimFrame>> {
        self.step_watched(command, |_| ())
    }

    /// Steps as [`Self::step`]; `watch` gets the world after each physics step, with the forces that acted during it.
    ///
    /// # Errors
    /// As [`Self::step`].
    pub fn step_watched(&mut self, command: ChannelValues, watch: impl FnMut(&World)) -> Result<Option<SimFrame>> {
        if !command.is_finite() {
            return Err(Error::value("command", "finite channels", format!("{command:?}")));
        }
        let rollout = self.rollout.as_mut().ok_or_else(not_reset)?;
        if let Some(hand) = rollout.episode().hands.first() {
            let side = hand.side;
            rollout.command(side, command);
        }
        rollout.next_frame_watched(watch)
    }

    /// Returns the running episode: drawn values, objects, physics.
    ///
    /// # Errors
    /// If there was no [`Self::reset`].
    pub fn rollout(&self) -> Result<&Rollout> {
        self.rollout.as_ref().ok_or_else(not_reset)
    }
}

fn not_reset() -> Error {
    Error::value("environment", "a call of `reset` first", "none")
}
