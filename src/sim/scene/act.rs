//! Acts: contact goals of a hand and their course in time.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use super::limits::{within, zero};
use super::object::ObjectSpec;
use crate::error::{Error, Result};
use crate::hand::{FINGER_LIMIT, PALM_LIMIT};
use crate::sim::range::UniformRange;

/// Largest force of a contact goal, N: a bound on numbers; [`ActSpec::check`] knows the strength of hands.
const MAX_FORCE: f64 = 1000.0;
/// Largest displacement of a hand, m: beyond the table's edge.
const MAX_DISPLACEMENT: f64 = 1.0;

/// Longest script, s.
const MAX_SCRIPT_SECS: f64 = 3600.0;

/// Contact goals of a hand and their course in time. Directions are those of the right hand in the object frame.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ActSpec {
    /// Name of the object to touch.
    pub object: String,
    /// Direction of the stretched fingers.
    pub fingers: [f64; 3],
    /// Direction that the palm faces.
    pub palm: [f64; 3],
    /// Angle by which the whole hand turns about a random axis, rad.
    #[serde(default = "zero")]
    pub turn: UniformRange,
    /// Direction from the object to where the hand comes from and leaves to, in the world frame.
    pub from: [f64; 3],
    /// Angle by which `from` turns about a random axis, rad.
    #[serde(default = "zero")]
    pub from_turn: UniformRange,
    /// Contact goals by site.
    pub contacts: BTreeMap<HandSite, ContactSpec>,
    /// Grip force as a multiple of the force that just holds the object against gravity; 0 leaves only `force`.
    #[serde(default = "zero")]
    pub grip: UniformRange,
    /// Curl of fingers without a goal: 0 stretched, 1 fist.
    #[serde(default = "default_curl")]
    pub curl: UniformRange,
    /// Fingers that close around the object until contact stops them.
    pub wrap: Option<WrapSpec>,
    /// True if durations and values are drawn with the same random numbers as the other hand's, and left and right are
    /// those of the first hand: for two hands that carry one object.
    #[serde(default)]
    pub in_step: bool,
    /// Values of the channels at the start.
    pub start: Channels,
    /// Phases in order.
    pub script: Vec<PhaseSpec>,
}

/// Fingers that close with limited torque until contact stops them.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct WrapSpec {
    /// Fingers that close.
    pub fingers: Vec<HandSite>,
    /// Torque of the knuckle's hinge when closed, N m; the two hinges beyond it have 0.7 and 0.45 of it.
    pub torque: UniformRange,
}

/// Part of a hand that can have a contact goal.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
#[allow(missing_docs)]
pub enum HandSite {
    Thumb,
    Index,
    Middle,
    Ring,
    Little,
    Palm,
}

/// Returns the force with which each of two opposite sides holds a weight at rest, N.
pub(crate) fn holding_force(mass: f64, friction: f64) -> f64 {
    mass * 9.81 / (2.0 * friction)
}

impl HandSite {
    /// Returns the largest force that the part of a human hand exerts, N.
    fn limit(self) -> f64 {
        if self == Self::Palm { PALM_LIMIT } else { FINGER_LIMIT }
    }

    /// The five fingers in anatomical order.
    pub const FINGERS: [HandSite; 5] =
        [HandSite::Thumb, HandSite::Index, HandSite::Middle, HandSite::Ring, HandSite::Little];
}

/// Contact goal: point on the object and normal force.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ContactSpec {
    /// Direction from the object's axis to the point, in the object frame; the goal is on the outermost surface in it.
    pub at: [f64; 3],
    /// Height of the point above the object's centre, m.
    #[serde(default = "zero")]
    pub height: UniformRange,
    /// Offset of the point from the object's axis, x and y of the object frame, m; y is mirrored for the left hand.
    pub aside: Option<[UniformRange; 2]>,
    /// Normal force in addition to the share of the grip force, N.
    #[serde(default = "zero")]
    pub force: UniformRange,
    /// Share of the grip force that this site carries.
    #[serde(default)]
    pub share: f64,
}

