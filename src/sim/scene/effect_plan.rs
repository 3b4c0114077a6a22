//! Selection of a scene's effects, each with its reason.

use super::act::ActSpec;
use super::object::ObjectSpec;
use super::spec::SceneSpec;
use crate::error::{Error, Result};
use crate::mujoco::{Integrator, PhysicsOptions};
use crate::sim::effect::{Effect, EffectSet, EffectsSpec, Observation};

/// Number of idle free bodies above which they are put to sleep: below, sleep saves no time.
const MAX_AWAKE_IDLE_BODIES: f64 = 8.0;
/// Duration of a hold above which friction creep matters, s: default friction lets go of the object.
const LONG_HOLD: f64 = 1.0;
/// Smallest ratio of friction stiffness to normal stiffness in a long hold: creep falls to a seventh of the default's.
const HOLDING_IMPRATIO: f64 = 10.0;
/// Number of effects.
const N_EFFECTS: usize = Effect::ALL.len();
/// Reason of effects that need dynamics.
const NO_DYNAMICS: &str = "there is no dynamics";

/// State of an effect, and its reason.
type Decision = (bool, &'static str);

/// Effects of a scene, each with the reason why it is on or off.
#[derive(Debug, Clone, PartialEq)]
pub struct EffectPlan {
    effects: EffectSet,
    /// Reason of each effect, in the order of [`Effect::ALL`].
    reasons: [String; N_EFFECTS],
    /// True if an object may hang in a grip longer than [`LONG_HOLD`].
    long_hold: bool,
}

impl EffectPlan {
    /// Selects the effects of `scene`.
    ///
    /// # Errors
    /// If the scene lists effects that cannot deliver its observations; the error names the missing effect.
    pub fn of(scene: &SceneSpec) -> Result<Self> {
        let facts = SceneFacts::of(scene);
        let automatic = facts.decide();
        let mut effects = EffectSet::default();
        let mut reasons: [String; N_EFFECTS] = Default::default();
        for (index, (effect, (on, reason))) in Effect::ALL.into_iter().zip(automatic).enumerate() {
            let (on, reason) = match scene.effects {
                EffectsSpec::Auto => (on, reason),
                EffectsSpec::Listed(listed) if listed.contains(effect) => (true, "the scene lists it"),
                EffectsSpec::Listed(_) => (false, "the scene's list does not contain it"),
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

    /// Returns the effects that are on.
    pub fn effects(&self) -> EffectSet {
        self.effects
    }

    /// Returns the reason why an effect is on or off.
    pub fn reason(&self, effect: Effect) -> &str {
        &self.reasons[effect as usize]
    }

    /// Returns `options` with the changes that the effects require.
    ///
    /// # Errors
    /// Never for options that are already checked; the signature is that of the check.
    pub fn physics(&self, effects: EffectSet, options: &PhysicsOptions) -> Result<PhysicsOptions> {
        let mut wanted = crate::mujoco::options::Unchecked::from(options.clone());
        if effects.contains(Effect::SoftBody) {
            wanted.integrator = Integrator::Discrete;
        }
        if effects.contains(Effect::Friction) && self.long_hold && wanted.noslip_iterations == 0 {
            wanted.impratio = wanted.impratio.max(HOLDING_IMPRATIO);
        }
        wanted.try_into()
    }
}

/// Facts about a scene that decide about its effects.
struct SceneFacts {
    observed: Vec<Observation>,
    replay: bool,
    presses: bool,
    lifts: bool,
    twists: bool,
    /// Longest time that an object may hang in a grip, s.
    hold: f64,
    free_bodies: f64,
    idle_bodies: f64,
    articulated: bool,
    soft: bool,
    lens: bool,
    noise: bool,
    shutter: bool,
    style: EffectSet,
}

impl SceneFacts {
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
            soft: scene.has_soft_object(),
            lens: scene.camera.distortion.iter().any(|k| k.low() != 0.0 || k.high() != 0.0),
            noise: scene.camera.noise.high() > 0.0,
            shutter: scene.camera.shutter.high() > 0.0,
            style: scene.look.style.effects(),
        }
    }

    /// Decides for each effect in the order of [`Effect::ALL`].
    fn decide(&self) -> [Decision; N_EFFECTS] {
        let dynamics = (self.observes_force() || self.presses) && !self.replay;
        [
            self.decide_dynamics(),
            self.decide_rigid_contact(dynamics),
            if dynamics { (true, "pressed objects must not slide off") } else { (false, NO_DYNAMICS) },
            self.decide_torsional_friction(dynamics),
            self.decide_gravity(dynamics),
            match (dynamics, self.articulated) {
                (_, false) => (false, "no object has a joint"),
                (false, _) => (false, "there is no dynamics to move the joints"),
                _ => (true, "an object has a joint"),
            },
            match (dynamics, self.soft) {
                (_, false) => (false, "no object is soft"),
                (false, _) => (false, "there is no dynamics to deform the soft object"),
                _ => (true, "an object is soft; the integrator is discrete"),
            },
            match (dynamics, self.idle_bodies > MAX_AWAKE_IDLE_BODIES) {
                (true, true) => (true, "many free bodies are idle; contacts are read from awake bodies"),
                (false, _) => (false, NO_DYNAMICS),
                _ => (false, "few bodies are idle"),
            },
            self.decide_near_contact(dynamics),
            match self.observes_pictures() {
                true => (true, "pictures are observed"),
                false => (false, "no picture is observed: no OpenGL context is created"),
            },
            (false, "only where a scene lists it: with shadows a picture takes five times as long"),
            self.decide_picture(
                self.lens,
                ["the camera's lens distorts the picture", "the camera's lens has no distortion"],
            ),
            self.decide_picture(self.noise, ["the camera has noise", "the camera has no noise"]),
            self.decide_picture(self.shutter, ["the camera has an exposure time", "the camera has no exposure time"]),
            self.decide_style(Effect::SkinDetail),
            self.decide_style(Effect::Textures),
            self.decide_style(Effect::Clutter),
            self.decide_style(Effect::AmbientOcclusion),
            self.decide_style(Effect::Wearer),
            self.decide_style(Effect::MoreLamps),
            self.decide_style(Effect::OtherCamera),
            self.decide_style(Effect::RollingShutter),
            self.decide_style(Effect::CameraProcessing),
        ]
    }

    fn observes(&self, wanted: &[Observation]) -> bool {
        wanted.iter().any(|observation| self.observed.contains(observation))
    }

    fn observes_force(&self) -> bool {
        self.observes(&[Observation::Force, Observation::Slip])
    }

    fn observes_touch(&self) -> bool {
        self.observes(&[Observation::Contact, Observation::Force, Observation::Slip])
    }

    fn observes_pictures(&self) -> bool {
        self.observes(&[Observation::Rgb, Observation::Depth])
    }

    fn decide_dynamics(&self) -> Decision {
        match (self.observes_force(), self.presses) {
            _ if self.replay => (false, "the preset replay has no dynamics: poses follow the plan"),
            (true, _) => (true, "force or slip is observed"),
            (_, true) => (true, "a hand presses on an object, and the object moves"),
            _ => (false, "no force is observed and no hand presses: poses follow the plan"),
        }
    }

    fn decide_rigid_contact(&self, dynamics: bool) -> Decision {
        match (self.observes_touch(), dynamics) {
            (true, _) => (true, "contact, force or slip is observed"),
            (_, true) => (true, "objects rest on the table and are moved by contact"),
            _ => (false, "no contact is observed, and nothing moves by contact"),
        }
    }

    fn decide_torsional_friction(&self, dynamics: bool) -> Decision {
        match (dynamics, self.lifts, self.twists) {
            (false, ..) => (false, NO_DYNAMICS),
            (_, true, _) => (true, "a held object would spin about its few contacts"),
            (_, _, true) => (true, "fingertips turn an object"),
            _ => (false, "no object is lifted or turned"),
        }
    }

    fn decide_gravity(&self, dynamics: bool) -> Decision {
        match (dynamics, self.free_bodies > 0.0 || self.soft) {
            (false, _) => (false, NO_DYNAMICS),
            (_, true) => (true, "free objects must rest on the table"),
            _ => (false, "no object is free to fall; hands have no weight"),
        }
    }

    fn decide_near_contact(&self, dynamics: bool) -> Decision {
        match (dynamics, self.observes_touch()) {
            (false, true) => (true, "without forces, collision detection finds the vertices within 1 cm"),
            (true, _) => (false, "contact forces tell where touch is"),
            _ => (false, "no contact is observed"),
        }
    }

    /// Decides an effect of the look's style.
    fn decide_style(&self, effect: Effect) -> Decision {
        let reasons = ["the style of the look has it", "the style of the look does without it"];
        self.decide_picture(self.style.contains(effect), reasons)
    }

    /// Decides an effect of the camera: it is on if the camera has the property and pictures are observed.
    fn decide_picture(&self, present: bool, [on, off]: [&'static str; 2]) -> Decision {
        match (self.observes_pictures(), present) {
            (true, true) => (true, on),
            (false, _) => (false, "no picture is observed"),
            _ => (false, off),
        }
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
    fn pose_alone_needs_no_effect() {
        let plan = EffectPlan::of(&scene("[pose]", "").unwrap().spec).unwrap();
        assert_eq!(plan.effects(), EffectSet::default(), "{}", plan.effects());
    }

    #[test]
    fn contact_needs_collision_and_force_needs_dynamics() {
        let of = |observe: &str| EffectPlan::of(&scene(observe, "").unwrap().spec).unwrap().effects();
        assert_eq!(of("[pose, contact]"), [Effect::RigidContact, Effect::NearContact].into_iter().collect());
        assert!(of("[force]").contains(Effect::Dynamics) && !of("[force]").contains(Effect::NearContact));
        assert!(!of("[force]").contains(Effect::Rendering) && of("[depth]").contains(Effect::Rendering));
    }

    #[test]
    fn insufficient_list_names_the_missing_effect() {
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
