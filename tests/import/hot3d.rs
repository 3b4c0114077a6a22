//! HOT3D clips become stores: exact labels, damage named, work resumed and divided.

use std::path::{Path, PathBuf};
use std::sync::LazyLock;
use std::sync::atomic::{AtomicUsize, Ordering};

use crate::check::{check_hands, check_poses, check_stamps, f1, open, supervised};
use crate::common::{self, egotac};
use crate::writers::files::{ManoFiles, glb, jpeg, tar, write};
use crate::writers::hot3d::{clip, motion, nanoseconds};
use crate::writers::take::{FRAMES, Take, cuboid};
use egotac::dataset::SourceFrames;
use egotac::dataset::zarr::{CAMERA_POSE, ZarrReader};
use egotac::error::{Error, Result};
use egotac::hand::{HandModel, Side};
use egotac::import::{ContactRule, HandModels, ImportTasks, Moment, Options, Reader, Recording, Settings, kind};
use egotac::label::physics::BodyOptions;
use egotac::label::replay::{Replayed, replay};
use egotac::label::{LabelTiming, Outcome, Shard};
use glam::{DAffine3, DMat3, DMat4, DQuat, DVec3};
use image::imageops::rotate90;
use serde_json::{Value, json};

static TAKE: LazyLock<Take> = LazyLock::new(Take::simulated);

/// Writes a data set with one clip, changed by `change`; returns the folder and the MANO files.
fn data_set(folder: &Path, change: impl FnOnce(&mut Vec<(String, Vec<u8>)>)) -> (PathBuf, ManoFiles) {
    let take = &*TAKE;
    let mano = ManoFiles::write(&folder.join("mano"), take, true);
    let root = folder.join("hot3d");
    let mut members = clip(take, &mano);
    change(&mut members);
    write(&root.join("train_aria/clip-001849.tar"), tar(&members));
    write(&root.join("object_models/obj_000007.glb"), glb(&take.box_mesh()));
    write(&root.join("object_models/obj_000012.glb"), glb(&cuboid(DVec3::splat(0.05))));
    (root, mano)
}

fn import(root: &Path, mano: &ManoFiles, out: &Path, more: &[&str]) -> std::process::Output {
    let paths = [root, out, &mano.left, &mano.right].map(|path| path.to_str().unwrap());
    let arguments =
        ["data", "import", "hot3d", paths[0], "--out", paths[1], "--mano-left", paths[2], "--mano-right", paths[3]];
    egotac(&[&arguments[..], more].concat())
}

#[test]
fn a_clip_has_the_simulators_contact_stamps_poses_and_upright_images() {
    let folder = tempfile::tempdir().unwrap();
    let (root, mano) = data_set(folder.path(), |_| ());
    let out = folder.path().join("clip.zarr");
    let output = import(&root, &mano, &out, &["--size", "0"]);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let (store, take) = (open(&out), &*TAKE);
    let score = f1(&store, take, &Side::BOTH);
    assert!(score >= 0.99, "F1 {score}");
    check_stamps(&store, (0..FRAMES).map(|index| nanoseconds(index) as f64 / 1e9));
    check_hands(&store, take, &mano.models, |_| DAffine3::IDENTITY, 2e-4);
    for (index, frame) in take.frames.iter().enumerate() {
        let decoded = image::load_from_memory(&jpeg(&frame.image)).unwrap().to_rgb8();
        assert!(store.image(index).unwrap() == rotate90(&decoded), "image {index}");
    }
    // A point to the right of the sensor's axis lies below that of the upright image.
    let turned = DAffine3::from_mat3(DMat3::from_cols(DVec3::NEG_Y, DVec3::X, DVec3::Z));
    check_poses(&store, CAMERA_POSE, |index| take.frames[index].camera * turned);
    check_poses(&store, "data/object_pose", |index| take.frames[index].object);
    assert_eq!(supervised(&store), [0, FRAMES * 1556]);
    let about = &store.raw_attributes()["import"];
    assert_eq!((&about["kind"], &about["hand"]["exact"]), (&json!("hot3d"), &json!(true)));
    assert!(about["licence"].as_str().unwrap().contains("CC BY-NC-SA"));
    assert_eq!(store.raw_attributes()["camera"]["projection_params"][0], 611.1);
    assert_eq!(crate::run::force_validity(&out, &crate::run::with_mano(&mano)), [0; 2 * FRAMES]);
    // The same command again finds the store complete, also of a data set that was moved; another rule would be another store.
    let moved = folder.path().join("moved");
    std::fs::rename(&root, &moved).unwrap();
    let root = moved;
    let again = import(&root, &mano, &out, &["--size", "0"]);
    assert!(String::from_utf8_lossy(&again.stdout).contains("done before"));
    assert_eq!(import(&root, &mano, &out, &["--contact-distance", "3mm"]).status.code(), Some(1));
}

