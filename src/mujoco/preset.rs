//! Named physics options: how exact, at what price.

use serde::{Deserialize, Serialize};

use super::options::{Cone, Integrator, Solver, Unchecked};
use crate::error::{Error, Result};

/// Timestep of the finest preset, s; what references are computed with.
pub const FINE_TIMESTEP: f64 = 5e-5;
/// Tolerance of the solver in a reference.
pub const FINE_TOLERANCE: f64 = 1e-12;

/// A named set of physics options, from the cheapest to the most exact; `stiff` is for what the others lose.
///
/// `docs/bench/sim.md` holds what each of them costs and how far it is from a reference.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Preset {
    /// Places of contact on recorded or planned poses: kinematics and collision, no dynamics and so no forces.
    Replay,
    /// Sweeps: 4 ms.
    Fast,
    /// Training data: elliptic cone, impratio 10 (a held object doesn't creep out of the hand), 2 ms.
    #[default]
    Default,
    /// Tables that verify something: impratio 100, 1 ms.
    Precise,
    /// What the others are measured against: impratio 100, 0.05 ms, tolerance 1e-12.
    Reference,
    /// Huge servo gains, direct solref, soft bodies: the discrete integrator, 1 ms.
    Stiff,
}

impl Preset {
    /// All presets.
    pub const ALL: [Preset; 6] = [Self::Replay, Self::Fast, Self::Default, Self::Precise, Self::Reference, Self::Stiff];

    /// Name, as in scenes and on the command line.
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

    /// The preset of that name.
    ///
    /// # Errors
    /// If there is none; the error lists them.
    pub fn from_name(name: &str) -> Result<Self> {
        let known = Self::ALL.into_iter().find(|preset| preset.name() == name);
        known.ok_or_else(|| Error::unknown("preset", name, Self::ALL.map(Self::name)))
    }

    /// The options themselves.
    ///
    /// Those of `replay` are the default's: its poses are planned in their steps.
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

    /// Whether states follow from forces; without, they are recorded or planned, and contacts have places but no forces.
    pub fn has_dynamics(self) -> bool {
        self != Self::Replay
    }

    /// Distance up to which surfaces that don't touch are reported as contacts without force, m.
    pub fn near_contact_gap(self) -> f64 {
        match self {
            Self::Replay => 0.01,
            _ => 0.0,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mujoco::PhysicsOptions;

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
