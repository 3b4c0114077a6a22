//! One episode of a scene: everything the scene leaves open, drawn from a seed.

use std::f64::consts::{PI, SQRT_2};

use glam::{DQuat, DVec3};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use sha2::{Digest, Sha256};

use super::appearance::{self, Look, Rgb};
use super::object::Object;
use super::range::Span;
use super::rig::HandRig;
use super::scene::{ActSpec, CameraSpec, HandSpec, ObjectSpec, Scene, ShapeSpec, SideSpec, Site};
use super::timeline::Timeline;
use crate::camera::Distortion;
use crate::error::{Error, Result};
use crate::hand::Side;

/// Distance that distractors keep from what hands deal with, m.
const WORKSPACE: f64 = 0.1;
/// Distance that they keep from hands at the beginning, m: skin and sleeve are somewhat thicker than the vertices say.
const CLEARANCE: f64 = 0.01;
/// Times that a lens is drawn before one that folds the picture is kept.
const LENS_DRAWS: usize = 100;

/// An episode's drawn values.
#[derive(Debug, Clone)]
pub struct Episode {
    /// Objects, in the scene's order.
    pub objects: Vec<ObjectDraw>,
    /// Hands that are there; an acting one first.
    pub hands: Vec<HandDraw>,
    /// The camera.
    pub camera: CameraDraw,
    /// Colours and lights.
    pub look: Look,
    /// Seconds until the last script ends.
    pub duration: f64,
}

/// A drawn object.
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
    /// Start in the world frame, m.
    pub position: DVec3,
    /// Start orientation.
    pub orientation: DQuat,
    /// Friction against the table where it differs.
    pub table_friction: Option<f64>,
    /// Whether it is more than a place to reach.
    pub solid: bool,
    /// Colour.
    pub colour: Rgb,
    /// Pattern and second colour, where it has one.
    pub texture: Option<(&'static str, Rgb)>,
}

/// A drawn hand.
#[derive(Debug, Clone)]
pub struct HandDraw {
    /// Which hand.
    pub side: Side,
    /// Place of the wrist around which its slides and hinges move, m.
    pub wrist: DVec3,
    /// Orientation of the hand around which its wrist hinges move.
    pub orientation: DQuat,
    /// Angles the fingers have where no goal says otherwise, in the rig's order, rad.
    pub posture: Vec<f64>,
    /// What it does; `None` is idle.
    pub act: Option<Act>,
    /// Fingers that wrap, and the torque at the knuckle, N m.
    pub wrap: Option<(Vec<Site>, f64)>,
    /// Colour of the skin.
    pub skin: Rgb,
    /// Colour of the sleeve.
    pub sleeve: Rgb,
}

/// What a hand does.
#[derive(Debug, Clone)]
pub struct Act {
    /// Index of the object.
    pub object: usize,
    /// Contact goals.
    pub goals: Vec<Goal>,
    /// Unit direction from the object to where the hand comes from, world frame.
    pub from: DVec3,
    /// Course in time.
    pub timeline: Timeline,
}

/// A contact goal in the world frame, at the object's start.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Goal {
    /// What shall touch.
    pub site: Site,
    /// Point on the surface, m.
    pub point: DVec3,
    /// Outward unit normal there.
    pub normal: DVec3,
    /// Normal force, N.
    pub force: f64,
}

/// A drawn camera.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CameraDraw {
    /// Mean position of the eye, m.
    pub eye: DVec3,
    /// Point looked at, m.
    pub target: DVec3,
    /// Vertical field of view, rad.
    pub fovy: f64,
    /// How its lens bends lines.
    pub distortion: Distortion,
    /// Tilt, rad.
    pub roll: f64,
    /// Amplitude of the head's motion, m.
    pub sway: f64,
    /// Phases of the head's motion, rad.
    pub phases: [f64; 6],
    /// Standard deviation of the sensor's noise, in steps of the 8-bit picture.
    pub noise: f64,
    /// Time for which the shutter is open, s.
    pub shutter: f64,
}