#[test]
fn contact_by_signed_distance_is_narrower_and_distances_are_those_of_the_box() {
    let folder = tempfile::tempdir().unwrap();
    let (root, mano) = data_set(folder.path(), |_| ());
    let out = folder.path().join("clip.zarr");
    assert!(import(&root, &mano, &out, &["--contact-distance", "2mm"]).status.success());
    let store = open(&out);
    let contact = store.read_contact(0..FRAMES).unwrap();
    let distance = store.read_f32("data/mano_distance", 0..FRAMES).unwrap();
    let mut touched = 0;
    for (index, frame) in TAKE.frames.iter().enumerate() {
        for side in Side::BOTH {
            for (place, vertex) in side.range().zip(&frame.hand(side).vertices) {
                let beyond = frame.object.inverse().transform_point3(vertex.as_dvec3()).abs() - TAKE.half;
                let outside = beyond.max(DVec3::ZERO).length();
                let exact = if outside > 0.0 { outside } else { beyond.max_element() };
                let got = f64::from(distance[1556 * index + place]);
                assert!((got - exact.min(0.05)).abs() < 3e-4, "{got} m for {exact} m");
                assert!((exact - 0.002).abs() < 3e-4 || (contact[1556 * index + place] == 1.0) == (exact <= 0.002));
                touched += usize::from(exact <= 0.002);
            }
        }
    }
    assert!(touched > 50, "{touched}");
}

#[test]
fn damaged_members_and_meshes_are_named_and_the_rest_is_imported() {
    let folder = tempfile::tempdir().unwrap();
    let (root, mano) = data_set(folder.path(), |members| {
        let mut change = |name: &str, edit: &dyn Fn(&mut Vec<u8>)| {
            edit(&mut members.iter_mut().find(|(member, _)| member == name).unwrap().1);
        };
        change("000001.hands.json", &|content| content.truncate(20));
        change("000002.image_214-1.jpg", &|content| content.truncate(30));
        change("000003.objects.json", &|content| {
            let mut json: Value = serde_json::from_slice(content).unwrap();
            json["7"][0]["T_world_from_object"]["quaternion_wxyz"] = json!([2, 0, 0, 0]);
            *content = json.to_string().into();
        });
        // MANO was not registered here: unknown, and no damage.
        change("000004.hands.json", &|content| {
            let mut json: Value = serde_json::from_slice(content).unwrap();
            json["left"]["mano_pose"] = Value::Null;
            *content = json.to_string().into();
        });
    });
    write(&root.join("train_quest3/clip-000002.tar"), vec![7; 2000]);
    let out = folder.path().join("stores");
    let output = import(&root, &mano, &out, &["--json", "-"]);
    assert_eq!(output.status.code(), Some(3), "{}", String::from_utf8_lossy(&output.stderr));
    let summary: Value = serde_json::from_slice(&output.stdout).unwrap();
    let faults: Vec<&str> = summary["summary"]["faults"]
        .as_array()
        .unwrap()
        .iter()
        .map(|fault| fault["reason"].as_str().unwrap())
        .collect();
    for expected in [
        "clip-001849.tar/000001.hands.json: not JSON",
        "clip-001849.tar/000002.image_214-1.jpg: ",
        "clip-001849.tar/000003.objects.json: 7[0].T_world_from_object.quaternion_wxyz: expected a quaternion of length 1",
    ] {
        assert_eq!(faults.iter().filter(|fault| fault.contains(expected)).count(), 1, "{expected} in {faults:?}");
    }
    assert_eq!(faults.len(), 3, "{faults:?}");
    assert!(summary["failed"][0]["reason"].as_str().unwrap().contains("not a tar archive"), "{summary}");
    let store = open(&out.join("clip-001849.zarr"));
    assert_eq!(store.len(), FRAMES);
    // Three frames and one hand have no label.
    assert_eq!(supervised(&store), [0, (FRAMES - 3) * 1556 - 778]);

    // Without the mesh of the touched box, contact is unknown, since a vertex may touch it.
    std::fs::remove_file(root.join("object_models/obj_000007.glb")).unwrap();
    let out = folder.path().join("without");
    let output = import(&root, &mano, &out, &[]);
    assert_eq!(output.status.code(), Some(3));
    assert!(String::from_utf8_lossy(&output.stdout).contains("object obj_000007: its mesh was not found"));
    assert_eq!(supervised(&open(&out.join("clip-001849.zarr"))), [0, 0]);
}

