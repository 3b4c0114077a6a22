//! Transfer of touch: sums, cones, limits, merged fingers, pooled vertices, and a grip in simulation.

use crate::trajectory::Trajectory;
#[allow(dead_code)]
use egotac::hand::{HandModel, HandParams, N_VERTICES, Region, Side};
use egotac::retarget::human::Hand;
use egotac::retarget::touch::PALM;
use egotac::retarget::touch::balance::{ForceBalance, LinkContact, into_cone};
use egotac::retarget::{Input, Retargeter, Robot, Touch, TouchPooling};
use glam::{DQuat, DVec3};
use proptest::prelude::*;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

fn contact(position: [f64; 3], normal: [f64; 3], wanted: [f64; 3]) -> LinkContact {
    LinkContact {
        link: 0,
        position: DVec3::from_array(position),
        normal: DVec3::from_array(normal).normalize(),
        wanted: DVec3::from_array(wanted),
        max_normal: 1e9,
        force: DVec3::ZERO,
    }
}

/// Twice the cost of a balance.
fn cost(contacts: &[LinkContact], net: DVec3, moment: DVec3) -> f64 {
    let middle = contacts.iter().map(|c| c.position).sum::<DVec3>() / contacts.len() as f64;
    let sum: DVec3 = contacts.iter().map(|c| c.force).sum();
    let turn: DVec3 = contacts.iter().map(|c| (c.position - middle).cross(c.force)).sum();
    contacts.iter().map(|c| (c.force - c.wanted).length_squared()).sum::<f64>()
        + 100.0 * (sum - net).length_squared()
        + 10.0 * ((turn - moment) / 0.05).length_squared()
}

