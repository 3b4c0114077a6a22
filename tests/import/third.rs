//! Data sets of fixed cameras, or of none, become stores: DexYCB, GRAB, ContactPose.

use std::sync::LazyLock;

use egotac::dataset::zarr::CAMERA_POSE;
use egotac::hand::Side;
use serde_json::json;

use crate::check::{check_hands, check_poses, check_stamps, f1, open, supervised};
use crate::common::refused;
use crate::run::{import, imported, with_mano};
use crate::writers::files::{ManoFiles, archive, jpeg, npy, write};
use crate::writers::take::{FRAMES, Take};
use crate::writers::third::{SEQUENCE, SERIAL, camera, f32s, write_contactpose, write_dexycb, write_grab};

static TAKE: LazyLock<Take> = LazyLock::new(Take::simulated);

#[test]
fn dexycb_has_the_simulators_contact_from_a_fixed_camera() {
    let (folder, take) = (tempfile::tempdir().unwrap(), &*TAKE);
    let (root, out) = (folder.path().join("dexycb"), folder.path().join("store.zarr"));
    let mano = ManoFiles::write(folder.path(), take, false);
    write_dexycb(&root, take, &mano);
    let store = imported("dexycb", &root, &out, &with_mano(&mano));
    check_stamps(&store, (0..FRAMES).map(|index| index as f64 / 30.0));
    check_poses(&store, CAMERA_POSE, |_| camera());
    // Without the pose of an object, vertices far from the others may touch it.
    assert_eq!(supervised(&store), [0, (FRAMES - 2) * 778]);
    let contact = store.read_contact(0..FRAMES).unwrap();
    let (mut hits, mut wrong) = (0, 0);
    for (index, frame) in take.frames.iter().enumerate().filter(|(index, _)| ![3, 4].contains(index)) {
        for (got, want) in contact[1556 * index..][Side::Right.range()].iter().zip(frame.touched(take, Side::Right)) {
            hits += usize::from(*got == 1.0 && want);
            wrong += usize::from((*got == 1.0) != want);
        }
    }
    let score = 2.0 * hits as f64 / (2 * hits + wrong) as f64;
    assert!(hits > 100 && score >= 0.99, "F1 {score}");
    let about = &store.raw_attributes()["import"];
    assert_eq!((&about["view"], &about["objects"]), (&json!("third person"), &json!(["003_cracker_box", "025_mug"])));
    assert_eq!(store.raw_attributes()["camera"]["cx"], 312.0);
}

#[test]
fn damaged_labels_of_dexycb_are_named_and_the_rest_is_imported() {
    let (folder, take) = (tempfile::tempdir().unwrap(), &*TAKE);
    let (root, out) = (folder.path().join("dexycb"), folder.path().join("out"));
    let mano = ManoFiles::write(folder.path(), take, false);
    write_dexycb(&root, take, &mano);
    let label = |index: usize| root.join(SEQUENCE).join(SERIAL).join(format!("labels_{index:06}.npz"));
    write(&label(0), b"no archive");
    write(&label(1), archive([("pose_y", npy(&[1, 3, 4], "<f4", &[0; 48]))]));
    let nan = [f64::NAN; 24];
    write(&label(2), archive([("pose_y", npy(&[2, 3, 4], "<f4", &f32s(nan)))]));
    // Another camera is not calibrated.
    write(&root.join(SEQUENCE).join("1/color_000000.jpg"), jpeg(&take.frames[0].image));
    let output = import("dexycb", &root, &out, &with_mano(&mano));
    assert_eq!(output.status.code(), Some(3));
    let text = String::from_utf8_lossy(&[output.stdout, output.stderr].concat()).into_owned();
    for expected in [
        "labels_000000.npz: no .npz archive",
        "labels_000001.npz: pose_y: expected shape [2, 3, 4], got [1, 3, 4]",
        "labels_000002.npz: pose_y: expected finite numbers",
        "extrinsics.yml: extrinsics: expected the camera 1, got none",
    ] {
        assert!(text.contains(expected), "{expected} is not in: {text}");
    }
    let store = open(&out.join(format!("{}_{SERIAL}.zarr", SEQUENCE.replace('/', "_"))));
    assert_eq!(supervised(&store), [0, (FRAMES - 5) * 778]);
}

