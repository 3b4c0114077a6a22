//! Articulated objects, whose parts are linked by joints.

use egotac::hand::{HandModel, HandParams, Side};
use egotac::physics::motion::Kinematics;
use egotac::physics::{Demand, ForceValidity, Mass, Pose, PoseNoise, RigidBody, Settings, Take, Tracked, whole};
use glam::{DMat3, DQuat, DVec3, Vec3};
use proptest::prelude::*;

const G: DVec3 = DVec3::new(0.0, 0.0, -9.81);

fn vector(size: f64) -> impl Strategy<Value = DVec3> {
    prop::array::uniform3(-size..size).prop_map(DVec3::from_array)
}

/// A cuboid's mass with its centre at `centre` in the frame of the object.
fn mass(half: DVec3, centre: DVec3, kilograms: f64) -> Mass {
    let square = half * half;
    let inertia = DVec3::new(square.y + square.z, square.x + square.z, square.x + square.y) * (kilograms / 3.0);
    Mass { kilograms, relative_sd: 0.0, centre, inertia: DMat3::from_diagonal(inertia) }
}

/// State of a point of a rigid body whose frame moves with these accelerations.
fn state(pose: Pose, spin: [DVec3; 2], linear: DVec3, place: DVec3) -> Kinematics {
    let [angular_velocity, angular_acceleration] = spin;
    let arm = pose.orientation * place;
    let turning = angular_acceleration.cross(arm) + angular_velocity.cross(angular_velocity.cross(arm));
    Kinematics {
        pose,
        velocity: DVec3::ZERO,
        acceleration: linear + turning,
        angular_velocity,
        angular_acceleration,
        acceleration_sd: DVec3::splat(0.1),
        angular_acceleration_sd: DVec3::splat(0.2),
        pose_sd: PoseNoise::default(),
    }
}

fn force(demand: &Demand) -> DVec3 {
    DVec3::new(demand.wrench[0], demand.wrench[1], demand.wrench[2])
}

fn moment(demand: &Demand) -> DVec3 {
    DVec3::new(demand.wrench[3], demand.wrench[4], demand.wrench[5])
}

proptest! {
    #[test]
    fn a_box_that_is_cut_in_two_asks_for_the_wrench_of_the_whole(
        place in vector(1.0), turn in vector(3.0), spins in [vector(5.0), vector(20.0)], linear in vector(10.0),
        cut in 0.1f64..0.9, kilograms in 0.05f64..3.0,
    ) {
        let half = DVec3::new(0.05, 0.03, 0.02);
        let pose = Pose { position: place, orientation: DQuat::from_scaled_axis(turn) };
        let of = |mass: &Mass| Demand::of(mass, &state(pose, spins, linear, mass.centre), G);
        let uncut = of(&mass(half, DVec3::ZERO, kilograms));
        // Along x, the pieces reach from -half.x to `at` and from there to half.x.
        let at = half.x * (2.0 * cut - 1.0);
        let pieces = [(-half.x, at), (at, half.x)].map(|(low, high)| {
            let centre = DVec3::X * (0.5 * (low + high));
            of(&mass(half.with_x(0.5 * (high - low)), centre, kilograms * (high - low) / (2.0 * half.x)))
        });
        let joined = Demand::joined(&pieces).unwrap();
        prop_assert!((force(&joined) - force(&uncut)).length() < 1e-9 * (1.0 + force(&uncut).length()));
        prop_assert!((moment(&joined) - moment(&uncut)).length() < 1e-9 * (1.0 + moment(&uncut).length()));
        prop_assert!(joined.centre.distance(uncut.centre) < 1e-12 && (joined.weight - uncut.weight).abs() < 1e-12);
        prop_assert!(joined.covariance.cholesky().is_some());
    }

    #[test]
    fn parts_that_turn_against_each_other_ask_for_the_sum_of_their_moments_about_any_point(
        places in [vector(1.0), vector(1.0)], spins in [vector(5.0), vector(20.0)], linears in [vector(10.0), vector(10.0)],
        masses in [0.05f64..3.0, 0.05f64..3.0],
    ) {
        let parts: Vec<Demand> = (0..2).map(|part| {
            let pose = Pose { position: places[part], orientation: DQuat::from_scaled_axis(spins[1 - part]) };
            let mass = mass(DVec3::new(0.05, 0.03, 0.02), DVec3::ZERO, masses[part]);
            Demand::of(&mass, &state(pose, [spins[part], spins[1 - part]], linears[part], DVec3::ZERO), G)
        }).collect();
        let joined = Demand::joined(&parts).unwrap();
        let about_origin = |demand: &Demand| moment(demand) + demand.centre.cross(force(demand));
        let sum: DVec3 = parts.iter().map(about_origin).sum();
        prop_assert!((about_origin(&joined) - sum).length() < 1e-9 * (1.0 + sum.length()));
        prop_assert!((force(&joined) - parts.iter().map(force).sum::<DVec3>()).length() < 1e-9);
    }
}

