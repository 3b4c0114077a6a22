//! Which effects a scene gets, and why.

use serde::Deserialize;
use serde::de::{self, Deserializer};

use super::{Effect, EffectSet, Observation};
use crate::error::{Error, Result};
use crate::mujoco::{Integrator, PhysicsOptions};
use crate::sim::scene::{ActSpec, ObjectSpec, SceneSpec};

/// More idle free bodies than this are worth putting to sleep.
const FEW_IDLE_BODIES: f64 = 8.0;
/// A hold longer than this slips out of a grip whose friction creeps, s.
const LONG_HOLD: f64 = 1.0;
/// Least ratio of friction's stiffness to that of normal forces in a long hold: creep falls to a seventh.
const HOLDING_IMPRATIO: f64 = 10.0;
/// Longest step with a soft body, s.
const SOFT_TIMESTEP: f64 = 1e-3;

/// Effects as a scene writes them: `auto`, or a list.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum EffectsSpec {
    /// The least that gives what is observed.
    #[default]
    Auto,
    /// These and no others.
    Listed(EffectSet),
}

impl<'de> Deserialize<'de> for EffectsSpec {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> std::result::Result<Self, D::Error> {
        #[derive(Deserialize)]
        #[serde(untagged)]
        enum Written {
            Word(String),
            List(Vec<String>),
        }
        let expected = || {
            let names: Vec<&str> = Effect::ALL.into_iter().map(Effect::name).collect();
            format!("`auto` or a list of {}", names.join(", "))
        };
        let names = match Written::deserialize(deserializer) {
            Ok(Written::Word(word)) if word == "auto" => return Ok(Self::Auto),
            Ok(Written::Word(word)) => return Err(de::Error::custom(format!("expected {}, got {word:?}", expected()))),
            Ok(Written::List(names)) => names,
            Err(_) => return Err(de::Error::custom(format!("expected {}", expected()))),
        };
        let find = |name: &String| {
            let effect = Effect::ALL.into_iter().find(|effect| effect.name() == name);
            effect.ok_or_else(|| de::Error::custom(format!("expected {}, got {name:?}", expected())))
        };
        Ok(Self::Listed(names.iter().map(find).collect::<std::result::Result<EffectSet, D::Error>>()?))
    }
}

/// What a scene simulates, and why.
#[derive(Debug, Clone, PartialEq)]
pub struct EffectPlan {
    effects: EffectSet,
    /// Why each effect is on or off, in the order of [`Effect::ALL`].
    reasons: [String; 14],
    long_hold: bool,
}

impl EffectPlan {
    /// Decides what `scene` simulates.
    ///
    /// # Errors
    /// If the scene lists effects that cannot deliver what it observes; the error names the missing one.
    pub fn of(scene: &SceneSpec) -> Result<Self> {
        let facts = Facts::of(scene);
        let automatic = facts.decide();
        let mut effects = EffectSet::default();
        let mut reasons: [String; 14] = Default::default();
        for (index, (effect, (on, reason))) in Effect::ALL.into_iter().zip(automatic).enumerate() {
            let (on, reason) = match scene.effects {
                EffectsSpec::Auto => (on, reason),
                EffectsSpec::Listed(listed) if listed.contains(effect) => (true, "the scene lists it"),
                EffectsSpec::Listed(_) => (false, "the scene's list leaves it out"),
            };
            effects = if on { effects.with(effect) } else { effects };
            reasons[index] = reason.into();
        }
        effects.check()?;
        for observation in &scene.observe {
            if let Some(missing) = observation.needs().iter().find(|needed| !effects.contains(**needed)) {
                let expected = format!("{missing}, which observing {} needs", observation.name());
                return Err(Error::value("effects", expected, effects));
            }
        }
        Ok(Self { effects, reasons, long_hold: facts.hold > LONG_HOLD })
    }

    /// The effects that are on.
    pub fn effects(&self) -> EffectSet {
        self.effects
    }

    /// Why an effect is on or off.
    pub fn reason(&self, effect: Effect) -> &str {
        &self.reasons[effect as usize]
    }

