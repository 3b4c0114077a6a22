//! Validated physics options, and their named presets.

use std::ops::RangeInclusive;

use serde::de::{Deserializer, Error as _};
use serde::{Deserialize, Serialize};
use serde_yaml::{Mapping, Value};

use crate::error::{Error, Result};

/// Accepted timesteps, s. Below the range, rounding swallows the motion of a step; above it, contacts are missed.
const TIMESTEP_RANGE: RangeInclusive<f64> = 1e-6..=2e-2;

/// Timestep of the preset `reference`, s.
const FINE_TIMESTEP: f64 = 5e-5;
/// Solver tolerance of the preset `reference`.
const FINE_TOLERANCE: f64 = 1e-12;

/// Shape of the friction cone.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Cone {
    /// Four facets: cheaper to solve, but finger forces of a grasp differ by 11 to 53 % from the elliptic cone's.
    Pyramidal,
    /// The exact cone.
    #[default]
    Elliptic,
}

/// Time integration scheme.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Integrator {
    /// Semi-implicit Euler with implicit joint damping.
    Euler,
    /// Fourth-order Runge-Kutta: accurate for fast free spin, at three times the cost.
    Rk4,
    /// Implicit in velocity.
    Implicit,
    /// Implicit in velocity without the Coriolis derivatives.
    #[default]
    ImplicitFast,
    /// First order and stable at any stiffness; elastic flexes need it.
    Discrete,
}

/// Solver of the constraint forces.
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

/// A named set of physics options, from the cheapest to the most exact; `stiff` is for models that the others lose.
///
/// `docs/bench/sim.md` lists the cost of each preset and its error against the reference.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Preset {
    /// Recorded or planned poses: kinematics and collision detection give contact positions; without dynamics there are
    /// no forces.
    Replay,
    /// Parameter sweeps: 4 ms.
    Fast,
    /// Training data: elliptic cone, 2 ms, impratio 10 (a held object does not creep out of the hand).
    #[default]
    Default,
    /// Verification: impratio 100, 1 ms.
    Precise,
    /// Ground truth for the other presets: impratio 100, 0.05 ms, tolerance 1e-12.
    Reference,
    /// Large servo gains, direct solref, soft bodies: the discrete integrator, 1 ms.
    Stiff,
}

/// Validated physics options: the engine accepts every value of this type.
///
/// A file gives single values, a preset, or a preset with values that override it: `{ preset: fast, impratio: 100 }`.
/// The preset defaults to [`Preset::Default`].
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
#[serde(into = "Unchecked")]
pub struct PhysicsOptions(Unchecked);

/// Physics options as written, before validation.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Unchecked {
    /// Preset that the values come from; single values may differ from it.
    pub preset: Preset,
    /// Simulated time per step, s.
    pub timestep: f64,
    /// Shape of the friction cone.
    pub cone: Cone,
    /// Ratio of friction to normal impedance; larger values reduce slip.
    pub impratio: f64,
    /// Constraint solver.
    pub solver: Solver,
    /// Maximum solver iterations per step; below 5, Newton's method loses grasps.
    pub iterations: u32,
    /// Cost improvement below which the solver stops.
    pub tolerance: f64,
    /// Iterations of the slip-removing pass after the solve; 0 disables it.
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

    /// Validates every value.
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
    /// Returns the options of a preset.
    pub fn preset(preset: Preset) -> Self {
        Self(preset.values())
    }

    /// Returns the options of another preset with this one's gravity, and with the discrete integrator if this one has
    /// it (soft bodies need it).
    pub fn with_preset(&self, preset: Preset) -> Self {
        let mut values = Unchecked { gravity: self.gravity, ..preset.values() };
        if self.integrator == Integrator::Discrete {
            values.integrator = Integrator::Discrete;
        }
        Self(values)
    }

    /// Returns the number of steps in `interval` seconds.
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

impl Preset {
    /// All presets, in the order of declaration.
    pub const ALL: [Preset; 6] = [Self::Replay, Self::Fast, Self::Default, Self::Precise, Self::Reference, Self::Stiff];

