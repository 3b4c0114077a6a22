//! The task: lift a hollow ball of unknown weight without crushing or dropping it.
//!
//! All balls look alike. A thin shell is light and breaks early, a thick one is heavy and bears more: the force that a
//! ball bears is a fixed multiple of the force that holds it. The thumb grips below the ball's equator and the fingers above,
//! so that the thumb carries part of the weight as normal force: whoever feels the normal forces can tell the weight as
//! soon as the ball leaves the table. The transmission of the hand, from the commanded to the applied force, is unknown
//! too. A policy commands the grip; the lift follows a fixed course, slow at first.

use std::path::Path;

use egotac::error::{Error, Result};
use egotac::hand::{JOINT_NAMES, N_JOINTS};
use egotac::mujoco::World;
use egotac::mujoco::world::Body;
use egotac::sim::rig::site_of;
use egotac::sim::scene::HandSite;
use egotac::sim::{ChannelValues, Environment, RolloutOptions, Scene, SimFrame};
use glam::DVec3;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};

/// The scene; the mass is replaced by the drawn one.
const SCENE: &str = include_str!("lift_ball.yaml");
/// Line of the scene that holds the mass.
const MASS_LINE: &str = "    mass: 0.2\n";
/// Height of the contact points above (fingers) and below (thumb) the ball's centre, m, as in the scene.
const CONTACT_HEIGHT: f64 = 0.012;
/// Coefficient of friction, as in the scene.
const FRICTION: f64 = 0.8;
/// Gravity, m/s².
const GRAVITY: f64 = 9.81;

/// Least and largest mass, kg; its logarithm is drawn uniformly.
pub const MASS: [f64; 2] = [0.06, 0.3];
/// Least and largest gain from commanded to applied grip.
const GAIN: [f64; 2] = [0.7, 1.4];
/// Largest offset between commanded and applied grip, N.
const OFFSET: f64 = 0.5;
/// Largest force on a side of the ball, as a multiple of the thumb's force that just holds it.
pub const CRUSH_RATIO: f64 = 1.8;

/// Time between two commands, s.
pub const INTERVAL: f64 = 0.08;
/// Largest change of the commanded grip in one interval, N.
pub const MAX_CHANGE: f64 = 0.5;
/// Grip at the start, N: fingers apart.
const FIRST_GRIP: f64 = -3.0;
/// Largest commanded grip, N.
const MAX_GRIP: f64 = 12.0;
/// Opening of the fingers at a grip of -1 N, m: the inverse stiffness of a fingertip.
const OPENING_PER_NEWTON: f64 = 0.004;
/// Widest opening, m, as in the scene.
const WIDEST: f64 = 0.014;

/// Earliest and latest start of the lift, s.
const LIFT_START: [f64; 2] = [1.3, 1.6];
/// First part of the lift, in which the fingers take over the weight: height, m, and speed, m/s.
const SLOW_LIFT: (f64, f64) = (0.016, 0.008);
/// Speed of the second part, m/s.
const LIFT_SPEED: f64 = 0.04;
/// Height of the lift, m.
const LIFT: f64 = 0.05;
/// Time that the ball is held at the top, s.
const HOLD: f64 = 0.6;
/// Share of the lift by which the ball has to rise.
const RISEN_SHARE: f64 = 0.75;
/// Distance by which a ball may lag behind the hand before it counts as dropped, m.
const DROP_DISTANCE: f64 = 0.025;

/// Values that no policy is told.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Hidden {
    /// Mass of the ball, kg.
    pub mass: f64,
    /// Gain from commanded to applied grip.
    pub gain: f64,
    /// Offset of the applied grip, N.
    pub offset: f64,
    /// Start of the lift, s; a policy sees the height of the lift.
    pub lift_start: f64,
}

impl Hidden {
    /// Draws the values of a seed.
    pub fn draw(seed: u64) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        rng.set_stream(77);
        let mut log = |[low, high]: [f64; 2]| (rng.random_range(low.ln()..high.ln())).exp();
        let (mass, gain) = (log(MASS), log(GAIN));
        let offset = rng.random_range(-OFFSET..OFFSET);
        let lift_start = rng.random_range(LIFT_START[0]..LIFT_START[1]);
        Self { mass, gain, offset, lift_start }
    }
}

