//! Forces whose truth is known on paper.

use egotac::geometry::Solid;
use egotac::hand::{HandModel, HandParams, Side};
use egotac::physics::contacts::Contact;
use egotac::physics::frame::{BodyEstimate, estimate};
use egotac::physics::motion::Kinematics;
use egotac::physics::patch::{Patch, Pusher};
use egotac::physics::{
    Demand, Estimate, ForceValidity, Mass, Pose, PoseNoise, RigidBody, Settings, Take, Tracked, lagged, whole,
};
use glam::{DMat3, DQuat, DVec3, Vec3};

const G: DVec3 = DVec3::new(0.0, 0.0, -9.81);

fn cuboid(name: &str, half: Vec3, kilograms: f64) -> RigidBody {
    let corner = |i: u32| {
        half * Vec3::new((i & 1) as f32 * 2.0 - 1.0, (i >> 1 & 1) as f32 * 2.0 - 1.0, (i >> 2) as f32 * 2.0 - 1.0)
    };
    let quads = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
    let triangles = quads.iter().flat_map(|[a, b, c, d]| [[*a, *b, *c], [*a, *c, *d]]).collect();
    RigidBody::from_mesh(name, (0..8).map(corner).collect(), triangles).unwrap().with_mass(kilograms, 0.0).unwrap()
}

/// A body at rest, or with an acceleration.
fn state(acceleration: DVec3) -> Kinematics {
    Kinematics {
        pose: Pose::IDENTITY,
        velocity: DVec3::ZERO,
        acceleration,
        angular_velocity: DVec3::ZERO,
        angular_acceleration: DVec3::ZERO,
        acceleration_sd: DVec3::splat(1e-3),
        angular_acceleration_sd: DVec3::splat(1e-3),
        pose_sd: PoseNoise::default(),
    }
}

fn contact(pusher: Pusher, points: &[(DVec3, DVec3)]) -> Contact {
    Contact { patch: Patch { pusher, gap: 0.0, points: points.to_vec() }, probability: 1.0, deep: false }
}

fn finger(link: usize) -> Pusher {
    Pusher::Link(Side::Right, link)
}

fn forces(body: &RigidBody, acceleration: DVec3, contacts: &[Contact]) -> BodyEstimate {
    let demand = Demand::of(body.mass.as_ref().unwrap(), &state(acceleration), G);
    estimate(body, &demand, contacts, None, &Settings::default())
}

fn mean(samples: &[f64]) -> f64 {
    samples.iter().sum::<f64>() / samples.len() as f64
}

fn sd(samples: &[f64]) -> f64 {
    let mean = mean(samples);
    (samples.iter().map(|s| (s - mean).powi(2)).sum::<f64>() / samples.len() as f64).sqrt()
}

#[test]
fn mass_properties_of_a_box_and_a_ball_are_those_of_the_formulas() {
    let half = DVec3::new(0.03, 0.05, 0.01);
    let Mass { centre, inertia, .. } = cuboid("box", half.as_vec3(), 0.4).mass.unwrap();
    let square = half * half;
    let exact = 0.4 / 3.0 * DVec3::new(square.y + square.z, square.x + square.z, square.x + square.y);
    assert!(centre.length() < 1e-6);
    assert!((inertia - DMat3::from_diagonal(exact)).to_cols_array().iter().all(|x| x.abs() < 1e-6 * 0.4), "{inertia}");
    let mut solid = Solid::default();
    solid.add_ball(0.04, parry3d::math::Pose::IDENTITY).unwrap();
    let ends = [Vec3::X, Vec3::Y, Vec3::Z].into_iter().flat_map(|axis| [axis * 0.04, axis * -0.04]).collect();
    let volume = RigidBody::from_solid("ball", solid, ends).volume().unwrap();
    assert!((volume.cubic_metres / (4.0 / 3.0 * std::f64::consts::PI * 0.04f64.powi(3)) - 1.0).abs() < 0.01);
    assert!((volume.gyration.x_axis.x / (0.4 * 0.04 * 0.04) - 1.0).abs() < 0.01);
}

#[test]
fn a_box_at_rest_on_a_palm_presses_with_its_weight() {
    let body = cuboid("box", Vec3::splat(0.03), 0.5);
    let below = [(-0.01, -0.01), (0.015, -0.005), (0.0, 0.015)].map(|(x, y)| (DVec3::new(x, y, -0.03), -DVec3::Z));
    let found = forces(&body, DVec3::ZERO, &[contact(finger(0), &below)]);
    let weight = 0.5 * 9.81;
    assert!((mean(&found.links[0].samples) - weight).abs() < 0.02 * weight + 0.05);
    assert!((found.hand_force - DVec3::Z * weight).length() < 0.02 * weight);
    assert!(sd(&found.links[0].samples) < 0.05 * weight, "{}", sd(&found.links[0].samples));
    assert!(found.links[0].remaining < 0.05, "{}", found.links[0].remaining);
    assert!(!found.unexplained);
}

