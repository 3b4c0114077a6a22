//! What a hand does: contact goals and their course in time.

use std::collections::BTreeMap;

use serde::Deserialize;

use super::{ObjectSpec, half, within, zero, zero3};
use crate::error::{Error, Result};
use crate::sim::range::Span;

/// No hand presses harder, N.
const MOST_FORCE: f64 = 1000.0;
/// No hand is sent further, m.
const FAR: f64 = 1.0;

/// Contact goals of a hand and their course in time. Directions are those of the right hand, in the object's frame.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ActSpec {
    /// Name of the object the hand deals with.
    pub object: String,
    /// Where the stretched fingers would point.
    pub fingers: [f64; 3],
    /// Where the palm faces.
    pub palm: [f64; 3],
    /// Random turn of the whole hand about a random axis, rad.
    #[serde(default = "zero")]
    pub turn: Span,
    /// Direction from which the hand comes and to which it leaves, in the world frame.
    pub from: [f64; 3],
    /// Random turn of `from`, rad.
    #[serde(default = "zero")]
    pub from_turn: Span,
    /// Goals by site.
    pub contacts: BTreeMap<Site, ContactSpec>,
    /// Grip force as a multiple of what just holds the object against gravity; 0 leaves `force` alone.
    #[serde(default = "zero")]
    pub grip: Span,
    /// Curl of fingers without goal: 0 stretched, 1 fist.
    #[serde(default = "half")]
    pub curl: Span,
    /// Fingers that close around the object until they meet it.
    pub wrap: Option<WrapSpec>,
    /// Whether durations and values are drawn with the same random numbers as the other hand's, and left and right are
    /// those of the first hand: two hands that carry one thing.
    #[serde(default)]
    pub in_step: bool,
    /// Channels at the start.
    pub start: Channels,
    /// Phases, one after another.
    pub script: Vec<PhaseSpec>,
}

/// Fingers that close until something stops them, with a torque that is limited.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct WrapSpec {
    /// The fingers.
    pub fingers: Vec<Site>,
    /// Torque of the knuckle's hinge when closed, N m; the hinges beyond have 0.7 and 0.45 of it.
    pub torque: Span,
}

/// A part of a hand that can be given a contact goal.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Deserialize)]
#[serde(rename_all = "lowercase")]
#[allow(missing_docs)]
pub enum Site {
    Thumb,
    Index,
    Middle,
    Ring,
    Little,
    Palm,
}

impl Site {
    /// The five fingers in anatomical order.
    pub const FINGERS: [Site; 5] = [Site::Thumb, Site::Index, Site::Middle, Site::Ring, Site::Little];
}

/// A goal: where a site touches the object, and how hard.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ContactSpec {
    /// Direction from the object's axis to the point, in its frame; the outermost surface that way is touched.
    pub at: [f64; 3],
    /// Height of the point above the object's centre, m.
    #[serde(default = "zero")]
    pub height: Span,
    /// How far aside of the object's axis the point lies, m: x and y of its frame, y mirrored for the left hand.
    pub aside: Option<[Span; 2]>,
    /// Normal force, N, in addition to the grip's share.
    #[serde(default = "zero")]
    pub force: Span,
    /// Share of the grip force that this site carries.
    #[serde(default)]
    pub share: f64,
}

/// One phase: the channels that change, and how long that takes. Channels not named keep their value.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PhaseSpec {
    /// Name, for the reader.
    pub phase: String,
    /// Duration, s.
    pub seconds: Span,
    /// See [`Channels`].
    pub standoff: Option<Span>,
    /// See [`Channels`].
    pub opening: Option<Span>,
    /// See [`Channels`].
    pub squeeze: Option<Span>,
    /// See [`Channels`].
    pub shift: Option<[Span; 3]>,
    /// See [`Channels`].
    pub twist: Option<Span>,
    /// See [`Channels`].
    pub wrap: Option<Span>,
}

