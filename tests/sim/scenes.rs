//! Shipped scenes do what their descriptions say, and their labels match the physics.

use egotac::hand::{HandModel, N_JOINTS, Side};
use egotac::sim::{Rollout, RolloutOptions, Scene, SimFrame};
use egotac::tactile::Validity;
use glam::{DVec3, Vec3};

/// Options without pictures, and thus without OpenGL.
fn without_pictures() -> RolloutOptions {
    RolloutOptions { picture: None, ..RolloutOptions::default() }
}

fn frames(scene: &str, seed: u64) -> (Rollout, Vec<SimFrame>) {
    let mut rollout = Rollout::new(&Scene::load(scene).unwrap(), seed, &without_pictures()).unwrap();
    let mut frames = Vec::new();
    while let Some(frame) = rollout.next_frame().unwrap() {
        frames.push(frame);
    }
    assert_eq!(frames.len(), rollout.frame_count());
    (rollout, frames)
}

/// Returns the force on the acting hand, N.
fn force(rollout: &Rollout, frame: &SimFrame) -> f64 {
    let actor = rollout.episode().hands[0].side;
    frame.hands[actor as usize].as_ref().map_or(0.0, |hand| hand.total)
}

/// Checks that the hand lifts the object off the table and puts it back.
fn check_lift(scene: &str, seed: u64) {
    let (rollout, frames) = frames(scene, seed);
    let top = frames.iter().max_by(|a, b| a.objects[0].position.z.total_cmp(&b.objects[0].position.z)).unwrap();
    let rise = top.objects[0].position.z - frames[0].objects[0].position.z;
    assert!(rise > 0.02, "{scene}, seed {seed}: rose by {rise} m");
    assert!(force(&rollout, top) > 0.3, "{scene}, seed {seed}: held by {} N", force(&rollout, top));
    // At least two contacts hold it.
    let hand = top.hands[rollout.episode().hands[0].side as usize].as_ref().unwrap();
    assert!(hand.contacts >= 2, "{scene}, seed {seed}: {} contacts", hand.contacts);
    let last = frames.last().unwrap();
    assert!(last.objects[0].position.z - frames[0].objects[0].position.z < 0.01, "{scene}, seed {seed}: set down");
    assert_eq!(force(&rollout, last), 0.0, "{scene}, seed {seed}: let go");
}

#[test]
fn mug_is_lifted_and_put_back() {
    (0..6).for_each(|seed| check_lift("lift_mug", seed));
}

#[test]
fn pinched_cube_is_lifted_and_put_back() {
    (0..6).for_each(|seed| check_lift("pinch_cube", seed));
}

#[test]
fn hovering_comes_near_but_never_touches() {
    for seed in 0..8 {
        let (rollout, frames) = frames("hover", seed);
        let most = frames.iter().map(|frame| force(&rollout, frame)).fold(0.0, f64::max);
        assert_eq!(most, 0.0, "seed {seed}");
        let moved = frames.last().unwrap().objects[0].position.distance(frames[0].objects[0].position);
        assert!(moved < 1e-3, "seed {seed}: the object moved by {moved} m");
    }
    // The scene exists because the distance rule labels some of it as contact.
    let near = (0..8).any(|seed| frames("hover", seed).1.iter().any(|frame| frame.proximity.contains(&1)));
    assert!(near);
}

#[test]
fn each_frame_conserves_force_and_is_valid() {
    for scene in ["pinch_cube", "lift_mug", "hover"] {
        for seed in 10..13 {
            let (_, frames) = frames(scene, seed);
            for frame in &frames {
                let time = frame.frame.timestamp;
                assert_eq!(frame.frame.validity, Validity::Valid, "{scene}, seed {seed}, {time} s");
                for (side, hand) in Side::BOTH.into_iter().zip(&frame.hands) {
                    let Some(hand) = hand else { continue };
                    assert!(hand.sum_residual <= 1e-6, "{scene}, seed {seed}, {time} s: {}", hand.sum_residual);
                    let stored = f64::from(frame.frame.field.total_force(side));
                    assert!((stored - hand.total).abs() <= 1e-5 * hand.total.max(1.0));
                }
            }
        }
    }
}

#[test]
fn frames_are_exactly_40_ms_apart() {
    let (_, frames) = frames("hover", 1);
    for (i, frame) in frames.iter().enumerate() {
        assert!((frame.frame.timestamp - 0.04 * i as f64).abs() < 1e-9);
    }
}