#[test]
fn hands_of_a_basis_need_mano_files() {
    let folder = tempfile::tempdir().unwrap();
    let (root, _) = data_set(folder.path(), |_| ());
    let [root, out] = [root, folder.path().join("a")].map(|path| path.to_str().unwrap().to_string());
    let error = common::refused(&["data", "import", "arctic", &root, "--out", &out], "--mano-left and --mano-right");
    assert!(error.contains("arctic"), "{error}");
    // A clip without UmeTrack's profile has poses of MANO's basis alone.
    let output = egotac(&["data", "import", "hot3d", &root, "--out", &out]);
    assert_eq!(output.status.code(), Some(3));
    assert!(String::from_utf8_lossy(&output.stdout).contains("expected MANO's pose basis"));
}

/// Writes a clip of the grasp of frame 0, carried along with the object, whose right hand is given in UmeTrack alone.
#[test]
fn without_mano_files_hands_are_fitted_to_the_joints_of_umetrack() {
    let folder = tempfile::tempdir().unwrap();
    let take = Take::of_mean_shape();
    let hand = take.frames[0].hand(Side::Right);
    let wrist =
        DAffine3::from_rotation_translation(DQuat::from_rotation_y(0.8), hand.wrist + DVec3::new(0.01, 0.0, 0.02));
    let angles: Vec<f64> = (0..22).map(|joint| 0.4 * (1.7 * joint as f64).sin()).collect();
    let carried = |index: usize| take.frames[index].object * take.frames[0].object.inverse();
    let profile = umetrack_profile(&hand.keypoints, wrist, &angles);
    let (root, _) = data_set(folder.path(), |members| {
        *members = clip(&take, &ManoFiles::write(&folder.path().join("other"), &take, true));
        for (name, content) in members.iter_mut() {
            if let Some(index) = name.strip_suffix(".hands.json") {
                let pose = carried(index.parse().unwrap()) * wrist;
                *content = json!({ "right": { "umetrack_pose": {
                    "joint_angles": angles, "T_world_from_wrist": motion(pose),
                } } })
                .to_string()
                .into();
            } else if name == "__hand_shapes.json__" {
                *content = json!({ "mano": vec![0.0; 10], "umetrack": profile }).to_string().into();
            }
        }
    });
    write(&root.join("object_models/obj_000007.glb"), glb(&take.box_mesh()));
    let out = folder.path().join("clip.zarr");
    let [source, store] = [&root, &out].map(|path| path.to_str().unwrap());
    let output = egotac(&["data", "import", "hot3d", source, "--out", store, "--size", "0"]);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&[output.stdout, output.stderr].concat()));
    let store = open(&out);
    assert_eq!(supervised(&store), [0, FRAMES * 778]);
    let contact = store.read_contact(0..FRAMES).unwrap();
    let want = take.frames[0].touched(&take, Side::Right);
    let (mut hits, mut wrong) = (0, 0);
    for index in 0..FRAMES {
        for (got, want) in contact[1556 * index..][Side::Right.range()].iter().zip(&want) {
            hits += usize::from(*got == 1.0 && *want);
            wrong += usize::from((*got == 1.0) != *want);
        }
    }
    let score = 2.0 * hits as f64 / (2 * hits + wrong) as f64;
    assert!(hits > 100 && score >= 0.98, "F1 {score}");
    // A damaged profile is named.
    let mut broken = profile.clone();
    broken["landmark_rest_bone_indices"][3] = json!([17, 0, 0]);
    let member = json!({ "mano": vec![0.0; 10], "umetrack": broken }).to_string().into_bytes();
    let mut members = clip(&take, &ManoFiles::write(&folder.path().join("other"), &take, true));
    members
        .iter_mut()
        .filter(|(name, _)| name == "__hand_shapes.json__")
        .for_each(|(_, content)| *content = member.clone());
    write(&root.join("train_aria/clip-001849.tar"), tar(&members));
    let output = egotac(&["data", "import", "hot3d", source, "--out", folder.path().join("b").to_str().unwrap()]);
    let error = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(
        error.contains("umetrack.landmark_rest_bone_indices[3][0]: expected a frame from 0 to 16, got 17"),
        "{error}"
    );
}

