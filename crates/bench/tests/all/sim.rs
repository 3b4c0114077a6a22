//! `egotac bench sim` measures right: errors shrink with the step, contact forces carry the weight of held objects, files
//! appear.
#![cfg(feature = "sim")]

use std::path::Path;
use std::process::{Command, Output};

use egotac::mujoco::options::Unchecked;
use egotac::mujoco::{PhysicsOptions, Preset};
use egotac::sim::{Rollout, RolloutOptions, Scene};
use egotac_bench::sim::errors::{Errors, Pool};
use egotac_bench::sim::replay::replay;
use egotac_bench::sim::table::SimReport;
use egotac_bench::sim::trace::Trace;

/// A cube on the table between thumb and index finger for a second; only the colours are random.
const SQUEEZE: &str = "
description: Squeeze a cube on the table.
physics: { preset: fast, impratio: 20 }
objects:
  - { name: cube, shape: { cube: { size: 0.04 } }, mass: 0.05, friction: 0.9, position: [0, 0], yaw: 1.3 }
hands:
  - side: right
    act:
      object: cube
      fingers: [0.35, 0.82, -0.4]
      palm: [-0.55, -0.05, -0.8]
      from: [0.05, -0.05, 1]
      contacts:
        thumb: { at: [-1, 0, 0], force: 1.5 }
        index: { at: [1, 0, 0], force: 1.5 }
      start: { opening: 0.004 }
      script:
        - { phase: close, seconds: 0.2, opening: 0 }
        - { phase: grip, seconds: 0.2, squeeze: 1 }
        - { phase: hold, seconds: 0.6 }
";

fn squeeze() -> Scene {
    Scene::parse("squeeze", Path::new("squeeze.yaml"), SQUEEZE).unwrap()
}

fn blind() -> RolloutOptions {
    RolloutOptions { picture: None, ..RolloutOptions::default() }
}

fn at(scene: &Scene, timestep: f64) -> Trace {
    let mut scene = scene.clone();
    let values = Unchecked { timestep, iterations: 100, tolerance: 1e-12, ..Preset::Default.values() };
    scene.spec.physics = PhysicsOptions::try_from(values).unwrap();
    Trace::record(&scene, 0, &blind()).unwrap()
}

fn errors(trace: &Trace, reference: &Trace) -> Errors {
    let mut pool = Pool::default();
    pool.add(trace, reference, &reference.quiet());
    pool.errors()
}

#[test]
fn a_scene_may_name_a_preset_beside_single_values() {
    let physics = squeeze().spec.physics;
    assert_eq!((physics.preset, physics.timestep, physics.impratio), (Preset::Fast, 4e-3, 20.0));
    let text = SQUEEZE.replace("preset: fast", "preset: fats");
    let error = Scene::parse("squeeze", Path::new("squeeze.yaml"), &text).unwrap_err().to_string();
    assert!(error.contains("squeeze.yaml") && error.contains("fats") && error.contains("precise"), "{error}");
}

#[test]
fn the_preset_replay_has_no_dynamics_and_gives_no_forces() {
    let replay = SQUEEZE.replace("{ preset: fast, impratio: 20 }", "{ preset: replay }");
    let parse = |text: &str| Scene::parse("squeeze", Path::new("squeeze.yaml"), text);
    let error = parse(&replay).and_then(|scene| Rollout::new(&scene, 0, &blind())).unwrap_err().to_string();
    assert!(error.contains("dynamics") && error.contains("force"), "{error}");
    let scene = parse(&replay.replace("objects:", "observe: [contact]\nobjects:")).unwrap();
    let mut rollout = Rollout::new(&scene, 0, &blind()).unwrap();
    let start = rollout.objects()[0].pose();
    let mut touching = 0;
    while let Some(frame) = rollout.next_frame().unwrap() {
        touching += usize::from(frame.frame.field.contact.contains(&1.0));
        assert!(frame.hands.iter().all(Option::is_none) && rollout.world().contacts().all(|c| c.normal_force == 0.0));
    }
    assert!(touching > 5, "{touching} frames");
    assert_eq!(rollout.objects()[0].pose().0, start.0);
}

