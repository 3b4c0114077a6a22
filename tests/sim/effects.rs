//! An effect that is off is absent: its counts, calls or traces are zero.

use std::path::Path;

use egotac::hand::{HandModel, N_BETAS, Side};
use egotac::mujoco::{Facts, PhysicsOptions};
use egotac::sim::lens::Lens;
use egotac::sim::randomize::EpisodeDraw;
use egotac::sim::rig::HandRig;
use egotac::sim::{Effect, EffectPlan, EffectSet, Rollout, RolloutOptions, Scene, SimFrame};

fn effects(of: &str) -> EffectSet {
    EffectPlan::of(&Scene::load(of).unwrap().spec).unwrap().effects()
}

fn rollout(scene: &str, effects: EffectSet) -> Rollout {
    let options = RolloutOptions { effects: Some(effects), picture: Some((48, 48)), ..RolloutOptions::default() };
    Rollout::new(&Scene::load(scene).unwrap(), 3, &options).unwrap()
}

/// Simulates a whole episode; returns its frames with the engine's counts.
fn frames(mut rollout: Rollout) -> Vec<(SimFrame, Facts)> {
    let mut frames = Vec::new();
    while let Some(frame) = rollout.next_frame().unwrap() {
        frames.push((frame, rollout.world().facts()));
    }
    frames
}

/// Removes the effects of pictures.
fn without_pictures(effects: EffectSet) -> EffectSet {
    let pictures = [Effect::Rendering, Effect::LensDistortion, Effect::SensorNoise, Effect::MotionBlur];
    pictures.into_iter().fold(effects, EffectSet::without)
}

#[test]
fn without_contact_the_contact_list_stays_empty() {
    let on = without_pictures(effects("pinch_cube"));
    assert!(frames(rollout("pinch_cube", on)).iter().any(|(_, facts)| facts.contacts > 4));
    let off = frames(rollout("pinch_cube", EffectSet::default()));
    assert!(off.iter().all(|(frame, facts)| facts.contacts == 0 && frame.hands.iter().all(Option::is_none)));
}

#[test]
fn without_dynamics_no_constraint_is_solved_and_no_object_moves() {
    let rollout = rollout("pinch_cube", EffectSet::default().with(Effect::RigidContact));
    let actor = rollout.episode().hands[0].side;
    let off = frames(rollout);
    let start = off[0].0.objects[0].position;
    assert!(off.iter().all(|(frame, facts)| facts.constraints == 0 && frame.objects[0].position == start));
    let wrist = |at: usize| {
        let frame = &off[at].0.frame;
        let pose = if actor == Side::Left { &frame.left_hand_pose } else { &frame.right_hand_pose };
        pose.as_ref().unwrap().transl
    };
    let way = (0..off.len()).map(|at| wrist(at).distance(wrist(0))).fold(0.0, f32::max);
    assert!(way > 0.04, "the hand must follow its plan; it moved {way} m");
    // A force that is not simulated is unknown, not zero.
    assert!(off.iter().all(|(frame, _)| frame.frame.field.force.iter().all(|force| force.is_nan())));
    assert!(off.iter().all(|(frame, _)| frame.frame.force_valid.iter().all(|valid| *valid == 0)));
}

#[test]
fn friction_and_torsional_friction_set_the_dimension_of_contacts() {
    let all = without_pictures(effects("pinch_cube"));
    let dimensions = |effects: EffectSet| {
        frames(rollout("pinch_cube", effects)).iter().map(|(_, facts)| facts.contact_dimensions).max().unwrap()
    };
    assert_eq!(dimensions(all), 4);
    let sliding = all.without(Effect::TorsionalFriction);
    assert_eq!(dimensions(sliding), 3);
    assert_eq!(dimensions(sliding.without(Effect::Friction)), 1);
}

#[test]
fn without_friction_the_cube_is_not_lifted() {
    let highest = |effects: EffectSet| {
        let frames = frames(rollout("pinch_cube", effects));
        let start = frames[0].0.objects[0].position.z;
        frames.iter().map(|(frame, _)| frame.objects[0].position.z - start).fold(0.0, f64::max)
    };
    let all = without_pictures(effects("pinch_cube"));
    assert!(highest(all) > 0.02);
    assert!(highest(all.without(Effect::TorsionalFriction).without(Effect::Friction)) < 0.01);
}

