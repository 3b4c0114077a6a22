//! Course of a script's channels in time: minimum-jerk curves between the values of its phases.

use glam::DVec3;
use rand::Rng;

use super::range::UniformRange;
use super::scene::{Channels, PhaseSpec};

/// Values of the channels at one instant: what a script gives over time, and what [`super::Environment::step`] takes.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct ChannelValues {
    /// Distance of the hand from its place at the object, m.
    pub standoff: f64,
    /// Distance of sites with goals from the surface, m.
    pub opening: f64,
    /// Share of the goal forces that is applied: 0 to 1 in a script, any multiple in a command.
    pub squeeze: f64,
    /// Displacement of the hand in the world frame, m.
    pub shift: DVec3,
    /// Rotation about the upright axis through the object's start, rad.
    pub twist: f64,
    /// Closure of wrapping fingers, 0 to 1.
    pub wrap: f64,
}

impl ChannelValues {
    /// Interpolates linearly: `self` at 0, `to` at 1.
    pub(super) fn lerp(self, to: Self, share: f64) -> Self {
        let mix = |a: f64, b: f64| a + (b - a) * share;
        Self {
            standoff: mix(self.standoff, to.standoff),
            opening: mix(self.opening, to.opening),
            squeeze: mix(self.squeeze, to.squeeze),
            shift: self.shift.lerp(to.shift, share),
            twist: mix(self.twist, to.twist),
            wrap: mix(self.wrap, to.wrap),
        }
    }

    /// Returns true if no channel is NaN or infinite.
    pub fn is_finite(&self) -> bool {
        let Self { standoff, opening, squeeze, shift, twist, wrap } = self;
        shift.is_finite() && [standoff, opening, squeeze, twist, wrap].iter().all(|value| value.is_finite())
    }
}

/// Command to a hand: channels that change linearly over an interval and then stay.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Ramp {
    /// Values at the start, and at the end.
    pub from: ChannelValues,
    pub to: ChannelValues,
    /// Start, s.
    pub begin: f64,
    /// Duration, s; positive.
    pub seconds: f64,
}

impl Ramp {
    /// Returns the values at `time`, s.
    pub fn at(&self, time: f64) -> ChannelValues {
        self.from.lerp(self.to, ((time - self.begin) / self.seconds).clamp(0.0, 1.0))
    }
}

/// Script with drawn durations and values.
#[derive(Debug, Clone, PartialEq)]
pub struct Timeline {
    start: ChannelValues,
    /// End of each phase, s, and the values at that time.
    phases: Vec<(f64, ChannelValues)>,
}

impl Timeline {
    /// Draws durations and values; `mirror` negates x of the shift, and the twist, as the left hand needs.
    pub fn sample(start: &Channels, script: &[PhaseSpec], mirror: bool, rng: &mut impl Rng) -> Self {
        let flip = if mirror { -1.0 } else { 1.0 };
        let sign = DVec3::new(flip, 1.0, 1.0);
        let mut values = ChannelValues {
            standoff: start.standoff.sample(rng),
            opening: start.opening.sample(rng),
            squeeze: start.squeeze.sample(rng),
            shift: DVec3::from_array(start.shift.each_ref().map(|s| s.sample(rng))) * sign,
            twist: flip * drawn(start.twist, rng),
            wrap: drawn(start.wrap, rng),
        };
        let start = values;
        let mut time = 0.0;
        let mut phases = Vec::new();
        for phase in script {
            time += phase.seconds.sample(rng);
            let mut draw = |range: &Option<UniformRange>, value: &mut f64| {
                if let Some(range) = range {
                    *value = range.sample(rng);
                }
            };
            draw(&phase.standoff, &mut values.standoff);
            draw(&phase.opening, &mut values.opening);
            draw(&phase.squeeze, &mut values.squeeze);
            if let Some(shift) = &phase.shift {
                values.shift = DVec3::from_array(shift.each_ref().map(|s| s.sample(rng))) * sign;
            }
            if let Some(twist) = phase.twist {
                values.twist = flip * twist.sample(rng);
            }
            if let Some(wrap) = phase.wrap {
                values.wrap = wrap.sample(rng);
            }
            phases.push((time, values));
        }
        Self { start, phases }
    }

    /// Returns the end of the last phase, s.
    pub fn duration(&self) -> f64 {
        self.phases.last().map_or(0.0, |(end, _)| *end)
    }

    /// Returns the largest opening of the script, m.
    pub fn widest_opening(&self) -> f64 {
        self.phases.iter().map(|(_, values)| values.opening).fold(self.start.opening, f64::max)
    }

    /// Returns the values at `time`, s; they are constant before the start and after the end.
    pub fn at(&self, time: f64) -> ChannelValues {
        let (mut begin, mut from) = (0.0, self.start);
        for &(end, to) in &self.phases {
            if time < end {
                return from.lerp(to, minimum_jerk((time - begin) / (end - begin)));
            }
            (begin, from) = (end, to);
        }
        from
    }
}

/// Draws a channel's start. A fixed channel takes no random number, so that scenes without it keep their episodes.
fn drawn(range: UniformRange, rng: &mut impl Rng) -> f64 {
    if range.low() == range.high() { range.low() } else { range.sample(rng) }
}

/// Returns the minimum-jerk curve of a reaching movement: from 0 to 1, with no velocity and acceleration at both ends.
fn minimum_jerk(x: f64) -> f64 {
    let x = x.clamp(0.0, 1.0);
    x * x * x * (10.0 + x * (6.0 * x - 15.0))
}
