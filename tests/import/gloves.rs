//! Data sets in HDF5 become stores: OpenTouch, TouchAnything, EgoDex.

use std::path::Path;
use std::sync::LazyLock;

use egotac::dataset::zarr::{CAMERA_POSE, LEFT_HAND_POSE, RIGHT_HAND_POSE, ZarrReader};
use egotac::hand::{HandModel, HandParams, N_VERTICES, Side};
use glam::{DAffine3, DMat4, Vec3};
use serde_json::json;

use crate::check::{check_images, check_poses, check_stamps, open, supervised};
use crate::common::egotac_bounded;
use crate::files::{jpeg, video, write};
use crate::h5::Node;
use crate::run::{import, imported};
use crate::take::{FRAMES, Take, TakeFrame};

static TAKE: LazyLock<Take> = LazyLock::new(Take::of_mean_shape);

/// Returns the newtons on each cell of a grid of `n` cells: vertex k lies on cell k modulo n.
fn cells(frame: &TakeFrame, side: Side, n: usize) -> Vec<f32> {
    let mut cells = vec![0.0; n];
    frame.hand(side).forces.iter().enumerate().for_each(|(vertex, force)| cells[vertex % n] += force);
    cells
}

/// Returns the 63 numbers of a hand's keypoints in another frame, m.
fn keypoints(frame: &TakeFrame, side: Side, to_world: DAffine3) -> Vec<f32> {
    let moved = |point: &Vec3| to_world.transform_point3(point.as_dvec3()).as_vec3().to_array();
    frame.hand(side).keypoints.iter().flat_map(moved).collect()
}

/// Checks that the keypoints of the stored hands are those of the take, moved by `to_from`.
fn check_keypoints(store: &ZarrReader, take: &Take, to_from: impl Fn(usize) -> DAffine3, skip: &[(usize, Side)]) {
    for (side, name) in Side::BOTH.into_iter().zip([LEFT_HAND_POSE, RIGHT_HAND_POSE]) {
        let model = HandModel::builtin(side);
        let values = store.read_f32(name, 0..store.len()).unwrap();
        for (index, frame) in take.frames.iter().enumerate() {
            let params: &[f32; 61] = values[61 * index..][..61].try_into().unwrap();
            if skip.contains(&(index, side)) {
                assert_eq!(*params, [0.0; 61], "{} hand, frame {index} is unknown", side.name());
                continue;
            }
            let got = model.keypoints(&model.forward(&HandParams::from_array(params)));
            for (got, want) in got.iter().zip(&frame.hand(side).keypoints) {
                let distance = got.as_dvec3().distance(to_from(index).transform_point3(want.as_dvec3()));
                assert!(distance < 0.004, "{} hand, frame {index}: {distance} m", side.name());
            }
        }
    }
}

/// Checks that the readings of a sensor are those that were written, and that nothing is known of force and contact.
fn check_readings(store: &ZarrReader, side: Side, want: impl Fn(usize) -> Vec<f32>) {
    let got = store.read_f32(&format!("data/tactile_{}", side.name()), 0..store.len()).unwrap();
    let want: Vec<f32> = (0..FRAMES).flat_map(want).collect();
    assert_eq!(got.len(), want.len());
    for (got, want) in got.iter().zip(&want) {
        assert!(got == want || got.is_nan() && want.is_nan(), "{got} for {want}");
    }
    assert_eq!(supervised(store), [0, 0]);
    let force = store.read_f32("data/mano_force", 0..store.len()).unwrap();
    assert!(force.len() == FRAMES * 2 * N_VERTICES && force.iter().all(|force| force.is_nan()));
}

/// Counts of the OpenTouch glove: fewer counts for more force.
fn counts(frame: &TakeFrame, side: Side) -> Vec<f32> {
    cells(frame, side, 256).into_iter().map(|newtons| (3072.0 - 500.0 * newtons).max(0.0).round()).collect()
}