#[test]
fn without_gravity_the_table_carries_no_force() {
    let all = without_pictures(effects("pinch_cube"));
    let weight = |effects: EffectSet| {
        let mut rollout = rollout("pinch_cube", effects);
        for _ in 0..3 {
            rollout.next_frame().unwrap();
        }
        (rollout.world().contacts().map(|contact| contact.normal_force).sum::<f64>(), rollout.world().facts().gravity)
    };
    let (force, gravity) = weight(all);
    assert!(force > 0.1 && gravity, "{force} N");
    let (force, gravity) = weight(all.without(Effect::Gravity));
    assert!(force < 1e-3 && !gravity, "{force} N");
}

#[test]
fn without_articulation_a_door_has_no_joint_and_is_fixed() {
    let all = without_pictures(effects("open_door"));
    let turned = |effects: EffectSet| {
        let frames = frames(rollout("open_door", effects));
        let first = frames[0].0.objects[0].orientation;
        let turn =
            frames.iter().map(|(frame, _)| frame.objects[0].orientation.angle_between(first)).fold(0.0, f64::max);
        (turn, frames[0].1.joints)
    };
    let (turn, joints) = turned(all);
    assert!(turn > 0.3, "{turn} rad");
    let (fast, fewer) = turned(all.without(Effect::Articulation));
    assert!(fast < 1e-9 && fewer == joints - 1, "{fast} rad, {fewer} of {joints} joints");
}

#[test]
fn without_soft_bodies_the_ball_is_rigid_and_has_no_elements() {
    let all = without_pictures(effects("squeeze_ball"));
    let soft = rollout("squeeze_ball", all);
    assert_eq!(soft.world().facts().soft_bodies, 1);
    assert_eq!(soft.world().options().integrator, egotac::mujoco::Integrator::Discrete);
    // The timestep is the preset's: the discrete integrator is stable at any stiffness.
    assert_eq!(soft.world().options().timestep, PhysicsOptions::default().timestep);
    let rigid = rollout("squeeze_ball", all.without(Effect::SoftBody));
    assert_eq!(rigid.world().facts().soft_bodies, 0);
    assert_ne!(rigid.world().options().integrator, egotac::mujoco::Integrator::Discrete);
}

#[test]
fn idle_bodies_sleep_only_with_the_effect_and_wake_when_touched() {
    let all = without_pictures(effects("clutter"));
    assert!(all.contains(Effect::Sleep));
    let with = frames(rollout("clutter", all));
    assert!(with.iter().any(|(_, facts)| facts.asleep > 5));
    let cube = |frames: &[(SimFrame, Facts)]| {
        let start = frames[0].0.objects[0].position.z;
        frames.iter().map(|(frame, _)| frame.objects[0].position.z - start).fold(0.0, f64::max)
    };
    assert!(cube(&with) > 0.02, "the hand must wake the cube and raise it, got {} m", cube(&with));
    let without = frames(rollout("clutter", all.without(Effect::Sleep)));
    assert!(without.iter().all(|(_, facts)| facts.asleep == 0));
    // Sleep must not change the physics: the hand carries the same force.
    let total = |frames: &[(SimFrame, Facts)]| -> f64 {
        frames.iter().flat_map(|(frame, _)| frame.hands.iter().flatten()).map(|hand| hand.total).sum()
    };
    let (a, b) = (total(&with), total(&without));
    assert!((a - b).abs() < 0.02 * b, "{a} N and {b} N, summed over frames");
}