    /// The physics options that the effects ask for, from those of the scene.
    ///
    /// # Errors
    /// Never with options that are checked already; the signature is that of the check.
    pub fn physics(&self, effects: EffectSet, options: &PhysicsOptions) -> Result<PhysicsOptions> {
        let mut wanted = crate::mujoco::options::Unchecked::from(options.clone());
        if effects.contains(Effect::SoftBody) {
            wanted.integrator = Integrator::Discrete;
            wanted.timestep = wanted.timestep.min(SOFT_TIMESTEP);
        }
        if effects.contains(Effect::Friction) && self.long_hold && wanted.noslip_iterations == 0 {
            wanted.impratio = wanted.impratio.max(HOLDING_IMPRATIO);
        }
        wanted.try_into()
    }
}

/// What decides about effects.
struct Facts {
    observed: Vec<Observation>,
    replay: bool,
    presses: bool,
    lifts: bool,
    twists: bool,
    /// Longest time for which an object may hang in a grip, s.
    hold: f64,
    free_bodies: f64,
    idle_bodies: f64,
    articulated: bool,
    soft: bool,
    lens: bool,
    noise: bool,
    shutter: bool,
}

impl Facts {
    fn of(scene: &SceneSpec) -> Self {
        let acts: Vec<&ActSpec> = scene.hands.iter().filter_map(|hand| hand.act.as_ref()).collect();
        let free = |object: &&ObjectSpec| object.is_free();
        let used = |name: &str| acts.iter().any(|act| act.object == name);
        let idle = scene.objects.iter().filter(free).filter(|object| !used(&object.name)).count() as f64;
        let lifting = acts.iter().filter(|act| act.lifts());
        let seconds = |act: &&&ActSpec| act.script.iter().map(|phase| phase.seconds.high()).sum::<f64>();
        Self {
            observed: scene.observe.clone(),
            replay: !scene.physics.preset.has_dynamics(),
            presses: acts.iter().any(|act| act.presses()),
            lifts: acts.iter().any(|act| act.lifts()),
            twists: acts.iter().any(|act| act.twists()),
            hold: lifting.clone().map(|act| seconds(&act)).fold(0.0, f64::max),
            free_bodies: scene.objects.iter().filter(free).count() as f64 + scene.distractors.high(),
            idle_bodies: idle + scene.distractors.high(),
            articulated: scene.objects.iter().any(|object| object.shape.is_articulated()),
            soft: scene.objects.iter().any(|object| object.shape.is_soft()),
            lens: scene.camera.distortion.iter().any(|k| k.low() != 0.0 || k.high() != 0.0),
            noise: scene.camera.noise.high() > 0.0,
            shutter: scene.camera.shutter.high() > 0.0,
        }
    }