    /// Returns the name used in scene files and on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::Replay => "replay",
            Self::Fast => "fast",
            Self::Default => "default",
            Self::Precise => "precise",
            Self::Reference => "reference",
            Self::Stiff => "stiff",
        }
    }

    /// Looks up a preset by name.
    ///
    /// # Errors
    /// If the name is unknown; the error lists the valid ones.
    pub fn from_name(name: &str) -> Result<Self> {
        let known = Self::ALL.into_iter().find(|preset| preset.name() == name);
        known.ok_or_else(|| Error::unknown("preset", name, Self::ALL.map(Self::name)))
    }

    /// Returns the option values.
    ///
    /// `replay` has the default's values: its poses are planned at that timestep.
    pub fn values(self) -> Unchecked {
        let default = Unchecked {
            preset: self,
            timestep: 2e-3,
            cone: Cone::Elliptic,
            impratio: 10.0,
            solver: Solver::Newton,
            iterations: 20,
            tolerance: 1e-8,
            noslip_iterations: 0,
            integrator: Integrator::ImplicitFast,
            gravity: [0.0, 0.0, -9.81],
        };
        match self {
            Self::Replay | Self::Default => default,
            Self::Fast => Unchecked { timestep: 4e-3, ..default },
            Self::Precise => Unchecked { timestep: 1e-3, impratio: 100.0, iterations: 50, ..default },
            Self::Reference => Unchecked {
                timestep: FINE_TIMESTEP,
                impratio: 100.0,
                iterations: 100,
                tolerance: FINE_TOLERANCE,
                ..default
            },
            Self::Stiff => Unchecked { timestep: 1e-3, integrator: Integrator::Discrete, ..default },
        }
    }

    /// Returns true if states follow from forces. Otherwise states are recorded or planned, and contacts have positions
    /// but no forces.
    pub fn has_dynamics(self) -> bool {
        self != Self::Replay
    }

    /// Returns the gap up to which separated surfaces are reported as contacts without force, m.
    pub(super) fn near_contact_gap(self) -> f64 {
        match self {
            Self::Replay => 0.01,
            _ => 0.0,
        }
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
    fn values_that_end_the_engine_process_are_refused() {
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
    fn a_preset_fills_the_values_that_a_file_omits() {
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
    fn with_preset_keeps_gravity_and_the_discrete_integrator() {
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

    #[test]
    fn every_preset_is_valid_and_fits_into_a_frame_and_a_control_interval() {
        for preset in Preset::ALL {
            let options = PhysicsOptions::try_from(preset.values()).unwrap();
            assert_eq!(options, PhysicsOptions::preset(preset));
            assert_eq!(options.preset, preset);
            assert!(options.steps_in(0.04).is_ok() && options.steps_in(0.008).is_ok(), "{}", preset.name());
            assert_eq!(Preset::from_name(preset.name()).unwrap(), preset);
        }
        assert_eq!(PhysicsOptions::default(), PhysicsOptions::preset(Preset::Default));
    }

    #[test]
    fn presets_have_the_published_values() {
        let table = [
            (Preset::Fast, 4e-3, 10.0, Integrator::ImplicitFast),
            (Preset::Default, 2e-3, 10.0, Integrator::ImplicitFast),
            (Preset::Precise, 1e-3, 100.0, Integrator::ImplicitFast),
            (Preset::Reference, 5e-5, 100.0, Integrator::ImplicitFast),
            (Preset::Stiff, 1e-3, 10.0, Integrator::Discrete),
        ];
        for (preset, timestep, impratio, integrator) in table {
            let values = preset.values();
            assert_eq!((values.timestep, values.impratio, values.integrator), (timestep, impratio, integrator));
            assert_eq!((values.cone, values.solver), (Cone::Elliptic, Solver::Newton));
            assert!(preset.has_dynamics() && preset.near_contact_gap() == 0.0);
        }
        assert!(!Preset::Replay.has_dynamics() && Preset::Replay.near_contact_gap() == 0.01);
        assert_eq!(Preset::Reference.values().tolerance, 1e-12);
    }

    #[test]
    fn an_unknown_preset_is_refused_with_the_list() {
        let error = Preset::from_name("fats").unwrap_err().to_string();
        assert!(error.contains("fats") && Preset::ALL.iter().all(|preset| error.contains(preset.name())), "{error}");
    }
}
