//! Rollouts with other hands, with pictures, in stores, and with invalid physics.

use std::path::Path;

use egotac::dataset::EpisodeReader;
use egotac::dataset::zarr::ZarrReader;
use egotac::hand::{HandModel, N_JOINTS, N_VERTICES, Side, Topology};
use egotac::mujoco::{PhysicsOptions, World};
use egotac::sim::guard::Guard;
use egotac::sim::{DatasetPlan, GenerateProgress, Rollout, RolloutOptions, Scene, generate, record};
use egotac::tactile::Validity;

/// Options without pictures.
fn without_pictures() -> RolloutOptions {
    RolloutOptions { picture: None, ..RolloutOptions::default() }
}

/// Options with small pictures.
fn small() -> RolloutOptions {
    RolloutOptions { picture: Some((16, 16)), ..RolloutOptions::default() }
}

/// Returns the same hand with its vertices in the opposite order, as if from another file.
fn renumbered(side: Side) -> HandModel {
    let mut model = HandModel::builtin(side);
    let reverse = |rows: &mut Vec<f32>, width: usize| {
        *rows = rows.chunks_exact(width).rev().flatten().copied().collect();
    };
    model.v_template.reverse();
    reverse(&mut model.lbs_weights, N_JOINTS);
    reverse(&mut model.shapedirs, 30);
    reverse(&mut model.posedirs, 3 * 135);
    model.j_regressor = model.j_regressor.chunks_exact(N_VERTICES).flat_map(|row| row.iter().rev().copied()).collect();
    let last = N_VERTICES as u32 - 1;
    model.faces.iter_mut().for_each(|face| *face = face.map(|vertex| last - vertex));
    model.topology = Topology::Mano;
    model
}

#[test]
fn reversed_vertex_order_gives_the_same_forces_reversed() {
    let scene = Scene::load("pinch_cube").unwrap();
    let other = RolloutOptions { hands: Side::BOTH.map(renumbered), ..without_pictures() };
    let mut a = Rollout::new(&scene, 1, &without_pictures()).unwrap();
    let mut b = Rollout::new(&scene, 1, &other).unwrap();
    assert_eq!(b.topology(), Topology::Mano);
    let mut touched = false;
    while let (Some(a), Some(b)) = (a.next_frame().unwrap(), b.next_frame().unwrap()) {
        for side in Side::BOTH {
            let of_a = &a.frame.field.force[side.range()];
            let of_b = &b.frame.field.force[side.range()];
            let difference: f32 = of_a.iter().zip(of_b.iter().rev()).map(|(a, b)| (a - b).abs()).sum();
            let total: f32 = of_a.iter().sum();
            touched |= total > 0.5;
            // Sums in another order differ in the last digits, and contact amplifies the difference; the grasp is the same.
            assert!(difference <= 0.1 * total.max(0.1), "{} s: {difference} N of {total} N", a.frame.timestamp);
        }
    }
    assert!(touched);
}

#[test]
fn picture_shows_the_object_and_the_approaching_hand() {
    let scene = Scene::load("lift_mug").unwrap();
    let options = RolloutOptions { picture: Some((96, 72)), ..RolloutOptions::default() };
    let mut rollout = Rollout::new(&scene, 5, &options).unwrap();
    let first = rollout.next_frame().unwrap().unwrap();
    assert_eq!(first.frame.camera_ego_rgb.dimensions(), (96, 72));
    let colours: std::collections::HashSet<_> = first.frame.camera_ego_rgb.pixels().collect();
    assert!(colours.len() > 50, "{} colours", colours.len());
    // The colour at the object's centre is the mug's: no other object there has its hue.
    let mug = rollout.episode().objects[0].colour;
    let [x, y] = rollout.intrinsics().project(first.camera.camera_from_world(first.objects[0].position)).unwrap();
    let pixel = first.frame.camera_ego_rgb.get_pixel(x as u32, y as u32).0.map(f64::from);
    let largest = |c: [f64; 3]| (0..3).max_by(|a, b| c[*a].total_cmp(&c[*b])).unwrap();
    assert_eq!(largest(pixel), largest(mug), "{pixel:?} for {mug:?}");
    // In the middle of the episode the hand is at the mug, and the picture has changed.
    for _ in 1..rollout.frame_count() / 2 {
        assert!(rollout.skip_frame());
    }
    let later = rollout.next_frame().unwrap().unwrap();
    let changed = first.frame.camera_ego_rgb.pixels().zip(later.frame.camera_ego_rgb.pixels());
    let changed = changed.filter(|(a, b)| (0..3).any(|c| a.0[c].abs_diff(b.0[c]) > 24)).count();
    assert!(changed > 96 * 72 / 50, "{changed} pixels changed");
}

