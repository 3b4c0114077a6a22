//! Stores with forces from motion: of the simulator, and of recordings that know poses alone.

use std::path::Path;

use egotac::crates::image::RgbImage;
use egotac::dataset::zarr::{
    ArraySpec, Contact, Dtype, MANO_FORCE, MANO_FORCE_VALID, OBJECT_POSE, Values, ZarrReader, ZarrWriter,
};
use egotac::dataset::{Attributes, EpisodeWriter, Frame};
use egotac::hand::{HandModel, N_FIELD, Side, Topology};
use egotac::label::physics::{BodyOptions, FrameCounts, Label, label};
use egotac::label::replay::{ReplayFrame, ReplayReport, Replayed, replay};
use egotac::physics::{ForceValidity, Settings};
use egotac::sim::{Rollout, RolloutOptions, Scene, physical, record};
use egotac::tactile::{ForceKind, TactileField, Validity};
use glam::DVec3;
use serde_json::json;

const PREDICTED: &str = "data/predicted_mano_force";

fn options() -> RolloutOptions {
    RolloutOptions { picture: None, ..RolloutOptions::default() }
}

fn run(store: &Path, out: &Path, bodies: BodyOptions) -> egotac::Result<FrameCounts> {
    let models = Side::BOTH.map(HandModel::builtin);
    label(store, out, &Label { models: &models, bodies, settings: Settings::default() }, |_, _| ())
}

fn nothing_given() -> BodyOptions {
    BodyOptions { masses: Default::default(), density: None, friction: None, meshes: None, gravity: None }
}

/// Sums of force over both hands at each frame; unknown vertices count as 0.
fn totals(store: &ZarrReader, name: &str) -> Vec<f64> {
    let force = store.read_f32(name, 0..store.len()).unwrap();
    force.chunks(N_FIELD).map(|row| row.iter().filter(|f| f.is_finite()).map(|f| f64::from(*f)).sum()).collect()
}

/// Writes what a data set of poses would hold of a rollout: images, poses, the object's mesh, and no force.
fn poses_alone(scene: &str, folder: &Path) -> (std::path::PathBuf, Vec<f64>, f64) {
    // An episode with one hand: the pose of the other is not known.
    let scene = Scene::load(scene).unwrap();
    let mut rollouts = (3..).map(|seed| Rollout::new(&scene, seed, &options()).unwrap());
    let mut rollout = rollouts.find(|rollout| rollout.episode().hands.len() == 1).unwrap();
    let (bodies, _) = physical::bodies(rollout.episode()).unwrap();
    let mass = bodies[0].mass.unwrap().kilograms;
    let half = bodies[0].samples.iter().fold(glam::Vec3::ZERO, |most, p| most.max(p.abs()));
    let mut obj = String::new();
    for corner in 0..8 {
        let sign = |bit: u32| if corner >> bit & 1 == 1 { 1000.0 } else { -1000.0 };
        obj += &format!("v {} {} {}\n", half.x * sign(0), half.y * sign(1), half.z * sign(2));
    }
    obj += "f 1 3 4 2\nf 5 6 8 7\nf 1 2 6 5\nf 3 7 8 4\nf 1 5 7 3\nf 2 4 8 6\n";
    let mesh = folder.join("millimetres.obj");
    std::fs::write(&mesh, obj).unwrap();
    let attributes = Attributes {
        topology: Topology::EgotacHand1,
        sigma: 0.0,
        contact_force: 0.05,
        producer: "test".into(),
        version: "0".into(),
        scene: "poses".into(),
        seed: 0,
    };
    let path = folder.join("poses.zarr");
    let extra = vec![ArraySpec::new(OBJECT_POSE, [1, 7], Dtype::F32)];
    let mut writer = ZarrWriter::create(&path, attributes, Contact::Truth, extra).unwrap();
    writer.set_attribute("force_kind", serde_json::Value::Null);
    let import = json!({ "objects": ["cube"], "object_meshes": [{ "file": mesh, "to_metres": 0.001 }] });
    writer.set_attribute("import", import);
    let mut truth = Vec::new();
    while let Some(frame) = rollout.next_frame().unwrap() {
        truth.push(f64::from(frame.frame.field.total_force(Side::Left) + frame.frame.field.total_force(Side::Right)));
        let (p, q) = (frame.objects[0].position, frame.objects[0].orientation);
        let pose = [p.x, p.y, p.z, q.w, q.x, q.y, q.z].map(|x| x as f32).to_vec();
        let unknown = || vec![f32::NAN; N_FIELD];
        let blank = Frame {
            camera_ego_rgb: RgbImage::new(1, 1),
            field: TactileField { topology: Topology::EgotacHand1, force: unknown(), contact: unknown() },
            force_valid: vec![0; N_FIELD],
            contact_valid: vec![0; N_FIELD],
            validity: Validity::Valid,
            ..frame.frame
        };
        writer.push_with(blank, vec![(OBJECT_POSE, Values::F32(pose))]).unwrap();
    }
    writer.end_episode().unwrap();
    writer.finish().unwrap();
    (path, truth, mass)
}