#[test]
fn a_ten_times_finer_step_is_nearer_to_the_reference() {
    let scene = squeeze();
    let reference = at(&scene, 1e-4);
    assert!(reference.quiet().len() >= 5, "{:?}", reference.quiet());
    let (coarse, fine) = (errors(&at(&scene, 8e-3), &reference), errors(&at(&scene, 8e-4), &reference));
    assert!(coarse.force.unwrap() > 0.0 && fine.force.unwrap() < coarse.force.unwrap(), "{fine:?}, {coarse:?}");
    assert!(fine.impulse.unwrap() < coarse.impulse.unwrap(), "{fine:?}, {coarse:?}");
    assert!(fine.force.unwrap() < 0.01, "{fine:?}");
    assert_eq!(errors(&reference, &reference).force, Some(0.0));
}

#[test]
fn forces_on_the_fingers_equal_those_of_the_script() {
    let trace = at(&squeeze(), 1e-3);
    let forces = trace.mean_forces(&trace.quiet());
    // Right thumb and index finger; the integral control has had half a second.
    assert!((forces[6] - 1.5).abs() < 0.1 && (forces[7] - 1.5).abs() < 0.1, "{forces:?}");
    assert!(forces.iter().sum::<f64>() - forces[6] - forces[7] < 1e-9, "{forces:?}");
    // On the table, the cube presses with its weight.
    assert!((trace.lift(&trace.quiet()).unwrap() - 1.0).abs() < 0.01);
}

#[test]
fn contact_forces_on_a_held_object_equal_its_weight() {
    for name in ["pinch_cube", "lift_mug"] {
        let scene = Scene::load(name).unwrap();
        let trace = Trace::record(&scene, 0, &blind()).unwrap();
        let quiet = trace.quiet();
        let mut rollout = Rollout::new(&scene, 0, &blind()).unwrap();
        let joint = rollout.world().free_joint(&scene.spec.objects[0].name).unwrap();
        let object = rollout.world().body_of(joint);
        let start = rollout.world().position(object).z;
        let (mut lift, mut steps) = (0.0, 0);
        assert!(rollout.skip_frame());
        for bin in 0..rollout.frame_count() - 1 {
            // Averaged over the servos' cycles: forces are a little larger at their ends than at their starts.
            let watched = rollout.skip_frame_watched(|world| {
                if !quiet.contains(&bin) || world.position(object).z < start + 0.015 {
                    return;
                }
                for contact in world.contacts() {
                    let [a, b] = contact.bodies;
                    assert!(world.body_name(a) != "world" || b != object, "{name}: on the table");
                    lift += f64::from(i8::from(b == object) - i8::from(a == object)) * contact.force.z;
                }
                steps += 1;
            });
            assert!(watched);
        }
        let weight = 9.81 * rollout.world().mass(object);
        assert!(steps >= 60, "{name}: {steps} steps");
        let ratio = lift / (f64::from(steps) * weight);
        assert!((ratio - 1.0).abs() < 0.01, "{name}: {ratio}");
        assert!((trace.lift(&quiet).unwrap() - 1.0).abs() < 0.01);
    }
}

#[test]
fn replay_finds_the_contacts_of_the_run_with_forces() {
    let scene = squeeze();
    let trace = at(&scene, 1e-3);
    let replayed = replay(&scene, 0, &trace.states, &blind(), 1).unwrap();
    assert_eq!(replayed.touched.len(), trace.touched.len());
    let mut pool = Pool::default();
    pool.add_sets(&replayed.touched, &trace.touched);
    assert!(pool.errors().f1.unwrap() > 0.6, "{:?}", pool.errors());
    // Before the fingers close there is no contact.
    assert!(replayed.touched[0].is_empty() && trace.touched[0].is_empty());
    assert!(replay(&scene, 0, &[vec![0.0; 3]], &blind(), 1).is_err());
}