#[test]
fn two_fingers_carry_the_weight_but_their_squeeze_is_not_determined() {
    let body = cuboid("box", Vec3::splat(0.03), 0.2);
    let side = |sign: f64| (DVec3::new(0.03 * sign, 0.0, 0.0), DVec3::new(sign, 0.0, 0.0));
    let contacts = [contact(finger(3), &[side(1.0)]), contact(finger(15), &[side(-1.0)])];
    let found = forces(&body, DVec3::ZERO, &contacts);
    let weight = 0.2 * 9.81;
    // What friction carries is determined: the weight, whatever the squeeze.
    assert!((found.hand_force - DVec3::Z * weight).length() < 0.02 * weight, "{}", found.hand_force);
    for link in &found.links {
        let force = mean(&link.samples);
        assert!(link.remaining > 0.3, "{}", link.remaining);
        // At least what friction needs, about twice that as people grip, and with a wide interval.
        assert!(force > weight / (2.0 * 0.8) && force < 5.0 * weight / (2.0 * 0.8), "{force}");
        assert!(sd(&link.samples) > 0.15 * force);
    }
    let difference: Vec<f64> = found.links[0].samples.iter().zip(&found.links[1].samples).map(|(a, b)| a - b).collect();
    assert!(mean(&difference).abs() < 0.05 && sd(&difference) < 0.1, "{difference:?}");
}

#[test]
fn pushing_determines_the_normal_force_of_a_fingertip() {
    let body = cuboid("box", Vec3::splat(0.03), 0.3);
    // A box in free fall, pushed sideways through its centre.
    let push = contact(finger(3), &[(DVec3::new(-0.03, 0.0, 0.0), -DVec3::X)]);
    let found = forces(&body, G + DVec3::X * 4.0, &[push]);
    assert!((mean(&found.links[0].samples) - 1.2).abs() < 0.02 * 1.2 + 0.05, "{}", mean(&found.links[0].samples));
    assert!(found.links[0].remaining < 0.05);
}

#[test]
fn forces_and_residual_add_up_to_the_wrench() {
    let body = cuboid("box", Vec3::splat(0.03), 0.4);
    let side = |sign: f64| (DVec3::new(0.03 * sign, 0.0, 0.0), DVec3::new(sign, 0.0, 0.0));
    let table = contact(Pusher::Fixed(0), &[(DVec3::new(0.0, 0.0, -0.03), -DVec3::Z)]);
    // Without a support in the problem, all of the wrench is the hand's, or is left over.
    for (acceleration, contacts) in [
        (DVec3::new(1.0, -2.0, 3.0), vec![contact(finger(3), &[side(1.0)]), contact(finger(15), &[side(-1.0)])]),
        (DVec3::ZERO, vec![contact(finger(3), &[side(1.0)])]),
        (DVec3::new(0.0, 0.0, -9.0), vec![]),
    ] {
        let found = forces(&body, acceleration, &contacts);
        let wrench = DVec3::new(found.wrench[0], found.wrench[1], found.wrench[2]);
        let residual = DVec3::new(found.residual[0], found.residual[1], found.residual[2]);
        // Samples of opposite noise cancel in the mean.
        assert!((found.hand_force + residual - wrench).length() < 0.01 * wrench.length() + 1e-3);
    }
    let alone = forces(&body, DVec3::ZERO, &[table]);
    assert!(alone.hand_force.length() == 0.0 && !alone.unexplained);
    let floating = forces(&body, DVec3::ZERO, &[contact(finger(3), &[side(1.0)])]);
    assert!(floating.unexplained, "one fingertip beside a box can't hold it");
}

/// A take with the right hand at rest, palm up, and one body above it.
fn take<'a>(models: &'a [HandModel; 2], body: RigidBody, poses: Vec<Option<Pose>>, orient: Vec3) -> Take<'a> {
    let n = poses.len();
    let params = HandParams { global_orient: orient, ..HandParams::default() };
    Take {
        times: (0..n).map(|k| k as f64 / 30.0).collect(),
        models: [&models[0], &models[1]],
        hands: [vec![Tracked::Absent; n], vec![Tracked::Present(Box::new(params)); n]],
        bodies: vec![body],
        poses: vec![poses],
        fixed: Vec::new(),
        gravity: Some(G),
    }
}