#[test]
fn same_seed_gives_the_same_rollout_bit_for_bit() {
    let (_, a) = frames("pinch_cube", 3);
    let (_, b) = frames("pinch_cube", 3);
    let (_, c) = frames("pinch_cube", 4);
    assert_eq!(a.len(), b.len());
    for (a, b) in a.iter().zip(&b) {
        assert_eq!(a.frame.field, b.frame.field);
        assert_eq!(a.objects, b.objects);
        assert_eq!(a.frame.right_hand_pose, b.frame.right_hand_pose);
    }
    assert_ne!(a[0].objects, c[0].objects);
}

#[test]
fn hand_parameters_reproduce_bodies_and_skin() {
    for (scene, seed) in [("lift_mug", 0), ("lift_mug", 1), ("pinch_cube", 0), ("pinch_cube", 2)] {
        let mut rollout = Rollout::new(&Scene::load(scene).unwrap(), seed, &without_pictures()).unwrap();
        for _ in 0..rollout.frame_count() / 2 {
            assert!(rollout.skip_frame());
        }
        for side in Side::BOTH {
            let Some(params) = rollout.hand_params(side) else { continue };
            let rig = &rollout.rigs()[side as usize];
            let posed = rig.model.forward(&params);
            let pose = |joint: usize| {
                let body = rollout.world().body(&rig.name(egotac::sim::rig::JOINT_NAMES[joint])).unwrap();
                (rollout.world().position(body), rollout.world().orientation(body))
            };
            for joint in 0..N_JOINTS {
                let error = posed.joints[joint].as_dvec3().distance(pose(joint).0);
                assert!(error < 1e-5, "{scene}, {}, joint {joint}: {error} m", side.name());
            }
            // The engine's skin is this sum over its bones; the bound vertices include the pose blend shapes.
            for (vertex, rest) in rig.bound_vertices(&posed).iter().enumerate() {
                let skin: DVec3 = (0..N_JOINTS)
                    .map(|joint| {
                        let (position, orientation) = pose(joint);
                        let weight = f64::from(rig.model.lbs_weights[vertex * N_JOINTS + joint]);
                        weight * (position + orientation * (rest.as_dvec3() - rig.joints[joint]))
                    })
                    .sum();
                let error = skin.distance(posed.vertices[vertex].as_dvec3());
                assert!(error < 1e-5, "{scene}, {}, vertex {vertex}: {error} m", side.name());
            }
        }
    }
}

#[test]
fn camera_sees_hand_and_object_in_most_frames() {
    for scene in ["pinch_cube", "lift_mug", "hover"] {
        let options = RolloutOptions { picture: None, ..RolloutOptions::default() };
        let mut seen = [0, 0];
        let mut all = 0;
        for seed in 0..4 {
            let mut rollout = Rollout::new(&Scene::load(scene).unwrap(), seed, &options).unwrap();
            while let Some(frame) = rollout.next_frame().unwrap() {
                // The picture is square: half the field of view to each side.
                let half = (0.5 * rollout.episode().camera.fovy).tan();
                let inside = |point: DVec3| {
                    let p = frame.camera.camera_from_world(point);
                    p.z > 0.1 && p.x.abs() < half * p.z && p.y.abs() < half * p.z
                };
                let actor = rollout.episode().hands[0].side;
                let wrist = rollout.hand_params(actor).map(|params| {
                    let posed: Vec<Vec3> = rollout.rigs()[actor as usize].model.forward(&params).vertices;
                    posed.iter().filter(|v| inside(v.as_dvec3())).count() * 2 > posed.len()
                });
                all += 1;
                seen[0] += usize::from(inside(frame.objects[0].position));
                seen[1] += usize::from(wrist == Some(true));
            }
        }
        assert!(seen[0] * 100 > all * 97 && seen[1] * 100 > all * 75, "{scene}: object, hand in {seen:?} of {all}");
    }
}

#[test]
fn either_hand_acts_and_swapped_models_are_refused() {
    let sides: Vec<Side> = (0..8)
        .map(|seed| {
            Rollout::new(&Scene::load("hover").unwrap(), seed, &without_pictures()).unwrap().episode().hands[0].side
        })
        .collect();
    assert!(sides.contains(&Side::Left) && sides.contains(&Side::Right));
    let swapped = RolloutOptions { hands: [Side::Right, Side::Left].map(HandModel::builtin), ..without_pictures() };
    assert!(Rollout::new(&Scene::load("hover").unwrap(), 0, &swapped).is_err());
}