#[test]
fn fewer_hull_corners_change_the_hand_and_three_are_refused() {
    let with = |hull_corners| Trace::record(&squeeze(), 0, &RolloutOptions { hull_corners, ..blind() });
    let (all, few) = (with(None).unwrap(), with(Some(8)).unwrap());
    // The same squeeze by other corners.
    assert!(all.touched != few.touched && errors(&few, &all).force.unwrap() < 0.1, "{:?}", errors(&few, &all));
    let error = with(Some(3)).unwrap_err().to_string();
    assert!(error.contains("hull corners") && error.contains("at least 4"), "{error}");
}

#[test]
fn guards_do_not_change_a_run() {
    let with = |guards| Trace::record(&squeeze(), 0, &RolloutOptions { guards, ..blind() }).unwrap();
    assert!(with(true) == with(false));
}

fn egotac(args: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_egotac-bench")).args(args).output().unwrap()
}

#[test]
fn bench_sim_writes_table_and_plots() {
    let folder = tempfile::tempdir().unwrap();
    let (scene, out) = (folder.path().join("squeeze.yaml"), folder.path().join("out"));
    std::fs::write(&scene, SQUEEZE).unwrap();
    let [scene, out_name] = [&scene, &out].map(|p| p.to_str().unwrap());
    let args = ["bench", "sim", scene, "--knobs", "preset,cone,label", "--repetitions", "1", "--out", out_name];
    let output = egotac(&args);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let path = out.join("sim.json");
    let report = SimReport::from_json(&path, &std::fs::read_to_string(&path).unwrap()).unwrap();
    assert_eq!((report.seed, report.seeds, report.scenes.len()), (0, 1, 1));
    assert!(report.scenes[0].quiet_seconds > 0.1, "{:?}", report.scenes);
    for preset in Preset::ALL {
        let row = report.row("preset", preset.name()).unwrap();
        assert!(row.entries[0].ms_per_second.unwrap() > 0.0 && row.entries[0].refused.is_none(), "{row:?}");
        assert_eq!(row.entries[0].same.force.is_some(), preset.has_dynamics());
    }
    let entry = |knob: &str, setting: &str| report.row(knob, setting).unwrap().entries[0].clone();
    let reference = entry("preset", "reference");
    let none = Errors { force: Some(0.0), impulse: Some(0.0), f1: Some(1.0), agreement: Some(1.0) };
    assert_eq!((reference.same, reference.model), (none, none));
    assert_eq!(entry("label", "c, 4 mm").same.f1, Some(1.0));
    assert_eq!(entry("cone", "elliptic").same, entry("preset", "default").same);
    assert!(entry("cone", "pyramidal").model.force.unwrap() > 0.0);
    let table = std::fs::read_to_string(out.join("sim.md")).unwrap();
    assert!(table.contains("| pyramidal |") && table.contains("**default**") && table.contains("squeeze"), "{table}");
    assert!(image::open(out.join("sim.png")).unwrap().width() > 1000);
    let svg = std::fs::read_to_string(out.join("sim.svg")).unwrap();
    assert!(svg.starts_with("<svg") && svg.contains("recommended"));
}

#[test]
fn a_scene_in_which_no_hand_presses_has_a_table_but_no_plot() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("out");
    let args = ["bench", "sim", "hover", "--knobs", "cone", "--repetitions", "1", "--out", out.to_str().unwrap()];
    let output = egotac(&args);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let [text, told] = [output.stdout, output.stderr].map(|bytes| String::from_utf8(bytes).unwrap());
    assert!(told.contains("no plot") && text.contains("| pyramidal |"), "{text}{told}");
    assert!(out.join("sim.json").exists() && out.join("sim.md").exists() && !out.join("sim.png").exists());
}

#[test]
fn bench_refuses_an_unknown_knob_with_the_list() {
    let output = egotac(&["bench", "sim", "hover", "--knobs", "kone", "--out", "/nonexistent/out"]);
    let error = String::from_utf8(output.stderr).unwrap();
    assert!(!output.status.success() && error.contains("kone") && error.contains("impratio"), "{error}");
}