/// Returns a profile of UmeTrack, a left hand in millimetres, whose landmarks lie at these keypoints of a right hand if its joints
/// are bent by `angles` and its wrist is at `wrist`. Joints lie at the keypoints as far as they bend fingers.
fn umetrack_profile(keypoints: &[glam::Vec3; 21], wrist: DAffine3, angles: &[f64]) -> Value {
    // Matrices by Rodrigues' formula, mirrored in x.
    let mirrored = DMat4::from(wrist) * DMat4::from_diagonal(glam::DVec4::new(-1.0, 1.0, 1.0, 1.0));
    let local = |keypoint: usize| mirrored.inverse().transform_point3(keypoints[keypoint].as_dvec3());
    let axis = |joint: usize| DVec3::new(0.3 * joint as f64 - 2.0, 1.0, 0.5 * (joint % 3) as f64).normalize();
    let turn = |joint: usize, place: DVec3| {
        let (k, angle) = (axis(joint), angles[joint]);
        let cross =
            DMat3::from_cols(DVec3::new(0.0, k.z, -k.y), DVec3::new(-k.z, 0.0, k.x), DVec3::new(k.y, -k.x, 0.0));
        let rotation = DMat3::IDENTITY + cross * angle.sin() + cross * cross * (1.0 - angle.cos());
        DMat4::from_mat3_translation(rotation, place - rotation * place)
    };
    let mut rest = vec![DVec3::ZERO; 22];
    let mut landmarks = vec![(DVec3::ZERO, 0); 20];
    landmarks[5] = (local(0), 1);
    for finger in 0..5 {
        let base = 1 + 4 * finger;
        // Both joints of a finger's base lie there, and turn nothing but what follows.
        rest[4 * finger] = local(base);
        let mut bent = turn(4 * finger, rest[4 * finger]);
        rest[4 * finger + 1] = rest[4 * finger];
        bent *= turn(4 * finger + 1, rest[4 * finger + 1]);
        let mut put = |landmark: usize, keypoint: usize, bent: &DMat4, frame: usize| {
            landmarks[landmark] = (bent.inverse().transform_point3(local(keypoint)), 2 + 3 * finger + frame);
        };
        let joints =
            if finger == 0 { [None, Some(6), Some(7)] } else { [5, 6, 7].map(|first| Some(first + 3 * finger)) };
        if let Some(landmark) = joints[0] {
            put(landmark, base, &bent, 0);
        }
        for joint in 2..4 {
            rest[4 * finger + joint] = bent.inverse().transform_point3(local(base + joint - 1));
            bent *= turn(4 * finger + joint, rest[4 * finger + joint]);
            put(joints[joint - 1].unwrap(), base + joint - 1, &bent, joint - 1);
        }
        put(finger, base + 3, &bent, 2);
    }
    let millimetres = |point: DVec3| (point * 1000.0).to_array();
    json!({
        "joint_rotation_axes": (0..22).map(|joint| axis(joint).to_array()).collect::<Vec<_>>(),
        "joint_rest_positions": rest.into_iter().map(millimetres).collect::<Vec<_>>(),
        "landmark_rest_positions": landmarks.iter().map(|(point, _)| millimetres(*point)).collect::<Vec<_>>(),
        "landmark_rest_bone_indices": landmarks.iter().map(|(_, frame)| [*frame, 0, 0]).collect::<Vec<_>>(),
        "landmark_rest_bone_weights": landmarks.iter().map(|_| [1.0, 0.0, 0.0]).collect::<Vec<_>>(),
    })
}