#[test]
fn grab_has_the_simulators_contact_and_no_images_to_learn_from() {
    let (folder, take) = (tempfile::tempdir().unwrap(), &*TAKE);
    let (root, out) = (folder.path().join("grab_root"), folder.path().join("store.zarr"));
    let mano = ManoFiles::write(folder.path(), take, false);
    write_grab(&root, take, &mano);
    let store = imported("grab", &root, &out, &with_mano(&mano));
    let score = f1(&store, take, &Side::BOTH);
    assert!(score >= 0.99, "F1 {score}");
    check_stamps(&store, (0..FRAMES).map(|index| index as f64 / 120.0));
    check_poses(&store, "data/object_pose", |index| take.frames[index].object);
    assert_eq!(supervised(&store), [0, FRAMES * 1556]);
    let about = &store.raw_attributes()["import"];
    assert_eq!((&about["view"], &about["scanned_hands"]), (&json!("none"), &json!(true)));
    let (at, config) = (folder.path().display(), folder.path().join("config.yaml"));
    write(&config, format!("name: test\ndata: [{at}/store.zarr]\nout: {at}/run\nmodel: toy\nseed: 5\nsteps: 2\n"));
    refused(&["train", "--config", config.to_str().unwrap()], "expected images to learn from");
    // The shape of a scan that is cut off is named.
    write(&root.join("tools/subject_meshes/male/s1_rhand.ply"), "ply\nformat ascii 1.0\nelement vertex 9\n");
    let output = import("grab", &root, &folder.path().join("again"), &with_mano(&mano));
    assert_eq!(output.status.code(), Some(1));
    let error = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(error.contains("s1_rhand.ply: "), "{error}");
}

#[test]
fn contactpose_places_fitted_hands_in_the_objects_frame() {
    let (folder, take) = (tempfile::tempdir().unwrap(), &*TAKE);
    let (root, out) = (folder.path().join("contactpose"), folder.path().join("store.zarr"));
    let mano = ManoFiles::write(folder.path(), take, false);
    write_contactpose(&root, take, &mano);
    let store = imported("contactpose", &root, &out, &with_mano(&mano));
    check_poses(&store, CAMERA_POSE, |_| camera());
    check_poses(&store, "data/object_pose", |index| take.frames[index].object);
    assert_eq!(supervised(&store), [0, FRAMES * 1556]);
    assert_eq!(store.raw_attributes()["import"]["view"], "none");
    let contact = store.read_contact(0..FRAMES).unwrap();
    let (mut hits, mut wrong) = (0, 0);
    for side in Side::BOTH {
        let want = take.frames[0].touched(take, side);
        for index in 0..FRAMES {
            for (got, want) in contact[1556 * index..][side.range()].iter().zip(&want) {
                hits += usize::from(*got == 1.0 && *want);
                wrong += usize::from((*got == 1.0) != *want);
            }
        }
    }
    let score = 2.0 * hits as f64 / (2 * hits + wrong) as f64;
    assert!(hits > 100 && score >= 0.99, "F1 {score}");
    // The grasp is that of frame 0, carried along with the object.
    let carried = |index: usize| take.frames[index].object * take.frames[0].object.inverse();
    let still = Take { half: take.half, frames: vec![take.frames[0].clone(); FRAMES] };
    check_hands(&store, &still, &mano.models, carried, 2e-4);
    let fits = root.join("contactpose_data/full3_use/box/mano_fits_15.json");
    let text = std::fs::read_to_string(&fits).unwrap().replacen("\"rotation\":[", "\"rotation\":[5,", 1);
    write(&fits, text);
    let output = import("contactpose", &root, &folder.path().join("again.zarr"), &with_mano(&mano));
    assert_eq!(output.status.code(), Some(3));
    let text = String::from_utf8_lossy(&output.stdout).into_owned();
    assert!(text.contains("mano_fits_15.json: [0].mTc.rotation: expected 4 numbers"), "{text}");
}