impl Episode {
    /// Draws an episode; the same scene, seed and rigs give the same one, bit for bit.
    ///
    /// # Errors
    /// If a contact goal misses its object, or a mesh file can't be read.
    pub fn sample(scene: &Scene, seed: u64, rigs: &[HandRig; 2]) -> Result<Self> {
        // One stream per concern: a scene that draws one number more for its objects keeps its camera and colours.
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
        let objects =
            spec.objects.iter().map(|o| ObjectDraw::sample(o, mirror, &mut rng)).collect::<Result<Vec<_>>>()?;
        let mut objects = objects;
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
        let starts: Vec<DVec3> = hands.iter().flat_map(|hand| hand.start(&rigs[hand.side as usize])).collect();
        let count = spec.distractors.sample(&mut stream(10)).round() as usize;
        distractors(count, &starts, &mut objects, &mut stream(11))?;
        let acting = hands.iter().filter_map(|hand| hand.act.as_ref());
        let duration = acting.map(|act| act.timeline.duration()).fold(1.0, f64::max);
        let mut rng = stream(8);
        // Both hands of a person have the same skin.
        let (skin, sleeve) = (appearance::skin(&mut rng), appearance::colour(&mut rng, 0.0..0.8, 0.1..0.9));
        hands.iter_mut().for_each(|hand| (hand.skin, hand.sleeve) = (skin, sleeve));
        let look = Look::sample(&mut rng);
        Ok(Self { objects, hands, camera: CameraDraw::sample(&spec.camera, &mut stream(9)), look, duration })
    }
}

impl ObjectDraw {
    fn sample(spec: &ObjectSpec, mirror: bool, rng: &mut impl Rng) -> Result<Self> {
        let shape = Object::sample(&spec.shape, rng)?;
        let [x, y] = spec.position.each_ref().map(|s| s.sample(rng));
        let yaw = spec.yaw.sample(rng);
        // Mirrored in the world's x, and since shapes are symmetric in their own y, that is another rotation.
        let (x, yaw) = if mirror { (-x, PI - yaw) } else { (x, yaw) };
        let (mass, friction) = (spec.mass.sample(rng), spec.friction.sample(rng));
        let colour = appearance::colour(rng, 0.15..0.95, 0.3..0.95);
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
            texture: spec.texture.then(|| appearance::texture(rng, colour)),
            shape,
        })
    }
}