#[test]
fn a_store_of_an_own_scene_needs_no_scene_file_any_more() {
    let folder = tempfile::tempdir().unwrap();
    let (store, out) = (folder.path().join("a.zarr"), folder.path().join("b.zarr"));
    let file = folder.path().join("fast_cube.yaml");
    let shipped = std::fs::read_to_string("sim/scenes/pinch_cube.yaml").unwrap();
    std::fs::write(&file, format!("rate: 50\n{shipped}")).unwrap();
    record(&Scene::load(&file.to_string_lossy()).unwrap(), 3, &options(), &store, |_, _| ()).unwrap();
    std::fs::remove_file(&file).unwrap();
    assert!(run(&store, &out, nothing_given()).unwrap().touching > 10);
}

#[test]
fn a_simulated_store_keeps_its_truth_and_gets_the_estimate_beside_it() {
    let folder = tempfile::tempdir().unwrap();
    let (store, out) = (folder.path().join("a.zarr"), folder.path().join("b.zarr"));
    record(&Scene::load("pinch_cube").unwrap(), 3, &options(), &store, |_, _| ()).unwrap();
    let counts = run(&store, &out, nothing_given()).unwrap();
    assert!(counts.touching > 10 && counts.undetermined > 0, "{counts:?}");
    let (before, after) = (ZarrReader::open(&store).unwrap(), ZarrReader::open(&out).unwrap());
    let all = 0..before.len();
    assert_eq!(before.read_f32(MANO_FORCE, all.clone()).unwrap(), after.read_f32(MANO_FORCE, all.clone()).unwrap());
    let about = &after.raw_attributes()["force_from_motion"];
    assert_eq!(about["origin"], "estimated from motion");
    // Vertices of a link sum to the link's force.
    let links = after.read_f32("data/link_force", all.clone()).unwrap();
    let sums: Vec<f64> =
        links.chunks(32).map(|row| row.iter().filter(|f| f.is_finite()).map(|f| f64::from(*f)).sum()).collect();
    for (sum, total) in sums.iter().zip(totals(&after, PREDICTED)) {
        assert!((sum - total).abs() < 1e-3 * (1.0 + total), "{sum} against {total}");
    }
    // Unknown is NaN with mask 0, and the deviation is known where the force is.
    let force = after.read_f32(PREDICTED, all.clone()).unwrap();
    let mask = after.read_u8("data/predicted_mano_force_valid", all.clone()).unwrap();
    let sd = after.read_f32("data/mano_force_std", all).unwrap();
    assert!(force.iter().zip(&mask).all(|(force, mask)| force.is_nan() == (*mask == 0)));
    assert!(force.iter().zip(&sd).all(|(force, sd)| force.is_nan() == sd.is_nan()));
    assert!(run(&store, &out, nothing_given()).unwrap_err().to_string().contains("exists already"));
}

#[test]
fn a_recording_of_poses_and_a_mesh_gets_forces_in_place_of_unknown_ones() {
    let folder = tempfile::tempdir().unwrap();
    let (store, truth, mass) = poses_alone("pinch_cube", folder.path());
    let out = folder.path().join("forces.zarr");
    let bodies = BodyOptions { masses: [("cube".to_string(), mass)].into(), ..nothing_given() };
    let counts = run(&store, &out, bodies).unwrap();
    let after = ZarrReader::open(&out).unwrap();
    assert_eq!(after.force_kind().unwrap(), Some(ForceKind::Spread));
    assert_eq!(after.raw_attributes()["force_origin"], "estimated from motion");
    assert_eq!(after.raw_attributes()["force_from_motion"]["episodes"][0]["gravity"], "found from resting objects");
    // The hand that the recording does not know stays unknown.
    assert!(counts.unknown.contains_key(ForceValidity::HandUnknown.reason()), "{counts:?}");
    let valid = after.read_u8(MANO_FORCE_VALID, 0..after.len()).unwrap();
    assert!(valid.contains(&0) && valid.contains(&1));
    // Total force on the hand rises and falls with the simulator's.
    let found = totals(&after, MANO_FORCE);
    let mean = |v: &[f64]| v.iter().sum::<f64>() / v.len() as f64;
    let (a, b) = (mean(&found), mean(&truth));
    let product = |x: &[f64], y: &[f64], a: f64, b: f64| x.iter().zip(y).map(|(x, y)| (x - a) * (y - b)).sum::<f64>();
    let pearson =
        product(&found, &truth, a, b) / (product(&found, &found, a, a) * product(&truth, &truth, b, b)).sqrt();
    assert!(pearson > 0.8, "{pearson}");
}