/// What a script drives.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Channels {
    /// How far the hand is from its place at the object, along `from`, m.
    #[serde(default = "zero")]
    pub standoff: Span,
    /// How far the sites with goals are from the surface, m.
    #[serde(default = "zero")]
    pub opening: Span,
    /// Share of the goal forces applied, 0 to 1.
    #[serde(default = "zero")]
    pub squeeze: Span,
    /// Displacement of the hand in the world frame, m; x is mirrored for the left hand.
    #[serde(default = "zero3")]
    pub shift: [Span; 3],
    /// Turn of the hand about the upright axis through the object's start, rad; mirrored for the left hand.
    #[serde(default = "zero")]
    pub twist: Span,
    /// How far the fingers of `wrap` close: 0 open, 1 until they meet the object.
    #[serde(default = "zero")]
    pub wrap: Span,
}

impl ActSpec {
    /// Whether the script ever presses or carries anything.
    pub fn presses(&self) -> bool {
        let pushes = self.grip.high() > 0.0 || self.contacts.values().any(|contact| contact.force.high() > 0.0);
        let some = |span: Option<Span>| span.is_some_and(|span| span.high() > 0.0);
        (pushes && (self.start.squeeze.high() > 0.0 || self.script.iter().any(|phase| some(phase.squeeze))))
            || self.start.wrap.high() > 0.0
            || self.script.iter().any(|phase| some(phase.wrap))
    }

    /// Whether it presses and raises the hand at once, so that the object hangs in the grip.
    pub fn lifts(&self) -> bool {
        self.presses() && self.script.iter().any(|phase| phase.shift.is_some_and(|[_, _, z]| z.high() > 0.005))
    }

    /// Whether it presses and turns the hand.
    pub fn twists(&self) -> bool {
        let turn = |span: Span| span.low() < 0.0 || span.high() > 0.0;
        self.presses() && self.script.iter().any(|phase| phase.twist.is_some_and(turn))
    }

    /// Checks ranges and names; `key` names the act in messages.
    pub(super) fn check(&self, key: &str, objects: &[ObjectSpec]) -> Result<()> {
        if !objects.iter().any(|object| object.name == self.object) {
            return Err(Error::unknown("object", &self.object, objects.iter().map(|o| o.name.as_str())));
        }
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
        within(&format!("{key}.grip"), self.grip, 0.0, MOST_FORCE)?;
        within(&format!("{key}.curl"), self.curl, 0.0, 1.0)?;
        for (site, contact) in &self.contacts {
            let key = format!("{key}.contacts.{site:?}").to_lowercase();
            within(&format!("{key}.force"), contact.force, 0.0, MOST_FORCE)?;
            within(&format!("{key}.height"), contact.height, -FAR, FAR)?;
            for aside in contact.aside.iter().flatten() {
                within(&format!("{key}.aside"), *aside, -FAR, FAR)?;
            }
            if !(0.0..=1.0).contains(&contact.share) {
                return Err(Error::value(format!("{key}.share"), "0 to 1", contact.share));
            }
        }
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

    fn check_wrap(&self, key: &str) -> Result<()> {
        let uses = self.start.wrap.high() > 0.0 || self.script.iter().any(|phase| phase.wrap.is_some());
        let Some(wrap) = &self.wrap else {
            return match uses {
                true => Err(Error::value(format!("{key}.wrap"), "fingers and torque, as the script wraps", "nothing")),
                false => Ok(()),
            };
        };
        within(&format!("{key}.wrap.torque"), wrap.torque, 0.0, 10.0)?;
        if wrap.fingers.is_empty() || wrap.fingers.contains(&Site::Palm) {
            let got = format!("{:?}", wrap.fingers).to_lowercase();
            return Err(Error::value(format!("{key}.wrap.fingers"), "fingers, at least one", got));
        }
        Ok(())
    }
}

impl PhaseSpec {
    fn check(&self, key: &str) -> Result<()> {
        let check = |name: &str, span: Option<Span>, low: f64, high: f64| match span {
            Some(span) => within(&format!("{key}.{name}"), span, low, high),
            None => Ok(()),
        };
        check("seconds", Some(self.seconds), 0.0, 600.0)?;
        check("standoff", self.standoff, -FAR, FAR)?;
        check("opening", self.opening, -FAR, FAR)?;
        check("squeeze", self.squeeze, 0.0, 1.0)?;
        check("twist", self.twist, -2.0, 2.0)?;
        check("wrap", self.wrap, 0.0, 1.0)?;
        self.shift.iter().flatten().try_for_each(|axis| check("shift", Some(*axis), -FAR, FAR))
    }
}
