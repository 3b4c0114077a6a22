//! Both hands of a rollout: rigs, drivers, poses.

use crate::error::Result;
use crate::hand::{HandParams, PosedHand, Side};
use crate::mujoco::World;
use crate::sim::driver::{HandDriver, TargetObject};
use crate::sim::randomize::EpisodeDraw;
use crate::sim::rig::HandRig;
use crate::sim::timeline::ChannelValues;

/// Rigs of both hands, and drivers of the hands that are present.
#[derive(Debug)]
pub(super) struct SimHands {
    /// Left and right rig.
    pub rigs: [HandRig; 2],
    drivers: [Option<HandDriver>; 2],
}

impl SimHands {
    /// Plans the motion of the episode's hands; leaves them in their start pose.
    ///
    /// # Errors
    /// If the world was not made from this episode.
    pub fn new(world: &mut World, rigs: [HandRig; 2], episode: &EpisodeDraw, targets: &[TargetObject]) -> Result<Self> {
        let mut drivers = [None, None];
        for hand in &episode.hands {
            let rig = &rigs[hand.side as usize];
            drivers[hand.side as usize] = Some(HandDriver::new(world, hand, rig, targets)?);
        }
        Ok(Self { rigs, drivers })
    }

    /// Returns the driver of a hand; `None` = absent.
    pub fn driver(&self, side: Side) -> Option<&HandDriver> {
        self.drivers[side as usize].as_ref()
    }

    /// Commands a hand in place of its script; see [`HandDriver::command`]. Returns false if it is absent or has no act.
    pub fn command(&mut self, side: Side, now: f64, seconds: f64, to: ChannelValues) -> bool {
        self.drivers[side as usize].as_mut().is_some_and(|driver| driver.command(now, seconds, to))
    }

    /// Updates the servo targets for the next `interval` seconds.
    pub fn drive(&mut self, world: &mut World, interval: f64) {
        for driver in self.drivers.iter_mut().flatten() {
            driver.drive(world, interval);
        }
    }

    /// Moves the hands to their planned pose at `time`, s, without dynamics.
    pub fn place(&self, world: &mut World, time: f64) {
        for driver in self.drivers.iter().flatten() {
            driver.place(world, time);
        }
    }

    /// Returns the current parameters of a hand; `None` = absent.
    pub fn params(&self, world: &World, side: Side) -> Option<HandParams> {
        let driver = self.driver(side)?;
        let (wrist, angles) = (driver.wrist(), driver.angles(world));
        Some(self.rigs[side as usize].params(world.position(wrist), world.orientation(wrist), &angles))
    }

    /// Returns the current parameters and vertices of a hand; `None` = absent.
    pub fn posed(&self, world: &World, side: Side) -> Option<(HandParams, PosedHand)> {
        let params = self.params(world, side)?;
        let posed = self.rigs[side as usize].model.forward(&params);
        Some((params, posed))
    }

    /// Copies the current vertices of the hands to the engine's skins, for the picture.
    ///
    /// # Errors
    /// If a skin has another number of vertices.
    pub fn update_skins(&self, world: &mut World) -> Result<()> {
        for side in Side::BOTH {
            if let (Some(driver), Some((_, posed))) = (self.driver(side), self.posed(world, side)) {
                let vertices = self.rigs[side as usize].bound_vertices(&posed);
                world.set_skin(driver.skin(), &vertices)?;
            }
        }
        Ok(())
    }
}