#[test]
fn near_contact_is_detected_only_with_the_effect_and_finds_all_near_vertices() {
    let text = std::fs::read_to_string("sim/scenes/hover.yaml").unwrap() + "observe: [pose, contact]\n";
    let scene = Scene::parse("hover", Path::new("hover.yaml"), &text).unwrap();
    let planned = EffectPlan::of(&scene.spec).unwrap().effects();
    assert_eq!(planned, [Effect::RigidContact, Effect::NearContact].into_iter().collect());
    let run = |effects: EffectSet| {
        let options = RolloutOptions { effects: Some(effects), picture: None, ..RolloutOptions::default() };
        frames(Rollout::new(&scene, 3, &options).unwrap())
    };
    let (with, without) = (run(planned), run(planned.without(Effect::NearContact)));
    assert!(with.iter().any(|(_, facts)| facts.near > 0));
    assert!(without.iter().all(|(_, facts)| facts.near == 0));
    assert!(without.iter().any(|(frame, _)| frame.proximity.contains(&1)), "the hand must come within 1 cm");
    for ((a, _), (b, _)) in with.iter().zip(&without) {
        assert_eq!(a.proximity, b.proximity, "{} s", a.frame.timestamp);
    }
}

#[test]
fn without_shadows_there_is_no_shadow_map() {
    let all = effects("poke");
    assert_eq!(rollout("poke", all).world().facts().shadow_map, 0);
    assert!(rollout("poke", all.with(Effect::Shadows)).world().facts().shadow_map > 0);
}

#[test]
fn noise_and_blur_change_only_the_picture() {
    let plain = effects("clutter").without(Effect::SensorNoise).without(Effect::MotionBlur);
    let noisy = plain.with(Effect::SensorNoise);
    let blurred = plain.with(Effect::MotionBlur);
    let run = |effects: EffectSet| {
        let mut rollout = rollout("clutter", effects);
        let mut frames = Vec::new();
        for _ in 0..rollout.frame_count() / 2 {
            frames.push(rollout.next_frame().unwrap().unwrap());
        }
        (frames, rollout.renders())
    };
    let (clean, renders) = run(plain);
    assert_eq!(renders, clean.len(), "one picture per frame");
    let (noise, renders) = run(noisy);
    assert_eq!(renders, clean.len());
    let sigma = rollout("clutter", noisy).episode().camera.noise;
    let (mut squares, mut count) = (0.0, 0.0);
    for (a, b) in clean.iter().zip(&noise) {
        let pairs = a.frame.camera_ego_rgb.as_raw().iter().zip(b.frame.camera_ego_rgb.as_raw());
        // Away from 0 and 255, where values are clipped.
        for (a, b) in pairs.filter(|(a, _)| (30..225).contains(*a)) {
            (squares, count) = (squares + (f64::from(*b) - f64::from(*a)).powi(2), count + 1.0);
        }
    }
    // Rounding adds a variance of 1/12.
    let measured = f64::sqrt(squares / count - 1.0 / 12.0);
    assert!((measured / sigma - 1.0).abs() < 0.05, "{measured} of {sigma}");
    let (blur, renders) = run(blurred);
    assert!(renders > clean.len(), "{renders} pictures");
    let differs = |a: &SimFrame, b: &SimFrame| a.frame.camera_ego_rgb != b.frame.camera_ego_rgb;
    assert!(clean.iter().zip(&blur).any(|(a, b)| differs(a, b)));
    for other in [noise, blur] {
        for (a, b) in clean.iter().zip(&other) {
            assert_eq!(a.frame.field, b.frame.field);
            assert_eq!(a.objects, b.objects);
        }
    }
}