/// Motion of a scene's first object.
enum ObjectMotion {
    /// Stays at its place.
    Still,
    /// Rises by more than 2 cm.
    Rises,
    /// Moves by more than this along the table, m.
    Slides(f64),
    /// Turns by more than this about its joint, rad.
    Turns(f64),
}

/// Checks that a scene touches or does not touch, and that its first object moves as expected.
fn check_scene(scene: &str, touched: bool, motion: &ObjectMotion) {
    for seed in [3, 4] {
        let (_, frames) = frames(scene, seed);
        let total = |frame: &SimFrame| frame.hands.iter().flatten().map(|hand| hand.total).sum::<f64>();
        let pressed = frames.iter().filter(|frame| total(frame) > 0.1).count();
        assert_eq!(pressed >= 8, touched, "{scene}, seed {seed}: {pressed} frames with touch");
        assert_eq!(pressed == 0, !touched, "{scene}, seed {seed}: {pressed} frames with touch");
        let refused = frames.iter().filter(|frame| frame.frame.validity != Validity::Valid).count();
        assert!(refused * 20 < frames.len(), "{scene}, seed {seed}: {refused} frames refused");
        let Some(start) = frames[0].objects.first() else { continue };
        let most = |measure: &dyn Fn(&egotac::sim::ObjectPose) -> f64| {
            frames.iter().map(|frame| measure(&frame.objects[0])).fold(0.0, f64::max)
        };
        let rise = most(&|pose| pose.position.z - start.position.z);
        let slide = most(&|pose| (pose.position - start.position).truncate().length());
        let turn = most(&|pose| pose.orientation.angle_between(start.orientation));
        match motion {
            ObjectMotion::Still => assert!(slide < 1e-3 && rise < 1e-3, "{scene}, seed {seed}: moved by {slide} m"),
            ObjectMotion::Rises => assert!(rise > 0.02, "{scene}, seed {seed}: rose by {rise} m"),
            ObjectMotion::Slides(least) => {
                assert!(slide > *least && rise < 0.01, "{scene}, seed {seed}: slid by {slide} m")
            }
            ObjectMotion::Turns(least) => {
                assert!(turn > *least && rise < 1e-3, "{scene}, seed {seed}: turned by {turn} rad")
            }
        }
    }
}

#[test]
fn grasped_objects_are_lifted() {
    for scene in ["tripod", "hold_plate", "carry_box", "clutter"] {
        check_scene(scene, true, &ObjectMotion::Rises);
    }
}

#[test]
fn bottle_in_a_power_grasp_is_lifted_and_stands_again() {
    for seed in 10..13 {
        let (_, frames) = frames("power_grasp", seed);
        let place = |frame: &SimFrame| (frame.objects[0].position.z, frame.objects[0].orientation * DVec3::Z);
        let ((start, _), (end, up)) = (place(&frames[0]), place(&frames[frames.len() - 1]));
        let rise = frames.iter().map(|frame| place(frame).0 - start).fold(0.0, f64::max);
        assert!(rise > 0.02, "seed {seed}: it rises by {rise} m");
        assert!((end - start).abs() < 0.005 && up.z > 0.98, "seed {seed}: it ends at {end} m, up is {up}");
        let contacts = frames.iter().flat_map(|frame| frame.hands.iter().flatten()).map(|hand| hand.contacts).max();
        assert!(contacts.unwrap() >= 6, "seed {seed}: the whole hand must touch");
    }
}

#[test]
fn pushed_objects_slide_and_objects_with_a_joint_turn() {
    check_scene("palm_push", true, &ObjectMotion::Slides(0.03));
    check_scene("slide_card", true, &ObjectMotion::Slides(0.02));
    check_scene("wipe_table", true, &ObjectMotion::Slides(0.02));
    check_scene("turn_knob", true, &ObjectMotion::Turns(0.3));
    check_scene("open_door", true, &ObjectMotion::Turns(0.3));
}

