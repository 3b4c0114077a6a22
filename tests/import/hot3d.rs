//! HOT3D clips become stores: exact labels, damage named, work resumed and divided.

use std::path::{Path, PathBuf};
use std::sync::LazyLock;
use std::sync::atomic::{AtomicUsize, Ordering};

use crate::check::{check_hands, check_poses, check_stamps, f1, open, supervised};
use crate::common::{self, egotac};
use crate::files::{ManoFiles, angles, glb, jpeg, tar, write};
use crate::take::{FRAMES, Take, cuboid};
use egotac::dataset::SourceFrames;
use egotac::dataset::zarr::{CAMERA_POSE, ZarrReader};
use egotac::error::{Error, Result};
use egotac::hand::Side;
use egotac::import::{ContactRule, HandModels, ImportTasks, Moment, Options, Reader, Recording, Settings, kind};
use egotac::label::{LabelTiming, Outcome, Shard};
use glam::{DAffine3, DMat3, DQuat, DVec3};
use image::RgbImage;
use image::imageops::rotate90;
use serde_json::{Value, json};

static TAKE: LazyLock<Take> = LazyLock::new(Take::simulated);

/// Stamp of a frame, ns: those of the device's clock, which starts at boot.
fn nanoseconds(index: usize) -> u64 {
    54_971_174_871_117 + 33_327_462 * index as u64
}

fn motion(pose: DAffine3) -> Value {
    let (q, p) = (DQuat::from_affine3(&pose), pose.translation);
    json!({ "quaternion_wxyz": [q.w, q.x, q.y, q.z], "translation_xyz": [p.x, p.y, p.z] })
}

/// Returns the members of a clip, by name.
fn clip(take: &Take, mano: &ManoFiles) -> Vec<(String, Vec<u8>)> {
    let mut members = Vec::new();
    let betas = &take.frames[0].hands[0].params.betas;
    for (index, frame) in take.frames.iter().enumerate() {
        let mut add = |name: &str, content: Vec<u8>| members.push((format!("{index:06}.{name}"), content));
        let hand = |side: Side| {
            let params = &frame.hand(side).params;
            let wrist = [params.global_orient.to_array(), params.transl.to_array()].concat();
            let thetas = mano.coefficients(side, &angles(&params.hand_pose));
            json!({ "mano_pose": { "thetas": thetas, "wrist_xform": wrist }, "boxes_amodal": {} })
        };
        let elsewhere = DAffine3::from_translation(DVec3::new(3.0, 0.0, 0.0));
        let object =
            |id: i64, pose: DAffine3| json!([{ "object_bop_id": id.to_string(), "T_world_from_object": motion(pose) }]);
        add("cameras.json", json!({ "214-1": {
            "calibration": { "projection_model_type": "CameraModelType.FISHEYE624", "projection_params": [611.1, 715.2] },
            "T_world_from_camera": motion(frame.camera),
        } }).to_string().into());
        add("hands.json", json!({ "left": hand(Side::Left), "right": hand(Side::Right) }).to_string().into());
        add("image_1201-1.jpg", jpeg(&RgbImage::new(8, 8)));
        add("image_214-1.jpg", jpeg(&frame.image));
        let times = json!({ "214-1": nanoseconds(index), "1201-1": nanoseconds(index) + 96_500 });
        add(
            "info.json",
            json!({ "sequence_id": "P0001_23fa0ee8", "device": "Aria", "image_timestamps_ns": times })
                .to_string()
                .into(),
        );
        add("objects.json", json!({ "7": object(7, frame.object), "12": object(12, elsewhere) }).to_string().into());
    }
    members.push(("__hand_shapes.json__".into(), json!({ "mano": betas, "umetrack": {} }).to_string().into()));
    members
}

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
    let output = import(&root, &mano, &out, &["--side", "0"]);
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
    // The same command again finds the store complete, also of a data set that was moved; another rule would be another store.
    let moved = folder.path().join("moved");
    std::fs::rename(&root, &moved).unwrap();
    let root = moved;
    let again = import(&root, &mano, &out, &["--side", "0"]);
    assert!(String::from_utf8_lossy(&again.stdout).contains("done before"));
    assert_eq!(import(&root, &mano, &out, &["--contact-distance", "3"]).status.code(), Some(1));
}

#[test]
fn contact_by_signed_distance_is_narrower_and_distances_are_those_of_the_box() {
    let folder = tempfile::tempdir().unwrap();
    let (root, mano) = data_set(folder.path(), |_| ());
    let out = folder.path().join("clip.zarr");
    assert!(import(&root, &mano, &out, &["--contact-distance", "2"]).status.success());
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
    let error = common::refused(
        &["data", "import", "hot3d", root.to_str().unwrap(), "--out", folder.path().join("a").to_str().unwrap()],
        "--mano-left and --mano-right",
    );
    assert!(error.contains("hot3d"), "{error}");
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
