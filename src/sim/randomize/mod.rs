//! Episodes of a scene: all values that the scene leaves open, drawn from a seed.

pub(crate) mod camera;

use std::f64::consts::PI;

use glam::{DQuat, DVec3};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use sha2::{Digest, Sha256};

use super::appearance::{Appearance, Glove, Rgb, colour, skin, texture};
use super::effect::{Effect, EffectSet};
use super::object::Object;
use super::photo::PhotoDraw;
use super::range::UniformRange;
use super::rig::{HandRig, Hinge, HingeMotion, base_joint};
use super::scene::{ActSpec, HandSite, HandSpec, ObjectSpec, Scene, SceneSpec, ShapeSpec, SideSpec, holding_force};
use super::timeline::Timeline;
use crate::error::{Error, Result};
use crate::hand::Side;

pub use camera::CameraDraw;

/// Distance of distractors from the scene's own objects, m.
const WORKSPACE_MARGIN: f64 = 0.1;
/// Distance of distractors from the hands at the start, m: skin and sleeve are slightly thicker than the vertices.
const HAND_MARGIN: f64 = 0.01;
/// Drawn values of an episode.
#[derive(Debug, Clone)]
pub struct EpisodeDraw {
    /// Objects in the scene's order, then distractors.
    pub objects: Vec<ObjectDraw>,
    /// Hands that are present, in the scene's order.
    pub hands: Vec<HandDraw>,
    /// Camera.
    pub camera: CameraDraw,
    /// Colours and lights.
    pub appearance: Appearance,
    /// Richer looks.
    pub photo: PhotoDraw,
    /// End of the last script, s.
    pub duration: f64,
}

/// Drawn values of an object.
#[derive(Debug, Clone)]
pub struct ObjectDraw {
    /// Name.
    pub name: String,
    /// Shape.
    pub shape: Object,
    /// Mass, kg.
    pub mass: f64,
    /// Coefficient of sliding friction.
    pub friction: f64,
    /// Start position in the world frame, m.
    pub position: DVec3,
    /// Start orientation.
    pub orientation: DQuat,
    /// Coefficient of sliding friction against the table where it differs.
    pub table_friction: Option<f64>,
    /// True if the object exists in the world; otherwise it is a place to reach.
    pub solid: bool,
    /// Colour.
    pub colour: Rgb,
    /// Pattern and second colour; `None` = one colour.
    pub texture: Option<(&'static str, Rgb)>,
}

/// Drawn values of a hand.
#[derive(Debug, Clone)]
pub struct HandDraw {
    /// Side of the hand.
    pub side: Side,
    /// Position of the wrist with all wrist joints at zero, m.
    pub wrist: DVec3,
    /// Orientation of the hand with all wrist joints at zero.
    pub orientation: DQuat,
    /// Rest angles of the fingers in the rig's order, rad.
    pub posture: Vec<f64>,
    /// Act; `None` = idle.
    pub act: Option<ActDraw>,
    /// Fingers that wrap, and the torque at the knuckle, N m.
    pub wrap: Option<(Vec<HandSite>, f64)>,
    /// Colour of the skin.
    pub skin: Rgb,
    /// Colour of the sleeve.
    pub sleeve: Rgb,
    /// Glove over the hand; `None` = bare.
    pub glove: Option<Glove>,
}

/// Drawn values of an act.
#[derive(Debug, Clone)]
pub struct ActDraw {
    /// Index of the touched object.
    pub object: usize,
    /// Contact goals.
    pub goals: Vec<ContactGoal>,
    /// Unit direction from the object to where the hand comes from, world frame.
    pub from: DVec3,
    /// Course in time.
    pub timeline: Timeline,
}

/// Contact goal in the world frame, at the object's start.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ContactGoal {
    /// Part of the hand that touches.
    pub site: HandSite,
    /// Point on the surface, m.
    pub point: DVec3,
    /// Outward unit normal of the surface.
    pub normal: DVec3,
    /// Normal force, N.
    pub force: f64,
}