#[test]
fn same_seed_gives_the_same_pictures() {
    let scene = Scene::load("hover").unwrap();
    let options = RolloutOptions { picture: Some((64, 64)), ..RolloutOptions::default() };
    let picture = || {
        let mut rollout = Rollout::new(&scene, 2, &options).unwrap();
        (0..20).for_each(|_| assert!(rollout.skip_frame()));
        rollout.next_frame().unwrap().unwrap().frame.camera_ego_rgb
    };
    assert_eq!(picture().as_raw(), picture().as_raw());
}

#[test]
fn data_set_holds_its_episodes_in_order_and_resumes_from_finished_parts() {
    let folder = tempfile::tempdir().unwrap();
    let options = RolloutOptions { picture: Some((24, 24)), ..RolloutOptions::default() };
    let scenes = ["hover", "pinch_cube"].map(|name| Scene::load(name).unwrap()).to_vec();
    let plan = DatasetPlan { scenes: scenes.clone(), episodes: 3, seed: 7, jobs: 2, options: options.clone() };
    let (store, parts) = (folder.path().join("set"), folder.path().join("set.parts"));
    let alone = folder.path().join("alone");
    record(&scenes[1], 8, &options, &alone, |_, _| ()).unwrap();

    // Copy the parts that an interruption after the first episode leaves.
    let left = folder.path().join("left");
    let keep = |at| {
        if at == GenerateProgress::Episodes(1, 3) {
            copy_folder(&parts, &left)
        }
    };
    let summary = generate(&plan, &store, keep).unwrap();
    assert!(!parts.exists());
    let set = ZarrReader::open(&store).unwrap();
    let ends = set.episode_ends().to_vec();
    assert_eq!((ends.len(), ends[2]), (3, summary.frames));
    same_frames(&set, ends[0], &ZarrReader::open(&alone).unwrap());
    assert!(generate(&plan, &store, |_| ()).unwrap_err().to_string().contains("exists already"));

    // The same call resumes from there. Another store replaces its first part, to see that the part is not recorded again.
    std::fs::rename(&left, &parts).unwrap();
    let first = parts.join("000000");
    if first.exists() {
        std::fs::remove_dir_all(&first).unwrap();
    }
    copy_folder(&alone, &first);
    let again = folder.path().join("again");
    let moved = folder.path().join("again.parts");
    std::fs::rename(&parts, &moved).unwrap();
    generate(&plan, &again, |_| ()).unwrap();
    same_frames(&ZarrReader::open(&again).unwrap(), 0, &ZarrReader::open(&alone).unwrap());

    // Parts of another plan are refused.
    copy_folder(&alone, &folder.path().join("third.parts"));
    std::fs::write(folder.path().join("third.parts/plan"), "another").unwrap();
    let error = generate(&plan, &folder.path().join("third"), |_| ()).unwrap_err().to_string();
    assert!(error.contains("other scenes, seeds or options"), "{error}");
}

fn same_frames(set: &ZarrReader, from: usize, alone: &ZarrReader) {
    for name in ["data/mano_force", "data/camera_ego_rgb", "data/object_pose", "data/camera_pose"] {
        let of_set = set.read(name, from..from + alone.len()).unwrap();
        assert!(of_set == alone.read(name, 0..alone.len()).unwrap(), "{name}");
    }
}

fn copy_folder(from: &Path, to: &Path) {
    std::fs::create_dir_all(to).unwrap();
    for entry in std::fs::read_dir(from).unwrap().flatten() {
        let target = to.join(entry.file_name());
        match entry.path().is_dir() {
            // Unfinished episodes have names that start with a dot, and may vanish.
            true if entry.file_name().to_string_lossy().starts_with('.') => {}
            true => copy_folder(&entry.path(), &target),
            false => drop(std::fs::copy(entry.path(), target).unwrap()),
        }
    }
}

const BALL: &str = r#"<mujoco><worldbody><geom name="floor" type="plane" size="1 1 .1"/>
    <body name="ball" pos="0 0 .05"><freejoint name="ball"/>
    <geom type="sphere" size=".02" mass=".2"/></body></worldbody></mujoco>"#;

