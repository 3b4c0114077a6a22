//! Physics options that cannot be invalid.

use std::ops::RangeInclusive;

use serde::de::{Deserializer, Error as _};
use serde::{Deserialize, Serialize};
use serde_yaml::{Mapping, Value};

use super::preset::Preset;
use crate::error::{Error, Result};

/// Timesteps the engine is trusted with, s: below, time stands still in float noise; above, contacts are missed.
pub const TIMESTEP_RANGE: RangeInclusive<f64> = 1e-6..=2e-2;

/// Shape of the friction cone.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Cone {
    /// Four facets; a cheaper problem, but another grasp (finger forces differ by 11 to 53 %).
    Pyramidal,
    /// The true cone.
    #[default]
    Elliptic,
}

/// How velocities become positions.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Integrator {
    /// Semi-implicit Euler with implicit joint damping.
    Euler,
    /// Fourth-order Runge-Kutta: right for fast free spin, 3 times the price.
    Rk4,
    /// Implicit in velocity.
    Implicit,
    /// Implicit in velocity without the Coriolis derivatives.
    #[default]
    ImplicitFast,
    /// Stable at any stiffness, first order; what elastic flexes need.
    Discrete,
}

/// How the constraint forces are found.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Solver {
    /// Projected Gauss-Seidel.
    Pgs,
    /// Conjugate gradients.
    Cg,
    /// Newton's method.
    #[default]
    Newton,
}

/// Physics options, checked: every value of this type is one the engine accepts.
///
/// In a file they are single values, or a preset next to values that replace the preset's:
/// `{ preset: fast, impratio: 100 }`. Without a preset it is [`Preset::Default`].
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
#[serde(into = "Unchecked")]
pub struct PhysicsOptions(Unchecked);

/// Physics options as written, not yet checked.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Unchecked {
    /// Where the values come from; single ones may differ.
    pub preset: Preset,
    /// Seconds per step.
    pub timestep: f64,
    /// Shape of the friction cone.
    pub cone: Cone,
    /// Stiffness of friction over that of normal forces.
    pub impratio: f64,
    /// Constraint solver.
    pub solver: Solver,
    /// Cap on the solver's iterations; Newton below 5 loses grasps.
    pub iterations: u32,
    /// Improvement at which the solver stops.
    pub tolerance: f64,
    /// Iterations that remove the slow slip of friction after the solve; 0 is off.
    pub noslip_iterations: u32,
    /// Integrator.
    pub integrator: Integrator,
    /// Acceleration of gravity in the world frame, m/s².
    pub gravity: [f64; 3],
}

impl Default for Unchecked {
    fn default() -> Self {
        Preset::Default.values()
    }
}

impl<'de> Deserialize<'de> for PhysicsOptions {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> std::result::Result<Self, D::Error> {
        let written = Mapping::deserialize(deserializer)?;
        let preset = match written.get("preset") {
            Some(name) => serde_yaml::from_value(name.clone()).map_err(D::Error::custom)?,
            None => Preset::Default,
        };
        let mut values = match serde_yaml::to_value(preset.values()).map_err(D::Error::custom)? {
            Value::Mapping(values) => values,
            _ => return Err(D::Error::custom("physics options are not a mapping")),
        };
        values.extend(written);
        let values: Unchecked = serde_yaml::from_value(Value::Mapping(values)).map_err(D::Error::custom)?;
        Self::try_from(values).map_err(D::Error::custom)
    }
}

impl TryFrom<Unchecked> for PhysicsOptions {
    type Error = Error;

    /// Checks every value.
    ///
    /// # Errors
    /// If a value is not finite or outside its range; the error names it.
    fn try_from(options: Unchecked) -> Result<Self> {
        in_range("timestep", options.timestep, TIMESTEP_RANGE)?;
        in_range("impratio", options.impratio, 1e-3..=1e4)?;
        in_range("tolerance", options.tolerance, 0.0..=1e-2)?;
        for (axis, value) in ["gravity x", "gravity y", "gravity z"].into_iter().zip(options.gravity) {
            in_range(axis, value, -1e3..=1e3)?;
        }
        if !(1..=1000).contains(&options.iterations) {
            return Err(Error::value("iterations", "1 to 1000", options.iterations));
        }
        if options.noslip_iterations > 1000 {
            return Err(Error::value("noslip_iterations", "0 to 1000", options.noslip_iterations));
        }
        Ok(Self(options))
    }
}

impl From<PhysicsOptions> for Unchecked {
    fn from(options: PhysicsOptions) -> Self {
        options.0
    }
}

impl std::ops::Deref for PhysicsOptions {
    type Target = Unchecked;