/// Writes a scene of OpenTouch with one clip: the last frame has no landmarks of the left hand.
pub fn write_opentouch(path: &Path, take: &Take) {
    let n = FRAMES as u64;
    let landmarks = |side: Side| {
        let of_frame = move |(index, frame): (usize, &TakeFrame)| match (side, index + 1 == FRAMES) {
            (Side::Left, true) => vec![f32::NAN; 63],
            _ => keypoints(frame, side, DAffine3::IDENTITY),
        };
        Node::f32s(&[n, 21, 3], take.frames.iter().enumerate().flat_map(of_frame))
    };
    let pressure =
        |side: Side| Node::f32s(&[n, 16, 16], take.frames.iter().flat_map(move |frame| counts(frame, side))).chunked(4);
    let clip = Node::group([
        ("rgb_images_jpeg", Node::Lists(take.frames.iter().map(|frame| jpeg(&frame.image)).collect())),
        ("timestamps", Node::i64s((0..FRAMES as i64).map(|index| 1_700_000_000_123_456_789 + 33_333_333 * index))),
        ("left_pressure", pressure(Side::Left)),
        ("right_pressure", pressure(Side::Right)),
        ("left_hand_landmarks", landmarks(Side::Left)),
        ("right_hand_landmarks", landmarks(Side::Right)),
    ]);
    let camera = Node::group([("T_device_camera", Node::f64s(&[4, 4], DMat4::IDENTITY.to_cols_array()))]);
    let file =
        Node::group([("data", Node::group([("demo_00", clip)])), ("calibration", Node::group([("rgb", camera)]))]);
    write(path, file.file());
}

#[test]
fn opentouch_keeps_counts_and_stamps_and_leaves_force_unknown() {
    let (folder, take) = (tempfile::tempdir().unwrap(), &*TAKE);
    let (root, out) = (folder.path().join("opentouch"), folder.path().join("store.zarr"));
    write_opentouch(&root.join("data/kitchen_p1.hdf5"), take);
    let store = imported("opentouch", &root, &out, &[]);
    check_stamps(
        &store,
        (0..FRAMES as i64).map(|index| {
            // The nearest number to the decimal fraction.
            let nanos = 123_456_789 + 33_333_333 * index;
            format!("{}.{:09}", 1_700_000_000 + nanos / 1_000_000_000, nanos % 1_000_000_000).parse().unwrap()
        }),
    );
    check_keypoints(&store, take, |_| DAffine3::IDENTITY, &[(FRAMES - 1, Side::Left)]);
    for side in Side::BOTH {
        check_readings(&store, side, |index| counts(&take.frames[index], side));
    }
    let about = &store.raw_attributes()["import"];
    let glove = &about["sensors"][1];
    assert_eq!((&glove["unit"], &glove["falls_with_pressure"]), (&json!("ADC counts"), &json!(true)));
    assert_eq!(glove["unused_cells"].as_array().unwrap().len(), 87);
    assert_eq!(store.raw_attributes()["camera"]["T_device_camera"]["shape"], json!([4, 4]));
}

/// Readings of the TouchAnything glove: parts of 20 N, and no taxel in the first corner.
fn parts(frame: &TakeFrame, side: Side) -> Vec<f32> {
    let mut parts: Vec<f32> = cells(frame, side, 441).into_iter().map(|newtons| (newtons / 20.0).min(1.0)).collect();
    parts[0] = f32::NAN;
    parts
}

/// Writes a trajectory of TouchAnything: hands in the camera's frame, images in chunks of four frames.
pub fn write_touchanything(path: &Path, take: &Take) {
    let n = FRAMES as u64;
    let images = |mirrored: bool| {
        let pixels = take.frames.iter().flat_map(|frame| match mirrored {
            true => image::imageops::flip_horizontal(&frame.image).into_raw(),
            false => frame.image.as_raw().clone(),
        });
        Node::u8s(&[n, 48, 64, 3], pixels.collect()).chunked(4)
    };
    let joints = |side: Side| {
        let of_frame = move |frame: &TakeFrame| keypoints(frame, side, frame.camera.inverse());
        Node::f32s(&[n, 21, 3], take.frames.iter().flat_map(of_frame))
    };
    // The estimator does not find the right hand in frame 3.
    let valid =
        |side: Side| Node::u8s(&[n], (0..FRAMES).map(|index| u8::from(side == Side::Left || index != 3)).collect());
    let grid =
        |side: Side| Node::f32s(&[n, 21, 21], take.frames.iter().flat_map(move |frame| parts(frame, side))).chunked(5);
    let file = Node::group([
        ("metadata", Node::Group(Vec::new(), vec![("task_name", "pour_water".into())])),
        ("timestamps", Node::i64s((0..FRAMES as i64).map(|index| 33_333 * index))),
        (
            "images",
            Node::group([("chest_color", images(false)), ("left_color", images(true)), ("right_color", images(false))]),
        ),
        (
            "hands",
            Node::group([
                ("wilor_left_joint_xyz", joints(Side::Left)),
                ("wilor_right_joint_xyz", joints(Side::Right)),
                ("wilor_left_valid", valid(Side::Left)),
                ("wilor_right_valid", valid(Side::Right)),
            ]),
        ),
        (
            "pressure",
            Node::group([("left_pressure_grid", grid(Side::Left)), ("right_pressure_grid", grid(Side::Right))]),
        ),
    ]);
    write(path, file.file());
}