#[test]
fn both_hands_touch_where_the_poses_of_a_clip_are_replayed() {
    let folder = tempfile::tempdir().unwrap();
    let (root, mano) = data_set(folder.path(), |_| ());
    let out = folder.path().join("clip.zarr");
    assert!(import(&root, &mano, &out, &["--size", "0"]).status.success());
    let [left, right] = [&mano.left, &mano.right].map(|path| path.to_str().unwrap());
    let store = out.to_str().unwrap();
    let mano_files = ["--mano-left", left, "--mano-right", right];
    let arguments = ["sim", "replay", store, "--gravity", "0,0,-1", "--json"];
    let output = egotac(&[&arguments[..], &mano_files].concat());
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let report: Value = serde_json::from_slice(&output.stdout).unwrap();
    // The person's hand bends by the built-in hand's hinges; three frames at either end do not count.
    assert!(report["missed_rotation_degrees"].as_f64().unwrap() < 0.1, "{report}");
    assert_eq!(report["replayed"], FRAMES - 6);
    // The clip has no forces to compare with, but in the simulator both hands touch in all of its frames.
    let models = [HandModel::load(&mano.left, Side::Left).unwrap(), HandModel::load(&mano.right, Side::Right).unwrap()];
    let bodies = BodyOptions { gravity: Some(DVec3::NEG_Z), ..BodyOptions::default() };
    let Replayed { frames, .. } = replay(&out, &models, &bodies).unwrap();
    assert_eq!(frames.len(), FRAMES);
    for frame in &frames {
        let sums = frame.links.map(|links| links.iter().sum::<f64>());
        assert!(sums.iter().all(|sum| *sum > 1.0), "frame {}: {sums:?} N", frame.frame);
        // The second object's mesh is there, but nothing touches it.
        assert!(frame.net[0].is_finite() && frame.net[1] == DVec3::ZERO, "{frame:?}");
    }
    let error = egotac(&["sim", "replay", store]);
    assert!(String::from_utf8_lossy(&error.stderr).contains("--mano-left"));
}

#[test]
fn the_list_names_every_kind_with_its_licence() {
    let output = egotac(&["data", "import", "--list"]);
    let text = String::from_utf8(output.stdout).unwrap();
    for kind in &egotac::import::kinds::ALL {
        assert!(text.contains(&format!("| {} |", kind.name)) && text.contains(kind.licence));
    }
    let docs = std::fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join("docs/import.md")).unwrap();
    assert!(docs.contains(&text), "docs/import.md holds the table that `egotac data import --list` prints");
    common::refused(&["data", "import", "vrs", "a", "--out", "b"], "known: hot3d");
}