/// A plate of 2 cm on the right hand's palm, of two halves on a hinge, or in one piece.
fn plates<'a>(models: &'a [HandModel; 2], pieces: &[(f32, Vec3)], kilograms: f64) -> Take<'a> {
    const FRAMES: usize = 20;
    let vertices = models[1].forward(&HandParams::default()).vertices;
    let top = vertices.iter().map(|v| v.z).fold(f32::MIN, f32::max);
    let near: Vec<Vec3> = vertices.iter().copied().filter(|v| v.z > top - 0.0015).collect();
    let middle = (near.iter().sum::<Vec3>() / near.len() as f32).with_z(top + 0.01 - 0.0005);
    let bodies = pieces.iter().enumerate().map(|(index, (half_width, _))| {
        let half = Vec3::new(*half_width, 0.15, 0.01);
        let sign = |corner: u32, bit: u32| (corner >> bit & 1) as f32 * 2.0 - 1.0;
        let corners = (0..8).map(|c| half * Vec3::new(sign(c, 0), sign(c, 1), sign(c, 2))).collect();
        let quads = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
        let triangles = quads.iter().flat_map(|[a, b, c, d]| [[*a, *b, *c], [*a, *c, *d]]).collect();
        let body = RigidBody::from_mesh(&format!("part {index}"), corners, triangles).unwrap();
        let body = body.with_mass(kilograms * f64::from(half_width / 0.15), 0.0).unwrap();
        RigidBody { joined_to: index.checked_sub(1), ..body }
    });
    let at = |offset: &Vec3| Some(Pose { position: (middle + *offset).as_dvec3(), orientation: DQuat::IDENTITY });
    Take {
        times: (0..FRAMES).map(|k| k as f64 / 30.0).collect(),
        models: [&models[0], &models[1]],
        hands: [vec![Tracked::Absent; FRAMES], vec![Tracked::Present(Box::default()); FRAMES]],
        bodies: bodies.collect(),
        poses: pieces.iter().map(|(_, offset)| vec![at(offset); FRAMES]).collect(),
        fixed: Vec::new(),
        gravity: Some(G),
    }
}

/// Place of the cut, m: beside the palm, so that no skin lies in the gap.
const CUT: f32 = 0.06;

/// Pieces of a plate, 0.3 m wide, that is cut at `cut`, m, beside its middle.
fn halves(cut: f32) -> [(f32, Vec3); 2] {
    [(0.5 * (0.15 + cut), Vec3::X * (0.5 * (cut - 0.15))), (0.5 * (0.15 - cut), Vec3::X * (0.5 * (cut + 0.15)))]
}

#[test]
fn a_hand_under_one_part_of_a_hinged_plate_carries_both() {
    let models = Side::BOTH.map(HandModel::builtin);
    let (kilograms, weight) = (0.6, 0.6 * 9.81);
    for pieces in [vec![(0.15, Vec3::ZERO)], halves(CUT).to_vec()] {
        let take = plates(&models, &pieces, kilograms);
        let found = whole(&take, &Settings::default());
        let hand = &found.frames[10].hands[1];
        assert_eq!(hand.validity, ForceValidity::Valid, "{} pieces", pieces.len());
        let total: f64 = hand.links.iter().map(|link| link.unwrap().force).sum();
        assert!((total - weight).abs() < 0.02 * weight + 0.05, "{} pieces: {total} N for {weight} N", pieces.len());
        // The first part stands for all.
        let wrenches: Vec<bool> = found.frames[10].bodies.iter().map(Option::is_some).collect();
        assert_eq!(wrenches, (0..pieces.len()).map(|part| part == 0).collect::<Vec<_>>());
    }
}

#[test]
fn a_body_that_rests_on_something_unknown_matters_to_the_hand_at_it_alone() {
    let models = Side::BOTH.map(HandModel::builtin);
    // A second plate floats two metres away, still or moving.
    let of = |offset: Vec3, speed: f64| {
        let mut take = plates(&models, &[(0.15, Vec3::ZERO), (0.15, offset)], 1.2);
        take.bodies[1].joined_to = None;
        for (frame, pose) in take.poses[1].iter_mut().enumerate() {
            pose.as_mut().unwrap().position += DVec3::X * (speed * frame as f64 / 30.0);
        }
        let found = whole(&take, &Settings::default());
        assert!(found.frames[10].bodies[1].as_ref().unwrap().unexplained, "{offset} {speed}");
        found.frames[10].hands[1].validity
    };
    let away = Vec3::X * 2.0;
    assert_eq!(of(away, 0.0), ForceValidity::Valid);
    assert_eq!(of(away, 0.1), ForceValidity::Unexplained);
}

#[test]
fn an_articulated_object_is_unknown_where_one_of_its_parts_is() {
    let models = Side::BOTH.map(HandModel::builtin);
    let mut take = plates(&models, &halves(CUT), 0.6);
    take.poses[1][10] = None;
    let gap = whole(&take, &Settings::default()).frames[10].hands[1].clone();
    assert_eq!(gap.validity, ForceValidity::PoseGap);
    let mut take = plates(&models, &halves(CUT), 0.6);
    take.bodies[1].mass = None;
    let massless = whole(&take, &Settings::default()).frames[10].hands[1].clone();
    assert_eq!(massless.validity, ForceValidity::MassUnknown);
}