#[test]
fn touchanything_keeps_grids_and_the_images_of_three_cameras() {
    let (folder, take) = (tempfile::tempdir().unwrap(), &*TAKE);
    let (root, out) = (folder.path().join("touchanything"), folder.path().join("store.zarr"));
    write_touchanything(&root.join("pour_water/traj_0001.hdf5"), take);
    let store = imported("touchanything", &root, &out, &[]);
    check_images(&store, take);
    check_stamps(&store, (0..FRAMES).map(|index| 33_333.0 * index as f64 / 1e6));
    check_keypoints(&store, take, |index| take.frames[index].camera.inverse(), &[(3, Side::Right)]);
    for side in Side::BOTH {
        check_readings(&store, side, |index| parts(&take.frames[index], side));
    }
    for (name, mirrored) in [("data/left_wrist_camera_rgb", true), ("data/right_wrist_camera_rgb", false)] {
        let got = store.read_u8(name, 0..FRAMES).unwrap();
        for (got, frame) in got.chunks_exact(48 * 64 * 3).zip(&take.frames) {
            let flipped = image::imageops::flip_horizontal(&frame.image);
            assert!(got == if mirrored { flipped.as_raw() } else { frame.image.as_raw() }.as_slice(), "{name}");
        }
    }
    assert_eq!(store.raw_attributes()["import"]["about"]["task"], "pour_water");
}

/// Names of the joints of a finger in EgoDex, from the palm to the tip.
const FINGER: [&str; 4] = ["Knuckle", "IntermediateBase", "IntermediateTip", "Tip"];
const FINGERS: [&str; 5] = ["Thumb", "IndexFinger", "MiddleFinger", "RingFinger", "LittleFinger"];

/// Writes an episode of EgoDex: joints in the world; the tracker does not see the left hand in frame 2.
pub fn write_egodex(root: &Path, take: &Take) {
    let n = FRAMES as u64;
    let motions = |motion: &dyn Fn(&TakeFrame) -> DAffine3| {
        let rows = take.frames.iter().flat_map(|frame| DMat4::from(motion(frame)).transpose().to_cols_array());
        Node::f32s(&[n, 4, 4], rows.map(|value| value as f32).collect::<Vec<_>>())
    };
    let mut transforms = vec![("camera".to_string(), motions(&|frame| frame.camera))];
    let mut confidences = Vec::new();
    for side in Side::BOTH {
        let mut joint = |name: String, keypoint: usize| {
            let at = move |frame: &TakeFrame| frame.hand(side).keypoints[keypoint].as_dvec3();
            transforms
                .push((format!("{}{name}", side.name()), motions(&|frame| DAffine3::from_translation(at(frame)))));
        };
        joint("Hand".into(), 0);
        for (finger, name) in FINGERS.iter().enumerate() {
            FINGER.iter().enumerate().for_each(|(k, part)| joint(format!("{name}{part}"), 1 + 4 * finger + k));
        }
        let seen = (0..FRAMES).map(|index| if (side, index) == (Side::Left, 2) { 0.1 } else { 0.9 });
        confidences.push((format!("{}Hand", side.name()), Node::f32s(&[n], seen)));
    }
    let intrinsic = [736.6, 0.0, 960.0, 0.0, 736.5, 540.0, 0.0, 0.0, 1.0];
    let attributes = vec![
        ("llm_description", "stack the cups".to_string()),
        ("llm_description2", "unstack the cups".to_string()),
        ("which_llm_description", "2".to_string()),
    ];
    let members = vec![
        ("transforms".to_string(), Node::Group(transforms, Vec::new())),
        ("confidences".to_string(), Node::Group(confidences, Vec::new())),
        ("camera".to_string(), Node::group([("intrinsic", Node::f32s(&[3, 3], intrinsic))])),
    ];
    write(&root.join("test/stack_cups/0.hdf5"), Node::Group(members, attributes).file());
    let images: Vec<_> = take.frames.iter().map(|frame| &frame.image).collect();
    video(&root.join("test/stack_cups/0.mp4"), &images);
}