/// Adds things that lie about on the table beside the place where the hands work, and not within `starts`, the vertices
/// of hands at the beginning.
///
/// Fewer than `count` where there is no room left.
fn distractors(count: usize, starts: &[DVec3], objects: &mut Vec<ObjectDraw>, rng: &mut impl Rng) -> Result<()> {
    let girth = |object: &ObjectDraw| f64::from(object.shape.outline().compute_local_aabb().half_extents().length());
    for index in 0..count {
        let mut size = || Span::fixed(rng.random_range(0.02..0.05));
        let shape = match index % 3 {
            0 => ShapeSpec::Box { size: [size(), size(), size()] },
            1 => ShapeSpec::Cylinder { radius: Span::fixed(0.5 * size().low()), height: size() },
            _ => ShapeSpec::Cube { size: size() },
        };
        let spec = ObjectSpec {
            name: format!("distractor_{}", index + 1),
            shape,
            mass: Span::new(0.02, 0.15),
            friction: Span::new(0.6, 1.0),
            table_friction: None,
            position: [Span::new(-0.4, 0.4), Span::new(-0.12, 0.42)],
            raised: None,
            yaw: Span::new(-PI, PI),
            solid: true,
            texture: index % 2 == 1,
        };
        let clear = |drawn: &ObjectDraw| {
            let worked = objects.iter().filter(|other| !other.name.starts_with("distractor_"));
            let far =
                worked.into_iter().all(|other| drawn.position.distance(other.position) > WORKSPACE + girth(other));
            let free = |vertex: &DVec3| drawn.position.distance(*vertex) > girth(drawn) + CLEARANCE;
            far && starts.iter().all(free)
                && objects.iter().all(|other| drawn.position.distance(other.position) > girth(drawn) + girth(other))
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
    /// Vertices at the beginning, world frame, m.
    fn start(&self, rig: &HandRig) -> Vec<DVec3> {
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
        scene: &super::scene::SceneSpec,
        rng: &mut impl Rng,
    ) -> Result<Self> {
        let side = rig.side();
        let (skin, sleeve) = ([0.0; 3], [0.0; 3]);
        let Some(act) = &spec.act else {
            let (wrist, orientation, posture) = idle(rig, rng);
            return Ok(Self { side, wrist, orientation, posture, act: None, wrap: None, skin, sleeve });
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
        let turn = DQuat::from_scaled_axis(direction(rng) * act.turn.sample(rng));
        let orientation = turn * rig.orientation(world(act.fingers), world(act.palm));
        let curl = act.curl.sample(rng);
        let posture = posture(rig, act, curl, rng);
        let goals = goals(act, object, local, rng)?;
        let params = rig.params(DVec3::ZERO, orientation, &posture);
        let posed = rig.model.forward(&params);
        let pad = |goal: &Goal| {
            let pad = rig.pad(goal.site);
            posed.joints[pad.joint].as_dvec3() + posed.rotations[pad.joint].as_dmat3() * pad.position
        };
        let wrist = goals.iter().map(|g| g.point - pad(g)).sum::<DVec3>() / goals.len() as f64;
        let mirror = if side == Side::Left { DVec3::new(-1.0, 1.0, 1.0) } else { DVec3::ONE };
        let turn = DQuat::from_scaled_axis(direction(rng) * act.from_turn.sample(rng));
        let mut from = (turn * (DVec3::from_array(act.from) * mirror)).normalize();
        // Never from below: the hand would come through the table.
        from.z = from.z.max(0.15);
        let timeline = Timeline::sample(&act.start, &act.script, side == Side::Left, rng);
        let wrap = act.wrap.as_ref().map(|wrap| (wrap.fingers.clone(), wrap.torque.sample(rng)));
        let act = Act { object: index, goals, from: from.normalize(), timeline };
        Ok(Self { side, wrist, orientation, posture, act: Some(act), wrap, skin, sleeve })
    }
}

impl CameraDraw {
    fn sample(spec: &CameraSpec, rng: &mut impl Rng) -> Self {
        let mut draw = Self {
            eye: DVec3::from_array(spec.eye.each_ref().map(|s| s.sample(rng))),
            target: DVec3::from_array(spec.target.each_ref().map(|s| s.sample(rng))),
            fovy: spec.fovy.sample(rng).to_radians(),
            roll: spec.roll.sample(rng),
            sway: spec.sway.sample(rng),
            phases: std::array::from_fn(|_| rng.random_range(0.0..2.0 * PI)),
            noise: spec.noise.sample(rng),
            shutter: spec.shutter.sample(rng),
            distortion: Distortion::default(),
        };
        // One that folds within a square picture is drawn again, whatever shape the picture has in the end: a seed means
        // one scene. Where the scene's spans hold hardly any other, the lens itself is refused later.
        for _ in 0..LENS_DRAWS {
            draw.distortion = Distortion(spec.distortion.each_ref().map(|s| s.sample(rng)));
            if draw.distortion.unbend(SQRT_2 * (0.5 * draw.fovy).tan()).is_some() {
                break;
            }
        }
        draw
    }
}

/// Angles before any goal: goal fingers half bent as for a grasp, the others as the scene says.
fn posture(rig: &HandRig, act: &ActSpec, curl: f64, rng: &mut impl Rng) -> Vec<f64> {
    let wraps = |site: Site| act.wrap.as_ref().is_some_and(|wrap| wrap.fingers.contains(&site));
    let bend = |hinge: &super::rig::Hinge| match (hinge.site, act.contacts.contains_key(&hinge.site)) {
        (Site::Thumb, _) if wraps(Site::Thumb) => [0.8, 0.1, 0.05, 0.1][hinge_place(hinge)],
        (site, _) if wraps(site) => [0.0, 0.2, 0.25, 0.15][hinge_place(hinge)],
        (Site::Thumb, true) => [0.45, 0.1, 0.25, 0.3][hinge_place(hinge)],
        (_, true) => [0.0, 0.75, 0.7, 0.4][hinge_place(hinge)],
        (Site::Thumb, false) => [curl - 0.3, 0.1, 0.3 * curl, 0.5 * curl][hinge_place(hinge)],
        (_, false) => [0.0, 1.2 * curl, 1.5 * curl, 0.9 * curl][hinge_place(hinge)],
    };
    let angles = rig
        .hinges
        .iter()
        .map(|hinge| (bend(hinge) + rng.random_range(-0.05..0.05)).clamp(hinge.range[0], hinge.range[1]));
    angles.collect()
}

/// 0 for abduction and twist at the base, 1 to 3 for flexion along the finger.
fn hinge_place(hinge: &super::rig::Hinge) -> usize {
    match hinge.motion {
        super::rig::Motion::Flex => hinge.joint - super::rig::base_joint(hinge.site) + 1,
        super::rig::Motion::Abduct => 0,
        super::rig::Motion::Twist => 1,
    }
}

fn goals(
    act: &ActSpec,
    object: &ObjectDraw,
    local: impl Fn([f64; 3]) -> DVec3,
    rng: &mut impl Rng,
) -> Result<Vec<Goal>> {
    // Two opposite sides hold a weight m g when each presses with m g / 2 mu.
    let holding = object.mass * 9.81 / (2.0 * object.friction) * act.grip.sample(rng);
    let mut goals = Vec::new();
    for (site, contact) in &act.contacts {
        let at = local(contact.at);
        let height = contact.height.sample(rng);
        let [x, y] = contact.aside.map_or([0.0; 2], |aside| aside.map(|span| span.sample(rng)));
        // `local` gives directions; mirroring is all that is wanted of it here.
        let through = local([x, y, 0.0]) * x.hypot(y) + DVec3::Z * height;
        let (point, normal) = object.shape.surface_towards(at, through).ok_or_else(|| {
            let expected = format!("a direction that meets {}", act.object);
            Error::value(format!("contacts.{site:?}.at").to_lowercase(), expected, format!("{:?}", contact.at))
        })?;
        goals.push(Goal {
            site: *site,
            point: object.position + object.orientation * point,
            normal: object.orientation * normal,
            force: contact.force.sample(rng) + contact.share * holding,
        });
    }
    Ok(goals)
}

/// A hand held still above the table beside the scene, palm down.
///
/// It does not lie on the table: a rigid convex palm would carry the arm's weight on one or two vertices.
fn idle(rig: &HandRig, rng: &mut impl Rng) -> (DVec3, DQuat, Vec<f64>) {
    let outward = if rig.side() == Side::Right { 1.0 } else { -1.0 };
    let fingers = DVec3::new(outward * rng.random_range(-0.45..0.0), 1.0, -0.05);
    let orientation = rig.orientation(fingers, DVec3::NEG_Z);
    let curl = rng.random_range(0.02..0.25);
    // The thumb lies beside the hand rather than under it.
    let bend = |hinge: &super::rig::Hinge| match (hinge.site, hinge_place(hinge)) {
        (Site::Thumb, place) => [-0.25, 0.0, 0.0, 0.1][place],
        (_, place) => [0.0, 0.5 * curl, 0.9 * curl, 0.6 * curl][place],
    };
    let angles: Vec<f64> = rig.hinges.iter().map(bend).collect();
    let posed = rig.model.forward(&rig.params(DVec3::ZERO, orientation, &angles));
    let lowest = posed.vertices.iter().map(|v| v.z).fold(f32::INFINITY, f32::min);
    let height = -f64::from(lowest) + rng.random_range(0.02..0.07);
    let wrist = DVec3::new(outward * rng.random_range(0.19..0.27), rng.random_range(-0.16..-0.04), height);
    (wrist, orientation, angles)
}

/// Uniform on the unit sphere.
fn direction(rng: &mut impl Rng) -> DVec3 {
    let z: f64 = rng.random_range(-1.0..1.0);
    let angle = rng.random_range(0.0..2.0 * PI);
    let r = (1.0 - z * z).sqrt();
    DVec3::new(r * angle.cos(), r * angle.sin(), z)
}