/// Writes three clips, of which the shards import different ones.
#[test]
fn shards_import_every_recording_once() {
    let folder = tempfile::tempdir().unwrap();
    let (root, mano) = data_set(folder.path(), |_| ());
    for name in ["clip-000001.tar", "clip-000002.tar"] {
        std::fs::copy(root.join("train_aria/clip-001849.tar"), root.join("train_aria").join(name)).unwrap();
    }
    let out = folder.path().join("stores");
    assert!(import(&root, &mano, &out, &["--shard", "0/2"]).status.success());
    let stores = || {
        let entries = std::fs::read_dir(&out).unwrap().map(|entry| entry.unwrap().file_name().into_string().unwrap());
        let mut names: Vec<String> = entries.filter(|name| !name.starts_with('.')).collect();
        names.sort();
        names
    };
    assert_eq!(stores(), ["clip-000001.zarr", "clip-001849.zarr", "manifest.json"]);
    assert!(import(&root, &mano, &out, &["--shard", "1/2"]).status.success());
    assert_eq!(stores(), ["clip-000001.zarr", "clip-000002.zarr", "clip-001849.zarr", "manifest.json"]);
    let manifest: Value = serde_json::from_slice(&std::fs::read(out.join("manifest.json")).unwrap()).unwrap();
    assert_eq!(manifest["summary"]["labelled"], 3 * FRAMES);
}

/// A reader whose medium fails once, at one moment.
struct Failing<'a> {
    reader: &'a dyn Reader,
    at: usize,
    failures: AtomicUsize,
}

impl Reader for Failing<'_> {
    fn recording(&self) -> &Recording {
        self.reader.recording()
    }

    fn files(&self) -> Result<Vec<PathBuf>> {
        self.reader.files()
    }

    fn moment(&self, index: usize) -> Result<Moment> {
        if index == self.at && self.failures.fetch_add(1, Ordering::Relaxed) == 0 {
            return Err(Error::io("clip")(std::io::Error::from_raw_os_error(5)));
        }
        self.reader.moment(index)
    }

    fn images(&self, from: usize) -> Result<SourceFrames<'_>> {
        self.reader.images(from)
    }
}

#[test]
fn an_import_that_stopped_goes_on_where_it_stopped() {
    let folder = tempfile::tempdir().unwrap();
    let (root, mano) = data_set(folder.path(), |_| ());
    let settings = || Settings {
        kind: kind("hot3d").unwrap(),
        hands: HandModels::load(Some(&mano.left), Some(&mano.right)).unwrap(),
        rule: ContactRule::Proximity,
        side: None,
        options: Options::default(),
    };
    let shard = Shard { index: 0, of: 1 };
    let run = |out: &Path, at: usize| -> (ZarrReader, u64) {
        let import = ImportTasks::find(&root, out, settings()).unwrap();
        let jobs = import.jobs();
        let labeller = import.labeller(0);
        let failing = Failing { reader: labeller.reader, at, failures: AtomicUsize::new(0) };
        let mut failing = egotac::import::labeller::GeometryLabeller { reader: &failing, ..labeller };
        let mut timing = LabelTiming::default();
        let mut outcome = jobs[0].run_with(&mut failing, shard, 0, &mut timing, &mut || ());
        if at < FRAMES {
            let error = outcome.unwrap_err().to_string();
            assert!(error.contains(&format!("{at} images of clip-001849 are labelled")), "{error}");
            assert!(!out.exists());
            timing = LabelTiming::default();
            outcome = jobs[0].run_with(&mut failing, shard, 0, &mut timing, &mut || ());
        }
        assert!(matches!(outcome.unwrap(), Outcome::Done(_)));
        (open(out), timing.frames)
    };
    let (whole, frames) = run(&folder.path().join("whole.zarr"), FRAMES);
    assert_eq!(frames, FRAMES as u64);
    let (resumed, frames) = run(&folder.path().join("resumed.zarr"), 5);
    assert_eq!(frames, FRAMES as u64 - 5);
    for array in whole.arrays() {
        if array.name.starts_with("data/") {
            let read = |store: &ZarrReader| format!("{:?}", store.read(&array.name, 0..FRAMES).unwrap());
            assert!(read(&whole) == read(&resumed), "{}", array.name);
        }
    }
}