#[test]
fn depth_matches_the_geometry_of_the_table() {
    for distortion in ["0, 0", "-0.3, 0.05", "0.2, 0"] {
        let camera = format!("observe: [depth, pose]\ncamera: {{ distortion: [{distortion}], fovy: 60 }}\n");
        let text = std::fs::read_to_string("sim/scenes/hover.yaml").unwrap() + &camera;
        let scene = Scene::parse("hover", Path::new("hover.yaml"), &text).unwrap();
        let options = RolloutOptions { picture: Some((65, 49)), ..RolloutOptions::default() };
        let mut rollout = Rollout::new(&scene, 4, &options).unwrap();
        assert_eq!(rollout.effects().contains(Effect::LensDistortion), distortion != "0, 0");
        let frame = rollout.next_frame().unwrap().unwrap();
        let depth = frame.depth.unwrap();
        assert_eq!(depth.len(), 65 * 49);
        // The table's plane, away from its edges and from the objects in its middle.
        let (camera, intrinsics) = (frame.camera, rollout.intrinsics());
        let (mut compared, mut off) = (0, 0);
        for (x, y) in (0..49usize).flat_map(|y| (0..65usize).map(move |x| (x, y))) {
            let ray = camera.orientation * intrinsics.direction([x as f64 + 0.5, y as f64 + 0.5]).unwrap();
            let along = -camera.position.z / ray.z;
            let place = camera.position + along * ray;
            if along > 0.0 && place.x.abs() < 0.4 && (-0.2..-0.1).contains(&place.y) {
                compared += 1;
                off += usize::from((f64::from(depth[y * 65 + x]) / along - 1.0).abs() > 0.01);
            }
        }
        // Distractors and forearms hide part of it.
        assert!(compared > 50 && off * 5 < compared, "distortion {distortion}: {off} of {compared} are off");
    }
}

#[test]
fn lens_without_distortion_leaves_the_picture_unchanged() {
    let straight = effects("lift_mug");
    assert!(!straight.contains(Effect::LensDistortion));
    let picture = |effects: EffectSet| {
        let mut rollout = rollout("lift_mug", effects);
        rollout.next_frame().unwrap().unwrap().frame.camera_ego_rgb
    };
    let [plain, through] = [straight, straight.with(Effect::LensDistortion)].map(picture);
    let pairs = || plain.as_raw().iter().zip(through.as_raw());
    let close = pairs().filter(|(a, b)| a.abs_diff(**b) <= 2).count();
    // Pixels on edges may get the colour of the other side.
    assert!(close as f64 > 0.98 * plain.as_raw().len() as f64, "{close} of {}", plain.as_raw().len());
}

#[test]
fn lens_that_folds_the_picture_is_refused_by_key() {
    let text = std::fs::read_to_string("sim/scenes/hover.yaml").unwrap();
    let with = |camera: &str| {
        let scene = Scene::parse("hover", Path::new("hover.yaml"), &format!("{text}camera: {{ {camera} }}\n")).unwrap();
        Rollout::new(&scene, 4, &RolloutOptions::default()).map(drop)
    };
    for camera in ["distortion: [-1, 0], fovy: 100", "distortion: [-0.05, -0.05], fovy: 110"] {
        let error = with(camera).unwrap_err().to_string();
        assert!(error.contains("camera.distortion"), "{camera}: {error}");
    }
    with("distortion: [-0.3, 0.05], fovy: 60").unwrap();
}

#[test]
fn drawn_lenses_show_the_corners() {
    let scene = Scene::load("clutter").unwrap();
    let rigs = Side::BOTH.map(|side| HandRig::new(HandModel::builtin(side), [0.0; N_BETAS]).unwrap());
    // Some lenses of the ranges fold the picture: with the last of these seeds the first lens that is drawn does.
    for seed in (0..400).chain([10341]) {
        let camera = EpisodeDraw::sample(&scene, seed, &rigs).unwrap().camera;
        Lens::new(&camera, (96, 96)).unwrap_or_else(|e| panic!("seed {seed}: {e}"));
    }
}

#[test]
fn slip_of_a_card_under_the_fingers_is_slower_than_the_hand() {
    let scene = Scene::load("slide_card").unwrap();
    let options = RolloutOptions { picture: None, ..RolloutOptions::default() };
    let mut rollout = Rollout::new(&scene, 3, &options).unwrap();
    let mut seen = 0;
    while let Some(frame) = rollout.next_frame().unwrap() {
        let slip = frame.slip.unwrap();
        for (slip, force) in slip.iter().zip(&frame.frame.field.force) {
            assert!(slip.is_finite() && *slip >= 0.0);
            assert!(*force > 0.0 || *slip == 0.0, "{slip} m/s without force");
            seen += usize::from(*force > 0.05);
            // The fingers carry the card along: it slips far slower than the hand moves, which is about 0.1 m/s.
            assert!(*force < 0.2 || *slip < 0.1, "{slip} m/s at {force} N");
        }
    }
    assert!(seen > 100);
}