/// One phase: duration, and values that channels reach at its end. Channels without a value keep theirs.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PhaseSpec {
    /// Name, for readers of the file.
    pub phase: String,
    /// Duration, s.
    pub seconds: UniformRange,
    /// See [`Channels`].
    pub standoff: Option<UniformRange>,
    /// See [`Channels`].
    pub opening: Option<UniformRange>,
    /// See [`Channels`].
    pub squeeze: Option<UniformRange>,
    /// See [`Channels`].
    pub shift: Option<[UniformRange; 3]>,
    /// See [`Channels`].
    pub twist: Option<UniformRange>,
    /// See [`Channels`].
    pub wrap: Option<UniformRange>,
}

/// Channels that a script drives.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Channels {
    /// Distance of the hand from its place at the object, along `from`, m.
    #[serde(default = "zero")]
    pub standoff: UniformRange,
    /// Distance of the sites with goals from the surface, m.
    #[serde(default = "zero")]
    pub opening: UniformRange,
    /// Share of the goal forces that is applied, 0 to 1.
    #[serde(default = "zero")]
    pub squeeze: UniformRange,
    /// Displacement of the hand in the world frame, m; x is mirrored for the left hand.
    #[serde(default = "zero3")]
    pub shift: [UniformRange; 3],
    /// Rotation of the hand about the upright axis through the object's start, rad; mirrored for the left hand.
    #[serde(default = "zero")]
    pub twist: UniformRange,
    /// Closure of the fingers of `wrap`: 0 open, 1 closed until contact stops them.
    #[serde(default = "zero")]
    pub wrap: UniformRange,
}

impl ActSpec {
    /// True if the script ever applies force.
    pub(crate) fn presses(&self) -> bool {
        let pushes = self.grip.high() > 0.0 || self.contacts.values().any(|contact| contact.force.high() > 0.0);
        let some = |range: Option<UniformRange>| range.is_some_and(|range| range.high() > 0.0);
        (pushes && (self.start.squeeze.high() > 0.0 || self.script.iter().any(|phase| some(phase.squeeze))))
            || self.start.wrap.high() > 0.0
            || self.script.iter().any(|phase| some(phase.wrap))
    }

    /// True if the script applies force and raises the hand, so that the object hangs in the grip.
    pub(crate) fn lifts(&self) -> bool {
        self.presses() && self.script.iter().any(|phase| phase.shift.is_some_and(|[_, _, z]| z.high() > 0.005))
    }

    /// True if the script applies force and turns the hand.
    pub(crate) fn twists(&self) -> bool {
        let turn = |range: UniformRange| range.low() < 0.0 || range.high() > 0.0;
        self.presses() && self.script.iter().any(|phase| phase.twist.is_some_and(turn))
    }

    /// Checks ranges and names; `key` names the act in errors.
    pub(super) fn check(&self, key: &str, objects: &[ObjectSpec]) -> Result<()> {
        let Some(object) = objects.iter().find(|object| object.name == self.object) else {
            return Err(Error::unknown("object", &self.object, objects.iter().map(|o| o.name.as_str())));
        };
        let directions = [("fingers", self.fingers), ("palm", self.palm), ("from", self.from)];
        let goals = self.contacts.values().map(|contact| ("contacts.at", contact.at));
        for (name, [x, y, z]) in directions.into_iter().chain(goals) {
            let length = (x * x + y * y + z * z).sqrt();
            if !(length.is_finite() && length > 1e-6) {
                return Err(Error::value(format!("{key}.{name}"), "a direction", format!("[{x}, {y}, {z}]")));
            }
        }
        if self.contacts.is_empty() {
            return Err(Error::value(format!("{key}.contacts"), "at least one goal", "none"));
        }
        if self.script.is_empty() {
            return Err(Error::value(format!("{key}.script"), "at least one phase", "none"));
        }
        let longest: f64 = self.script.iter().map(|phase| phase.seconds.high()).sum();
        within(&format!("{key}.script, sum of seconds"), UniformRange::fixed(longest), 0.0, MAX_SCRIPT_SECS)?;
        within(&format!("{key}.grip"), self.grip, 0.0, MAX_FORCE)?;
        within(&format!("{key}.curl"), self.curl, 0.0, 1.0)?;
        for (site, contact) in &self.contacts {
            let key = format!("{key}.contacts.{site:?}").to_lowercase();
            within(&format!("{key}.force"), contact.force, 0.0, MAX_FORCE)?;
            within(&format!("{key}.height"), contact.height, -MAX_DISPLACEMENT, MAX_DISPLACEMENT)?;
            for aside in contact.aside.iter().flatten() {
                within(&format!("{key}.aside"), *aside, -MAX_DISPLACEMENT, MAX_DISPLACEMENT)?;
            }
            if !(0.0..=1.0).contains(&contact.share) {
                return Err(Error::value(format!("{key}.share"), "0 to 1", contact.share));
            }
        }
        self.check_strength(key, object)?;
        self.check_wrap(key)?;
        let Channels { standoff, opening, squeeze, shift, twist, wrap } = self.start;
        let start = PhaseSpec {
            phase: "start".into(),
            seconds: zero(),
            standoff: Some(standoff),
            opening: Some(opening),
            squeeze: Some(squeeze),
            shift: Some(shift),
            twist: Some(twist),
            wrap: Some(wrap),
        };
        start.check(&format!("{key}.start"))?;
        self.script.iter().enumerate().try_for_each(|(i, phase)| phase.check(&format!("{key}.script[{i}]")))
    }