fn total(estimate: &Estimate, frame: usize) -> f64 {
    let hand = &estimate.frames[frame].hands[1];
    assert_eq!(hand.validity, ForceValidity::Valid, "{}", hand.validity.reason());
    hand.links.iter().map(|link| link.unwrap().force).sum()
}

#[test]
fn a_ball_in_free_fall_feels_no_hand() {
    let models = Side::BOTH.map(HandModel::builtin);
    let top = models[1].forward(&HandParams::default()).vertices.iter().map(|v| v.z).fold(f32::MIN, f32::max);
    let body = cuboid("ball", Vec3::splat(0.03), 0.3);
    let fall = |k: usize| {
        let t = k as f64 / 30.0;
        let height = f64::from(top) + 1.5 + 1.0 * t - 4.905 * t * t;
        Some(Pose { position: DVec3::Z * height, orientation: DQuat::from_rotation_x(2.0 * t) })
    };
    let found = whole(&take(&models, body, (0..18).map(fall).collect(), Vec3::ZERO), &Settings::default());
    for frame in 0..18 {
        let hand = &found.frames[frame].hands[1];
        assert_eq!((hand.validity, total(&found, frame)), (ForceValidity::Valid, 0.0));
        let residual = found.frames[frame].bodies[0].as_ref().unwrap().residual;
        assert!(residual.fixed_rows::<3>(0).norm() < 0.02 * 0.3 * 9.81 + 0.01, "{residual} at {frame}");
    }
}

/// Returns the place of a plate of 2 cm that is pressed 0.5 mm into the skin, its centre of mass over the highest skin.
fn on_top(vertices: &[Vec3]) -> DVec3 {
    let top = vertices.iter().map(|v| v.z).fold(f32::MIN, f32::max);
    let near: Vec<Vec3> = vertices.iter().copied().filter(|v| v.z > top - 0.0015).collect();
    let centre = near.iter().sum::<Vec3>() / near.len() as f32;
    DVec3::new(centre.x.into(), centre.y.into(), f64::from(top) + 0.01 - 0.0005)
}

#[test]
fn a_plate_on_a_whole_hand_presses_with_its_weight_on_all_links_together() {
    let models = Side::BOTH.map(HandModel::builtin);
    for orient in [Vec3::ZERO, Vec3::X * std::f32::consts::PI, Vec3::X * 0.5 * std::f32::consts::PI] {
        let params = HandParams { global_orient: orient, ..HandParams::default() };
        let vertices = models[1].forward(&params).vertices;
        let place = on_top(&vertices);
        let body = cuboid("plate", Vec3::new(0.15, 0.15, 0.01), 0.6);
        let rest = vec![Some(Pose { position: place, orientation: DQuat::IDENTITY }); 20];
        let found = whole(&take(&models, body, rest, orient), &Settings::default());
        let (force, weight) = (total(&found, 10), 0.6 * 9.81);
        let hand = &found.frames[10].hands[1];
        assert_eq!(hand.validity, ForceValidity::Valid);
        assert!((force - weight).abs() < 0.02 * weight + 0.05, "{force} N for {weight} N, {orient}");
    }
}

#[test]
fn a_force_that_motion_determines_keeps_a_narrow_interval() {
    let models = Side::BOTH.map(HandModel::builtin);
    let vertices = models[1].forward(&HandParams::default()).vertices;
    let body = cuboid("plate", Vec3::new(0.15, 0.15, 0.01), 0.6);
    let hold = 0.6 * 9.81 / (2.0 * body.friction);
    // The palm alone carries the plate.
    let rest = Some(Pose { position: on_top(&vertices), orientation: DQuat::IDENTITY });
    let take = take(&models, body, vec![rest; 20], Vec3::ZERO);
    let of = |unseen: [f64; 2]| whole(&take, &Settings { unseen, ..Settings::default() }).frames.swap_remove(10);
    let (narrow, wide) = (of([0.0, 0.0]), of([2.0, 1.0]));
    let mut far = 0;
    for (narrow, wide) in narrow.hands[1].links.iter().zip(&wide.hands[1].links) {
        let (narrow, wide) = (narrow.unwrap(), wide.unwrap());
        assert_eq!(narrow.force, wide.force);
        let [a, b] = [narrow, wide].map(|link| link.interval[1] - link.force);
        assert!(b >= a && b - a < 0.1 * (2.0 + hold), "{a} and {b}: the weight is known, whatever hands do");
        far += usize::from(wide.interval == [0.0, 0.0]);
    }
    // Links away from the plate feel nothing, for certain.
    assert!(far >= 10, "{far} far");
}