impl EpisodeDraw {
    /// Draws an episode; the same scene, seed and rigs give the same episode, bit for bit.
    ///
    /// # Errors
    /// If a contact goal misses its object, or a mesh file cannot be read.
    pub fn sample(scene: &Scene, seed: u64, rigs: &[HandRig; 2]) -> Result<Self> {
        // One stream per part: a scene that draws one number more for its objects keeps its camera and colours.
        let stream = |index: u64| {
            let digest = Sha256::digest(scene.name.as_bytes());
            let name = u64::from_le_bytes(std::array::from_fn(|i| digest[i]));
            let mut rng = ChaCha8Rng::seed_from_u64(seed ^ name);
            rng.set_stream(index);
            rng
        };
        let spec = &scene.spec;
        let mut rng = stream(0);
        let right_acts = rng.random::<bool>();
        let actor = match spec.hands[0].side {
            SideSpec::Left => Side::Left,
            SideSpec::Right => Side::Right,
            SideSpec::Either if right_acts => Side::Right,
            SideSpec::Either => Side::Left,
        };
        let mirror = actor == Side::Left;
        let mut rng = stream(1);
        let mut objects =
            spec.objects.iter().map(|o| ObjectDraw::sample(o, mirror, &mut rng)).collect::<Result<Vec<_>>>()?;
        let mut hands: Vec<HandDraw> = Vec::new();
        for (index, hand) in spec.hands.iter().enumerate() {
            let mut rng = stream(2 + index as u64);
            let side = if (index == 0) == (actor == Side::Left) { Side::Left } else { Side::Right };
            let present = rng.random::<f64>() < hand.presence;
            if present {
                let rig = &rigs[side as usize];
                let mut drawn = HandDraw::sample(hand, rig, &objects, spec, &mut rng)?;
                if let (Some(act), Some(spec)) = (&mut drawn.act, hand.act.as_ref().filter(|act| act.in_step)) {
                    act.timeline = Timeline::sample(&spec.start, &spec.script, mirror, &mut stream(12));
                }
                hands.push(drawn);
            }
        }
        let starts: Vec<DVec3> = hands.iter().flat_map(|hand| hand.start_vertices(&rigs[hand.side as usize])).collect();
        let count = spec.distractors.sample(&mut stream(10)).round() as usize;
        add_distractors(count, &starts, &mut objects, &mut stream(11))?;
        let acting = hands.iter().filter_map(|hand| hand.act.as_ref());
        let duration = acting.map(|act| act.timeline.duration()).fold(1.0, f64::max);
        let mut rng = stream(8);
        // Both hands of a person have the same skin.
        let (skin, sleeve) = (skin(&mut rng), colour(&mut rng, 0.0..0.8, 0.1..0.9));
        let glove = Glove::sample(spec.look.hands, skin, &mut stream(13));
        hands.iter_mut().for_each(|hand| (hand.skin, hand.sleeve, hand.glove) = (skin, sleeve, glove));
        let appearance = Appearance::sample(&spec.look, &mut rng);
        let camera = CameraDraw::sample(&spec.camera, &mut stream(9));
        let photo = PhotoDraw::sample(&camera, stream);
        Ok(Self { objects, hands, camera, appearance, photo, duration })
    }
}

impl EpisodeDraw {
    /// Returns the camera that a rollout with these effects has.
    pub(crate) fn camera(&self, effects: EffectSet) -> &CameraDraw {
        if effects.contains(Effect::OtherCamera) { &self.photo.camera } else { &self.camera }
    }
}

impl ObjectDraw {
    fn sample(spec: &ObjectSpec, mirror: bool, rng: &mut impl Rng) -> Result<Self> {
        let shape = Object::sample(&spec.shape, rng)?;
        let [x, y] = spec.position.each_ref().map(|s| s.sample(rng));
        let yaw = spec.yaw.sample(rng);
        // A reflection in the world's x is a rotation here, since shapes are symmetric in their own y.
        let (x, yaw) = if mirror { (-x, PI - yaw) } else { (x, yaw) };
        let (mass, friction) = (spec.mass.sample(rng), spec.friction.sample(rng));
        let colour = colour(rng, 0.15..0.95, 0.3..0.95);
        let raised = spec.raised.map_or(0.0, |raised| raised.sample(rng));
        Ok(Self {
            name: spec.name.clone(),
            position: DVec3::new(x, y, shape.half_height + raised),
            orientation: DQuat::from_rotation_z(yaw),
            mass,
            friction,
            table_friction: spec.table_friction.map(|friction| friction.sample(rng)),
            solid: spec.solid,
            colour,
            texture: spec.texture.then(|| texture(rng, colour)),
            shape,
        })
    }
}