#[test]
fn negative_scenes_touch_no_object() {
    check_scene("reach_past", false, &ObjectMotion::Still);
    let (_, frames) = frames("rub_hands", 3);
    let both = frames.iter().filter(|frame| frame.hands.iter().flatten().filter(|hand| hand.total > 0.5).count() == 2);
    assert!(both.count() > 10, "each hand is touched by the other");
    assert!(frames.iter().all(|frame| frame.objects.is_empty() && !frame.proximity.contains(&1)));
}

#[test]
fn pressed_button_sinks_and_returns() {
    let (_, frames) = frames("press_button", 3);
    let start = frames[0].objects[0].position.z;
    let deepest = frames.iter().map(|frame| start - frame.objects[0].position.z).fold(0.0, f64::max);
    assert!(deepest > 0.002, "sank by {deepest} m");
    let last = frames.last().unwrap().objects[0].position.z;
    assert!((last - start).abs() < 5e-4, "came up to {} m of where it was", last - start);
}

#[test]
fn stick_is_handed_from_one_hand_to_the_other() {
    let (rollout, frames) = frames("regrasp", 3);
    let first = rollout.episode().hands[0].side as usize;
    let force = |frame: &SimFrame, hand: usize| frame.hands[hand].as_ref().map_or(0.0, |hand| hand.total);
    let raised: Vec<&SimFrame> =
        frames.iter().filter(|frame| frame.objects[0].position.z - frames[0].objects[0].position.z > 0.01).collect();
    let phase = |one: bool, other: bool| {
        raised.iter().filter(|f| (force(f, first) > 0.5) == one && (force(f, 1 - first) > 0.5) == other).count()
    };
    assert!(phase(true, false) > 5 && phase(true, true) > 3 && phase(false, true) > 5);
    assert_eq!(phase(false, false), 0, "a hand must hold the raised stick");
}

#[test]
fn soft_ball_deforms_under_the_force_of_the_fingers() {
    let (rollout, frames) = frames("squeeze_ball", 3);
    let egotac::sim::object::Mount::Soft { radius, .. } = rollout.episode().objects[0].shape.mount else {
        panic!("the ball is soft")
    };
    let pressed = frames.iter().filter(|frame| force(&rollout, frame) > 0.5).count();
    assert!(pressed > 10, "{pressed} frames");
    // Between the fingers it is thinner than at rest.
    let squeezed = frames.iter().max_by(|a, b| force(&rollout, a).total_cmp(&force(&rollout, b))).unwrap();
    let hand = rollout.episode().hands[0].side;
    let pose = if hand == Side::Left { &squeezed.frame.left_hand_pose } else { &squeezed.frame.right_hand_pose };
    let vertices = rollout.rigs()[hand as usize].model.forward(pose.as_ref().unwrap()).vertices;
    let centre = squeezed.objects[0].position;
    let nearest = vertices.iter().map(|v| v.as_dvec3().distance(centre)).fold(f64::INFINITY, f64::min);
    assert!(nearest < radius - 4e-4, "the skin stands {nearest} m from the middle of a ball of {radius} m");
}

#[test]
fn a_soft_ball_has_as_many_points_as_the_scene_says() {
    let mut scene = Scene::load("squeeze_ball").unwrap();
    for points in [5, 7, 10] {
        scene.spec.objects[0].shape.set_points(points);
        let mut rollout = Rollout::new(&scene, 3, &without_pictures()).unwrap();
        let world = rollout.world();
        let flex = world.flex("ball").unwrap();
        // The surface of a cube of points, and the centre; two triangles for each square of the six sides.
        assert_eq!(world.flex_points(&flex).len(), 6 * (points - 1) * (points - 1) + 3);
        assert_eq!(flex.triangles.len(), 2 * 6 * (points - 1) * (points - 1));
        let pressed = std::iter::from_fn(|| rollout.next_frame().unwrap())
            .filter(|f| f.hands.iter().flatten().any(|hand| hand.total > 0.5));
        assert!(pressed.count() > 10, "{points} points");
    }
}

#[test]
fn no_distractor_starts_within_a_hand() {
    let scene = Scene::load("clutter").unwrap();
    // Seeds of a former fault, and the first 30.
    for seed in [6132, 6322, 6835].into_iter().chain(0..30) {
        let rollout = Rollout::new(&scene, seed, &without_pictures());
        let rollout = rollout.unwrap_or_else(|error| panic!("seed {seed}: {error}"));
        assert!(rollout.objects().len() > 5, "seed {seed}: {} objects", rollout.objects().len());
    }
}