    /// Refuses a grip that no human hand can exert in any draw. Single draws beyond it are flagged in their frames.
    fn check_strength(&self, key: &str, object: &ObjectSpec) -> Result<()> {
        let (mass, friction, grip) = (object.mass.low(), object.friction.high(), self.grip.low());
        let hold = holding_force(mass, friction) * grip;
        for (site, contact) in &self.contacts {
            let (least, most) = (contact.force.low() + contact.share * hold, site.limit());
            if least > most {
                let key = format!("{key}.contacts.{site:?}").to_lowercase();
                let expected = format!("at most {most} N, the limit of a human hand");
                let got = format!("at least {least:.0} N: {grip} times what holds {mass} kg at friction {friction}");
                return Err(Error::value(key, expected, got));
            }
        }
        Ok(())
    }

    fn check_wrap(&self, key: &str) -> Result<()> {
        let uses = self.start.wrap.high() > 0.0 || self.script.iter().any(|phase| phase.wrap.is_some());
        let Some(wrap) = &self.wrap else {
            return match uses {
                true => Err(Error::value(format!("{key}.wrap"), "fingers and torque, as the script wraps", "nothing")),
                false => Ok(()),
            };
        };
        within(&format!("{key}.wrap.torque"), wrap.torque, 0.0, 10.0)?;
        if wrap.fingers.is_empty() || wrap.fingers.contains(&HandSite::Palm) {
            let got = format!("{:?}", wrap.fingers).to_lowercase();
            return Err(Error::value(format!("{key}.wrap.fingers"), "fingers, at least one", got));
        }
        Ok(())
    }
}

impl PhaseSpec {
    fn check(&self, key: &str) -> Result<()> {
        let check = |name: &str, range: Option<UniformRange>, low: f64, high: f64| match range {
            Some(range) => within(&format!("{key}.{name}"), range, low, high),
            None => Ok(()),
        };
        check("seconds", Some(self.seconds), 0.0, 600.0)?;
        check("standoff", self.standoff, -MAX_DISPLACEMENT, MAX_DISPLACEMENT)?;
        check("opening", self.opening, -MAX_DISPLACEMENT, MAX_DISPLACEMENT)?;
        check("squeeze", self.squeeze, 0.0, 1.0)?;
        check("twist", self.twist, -2.0, 2.0)?;
        check("wrap", self.wrap, 0.0, 1.0)?;
        self.shift
            .iter()
            .flatten()
            .try_for_each(|axis| check("shift", Some(*axis), -MAX_DISPLACEMENT, MAX_DISPLACEMENT))
    }
}

fn zero3() -> [UniformRange; 3] {
    [zero(); 3]
}

/// Default curl of fingers without a goal.
fn default_curl() -> UniformRange {
    UniformRange::new(0.3, 0.6)
}
