//! Settings that are compared: presets, and one knob at a time from the default.

use std::borrow::Cow;

use egotac::error::{Error, Result};
use egotac::mujoco::options::Unchecked;
use egotac::mujoco::{Cone, Integrator, PhysicsOptions, Preset};
use egotac::sim::EffectPlan;
use egotac::sim::{RolloutOptions, Scene};

/// Points along each edge of a soft body's grid in the model that other grids are compared with.
const FINEST_GRID: usize = 13;
/// Timestep of the reference of the same model, s.
pub const SAME_MODEL_TIMESTEP: f64 = 1e-4;

/// A parameter that costs time or accuracy.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Knob {
    /// All physics options at once.
    Preset,
    /// Simulated time per step.
    Timestep,
    /// Shape of the friction cone.
    Cone,
    /// Limit of the solver's iterations.
    Iterations,
    /// Integrator.
    Integrator,
    /// Stiffness of friction.
    Impratio,
    /// Corners of the hand's collision hulls.
    Hull,
    /// Points of a soft body's grid.
    Grid,
    /// Kind of label.
    Label,
    /// Size of the picture.
    Size,
    /// Shadows in the picture.
    Shadows,
}

impl Knob {
    /// All knobs, in the order of the table.
    pub const ALL: [Knob; 11] = [
        Self::Preset,
        Self::Timestep,
        Self::Cone,
        Self::Iterations,
        Self::Integrator,
        Self::Impratio,
        Self::Hull,
        Self::Grid,
        Self::Label,
        Self::Size,
        Self::Shadows,
    ];

    /// Name on the command line and in the table.
    pub fn name(self) -> &'static str {
        match self {
            Self::Preset => "preset",
            Self::Timestep => "timestep",
            Self::Cone => "cone",
            Self::Iterations => "iterations",
            Self::Integrator => "integrator",
            Self::Impratio => "impratio",
            Self::Hull => "hull",
            Self::Grid => "grid",
            Self::Label => "label",
            Self::Size => "size",
            Self::Shadows => "shadows",
        }
    }

    /// Returns the knob of this name.
    ///
    /// # Errors
    /// If there is none; the error lists the names.
    pub fn from_name(name: &str) -> Result<Self> {
        let known = Self::ALL.into_iter().find(|knob| knob.name() == name);
        known.ok_or_else(|| Error::unknown("knob", name, Self::ALL.map(Self::name)))
    }

    /// Returns the settings of physics and hulls to compare; empty for a knob of labels or pictures.
    pub fn variants(self) -> Vec<Variant> {
        let variants = |values: &[(&str, Change)]| {
            values.iter().map(|(name, change)| Variant { knob: self, name: (*name).into(), change: *change }).collect()
        };
        match self {
            Self::Preset => {
                let simulated = Preset::ALL.into_iter().filter(|preset| preset.has_dynamics());
                simulated
                    .map(|preset| Variant { knob: self, name: preset.name().into(), change: Change::Preset(preset) })
                    .collect()
            }
            Self::Timestep => variants(&[
                ("0.5 ms", Change::Timestep(5e-4)),
                ("1 ms", Change::Timestep(1e-3)),
                ("2 ms", Change::Timestep(2e-3)),
                ("4 ms", Change::Timestep(4e-3)),
                ("8 ms", Change::Timestep(8e-3)),
            ]),
            Self::Cone => {
                variants(&[("elliptic", Change::Cone(Cone::Elliptic)), ("pyramidal", Change::Cone(Cone::Pyramidal))])
            }
            Self::Iterations => variants(&[
                ("1", Change::Iterations(1)),
                ("2", Change::Iterations(2)),
                ("3", Change::Iterations(3)),
                ("5", Change::Iterations(5)),
                ("20", Change::Iterations(20)),
                ("100", Change::Iterations(100)),
            ]),
            Self::Integrator => variants(&[
                ("euler", Change::Integrator(Integrator::Euler)),
                ("implicitfast", Change::Integrator(Integrator::ImplicitFast)),
                ("implicit", Change::Integrator(Integrator::Implicit)),
                ("discrete", Change::Integrator(Integrator::Discrete)),
                ("rk4", Change::Integrator(Integrator::Rk4)),
            ]),
            Self::Impratio => variants(&[
                ("1", Change::Impratio(1.0)),
                ("10", Change::Impratio(10.0)),
                ("100", Change::Impratio(100.0)),
            ]),
            Self::Hull => variants(&[
                ("8 corners", Change::Corners(Some(8))),
                ("16 corners", Change::Corners(Some(16))),
                ("32 corners", Change::Corners(Some(32))),
                ("all corners", Change::Corners(None)),
            ]),
            Self::Grid => variants(&[
                ("as the scene says", Change::Grid(None)),
                ("5 points", Change::Grid(Some(5))),
                ("7 points", Change::Grid(Some(7))),
                ("9 points", Change::Grid(Some(9))),
                ("11 points", Change::Grid(Some(11))),
                ("13 points", Change::Grid(Some(FINEST_GRID))),
            ]),
            Self::Label | Self::Size | Self::Shadows => Vec::new(),
        }
    }
}