/// End of a trial.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum End {
    /// The ball is held at the top and was never crushed.
    Lifted,
    /// A side of the ball bore more than the limit.
    Crushed,
    /// The ball stayed behind.
    Dropped,
    /// The simulation lost its state.
    Lost,
}

/// Result of a trial.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Outcome {
    /// Seed of the trial.
    pub seed: u64,
    /// Mass of the ball, kg.
    pub mass: f64,
    /// How it ended.
    pub end: End,
    /// Largest force on a side of the ball relative to the limit.
    pub peak: f64,
    /// Rise of the ball at the end, m.
    pub rise: f64,
}

/// Forces between hand and ball at an instant.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Grasp {
    /// Sum of the thumb's normal forces, N.
    pub thumb: f64,
    /// Sum of the normal forces of the other parts of the hand, N.
    pub fingers: f64,
    /// Upward force of the hand on the ball, N.
    pub load: f64,
}

/// A running trial.
#[derive(Debug)]
pub struct Trial {
    environment: Environment,
    /// The hidden values.
    pub hidden: Hidden,
    seed: u64,
    ball: Body,
    /// Links of the thumb, and of the rest of the hand.
    links: [Vec<Body>; 2],
    /// Height of the ball at the start, m.
    rest: f64,
    /// Sine of the angle between the grip's axis and the horizontal.
    sine: f64,
    frame: SimFrame,
    /// Commanded grip, N.
    grip: f64,
    /// Largest mean force on a side over an interval, N.
    peak: f64,
    /// Number of commands so far.
    steps: usize,
    end: Option<End>,
}

impl Trial {
    /// Starts the trial of a seed; `picture`: side of the pictures, pixels, `None` = without pictures.
    ///
    /// # Errors
    /// If the scene can't be built, or pictures are needed and there is no OpenGL.
    pub fn start(seed: u64, picture: Option<u32>) -> Result<Self> {
        let hidden = Hidden::draw(seed);
        let text = SCENE.replace(MASS_LINE, &format!("    mass: {}\n", hidden.mass));
        let scene = Scene::parse("lift_ball", Path::new("lift_ball.yaml"), &text)?;
        let options =
            RolloutOptions { picture: picture.map(|side| (side, side)), guards: false, ..RolloutOptions::default() };
        let mut environment = Environment::new(scene, options);
        let frame = environment.reset(seed)?;
        let rollout = environment.rollout()?;
        let ball = rollout.objects().first().and_then(|object| object.body());
        let ball = ball.ok_or_else(|| Error::value("objects", "a solid ball", "none"))?;
        let rig = &rollout.rigs()[rollout.episode().hands[0].side as usize];
        let of = |thumb: bool| {
            let joints = (0..N_JOINTS).filter(|joint| (site_of(*joint) == HandSite::Thumb) == thumb);
            joints.map(|joint| rollout.world().body(&rig.name(JOINT_NAMES[joint]))).collect::<Result<Vec<_>>>()
        };
        let links = [of(true)?, of(false)?];
        let start = &rollout.episode().objects[0];
        let (rest, sine) = (start.position.z, CONTACT_HEIGHT / start.shape.half_height);
        let grip = FIRST_GRIP;
        Ok(Self { environment, hidden, seed, ball, links, rest, sine, frame, grip, peak: 0.0, steps: 0, end: None })
    }

    /// Returns the frame of this instant.
    pub fn frame(&self) -> &SimFrame {
        &self.frame
    }

    /// Returns the commanded grip, N.
    pub fn grip(&self) -> f64 {
        self.grip
    }

    /// Returns the number of commands so far.
    pub fn steps(&self) -> usize {
        self.steps
    }

    /// Returns the commanded height of the lift at `time`, m.
    fn lift_at(&self, time: f64) -> f64 {
        let since = time - self.hidden.lift_start;
        let (height, speed) = SLOW_LIFT;
        let slow = height / speed;
        (speed * since.clamp(0.0, slow) + LIFT_SPEED * (since - slow).max(0.0)).min(LIFT)
    }

    /// Returns the commanded height of the lift, m.
    pub fn lift(&self) -> f64 {
        self.lift_at(self.steps as f64 * INTERVAL)
    }

    /// Returns the end of the trial, s.
    fn duration(&self) -> f64 {
        let (height, speed) = SLOW_LIFT;
        self.hidden.lift_start + height / speed + (LIFT - height) / LIFT_SPEED + HOLD
    }

