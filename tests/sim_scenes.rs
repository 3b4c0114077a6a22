//! The shipped scenes do what they say, and their labels are what the physics says.
#![cfg(feature = "sim")]

use egotac::hand::{HandModel, N_JOINTS, Side};
use egotac::sim::{Rollout, RolloutOptions, Scene, SimFrame};
use egotac::tactile::Validity;
use glam::{DVec3, Vec3};

/// Without pictures: no display, no OpenGL.
fn blind() -> RolloutOptions {
    RolloutOptions { picture: None, ..RolloutOptions::default() }
}

fn frames(scene: &str, seed: u64) -> (Rollout, Vec<SimFrame>) {
    let mut rollout = Rollout::new(&Scene::load(scene).unwrap(), seed, &blind()).unwrap();
    let mut frames = Vec::new();
    while let Some(frame) = rollout.next_frame().unwrap() {
        frames.push(frame);
    }
    assert_eq!(frames.len(), rollout.frame_count());
    (rollout, frames)
}

/// Force on the hand that acts, N.
fn force(rollout: &Rollout, frame: &SimFrame) -> f64 {
    let actor = rollout.episode().hands[0].side;
    frame.hands[actor as usize].as_ref().map_or(0.0, |hand| hand.total)
}

/// In the middle of the phase `hold` the object hangs in the hand: off the table, where the hand took it.
fn is_held(scene: &str, seed: u64) {
    let (rollout, frames) = frames(scene, seed);
    let top = frames.iter().max_by(|a, b| a.objects[0].position.z.total_cmp(&b.objects[0].position.z)).unwrap();
    let rise = top.objects[0].position.z - frames[0].objects[0].position.z;
    assert!(rise > 0.02, "{scene}, seed {seed}: rose by {rise} m");
    assert!(force(&rollout, top) > 0.3, "{scene}, seed {seed}: held by {} N", force(&rollout, top));
    // Touched by two links or more, and by nothing but the hand: the net force is the weight.
    let hand = top.hands[rollout.episode().hands[0].side as usize].as_ref().unwrap();
    assert!(hand.contacts >= 2, "{scene}, seed {seed}: {} contacts", hand.contacts);
    let last = frames.last().unwrap();
    assert!(last.objects[0].position.z - frames[0].objects[0].position.z < 0.01, "{scene}, seed {seed}: set down");
    assert_eq!(force(&rollout, last), 0.0, "{scene}, seed {seed}: let go");
}

#[test]
fn the_mug_leaves_the_table_in_the_hand_and_comes_back() {
    (0..6).for_each(|seed| is_held("lift_mug", seed));
}

#[test]
fn the_pinched_cube_leaves_the_table_between_the_fingers_and_comes_back() {
    (0..6).for_each(|seed| is_held("pinch_cube", seed));
}

#[test]
fn hovering_never_touches_though_it_is_near() {
    for seed in 0..8 {
        let (rollout, frames) = frames("hover", seed);
        let most = frames.iter().map(|frame| force(&rollout, frame)).fold(0.0, f64::max);
        assert_eq!(most, 0.0, "seed {seed}");
        let moved = frames.last().unwrap().objects[0].position.distance(frames[0].objects[0].position);
        assert!(moved < 1e-3, "seed {seed}: the object moved by {moved} m");
    }
    // The distance rule calls some of it contact; that is what the scene is for.
    let near = (0..8).any(|seed| frames("hover", seed).1.iter().any(|frame| frame.proximity.contains(&1)));
    assert!(near);
}

#[test]
fn every_frame_conserves_force_and_is_valid() {
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
fn frames_come_at_25_hertz_exactly() {
    let (_, frames) = frames("hover", 1);
    for (i, frame) in frames.iter().enumerate() {
        assert!((frame.frame.timestamp - 0.04 * i as f64).abs() < 1e-9);
    }
}

#[test]
fn the_same_seed_gives_the_same_rollout_bit_for_bit() {
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
        let mut rollout = Rollout::new(&Scene::load(scene).unwrap(), seed, &blind()).unwrap();
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
            // The engine's skin is this sum over its bones; what is bound to them carries the pose blend shapes.
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
fn the_camera_sees_hand_and_object_most_of_the_time() {
    for scene in ["pinch_cube", "lift_mug", "hover"] {
        let options = RolloutOptions { picture: None, ..RolloutOptions::default() };
        let mut seen = [0, 0];
        let mut all = 0;
        for seed in 0..4 {
            let mut rollout = Rollout::new(&Scene::load(scene).unwrap(), seed, &options).unwrap();
            while let Some(frame) = rollout.next_frame().unwrap() {
                // The picture is square; half the field of view to each side.
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
fn both_hands_act_and_both_sides_are_the_models() {
    let sides: Vec<Side> = (0..8)
        .map(|seed| Rollout::new(&Scene::load("hover").unwrap(), seed, &blind()).unwrap().episode().hands[0].side)
        .collect();
    assert!(sides.contains(&Side::Left) && sides.contains(&Side::Right));
    let swapped = RolloutOptions { hands: [Side::Right, Side::Left].map(HandModel::builtin), ..blind() };
    assert!(Rollout::new(&Scene::load("hover").unwrap(), 0, &swapped).is_err());
}