/// Simulates one step of a ball after `prepare`; returns the guard's verdict.
fn guarded(prepare: impl Fn(&mut World)) -> Validity {
    let mut world = World::from_mjcf(BALL, &PhysicsOptions::default()).unwrap();
    let ball = world.free_joint("ball").unwrap();
    let mut guard = Guard::new(&world, &[ball], 0.004);
    prepare(&mut world);
    world.step();
    guard.after_step(&world);
    world.forward();
    guard.frame(&world)
}

#[test]
fn guards_name_the_fault_and_accept_valid_states() {
    let move_to = |z: f64| move |world: &mut World| world.qpos_mut()[2] = z;
    assert_eq!(guarded(|_| ()), Validity::Valid);
    assert_eq!(guarded(move_to(0.0195)), Validity::Valid);
    assert_eq!(guarded(move_to(0.01)), Validity::TooDeep);
    assert_eq!(guarded(move_to(f64::NAN)), Validity::NotFinite);
    assert_eq!(guarded(move_to(1e12)), Validity::EngineWarning);
}

#[test]
fn world_whose_time_stands_still_is_invalid() {
    let world = World::from_mjcf(BALL, &PhysicsOptions::default()).unwrap();
    let mut guard = Guard::new(&world, &[], 0.004);
    guard.after_step(&world); // There was no step.
    let mut world = world;
    assert_eq!(guard.frame(&world), Validity::NotFinite);
    // A lost state stays lost.
    world.step();
    guard.after_step(&world);
    assert_eq!(guard.frame(&world), Validity::NotFinite);
}

#[test]
fn physics_does_not_depend_on_the_frame_rate() {
    let text = std::fs::read_to_string(concat!(env!("CARGO_MANIFEST_DIR"), "/sim/scenes/pinch_cube.yaml")).unwrap();
    let at_rate = |rate: f64| {
        let scene = Scene::parse("rated", Path::new("rated.yaml"), &format!("rate: {rate}\n{text}")).unwrap();
        let mut rollout = Rollout::new(&scene, 4, &without_pictures()).unwrap();
        let mut frames = Vec::new();
        while let Some(frame) = rollout.next_frame().unwrap() {
            frames.push(frame.frame);
        }
        frames
    };
    // At 50 Hz a frame has 10 steps, which is not a multiple of the 4 steps between controls.
    let [slow, fast] = [25.0, 50.0].map(at_rate);
    let mut touched = false;
    for (at, frame) in slow.iter().enumerate() {
        let other = &fast[2 * at];
        assert!((frame.timestamp - other.timestamp).abs() < 1e-9);
        assert_eq!(frame.field.force, other.field.force, "at {} s", frame.timestamp);
        touched |= frame.field.force.iter().any(|force| *force > 0.1);
    }
    assert!(touched);
}

#[test]
fn store_holds_the_residuals_of_each_frame() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.zarr");
    let summary = record(&Scene::load("lift_mug").unwrap(), 2, &small(), &path, |_, _| ()).unwrap();
    let store = ZarrReader::open(&path).unwrap();
    let residuals = store.read_f32("data/force_residual", 0..store.len()).unwrap();
    assert_eq!(residuals.len(), store.len() * 4);
    let most = |k: usize| residuals.iter().skip(k).step_by(2).copied().fold(0f32, f32::max);
    assert!((f64::from(most(0)) - summary.sum_residual).abs() < 1e-9, "{} {}", most(0), summary.sum_residual);
    assert!((f64::from(most(1)) / summary.moment_residual - 1.0).abs() < 1e-5);
    assert!(most(0) < 1e-6 && most(1) > 0.0);
}

#[test]
fn scenes_with_and_without_objects_share_a_store() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("empty.zarr");
    let text = "description: An idle hand.\nobjects: []\nhands:\n  - side: right\n";
    let empty = Scene::parse("empty", Path::new("empty.yaml"), text).unwrap();
    for scenes in [vec![empty.clone()], vec![Scene::load("hover").unwrap(), empty]] {
        let plan = DatasetPlan { scenes, episodes: 2, seed: 0, options: small(), jobs: 1 };
        generate(&plan, &path, |_| ()).unwrap();
        assert_eq!(ZarrReader::open(&path).unwrap().episode_ends().len(), 2);
        std::fs::remove_dir_all(&path).unwrap();
    }
}
