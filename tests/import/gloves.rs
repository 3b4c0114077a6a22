//! Data sets in HDF5 become stores: OpenTouch, TouchAnything, EgoDex.

use std::sync::LazyLock;

use egotac::dataset::zarr::{CAMERA_POSE, LEFT_HAND_POSE, RIGHT_HAND_POSE, ZarrReader};
use egotac::hand::{HandModel, HandParams, N_VERTICES, Side};
use egotac::sensor;
use glam::DAffine3;
use serde_json::json;

use crate::check::{check_images, check_poses, check_stamps, open, supervised};
use crate::common::egotac_bounded;
use crate::run::{import, imported};
use crate::writers::files::write;
use crate::writers::gloves::{counts, parts, write_egodex, write_opentouch, write_touchanything};
use crate::writers::take::{FRAMES, Take, TakeFrame};

static TAKE: LazyLock<Take> = LazyLock::new(Take::of_mean_shape);

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

/// Checks that the readings of a sensor are those that were written, and that nothing is known of force.
fn check_readings(store: &ZarrReader, side: Side, want: impl Fn(usize) -> Vec<f32>) {
    let got = store.read_f32(&format!("data/tactile_{}", side.name()), 0..store.len()).unwrap();
    let want: Vec<f32> = (0..FRAMES).flat_map(want).collect();
    assert_eq!(got.len(), want.len());
    for (got, want) in got.iter().zip(&want) {
        assert!(got == want || got.is_nan() && want.is_nan(), "{got} for {want}");
    }
    assert_eq!(supervised(store)[0], 0);
    let force = store.read_f32("data/mano_force", 0..store.len()).unwrap();
    assert!(force.len() == FRAMES * 2 * N_VERTICES && force.iter().all(|force| force.is_nan()));
}

/// Tells of a cell of the OpenTouch grid whether its authors erased it.
fn unused(cell: usize) -> bool {
    let (row, column) = (cell / 16, cell % 16);
    row < 12 && column >= 11 || row < 9 && [2, 5, 8].contains(&column)
}

/// Checks relative readings and contact at the vertices: those of the map, and near the simulator's forces. `share`: part of the
/// range that each taxel reads.
fn check_relative(store: &ZarrReader, take: &Take, map: &str, share: impl Fn(&TakeFrame, Side) -> Vec<f32>) {
    let map = sensor::open(map).unwrap();
    let n = store.len();
    let [reading, contact] = [store.read_f32("data/mano_reading", 0..n).unwrap(), store.read_contact(0..n).unwrap()];
    let known = store.read_u8("data/mano_contact_valid", 0..n).unwrap();
    let (mut touched, mut strongest) = (0, 0);
    for (index, frame) in take.frames.iter().enumerate() {
        for side in Side::BOTH {
            let at = 1556 * index + side.range().start;
            let (vertices, forces) = (&frame.hand(side).vertices, &frame.hand(side).forces);
            let want = map.hands[side as usize].reading(&share(frame, side));
            for (vertex, want) in want.iter().enumerate() {
                let got = reading[at + vertex];
                assert!(got.is_nan() && want.is_nan() || (got - want).abs() < 1e-6, "{got} for {want}");
                assert_eq!(known[at + vertex] == 1, !want.is_nan());
                if want.is_nan() || contact[at + vertex] != 1.0 {
                    assert!(want.is_nan() || *want <= 0.1, "{want} is contact");
                    continue;
                }
                let near = (0..778).filter(|v| forces[*v] > 0.02).map(|v| vertices[v].distance(vertices[vertex]));
                let near = near.fold(f32::INFINITY, f32::min);
                assert!(near < 0.02, "frame {index}: vertex {vertex} is {near} m from all force");
                touched += 1;
            }
            let covered = (0..778).filter(|v| !want[*v].is_nan());
            let hardest = covered.max_by(|a, b| forces[*a].total_cmp(&forces[*b])).unwrap();
            let near = |v: &usize| vertices[*v].distance(vertices[hardest]) < 0.012;
            if forces[hardest] > 0.3 {
                assert!(
                    (0..778).filter(near).any(|v| contact[at + v] == 1.0),
                    "frame {index}: {} N unseen",
                    forces[hardest]
                );
                strongest += 1;
            }
        }
    }
    assert!(touched > 50 && strongest > 3, "{touched} vertices, {strongest} strong touches");
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
    let unused: Vec<bool> = (0..256).map(unused).collect();
    check_relative(&store, take, "opentouch_169", |frame, side| {
        let share = |(count, unused): (f32, &bool)| if *unused { f32::NAN } else { (3072.0 - count) / 3072.0 };
        counts(frame, side).into_iter().zip(&unused).map(share).collect()
    });
    let about = &store.raw_attributes()["import"];
    assert_eq!((&about["force"], &about["force_kind"]), (&json!("unknown"), &json!(null)));
    assert_eq!(
        (&about["reading"]["kind"], &about["reading"]["taxel_map"]),
        (&json!("relative"), &json!("opentouch_169"))
    );
    assert_eq!(about["contact_rule"], "reading above 0.1 of the range of an uncalibrated glove");
    let glove = &about["sensors"][1];
    assert_eq!((&glove["unit"], &glove["falls_with_pressure"]), (&json!("ADC counts"), &json!(true)));
    assert_eq!(glove["unused_cells"].as_array().unwrap().len(), 87);
    assert_eq!(store.raw_attributes()["camera"]["T_device_camera"]["shape"], json!([4, 4]));
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
    check_relative(&store, take, "touchanything_21x21", parts);
    // Another share of the range is another store.
    let harder = imported("touchanything", &root, &folder.path().join("harder.zarr"), &["--contact-reading", "0.5"]);
    let count = |store: &ZarrReader| store.read_contact(0..FRAMES).unwrap().iter().filter(|c| **c == 1.0).count();
    assert!(count(&harder) < count(&store) && supervised(&harder) == supervised(&store));
    for (name, mirrored) in [("data/left_wrist_camera_rgb", true), ("data/right_wrist_camera_rgb", false)] {
        let got = store.read_u8(name, 0..FRAMES).unwrap();
        for (got, frame) in got.chunks_exact(48 * 64 * 3).zip(&take.frames) {
            let flipped = image::imageops::flip_horizontal(&frame.image);
            assert!(got == if mirrored { flipped.as_raw() } else { frame.image.as_raw() }.as_slice(), "{name}");
        }
    }
    assert_eq!(store.raw_attributes()["import"]["about"]["task"], "pour_water");
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