/// One setting of a knob.
#[derive(Debug, Clone, PartialEq)]
pub struct Variant {
    /// The knob.
    pub knob: Knob,
    /// Name of the setting.
    pub name: String,
    /// Change from the default.
    pub change: Change,
}

/// Change of a setting from the default.
#[derive(Debug, Clone, Copy, PartialEq)]
#[allow(missing_docs)]
pub enum Change {
    Preset(Preset),
    Timestep(f64),
    Cone(Cone),
    Iterations(u32),
    Integrator(Integrator),
    Impratio(f64),
    Corners(Option<usize>),
    Grid(Option<usize>),
}

/// Physics, hulls and grids of a run.
#[derive(Debug, Clone, PartialEq)]
pub struct Setup {
    /// Physics options.
    pub physics: PhysicsOptions,
    /// Largest number of corners of each link's hull; `None` = all.
    pub corners: Option<usize>,
    /// Points along each edge of a soft body's grid; `None` = as the scene says.
    pub points: Option<usize>,
}

impl Setup {
    /// Creates a variant of a scene's physics; gravity and what soft bodies need stay.
    ///
    /// # Errors
    /// If a value is out of range.
    pub fn new(scene: &PhysicsOptions, change: Change) -> Result<Self> {
        let preset = match change {
            Change::Preset(preset) => preset,
            _ => Preset::Default,
        };
        // All variants carry one preset name, so that equal values are equal setups and run once.
        let mut values = Unchecked { preset: Preset::Default, ..scene.with_preset(preset).into() };
        let (mut corners, mut points) = (None, None);
        match change {
            Change::Preset(_) => (),
            Change::Timestep(timestep) => values.timestep = timestep,
            Change::Cone(cone) => values.cone = cone,
            Change::Iterations(iterations) => values.iterations = iterations,
            Change::Integrator(integrator) => values.integrator = integrator,
            Change::Impratio(impratio) => values.impratio = impratio,
            Change::Corners(most) => corners = most,
            Change::Grid(wanted) => points = wanted,
        }
        Ok(Self { physics: values.try_into()?, corners, points })
    }

    /// Returns the fine reference of the same model: same cone, impratio and hulls, 0.1 ms, tolerance 1e-12. The reference
    /// model is its own reference, at 0.05 ms.
    ///
    /// # Errors
    /// Never for a valid setup.
    pub fn reference(&self, scene: &PhysicsOptions) -> Result<Self> {
        let model = Self::model(scene)?;
        let values =
            Unchecked { cone: self.physics.cone, impratio: self.physics.impratio, ..model.physics.clone().into() };
        let fine = Self { physics: values.clone().try_into()?, ..self.clone() };
        if fine == model {
            return Ok(model);
        }
        Ok(Self { physics: Unchecked { timestep: SAME_MODEL_TIMESTEP, ..values }.try_into()?, ..fine })
    }