#[test]
fn forces_that_balance_inside_their_cones_stay_as_they_are() {
    let mut contacts = [
        contact([0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [-3.0, 0.5, 0.0]),
        contact([0.04, 0.0, 0.0], [-1.0, 0.0, 0.0], [3.0, -0.5, 0.0]),
    ];
    let middle = DVec3::X * 0.02;
    let moment = contacts.iter().map(|c| (c.position - middle).cross(c.wanted)).sum();
    ForceBalance::new(2).solve(&mut contacts, DVec3::ZERO, moment, 0.8);
    for contact in contacts {
        assert!((contact.force - contact.wanted).length() < 1e-9, "{}", contact.force);
    }
}

#[test]
fn a_balance_is_as_good_as_any_nearby_and_within_its_cones() {
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    for _ in 0..40 {
        let mut vector = |size: f64| DVec3::from_array(std::array::from_fn(|_| rng.random_range(-size..size)));
        let mut contacts: Vec<LinkContact> = (0..4)
            .map(|_| {
                let normal = vector(1.0).normalize();
                LinkContact {
                    link: 0,
                    position: vector(0.05),
                    normal,
                    wanted: -2.0 * normal + vector(1.5),
                    max_normal: 1e9,
                    force: DVec3::ZERO,
                }
            })
            .collect();
        let (net, moment) = (contacts.iter().map(|c| c.wanted).sum::<DVec3>() + vector(0.5), vector(0.02));
        ForceBalance::new(4).solve(&mut contacts, net, moment, 0.8);
        let best = cost(&contacts, net, moment);
        for contact in &contacts {
            let push = -contact.force.dot(contact.normal);
            let slide = (contact.force + push * contact.normal).length();
            assert!(push >= -1e-12 && slide <= 0.8 * push + 1e-9, "{push} {slide}");
        }
        for _ in 0..300 {
            let mut other = contacts.clone();
            for contact in &mut other {
                contact.force = into_cone(contact.force + vector(0.05), contact, 0.8);
            }
            assert!(cost(&other, net, moment) > best * (1.0 - 0.02) - 1e-6, "{} {best}", cost(&other, net, moment));
        }
    }
}

proptest! {
    #[test]
    fn the_cone_is_a_projection(f in prop::array::uniform3(-5.0f64..5.0), n in prop::array::uniform3(-1.0f64..1.0)) {
        prop_assume!(DVec3::from_array(n).length() > 0.1);
        let at = contact([0.0; 3], n, [0.0; 3]);
        let once = into_cone(DVec3::from_array(f), &at, 0.8);
        prop_assert!((into_cone(once, &at, 0.8) - once).length() < 1e-9);
        // What is cut off is at a right angle to what stays.
        prop_assert!((DVec3::from_array(f) - once).dot(once).abs() < 1e-9 * (1.0 + once.length_squared()));
    }
}

fn follow(
    robot: &str,
    touch: impl Fn(usize, &[DVec3; 21], [f64; 5], [DVec3; 5]) -> Touch,
    frames: usize,
) -> Vec<egotac::retarget::Output> {
    let trajectory = Trajectory::generate(frames, 11).unwrap();
    let mut retargeter = Retargeter::new(Robot::load(robot, None).unwrap()).unwrap();
    (0..frames)
        .map(|frame| {
            let keypoints = trajectory.keypoints[frame];
            let mut input = Input::new(keypoints, frame as f64 / 30.0);
            input.touch = Some(touch(frame, &keypoints, trajectory.tip_contact[frame], trajectory.tip_force[frame]));
            retargeter.push(&input).unwrap().clone()
        })
        .collect()
}

#[test]
fn the_net_force_of_five_fingers_stays_on_four_and_two() {
    // Five fingers press on a ball before the palm: fewer fingers must carry the same sum.
    let press = |_: usize, keypoints: &[DVec3; 21], _, _| {
        let hand = Hand::new(keypoints, Side::Right).unwrap();
        let forces = std::array::from_fn(|finger| {
            let normal = egotac::retarget::human::pad_normal(&hand.points, finger);
            hand.axes * (-(1.0 + 0.3 * finger as f64) * normal)
        });
        Touch { tip_contact: [1.0; 5], tip_force: Some(forces), segments: None }
    };
    for robot in ["four_finger", "tendon_hand"] {
        for (frame, output) in follow(robot, press, 40).iter().enumerate().skip(5) {
            let sum: DVec3 = output.expected_touch.links.iter().map(|link| link.force).sum();
            let asked = output.expected_touch.net_force;
            assert!(
                (sum - asked).length() < 0.05 * asked.length().max(1.0),
                "{robot}, frame {frame}: {sum} for {asked}"
            );
            assert!(
                output.expected_touch.unassigned_force == 0.0
                    && output.expected_touch.links.iter().all(|link| link.normal_force >= 0.0)
            );
        }
    }
}

/// Mean angle between a fingertip's force and the one asked for, degrees, in pinches whose forces are turned to a side.
fn turned_pinches(robot: &str, facing: Option<f64>) -> f64 {
    let trajectory = Trajectory::generate(360, 11).unwrap();
    let mut robot = Robot::load(robot, None).unwrap();
    robot.spec.weights.facing = facing.unwrap_or(robot.spec.weights.facing);
    let friction = robot.spec.contact.friction;
    let mut retargeter = Retargeter::new(robot).unwrap();
    let mut angles = Vec::new();
    for frame in 0..trajectory.keypoints.len() {
        let (contact, force) = (trajectory.tip_contact[frame], trajectory.tip_force[frame]);
        // Sixty degrees off the line between the tips: more than friction alone holds.
        let side = DQuat::from_axis_angle(force[0].any_orthogonal_vector().normalize_or(DVec3::X), 60f64.to_radians());
        let turned = force.map(|force| side * force);
        let mut input = Input::new(trajectory.keypoints[frame], frame as f64 / 30.0);
        input.touch = Some(Touch { tip_contact: contact, tip_force: Some(turned), segments: None });
        let output = retargeter.push(&input).unwrap();
        for (asked, got) in turned.iter().zip(output.expected_touch.tip_force).filter(|(asked, _)| asked.length() > 0.1)
        {
            if got.length() > 0.0 {
                angles.push(got.angle_between(*asked).to_degrees());
            }
        }
        for link in output.expected_touch.links.iter().filter(|link| link.normal_force > 0.0) {
            assert!(link.force.length() <= link.normal_force * (1.0 + friction * friction).sqrt() * 1.001, "{link:?}");
        }
    }
    assert!(angles.len() > 100);
    angles.iter().sum::<f64>() / angles.len() as f64
}

#[test]
fn fingertips_press_each_other_in_the_humans_direction() {
    // Seven coupled joints can turn fingertips less than sixteen free ones.
    for (robot, most, share) in [("four_finger", 8.0, 0.5), ("tendon_hand", 18.0, 0.85)] {
        let (facing, not) = (turned_pinches(robot, None), turned_pinches(robot, Some(0.0)));
        println!("{robot}: {facing} degrees, {not} without");
        assert!(facing < most && facing < share * not, "{robot}: {facing} degrees, {not} without");
    }
}

#[test]
fn what_is_not_touched_feels_nothing_and_forces_may_be_huge() {
    for size in [0.0, 1e4] {
        let touch = move |_: usize, _: &[DVec3; 21], contact: [f64; 5], force: [DVec3; 5]| Touch {
            tip_contact: contact,
            tip_force: Some(force.map(|f| f.normalize_or_zero() * size)),
            segments: None,
        };
        for output in follow("four_finger", touch, 90) {
            for link in &output.expected_touch.links {
                assert!(link.force.is_finite() && link.normal_force >= 0.0);
                assert!(link.contact > 0.5 || link.normal_force == 0.0, "{link:?}");
            }
            if size == 0.0 {
                assert!(output.expected_touch.links.iter().all(|link| link.normal_force == 0.0));
            }
        }
    }
}

#[test]
fn joint_torques_stay_within_the_actuators_limits() {
    let touch = |_: usize, _: &[DVec3; 21], contact: [f64; 5], force: [DVec3; 5]| Touch {
        tip_contact: contact,
        tip_force: Some(force.map(|f| 100.0 * f)),
        segments: None,
    };
    let mut clipped = 0;
    for output in follow("four_finger", touch, 90) {
        clipped += usize::from(output.expected_touch.clipped);
        // Every joint of this robot has a servo of 1.2 N m.
        assert!(
            output.expected_touch.torque.iter().all(|torque| torque.abs() <= 1.2 * 1.001),
            "{:?}",
            output.expected_touch.torque
        );
    }
    assert!(clipped > 10);
}

#[test]
fn a_bad_force_is_reported_by_name() {
    let good = Trajectory::generate(2, 0).unwrap().keypoints;
    let mut retargeter = Retargeter::new(Robot::load("four_finger", None).unwrap()).unwrap();
    for (force, says) in [(f64::NAN, "tip_force[2]"), (f64::INFINITY, "tip_force[2]")] {
        let mut forces = [DVec3::ZERO; 5];
        forces[2].y = force;
        let touch = Touch { tip_contact: [1.0; 5], tip_force: Some(forces), segments: None };
        let error = retargeter.push(&Input { touch: Some(touch), ..Input::new(good[0], 0.0) }).unwrap_err().to_string();
        assert!(error.contains(says), "{error}");
    }
    let touch = Touch { tip_contact: [0.0, 2.0, 0.0, 0.0, 0.0], ..Touch::default() };
    let error = retargeter.push(&Input { touch: Some(touch), ..Input::new(good[0], 0.0) }).unwrap_err().to_string();
    assert!(error.contains("tip_contact[1]"), "{error}");
}

#[test]
fn unknown_touch_is_no_touch_and_no_absence_of_touch() {
    let pooling = TouchPooling::builtin(Side::Right).unwrap();
    let unknown = vec![f32::NAN; N_VERTICES];
    let mut touch = Touch::default();
    pooling.pool_into(&unknown, &unknown, &mut touch).unwrap();
    assert!(touch.segments.is_none() && touch.tip_contact.iter().all(|contact| contact.is_nan()));
    // One known vertex is enough, and the others are ignored.
    let mut force = unknown.clone();
    force[0] = 0.5;
    pooling.pool_into(&force, &unknown, &mut touch).unwrap();
    let pressed: f64 = touch.segments.unwrap().iter().map(|segment| segment.pressed).sum();
    assert_eq!(pressed, 0.5);
    // The robot follows a hand of unknown touch as one without any.
    let hand = Trajectory::generate(2, 0).unwrap().keypoints[0];
    let robot = || Retargeter::new(Robot::load("four_finger", None).unwrap()).unwrap();
    let pose = |touch| robot().push(&Input { touch, ..Input::new(hand, 0.0) }).unwrap().qpos.clone();
    assert_eq!(pose(Some(Touch::default())), pose(None));
}

#[test]
fn vertices_pool_to_the_segments_they_lie_on() {
    for side in Side::BOTH {
        let model = HandModel::builtin(side);
        let pooling = TouchPooling::new(&model).unwrap();
        let regions = model.regions();
        for (region, segment) in
            [(Region::ThumbTip, 2), (Region::IndexMiddle, 4), (Region::LittleProximal, 12), (Region::Palm, PALM)]
        {
            let force: Vec<f32> = regions.iter().map(|r| if *r == region { 0.1 } else { 0.0 }).collect();
            let mut touch = Touch::default();
            pooling.pool_into(&force, &[], &mut touch).unwrap();
            let segments = touch.segments.unwrap();
            let total: f64 = force.iter().map(|f| f64::from(*f)).sum();
            assert!((segments[segment].pressed - total).abs() < 1e-3 && segments[segment].contact == 1.0);
            assert!(segments.iter().enumerate().all(|(other, s)| other == segment || s.pressed == 0.0));
        }
        let error = pooling.pool_into(&vec![-1.0; N_VERTICES], &[], &mut Touch::default()).unwrap_err().to_string();
        assert!(error.contains("force[0]"), "{error}");
        assert!(pooling.pool_into(&[0.0; 3], &[], &mut Touch::default()).is_err());
    }
}

#[test]
fn a_press_on_a_pad_points_into_it_in_any_pose() {
    let model = HandModel::builtin(Side::Right);
    let pooling = TouchPooling::new(&model).unwrap();
    let rest = Hand::new(&Hand::of_model(&model, &HandParams::default()), Side::Right).unwrap();
    // The vertex of the index fingertip that faces most to the palm.
    let normals = egotac::hand::vertex_normals(&model.v_template, &model.faces);
    let palmar = rest.axes.x_axis;
    let regions = model.regions();
    let vertex = (0..N_VERTICES)
        .filter(|v| regions[*v] == Region::IndexTip)
        .max_by(|a, b| normals[*a].as_dvec3().dot(palmar).total_cmp(&normals[*b].as_dvec3().dot(palmar)))
        .unwrap();
    let mut force = vec![0.0; N_VERTICES];
    force[vertex] = 2.0;
    let mut touch = Touch::default();
    pooling.pool_into(&force, &[], &mut touch).unwrap();
    let segment = touch.segments.as_ref().unwrap()[5];
    assert!(segment.force.x < -1.8, "{}", segment.force);
    assert_eq!(touch.tip_contact[1], 1.0);
}

#[test]
fn a_links_own_frame_and_that_of_the_hand_hold_the_same_force() {
    let press = |_: usize, _: &[DVec3; 21], contact: [f64; 5], force: [DVec3; 5]| Touch {
        tip_contact: contact,
        tip_force: Some(force),
        segments: None,
    };
    let mut pressed = 0;
    for output in follow("tendon_hand", press, 90) {
        for link in &output.expected_touch.links {
            assert!((link.force.length() - link.body_force.length()).abs() < 1e-9);
            pressed += usize::from(link.force.length() > 1.0);
            // A force has no torque about its own point of action.
            assert!((link.torque - link.position.cross(link.force)).length() < 1e-9);
        }
    }
    assert!(pressed > 20, "{pressed}");
}