/// Adds distractors: objects on the table outside the workspace and away from `starts`, the hands' vertices at the
/// start, m.
///
/// Adds fewer than `count` if there is no room left.
///
/// # Errors
/// If a convex piece is degenerate.
fn add_distractors(count: usize, starts: &[DVec3], objects: &mut Vec<ObjectDraw>, rng: &mut impl Rng) -> Result<()> {
    let radius = |object: &ObjectDraw| f64::from(object.shape.outline().compute_local_aabb().half_extents().length());
    for index in 0..count {
        let mut size = || UniformRange::fixed(rng.random_range(0.02..0.05));
        let shape = match index % 3 {
            0 => ShapeSpec::Box { size: [size(), size(), size()] },
            1 => ShapeSpec::Cylinder { radius: UniformRange::fixed(0.5 * size().low()), height: size() },
            _ => ShapeSpec::Cube { size: size() },
        };
        let spec = ObjectSpec {
            name: format!("distractor_{}", index + 1),
            shape,
            mass: UniformRange::new(0.02, 0.15),
            friction: UniformRange::new(0.6, 1.0),
            table_friction: None,
            position: [UniformRange::new(-0.4, 0.4), UniformRange::new(-0.12, 0.42)],
            raised: None,
            yaw: UniformRange::new(-PI, PI),
            solid: true,
            texture: index % 2 == 1,
        };
        let clear = |drawn: &ObjectDraw| {
            let own = objects.iter().filter(|other| !other.name.starts_with("distractor_"));
            let far =
                own.into_iter().all(|other| drawn.position.distance(other.position) > WORKSPACE_MARGIN + radius(other));
            let free = |vertex: &DVec3| drawn.position.distance(*vertex) > radius(drawn) + HAND_MARGIN;
            far && starts.iter().all(free)
                && objects.iter().all(|other| drawn.position.distance(other.position) > radius(drawn) + radius(other))
        };
        for _ in 0..100 {
            let drawn = ObjectDraw::sample(&spec, false, rng)?;
            if clear(&drawn) {
                objects.push(drawn);
                break;
            }
        }
    }
    Ok(())
}

impl HandDraw {
    /// Returns the vertices at the start, world frame, m.
    fn start_vertices(&self, rig: &HandRig) -> Vec<DVec3> {
        let displacement = self.act.as_ref().map_or(DVec3::ZERO, |act| {
            let channels = act.timeline.at(0.0);
            act.from * channels.standoff + channels.shift
        });
        let params = rig.params(self.wrist + displacement, self.orientation, &self.posture);
        rig.model.forward(&params).vertices.into_iter().map(|vertex| vertex.as_dvec3()).collect()
    }

    fn sample(
        spec: &HandSpec,
        rig: &HandRig,
        objects: &[ObjectDraw],
        scene: &SceneSpec,
        rng: &mut impl Rng,
    ) -> Result<Self> {
        let side = rig.side();
        let (skin, sleeve, glove) = ([0.0; 3], [0.0; 3], None);
        let Some(act) = &spec.act else {
            let (wrist, orientation, posture) = draw_idle(rig, rng);
            return Ok(Self { side, wrist, orientation, posture, act: None, wrap: None, skin, sleeve, glove });
        };
        let index = objects
            .iter()
            .position(|o| o.name == act.object)
            .ok_or_else(|| Error::unknown("object", &act.object, scene.objects.iter().map(|o| o.name.as_str())))?;
        let object = &objects[index];
        let local = |v: [f64; 3]| {
            let flip = if side == Side::Left { -1.0 } else { 1.0 };
            DVec3::new(v[0], flip * v[1], v[2]).normalize_or_zero()
        };
        let world = |v: [f64; 3]| object.orientation * local(v);
        let turn = DQuat::from_scaled_axis(draw_direction(rng) * act.turn.sample(rng));
        let orientation = turn * rig.orientation(world(act.fingers), world(act.palm));
        let curl = act.curl.sample(rng);
        let posture = draw_posture(rig, act, curl, rng);
        let goals = draw_goals(act, object, local, rng)?;
        let params = rig.params(DVec3::ZERO, orientation, &posture);
        let posed = rig.model.forward(&params);
        let pad = |goal: &ContactGoal| {
            let pad = rig.pad(goal.site);
            posed.joints[pad.joint].as_dvec3() + posed.rotations[pad.joint].as_dmat3() * pad.position
        };
        let wrist = goals.iter().map(|g| g.point - pad(g)).sum::<DVec3>() / goals.len() as f64;
        let mirror = if side == Side::Left { DVec3::new(-1.0, 1.0, 1.0) } else { DVec3::ONE };
        let turn = DQuat::from_scaled_axis(draw_direction(rng) * act.from_turn.sample(rng));
        let mut from = (turn * (DVec3::from_array(act.from) * mirror)).normalize();
        // Never from below, through the table.
        from.z = from.z.max(0.15);
        let timeline = Timeline::sample(&act.start, &act.script, side == Side::Left, rng);
        let wrap = act.wrap.as_ref().map(|wrap| (wrap.fingers.clone(), wrap.torque.sample(rng)));
        let act = ActDraw { object: index, goals, from: from.normalize(), timeline };
        Ok(Self { side, wrist, orientation, posture, act: Some(act), wrap, skin, sleeve, glove })
    }
}