    /// Returns the scene with this setup's grids.
    pub fn scene<'a>(&self, scene: &'a Scene) -> Cow<'a, Scene> {
        let Some(points) = self.points else { return Cow::Borrowed(scene) };
        let mut scene = scene.clone();
        scene.spec.objects.iter_mut().for_each(|object| object.shape.set_points(points));
        Cow::Owned(scene)
    }

    /// Returns the options of a rollout of `scene`: as the scene's effects ask for, except impratio, which is as set.
    ///
    /// # Errors
    /// If the effects can't deliver what the scene observes.
    pub fn options(&self, scene: &Scene, base: &RolloutOptions) -> Result<RolloutOptions> {
        let plan = EffectPlan::of(&scene.spec)?;
        let effects = base.effects.unwrap_or(plan.effects());
        let values = Unchecked { impratio: self.physics.impratio, ..plan.physics(effects, &self.physics)?.into() };
        Ok(RolloutOptions { physics: Some(values.try_into()?), hull_corners: self.corners, ..base.clone() })
    }

    /// Returns the reference model: elliptic, impratio 100, 0.05 ms, all corners, the scene's grids.
    ///
    /// # Errors
    /// Never for a valid scene.
    pub fn model(scene: &PhysicsOptions) -> Result<Self> {
        Self::new(scene, Change::Preset(Preset::Reference))
    }

    /// Returns the model that a change is compared with: the reference model, with the finest grid where grids are compared.
    ///
    /// # Errors
    /// As [`Self::model`].
    pub fn model_for(scene: &PhysicsOptions, change: Change) -> Result<Self> {
        let points = matches!(change, Change::Grid(_)).then_some(FINEST_GRID);
        Ok(Self { points, ..Self::model(scene)? })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_knob_has_the_default_among_its_settings() {
        let scene = PhysicsOptions::default();
        let default = Setup::new(&scene, Change::Preset(Preset::Default)).unwrap();
        for knob in Knob::ALL {
            assert_eq!(Knob::from_name(knob.name()).unwrap(), knob);
            let setups: Vec<Setup> = knob.variants().iter().map(|v| Setup::new(&scene, v.change).unwrap()).collect();
            assert!(setups.is_empty() || setups.iter().filter(|setup| **setup == default).count() == 1, "{knob:?}");
        }
        assert!(Knob::from_name("kone").unwrap_err().to_string().contains("timestep"));
    }

    #[test]
    fn impratio_stays_as_set_in_a_scene_with_a_long_hold() {
        let scene = Scene::load("lift_mug").unwrap();
        for impratio in [1.0, 100.0] {
            let setup = Setup::new(&scene.spec.physics, Change::Impratio(impratio)).unwrap();
            let options = setup.options(&scene, &RolloutOptions::default()).unwrap();
            assert_eq!(options.physics.unwrap().impratio, impratio);
        }
    }

    #[test]
    fn grids_are_changed_in_soft_objects_alone_and_compared_with_the_finest() {
        let (soft, rigid) = (Scene::load("squeeze_ball").unwrap(), Scene::load("pinch_cube").unwrap());
        let physics = &soft.spec.physics;
        let coarse = Setup::new(physics, Change::Grid(Some(5))).unwrap();
        assert_eq!(*coarse.scene(&rigid), rigid);
        assert_ne!(*coarse.scene(&soft), soft);
        assert_eq!(*Setup::new(physics, Change::Grid(None)).unwrap().scene(&soft), soft);
        assert_eq!(coarse.reference(physics).unwrap().points, Some(5));
        assert_eq!(Setup::model_for(physics, Change::Grid(Some(5))).unwrap().points, Some(FINEST_GRID));
        assert_eq!(Setup::model_for(physics, Change::Timestep(1e-3)).unwrap(), Setup::model(physics).unwrap());
    }

    #[test]
    fn the_reference_of_the_reference_is_itself() {
        let scene = PhysicsOptions::default();
        let model = Setup::model(&scene).unwrap();
        assert_eq!(model.reference(&scene).unwrap(), model);
        let precise = Setup::new(&scene, Change::Preset(Preset::Precise)).unwrap();
        assert_eq!(precise.reference(&scene).unwrap(), model);
        let cone = Setup::new(&scene, Change::Cone(Cone::Pyramidal)).unwrap().reference(&scene).unwrap();
        assert_eq!((cone.physics.cone, cone.physics.impratio), (Cone::Pyramidal, 10.0));
        assert_eq!((cone.physics.timestep, cone.physics.tolerance), (1e-4, 1e-12));
    }
}