#[test]
fn a_recording_is_replayed_in_a_world_of_its_mesh() {
    let folder = tempfile::tempdir().unwrap();
    let (store, truth, mass) = poses_alone("pinch_cube", folder.path());
    let models = Side::BOTH.map(HandModel::builtin);
    // The engine's force at a depth grows with the mass.
    let bodies = BodyOptions { masses: [("cube".to_string(), mass)].into(), ..nothing_given() };
    let Replayed { frames, missed_rotation } = replay(&store, &models, &bodies).unwrap();
    // The hand was posed by the same hinges.
    assert!(missed_rotation < 1e-4, "{missed_rotation}");
    assert_eq!(frames.len(), truth.len());
    // The recording knows one hand, and does not tell whether there was another.
    let known = |frame: &ReplayFrame| -> Vec<f64> {
        let sums = frame.links.iter().map(|links| links.iter().sum::<f64>());
        sums.filter(|sum| sum.is_finite()).collect()
    };
    assert!(frames.iter().all(|frame| known(frame).len() == 1));
    let inner = frames.iter().filter(|frame| frame.to_edge >= 3);
    let pairs: Vec<(f64, f64)> = inner.map(|frame| (known(frame)[0], truth[frame.frame])).collect();
    let touching: Vec<&(f64, f64)> = pairs.iter().filter(|(own, truth)| *own > 0.05 || *truth > 0.05).collect();
    let off = touching.iter().map(|(own, truth)| (own - truth).abs()).sum::<f64>();
    let off = off / touching.iter().map(|pair| pair.1).sum::<f64>();
    assert!(touching.len() > 20 && off < 0.2, "{off}: {touching:?}");
    // At rest the support pushes straight up. It is found where the cube rests, so that nothing tells how deep the cube lay in
    // the simulator's table, and the force is below the weight.
    let weight = mass * 9.81;
    let first = &frames[3].net[0];
    assert!(first.z > 0.1 * weight && first.z < 1.05 * weight && first.truncate().length() < 1e-6, "{first:?}");
    // Forces from motion are not called recorded ones.
    let out = folder.path().join("forces.zarr");
    run(&store, &out, nothing_given()).unwrap();
    let report = ReplayReport::of(&out, &models, &nothing_given()).unwrap();
    let names: Vec<&str> = report.agreements.iter().map(|agreement| agreement.quantity.as_str()).collect();
    assert!(names.len() == 3 && names.iter().all(|name| name.ends_with("forces from motion")), "{names:?}");
    // The sum on the known hand does not need the other one.
    assert!(report.agreements[0].entries > 20, "{report:?}");
}

#[test]
fn what_a_store_lacks_is_named_with_a_remedy() {
    let folder = tempfile::tempdir().unwrap();
    let (store, _, mass) = poses_alone("pinch_cube", folder.path());
    let out = folder.path().join("forces.zarr");
    let bodies = BodyOptions { masses: [("cup".to_string(), mass)].into(), ..nothing_given() };
    let error = run(&store, &out, bodies).unwrap_err().to_string();
    assert!(error.contains("cup") && error.contains("cube") && !out.exists(), "{error}");
    std::fs::remove_file(folder.path().join("millimetres.obj")).unwrap();
    let error = run(&store, &out, nothing_given()).unwrap_err().to_string();
    assert!(error.contains("millimetres.obj") && !out.exists(), "{error}");
    let bodies = BodyOptions { gravity: Some(DVec3::NEG_Z), meshes: Some(folder.path().into()), ..nothing_given() };
    std::fs::write(folder.path().join("cube.obj"), "v 0 0 0\nv 20 0 0\nv 0 20 0\nf 1 2 3\n").unwrap();
    // An open surface has no volume: without a mass, forces are unknown and never 0.
    let counts = run(&store, &out, bodies).unwrap();
    assert!(counts.touching == 0, "{counts:?}");
}