/// Draws the rest angles: fingers with goals half bent as for a grasp, the others as the scene says.
fn draw_posture(rig: &HandRig, act: &ActSpec, curl: f64, rng: &mut impl Rng) -> Vec<f64> {
    let wraps = |site: HandSite| act.wrap.as_ref().is_some_and(|wrap| wrap.fingers.contains(&site));
    let bend = |hinge: &Hinge| match (hinge.site, act.contacts.contains_key(&hinge.site)) {
        (HandSite::Thumb, _) if wraps(HandSite::Thumb) => [0.8, 0.1, 0.05, 0.1][hinge_column(hinge)],
        (site, _) if wraps(site) => [0.0, 0.2, 0.25, 0.15][hinge_column(hinge)],
        (HandSite::Thumb, true) => [0.45, 0.1, 0.25, 0.3][hinge_column(hinge)],
        (_, true) => [0.0, 0.75, 0.7, 0.4][hinge_column(hinge)],
        (HandSite::Thumb, false) => [curl - 0.3, 0.1, 0.3 * curl, 0.5 * curl][hinge_column(hinge)],
        (_, false) => [0.0, 1.2 * curl, 1.5 * curl, 0.9 * curl][hinge_column(hinge)],
    };
    let angles = rig
        .hinges
        .iter()
        .map(|hinge| (bend(hinge) + rng.random_range(-0.05..0.05)).clamp(hinge.range[0], hinge.range[1]));
    angles.collect()
}

/// Returns the column of a hinge in the tables of angles: 0 for abduction, 1 to 3 for flexion along the finger; 1 also
/// for the thumb's twist.
fn hinge_column(hinge: &Hinge) -> usize {
    match hinge.motion {
        HingeMotion::Flex => hinge.joint - base_joint(hinge.site) + 1,
        HingeMotion::Abduct => 0,
        HingeMotion::Twist => 1,
    }
}

/// Draws the contact goals of an act; `local` mirrors and normalises a direction in the object frame.
///
/// # Errors
/// If the direction of a goal misses the object.
fn draw_goals(
    act: &ActSpec,
    object: &ObjectDraw,
    local: impl Fn([f64; 3]) -> DVec3,
    rng: &mut impl Rng,
) -> Result<Vec<ContactGoal>> {
    let holding = holding_force(object.mass, object.friction) * act.grip.sample(rng);
    let mut goals = Vec::new();
    for (site, contact) in &act.contacts {
        let at = local(contact.at);
        let height = contact.height.sample(rng);
        let [x, y] = contact.aside.map_or([0.0; 2], |aside| aside.map(|range| range.sample(rng)));
        // `local` normalises: only its mirroring is needed here.
        let through = local([x, y, 0.0]) * x.hypot(y) + DVec3::Z * height;
        let (point, normal) = object.shape.surface_towards(at, through).ok_or_else(|| {
            let expected = format!("a direction that meets {}", act.object);
            Error::value(format!("contacts.{site:?}.at").to_lowercase(), expected, format!("{:?}", contact.at))
        })?;
        goals.push(ContactGoal {
            site: *site,
            point: object.position + object.orientation * point,
            normal: object.orientation * normal,
            force: contact.force.sample(rng) + contact.share * holding,
        });
    }
    Ok(goals)
}

/// Draws an idle hand: held still above the table beside the scene, palm down.
///
/// It does not lie on the table, where a rigid convex palm would rest on one or two vertices.
fn draw_idle(rig: &HandRig, rng: &mut impl Rng) -> (DVec3, DQuat, Vec<f64>) {
    let outward = if rig.side() == Side::Right { 1.0 } else { -1.0 };
    let fingers = DVec3::new(outward * rng.random_range(-0.45..0.0), 1.0, -0.05);
    let orientation = rig.orientation(fingers, DVec3::NEG_Z);
    let curl = rng.random_range(0.02..0.25);
    // The thumb is beside the hand, not under it.
    let bend = |hinge: &Hinge| match (hinge.site, hinge_column(hinge)) {
        (HandSite::Thumb, place) => [-0.25, 0.0, 0.0, 0.1][place],
        (_, place) => [0.0, 0.5 * curl, 0.9 * curl, 0.6 * curl][place],
    };
    let angles: Vec<f64> = rig.hinges.iter().map(bend).collect();
    let posed = rig.model.forward(&rig.params(DVec3::ZERO, orientation, &angles));
    let lowest = posed.vertices.iter().map(|v| v.z).fold(f32::INFINITY, f32::min);
    let height = -f64::from(lowest) + rng.random_range(0.02..0.07);
    let wrist = DVec3::new(outward * rng.random_range(0.19..0.27), rng.random_range(-0.16..-0.04), height);
    (wrist, orientation, angles)
}

/// Draws a direction uniformly from the unit sphere.
fn draw_direction(rng: &mut impl Rng) -> DVec3 {
    let z: f64 = rng.random_range(-1.0..1.0);
    let angle = rng.random_range(0.0..2.0 * PI);
    let r = (1.0 - z * z).sqrt();
    DVec3::new(r * angle.cos(), r * angle.sin(), z)
}