#[test]
fn what_is_not_known_is_named_and_never_zero() {
    let models = Side::BOTH.map(HandModel::builtin);
    let top = models[1].forward(&HandParams::default()).vertices.iter().map(|v| v.z).fold(f32::MIN, f32::max);
    let place = Pose { position: DVec3::Z * (f64::from(top) + 0.0095), orientation: DQuat::IDENTITY };
    let plate = || cuboid("plate", Vec3::new(0.3, 0.3, 0.01), 0.6);
    let at = |take: &Take, frame: usize| whole(take, &Settings::default()).frames[frame].hands[1].clone();
    let known = take(&models, plate(), vec![Some(place); 20], Vec3::ZERO);
    assert!(known.bodies[0].mass.is_some());

    let mut no_mass = known.clone();
    no_mass.bodies[0].mass = None;
    let mut no_gravity = known.clone();
    no_gravity.gravity = None;
    let mut gap = known.clone();
    gap.poses[0][10] = None;
    let mut unseen = known.clone();
    unseen.hands[1][10] = Tracked::Unknown;
    let mut deep = known.clone();
    deep.bodies[0] = cuboid("block", Vec3::new(0.3, 0.3, 0.05), 0.6);
    // Its middle was 9.5 mm above the highest skin: the hand is 40 mm inside.
    for (take, reason) in [
        (&no_mass, ForceValidity::MassUnknown),
        (&no_gravity, ForceValidity::GravityUnknown),
        (&gap, ForceValidity::PoseGap),
        (&unseen, ForceValidity::HandUnknown),
        (&deep, ForceValidity::Deep),
    ] {
        let hand = at(take, 10);
        assert_eq!(hand.validity, reason);
        assert!(hand.links.iter().any(Option::is_none), "{}", reason.reason());
    }
}

#[test]
fn intervals_cover_forces_that_are_drawn_as_people_grip() {
    use rand::{Rng, SeedableRng};
    let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(5);
    let body = cuboid("box", Vec3::splat(0.03), 0.2);
    let (mut inside, mut all) = (0, 0);
    for _ in 0..150 {
        // Two fingers at random heights; the truth squeezes by a ratio about the prior's median.
        let mut height = || rng.random_range(-0.004..0.004);
        let (a, b) = (height(), height());
        let contacts = [
            contact(finger(3), &[(DVec3::new(0.03, a, a), DVec3::X)]),
            contact(finger(15), &[(DVec3::new(-0.03, a, b), -DVec3::X)]),
        ];
        let least = 0.2 * 9.81 / (2.0 * 0.8);
        let z: f64 = rand_distr::Distribution::sample(&rand_distr::StandardNormal, &mut rng);
        let truth = least * (1.0 + 1.2 * (0.7 * z).exp());
        let found = forces(&body, DVec3::ZERO, &contacts);
        for link in &found.links {
            let mut sorted = link.samples.clone();
            sorted.sort_by(f64::total_cmp);
            let (mean, sd) = (mean(&sorted), sd(&sorted));
            inside += usize::from((truth - mean).abs() <= 1.645 * sd);
            all += 1;
        }
    }
    let share = inside as f64 / all as f64;
    assert!((0.8..=0.99).contains(&share), "{share}");
}

#[test]
fn a_stream_with_a_fixed_lag_gives_the_weight_too() {
    let models = Side::BOTH.map(HandModel::builtin);
    let vertices = models[1].forward(&HandParams::default()).vertices;
    let top = vertices.iter().map(|v| v.z).fold(f32::MIN, f32::max);
    let near: Vec<Vec3> = vertices.into_iter().filter(|v| v.z > top - 0.0015).collect();
    let centre = (near.iter().sum::<Vec3>() / near.len() as f32).as_dvec3();
    let pose = Pose { position: centre.with_z(f64::from(top) + 0.0095), orientation: DQuat::IDENTITY };
    let all = take(&models, cuboid("plate", Vec3::new(0.15, 0.15, 0.01), 0.6), vec![Some(pose); 16], Vec3::ZERO);
    let mut memories = Vec::new();
    // A window of twelve frames, of which the eighth is estimated: four frames late.
    for end in 12..16 {
        let frames = end - 12..end;
        let mut window = all.clone();
        window.times = all.times[frames.clone()].to_vec();
        window.hands = all.hands.each_ref().map(|hand| hand[frames.clone()].to_vec());
        window.poses[0] = all.poses[0][frames].to_vec();
        let found = lagged(&window, 7, &mut memories, &Settings::default());
        let hand = &found.hands[1];
        assert_eq!(hand.validity, ForceValidity::Valid, "{}", hand.validity.reason());
        let force: f64 = hand.links.iter().map(|link| link.unwrap().force).sum();
        assert!((force - 0.6 * 9.81).abs() < 0.02 * 0.6 * 9.81 + 0.05, "{force}");
        assert!(memories[0].is_some());
    }
}