    /// On or off, and why, for each effect in the order of [`Effect::ALL`].
    fn decide(&self) -> [(bool, &'static str); 14] {
        let observes = |wanted: &[Observation]| wanted.iter().any(|w| self.observed.contains(w));
        let forces = observes(&[Observation::Force, Observation::Slip]);
        let pictures = observes(&[Observation::Rgb, Observation::Depth]);
        let touch = observes(&[Observation::Contact, Observation::Force, Observation::Slip]);
        let dynamics = (forces || self.presses) && !self.replay;
        let unpressed = "no force is wanted and no hand presses: poses follow from the plan";
        let still = "without dynamics nothing pushes";
        [
            match (forces, self.presses) {
                _ if self.replay => (false, "the preset replay has none: poses follow from the plan"),
                (true, _) => (true, "force or slip is wanted"),
                (_, true) => (true, "a hand presses on an object, which moves"),
                _ => (false, unpressed),
            },
            match (touch, dynamics) {
                (true, _) => (true, "touch is wanted"),
                (_, true) => (true, "objects rest on the table and move by touch"),
                _ => (false, "touch is not wanted, and nothing moves by it"),
            },
            if dynamics { (true, "what is pressed must not slide off") } else { (false, still) },
            match (dynamics, self.lifts, self.twists) {
                (false, ..) => (false, still),
                (_, true, _) => (true, "an object hangs between few contacts and would spin"),
                (_, _, true) => (true, "an object is turned by fingertips"),
                _ => (false, "nothing hangs in a grip or is turned"),
            },
            match (dynamics, self.free_bodies > 0.0 || self.soft) {
                (false, _) => (false, still),
                (_, true) => (true, "objects that nothing else holds must rest on the table"),
                _ => (false, "no object is free to fall; hands carry themselves"),
            },
            match (dynamics, self.articulated) {
                (_, false) => (false, "no object has a joint"),
                (false, _) => (false, "nothing moves the joints"),
                _ => (true, "an object has a joint"),
            },
            match (dynamics, self.soft) {
                (_, false) => (false, "no object is soft"),
                (false, _) => (false, "nothing deforms the soft object"),
                _ => (true, "an object is soft; integrator discrete, steps of at most 1 ms"),
            },
            match (dynamics, self.idle_bodies > FEW_IDLE_BODIES) {
                (true, true) => (true, "many free bodies lie idle; touch is read from awake ones"),
                (false, _) => (false, still),
                _ => (false, "few bodies lie idle"),
            },
            match (dynamics, touch) {
                (false, true) => (true, "without forces, places within 1 cm come from collision detection"),
                (true, _) => (false, "contacts with force say where touch is"),
                _ => (false, "touch is not wanted"),
            },
            if pictures { (true, "pictures are wanted") } else { (false, "no picture is wanted: no OpenGL context") },
            (false, "only where a scene lists it: a shadow map makes a picture five times as dear"),
            match (pictures, self.lens) {
                (true, true) => (true, "the camera's lens bends lines"),
                (false, _) => (false, "no picture is wanted"),
                _ => (false, "the camera's lens bends nothing"),
            },
            match (pictures, self.noise) {
                (true, true) => (true, "the camera has noise"),
                (false, _) => (false, "no picture is wanted"),
                _ => (false, "the camera has none"),
            },
            match (pictures, self.shutter) {
                (true, true) => (true, "the camera's shutter takes time"),
                (false, _) => (false, "no picture is wanted"),
                _ => (false, "the camera's shutter takes no time"),
            },
        ]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sim::Scene;

    fn scene(observe: &str, rest: &str) -> Result<Scene> {
        let hands = "hands: [{ side: right }]";
        let text = format!("description: test\nobserve: {observe}\nobjects: []\n{hands}\n{rest}");
        Scene::parse("test", std::path::Path::new("test.yaml"), &text)
    }

    #[test]
    fn poses_alone_need_nothing() {
        let plan = EffectPlan::of(&scene("[pose]", "").unwrap().spec).unwrap();
        assert_eq!(plan.effects(), EffectSet::default(), "{}", plan.effects());
    }

    #[test]
    fn places_need_collision_and_forces_need_dynamics() {
        let of = |observe: &str| EffectPlan::of(&scene(observe, "").unwrap().spec).unwrap().effects();
        assert_eq!(of("[pose, contact]"), [Effect::RigidContact, Effect::NearContact].into_iter().collect());
        assert!(of("[force]").contains(Effect::Dynamics) && !of("[force]").contains(Effect::NearContact));
        assert!(!of("[force]").contains(Effect::Rendering) && of("[depth]").contains(Effect::Rendering));
    }

    #[test]
    fn a_list_that_cannot_deliver_names_what_is_missing() {
        let error = |observe: &str, list: &str| scene(observe, list).unwrap_err().to_string();
        let text = error("[rgb]", "effects: [dynamics]");
        assert!(text.contains("rendering, which observing rgb needs"), "{text}");
        let text = error("[force]", "effects: [rigid_contact]");
        assert!(text.contains("dynamics, which observing force needs"), "{text}");
        let text = error("[pose]", "effects: [shadows]");
        assert!(text.contains("rendering, which shadows needs"), "{text}");
        let text = error("[pose]", "effects: [wind]");
        assert!(text.contains("wind") && text.contains("motion_blur"), "{text}");
        let text = error("[pose]", "effects: most");
        assert!(text.contains("most") && text.contains("auto"), "{text}");
    }
}