    /// Returns the fingers' force that just holds a load, N. The thumb's and the fingers' friction are equal, or the ball
    /// would turn; where both are at the edge of the fingers' cone, they and the thumb's larger normal force carry the load.
    pub fn holding(&self, load: f64) -> f64 {
        0.5 * load * (1.0 - self.sine * self.sine).sqrt() / FRICTION
    }

    /// Returns the largest force that a side of the ball bears, N.
    pub fn limit(&self) -> f64 {
        let weight = self.hidden.mass * GRAVITY;
        CRUSH_RATIO * (self.holding(weight) + weight * self.sine)
    }

    /// Returns the forces between hand and ball at this instant.
    ///
    /// # Errors
    /// Never after [`Self::start`].
    pub fn grasp(&self) -> Result<Grasp> {
        Ok(grasp(self.environment.rollout()?.world(), self.ball, &self.links))
    }

    /// Changes the commanded grip by `change`, N, limited to [`MAX_CHANGE`], and simulates one interval. Returns false if
    /// the trial is over; a crushed ball ends it only with `stop_when_crushed`.
    ///
    /// # Errors
    /// If `change` is not finite, or rendering fails.
    pub fn act(&mut self, change: f64, stop_when_crushed: bool) -> Result<bool> {
        self.grip = (self.grip + change.clamp(-MAX_CHANGE, MAX_CHANGE)).clamp(FIRST_GRIP, MAX_GRIP);
        self.steps += 1;
        let applied = self.hidden.gain * self.grip + self.hidden.offset;
        let command = ChannelValues {
            opening: (-applied * OPENING_PER_NEWTON).clamp(0.0, WIDEST),
            squeeze: applied.max(0.0),
            shift: DVec3::Z * self.lift(),
            ..ChannelValues::default()
        };
        let (mut thumb, mut fingers, mut count) = (0.0, 0.0, 0u32);
        let (ball, links) = (self.ball, &self.links);
        let frame = self.environment.step_watched(command, |world| {
            let now = grasp(world, ball, links);
            (thumb, fingers, count) = (thumb + now.thumb, fingers + now.fingers, count + 1);
        })?;
        let Some(frame) = frame else {
            self.end = Some(End::Lost);
            return Ok(false);
        };
        self.frame = frame;
        // The mean over an interval: single peaks of the contact solver don't break the ball.
        self.peak = self.peak.max(f64::max(thumb, fingers) / f64::from(count.max(1)));
        self.end = self.judge(stop_when_crushed);
        Ok(self.end.is_none())
    }

    /// Returns the end of the trial if it is over.
    fn judge(&self, stop_when_crushed: bool) -> Option<End> {
        let crushed = self.peak > self.limit();
        let dropped = self.lift() - self.rise() > DROP_DISTANCE;
        let over = self.steps as f64 * INTERVAL >= self.duration();
        match () {
            () if crushed && (stop_when_crushed || over || dropped) => Some(End::Crushed),
            () if dropped => Some(End::Dropped),
            () if over && self.rise() >= RISEN_SHARE * LIFT => Some(End::Lifted),
            () if over => Some(End::Dropped),
            () => None,
        }
    }

    /// Returns the rise of the ball since the start, m.
    pub fn rise(&self) -> f64 {
        self.frame.objects.first().map_or(f64::NAN, |ball| ball.position.z) - self.rest
    }

    /// Returns the result of a trial that is over.
    pub fn outcome(&self) -> Outcome {
        let end = self.end.unwrap_or(End::Lost);
        Outcome { seed: self.seed, mass: self.hidden.mass, end, peak: self.peak / self.limit(), rise: self.rise() }
    }
}

/// Sums the contacts of hand and ball.
fn grasp(world: &World, ball: Body, links: &[Vec<Body>; 2]) -> Grasp {
    let mut sum = Grasp::default();
    for contact in world.contacts() {
        let [a, b] = contact.bodies;
        // The engine's force acts on the second body.
        let (link, upward) = match (a == ball, b == ball) {
            (true, false) => (b, -contact.force.z),
            (false, true) => (a, contact.force.z),
            _ => continue,
        };
        let [of_thumb, of_rest] = links.each_ref().map(|side| side.contains(&link));
        if of_thumb {
            sum.thumb += contact.normal_force;
        } else if of_rest {
            sum.fingers += contact.normal_force;
        } else {
            continue;
        }
        sum.load += upward;
    }
    sum
}