#[test]
fn egodex_has_hands_camera_and_description_for_labelling() {
    let (folder, take) = (tempfile::tempdir().unwrap(), &*TAKE);
    let (root, out) = (folder.path().join("egodex"), folder.path().join("store.zarr"));
    write_egodex(&root, take);
    let store = imported("egodex", &root, &out, &[]);
    check_images(&store, take);
    check_stamps(&store, (0..FRAMES).map(|index| index as f64 / 30.0));
    check_keypoints(&store, take, |_| DAffine3::IDENTITY, &[(2, Side::Left)]);
    check_poses(&store, CAMERA_POSE, |index| take.frames[index].camera);
    assert_eq!(supervised(&store), [0, 0]);
    assert_eq!(store.raw_attributes()["import"]["about"]["description"], "unstack the cups");
    assert_eq!(store.raw_attributes()["camera"]["fx"], 736.5999755859375);
}

/// A file that is cut off, one of another layout and one with huge lengths are named; the rest is imported.
#[test]
fn damaged_hdf5_files_are_named_and_the_rest_is_imported() {
    let (folder, take) = (tempfile::tempdir().unwrap(), &*TAKE);
    let (root, out) = (folder.path().join("opentouch"), folder.path().join("out"));
    write_opentouch(&root.join("data/kitchen_p1.hdf5"), take);
    let whole = std::fs::read(root.join("data/kitchen_p1.hdf5")).unwrap();
    write(&root.join("data/cut.hdf5"), &whole[..whole.len() / 3]);
    write(&root.join("data/foreign.hdf5"), b"no HDF5 file");
    // The lengths of the left pressure, (9, 16, 16), become 9 x 16 x 2^40.
    let shape = [9u64, 16, 16].map(u64::to_le_bytes).concat();
    let at = whole.windows(24).position(|window| window == shape).unwrap();
    let mut huge = whole.clone();
    huge[at + 16..at + 24].copy_from_slice(&(1u64 << 40).to_le_bytes());
    write(&root.join("data/huge.hdf5"), huge);
    let output = import("opentouch", &root, &out, &[]);
    assert_eq!(output.status.code(), Some(3));
    let error = String::from_utf8_lossy(&output.stderr);
    for expected in [
        "cut.hdf5: ",
        "foreign.hdf5: content: ",
        "huge.hdf5: data/demo_00/left_pressure: expected shape [9, 16, 16], got [9, 16, 1099511627776]",
    ] {
        assert!(error.contains(expected), "{expected} is not in: {error}");
    }
    assert_eq!(open(&out.join("kitchen_p1_demo_00.zarr")).len(), FRAMES);
}

/// A number of frames beyond the limit is refused within 1.5 GB of memory.
#[test]
fn a_hostile_hdf5_file_is_refused_within_the_limits() {
    let (folder, take) = (tempfile::tempdir().unwrap(), &*TAKE);
    let path = folder.path().join("a.hdf5");
    write_opentouch(&path, take);
    let whole = std::fs::read(&path).unwrap();
    // Number of frames beyond the limit.
    let frames = 1u64 << 40;
    let mut many = whole.clone();
    let length = (FRAMES as u64).to_le_bytes();
    let rank_one: Vec<u8> = [&[1, 1, 0, 0, 0, 0, 0, 0][..], &length].concat();
    let places: Vec<usize> = (0..whole.len() - 16).filter(|at| whole[*at..][..16] == rank_one).collect();
    assert_eq!(places.len(), 2);
    for at in places {
        many[at + 8..at + 16].copy_from_slice(&frames.to_le_bytes());
    }
    write(&path, many);
    let out = folder.path().join("out");
    let output =
        egotac_bounded(&["data", "import", "opentouch", path.to_str().unwrap(), "--out", out.to_str().unwrap()]);
    assert_eq!(output.status.code(), Some(1));
    let error = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(error.contains("rgb_images_jpeg: expected at most 16777216 frames, got 1099511627776"), "{error}");
}
