//! Data sets of fixed cameras, or of none, and of meshes in the camera's frame become stores: DexYCB, GRAB, ContactPose, EPIC-Contact.

use std::sync::LazyLock;

use egotac::dataset::zarr::CAMERA_POSE;
use egotac::hand::Side;
use glam::DAffine3;
use serde_json::json;

use crate::check::{check_hands, check_poses, check_stamps, f1, open, supervised};
use crate::common::{egotac, refused};
use crate::run::{force_validity, import, imported, with_mano};
use crate::writers::files::{ManoFiles, archive, jpeg, npy, write};
use crate::writers::take::{FRAMES, Take};
use crate::writers::third::{
    EPIC_CLIP, SEQUENCE, SERIAL, camera, f32s, write_contactpose, write_dexycb, write_epic_contact, write_grab,
};

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
    // Without the left hand nothing explains how the box is held; in frame 3 the hand is not known and in frame 4 the box.
    let expected = |frame: usize| [1, [4, 4, 4, 1, 2].get(frame).copied().unwrap_or(4)];
    let validity = force_validity(&out, &with_mano(&mano));
    assert_eq!(validity, (0..FRAMES).flat_map(expected).collect::<Vec<_>>());
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
    assert_eq!(force_validity(&out, &with_mano(&mano)), [0; 2 * FRAMES]);
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
    assert_eq!(force_validity(&out, &with_mano(&mano)), [0; 2 * FRAMES]);
}

#[test]
fn epic_contact_has_the_simulators_contact_and_its_mesh_in_the_store() {
    let (folder, take) = (tempfile::tempdir().unwrap(), &*TAKE);
    let (root, out) = (folder.path().join("epic-contact"), folder.path().join("store.zarr"));
    let mano = ManoFiles::write(folder.path(), take, false);
    write_epic_contact(&root, take);
    let output = import("epic-contact", &root, &out, &with_mano(&mano));
    assert_eq!(output.status.code(), Some(3), "one frame was not extracted");
    let text = String::from_utf8_lossy(&output.stdout).into_owned();
    let (video, first, step) = EPIC_CLIP;
    assert!(text.contains(&format!("frame_{:010}.jpg", first + 4 * step)), "{text}");
    let store = open(&out);
    check_stamps(&store, (0..FRAMES).map(|index| (first + step * index) as f64 / 50.0));
    check_poses(&store, CAMERA_POSE, |_| DAffine3::IDENTITY);
    // Frame 2 has no left hand, frame 3 no object and frame 4 no image. Without the object only the vertices that touch something
    // else are known, and there is nothing else.
    assert_eq!(supervised(&store), [0, 1556 * (FRAMES - 3) + 778]);
    let contact = store.read_contact(0..FRAMES).unwrap();
    let (mut hits, mut wrong) = (0, 0);
    for (index, frame) in take.frames.iter().enumerate().filter(|(index, _)| ![2, 3, 4].contains(index)) {
        for side in Side::BOTH {
            for (got, want) in contact[1556 * index..][side.range()].iter().zip(frame.touched(take, side)) {
                hits += usize::from(*got == 1.0 && want);
                wrong += usize::from((*got == 1.0) != want);
            }
        }
    }
    let score = 2.0 * hits as f64 / (2 * hits + wrong) as f64;
    assert!(hits > 100 && score >= 0.99, "F1 {score}");
    let about = &store.raw_attributes()["import"];
    assert_eq!((&about["view"], &about["about"]["video"]), (&json!("ego"), &json!(video)));
    // The mesh is a part of the store: forces from motion need neither the data set nor the place of the store.
    let moved = folder.path().join("moved.zarr");
    std::fs::rename(&out, &moved).unwrap();
    std::fs::remove_dir_all(&root).unwrap();
    let forces = folder.path().join("forces.zarr");
    let [from, to] = [&moved, &forces].map(|path| path.to_str().unwrap());
    let args = ["label", from, "--physics", "--gravity", "0,9.81,0", "--mass", "object=0.3", "--out", to];
    let output = egotac(&[&args[..], &with_mano(&mano)].concat());
    let text = String::from_utf8_lossy(&[output.stdout, output.stderr].concat()).into_owned();
    assert_eq!(output.status.code(), Some(0), "{text}");
}

#[test]
fn damaged_members_of_epic_contact_are_named() {
    let (folder, take) = (tempfile::tempdir().unwrap(), &*TAKE);
    let (root, out) = (folder.path().join("epic-contact"), folder.path().join("store.zarr"));
    write_epic_contact(&root, take);
    let numbers = |values: &[i64]| {
        let bytes: Vec<u8> = values.iter().flat_map(|value| value.to_le_bytes()).collect();
        npy(&[values.len()], "<i8", &bytes)
    };
    write(&root.join("clips/backwards.npz"), archive([("_frame_num", numbers(&[4, 3]))]));
    write(&root.join("clips/other.npz"), archive([("points", numbers(&[1]))]));
    write(&root.join("clips/cut.npz"), b"PK");
    let output = import("epic-contact", &root, &out, &[]);
    assert_eq!(output.status.code(), Some(3));
    let text = String::from_utf8_lossy(&[output.stdout, output.stderr].concat()).into_owned();
    for expected in [
        "backwards.npz: _frame_num: expected numbers of frames that increase, at least one",
        "other.npz: _frame_num: expected this member, got none",
        "cut.npz: no .npz archive",
    ] {
        assert!(text.contains(expected), "{expected} is not in: {text}");
    }
}