    fn deref(&self) -> &Unchecked {
        &self.0
    }
}

impl PhysicsOptions {
    /// The options of a preset.
    pub fn preset(preset: Preset) -> Self {
        Self(preset.values())
    }

    /// These options at another preset: gravity stays, and so does the discrete integrator, which soft bodies need.
    pub fn with_preset(&self, preset: Preset) -> Self {
        let mut values = Unchecked { gravity: self.gravity, ..preset.values() };
        if self.integrator == Integrator::Discrete {
            values.integrator = Integrator::Discrete;
        }
        Self(values)
    }

    /// Steps in `interval` seconds.
    ///
    /// # Errors
    /// If `interval` is not a whole number of timesteps.
    pub fn steps_in(&self, interval: f64) -> Result<usize> {
        let steps = interval / self.timestep;
        if !(steps.is_finite() && steps >= 0.5 && (steps - steps.round()).abs() < 1e-6) {
            let expected = format!("a whole number of {} s steps", self.timestep);
            return Err(Error::value("frame interval", expected, interval));
        }
        Ok(steps.round() as usize)
    }
}

fn in_range(name: &str, value: f64, range: RangeInclusive<f64>) -> Result<()> {
    if range.contains(&value) {
        return Ok(());
    }
    Err(Error::value(name, format!("{} to {}", range.start(), range.end()), value))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_that_would_end_the_process_are_refused() {
        let bad = [
            Unchecked { timestep: 0.0, ..Default::default() },
            Unchecked { timestep: -2e-3, ..Default::default() },
            Unchecked { timestep: f64::NAN, ..Default::default() },
            Unchecked { timestep: 1000.0, ..Default::default() },
            Unchecked { impratio: 0.0, ..Default::default() },
            Unchecked { iterations: 0, ..Default::default() },
            Unchecked { tolerance: f64::INFINITY, ..Default::default() },
            Unchecked { gravity: [0.0, f64::NAN, 0.0], ..Default::default() },
        ];
        for options in bad {
            assert!(PhysicsOptions::try_from(options.clone()).is_err(), "{options:?}");
        }
    }

    #[test]
    fn an_unknown_integrator_is_refused_by_name() {
        let error = serde_yaml::from_str::<PhysicsOptions>("integrator: leapfrog").unwrap_err().to_string();
        assert!(error.contains("leapfrog") && error.contains("implicitfast"), "{error}");
    }

    #[test]
    fn a_preset_fills_what_is_not_written() {
        let read = |text: &str| serde_yaml::from_str::<PhysicsOptions>(text);
        assert_eq!(read("preset: fast").unwrap(), PhysicsOptions::preset(Preset::Fast));
        assert_eq!(read("{}").unwrap(), PhysicsOptions::default());
        let mixed = read("{ impratio: 3, preset: precise }").unwrap();
        assert_eq!(*mixed, Unchecked { impratio: 3.0, ..Preset::Precise.values() });
        let error = read("preset: fats").unwrap_err().to_string();
        assert!(error.contains("fats") && error.contains("replay") && error.contains("stiff"), "{error}");
        let error = read("{ preset: fast, timestep: 1 }").unwrap_err().to_string();
        assert!(error.contains("timestep"), "{error}");
        let error = read("{ preset: fast, imprato: 1 }").unwrap_err().to_string();
        assert!(error.contains("imprato") && error.contains("impratio"), "{error}");
        assert!(read("timestep: .nan").is_err());
    }

    #[test]
    fn options_read_back_as_written() {
        let options = PhysicsOptions::try_from(Unchecked { impratio: 3.5, ..Preset::Stiff.values() }).unwrap();
        let text = serde_json::to_string(&options).unwrap();
        assert_eq!(serde_json::from_str::<PhysicsOptions>(&text).unwrap(), options);
    }

    #[test]
    fn another_preset_leaves_gravity_and_the_discrete_integrator() {
        let soft = Unchecked { gravity: [0.0, 0.0, -1.6], integrator: Integrator::Discrete, ..Default::default() };
        let soft = PhysicsOptions::try_from(soft).unwrap().with_preset(Preset::Precise);
        assert_eq!((soft.gravity[2], soft.integrator), (-1.6, Integrator::Discrete));
        assert_eq!((soft.timestep, soft.impratio, soft.preset), (1e-3, 100.0, Preset::Precise));
    }

    #[test]
    fn a_frame_is_a_whole_number_of_steps() {
        let options = PhysicsOptions::default();
        assert_eq!(options.steps_in(0.04).unwrap(), 20);
        assert!(options.steps_in(0.0333).is_err());
        assert!(options.steps_in(0.0).is_err());
    }
}
