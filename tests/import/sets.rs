//! Data sets of image files become stores: H2O, FPHA, ARCTIC, OakInk2.

use std::sync::LazyLock;

use crate::check::{check_hands, check_images, check_poses, check_stamps, f1, open, supervised};
use crate::common::refused;
use crate::run::{force_validity, import, succeeded, with_mano};
use crate::writers::files::{ManoFiles, jpeg, write};
use crate::writers::sets::{OFFSET, sequence, write_arctic, write_fpha, write_h2o, write_oakink2};
use crate::writers::take::{FRAMES, Take};
use egotac::dataset::zarr::CAMERA_POSE;
use egotac::hand::{HandModel, Side};
use egotac::label::physics::BodyOptions;
use egotac::label::replay::{Replayed, replay};
use glam::{DAffine3, DVec3};
use safetensors::Dtype;
use safetensors::tensor::TensorView;

static TAKE: LazyLock<Take> = LazyLock::new(Take::simulated);

#[test]
fn h2o_has_the_simulators_contact_stamps_poses_and_images() {
    let (folder, take) = (tempfile::tempdir().unwrap(), &*TAKE);
    let (root, out) = (folder.path().join("h2o"), folder.path().join("h2o.zarr"));
    write_h2o(&root, take);
    let mano = ManoFiles::write(folder.path(), take, false);
    succeeded(&import("h2o", &root, &out, &with_mano(&mano)));
    let store = open(&out);
    let score = f1(&store, take, &Side::BOTH);
    assert!(score >= 0.99, "F1 {score}");
    check_images(&store, take);
    check_stamps(&store, (0..FRAMES).map(|index| index as f64 / 30.0));
    check_hands(&store, take, &mano.models, |_| DAffine3::IDENTITY, 2e-4);
    check_poses(&store, CAMERA_POSE, |index| take.frames[index].camera);
    check_poses(&store, "data/object_pose", |index| take.frames[index].object);
    assert_eq!(supervised(&store), [0, FRAMES * 1556]);
    assert_eq!(store.raw_attributes()["camera"]["fx"], 636.6593);
    assert_eq!(store.raw_attributes()["topology"], "mano");
    assert_eq!(force_validity(&out, &with_mano(&mano)), [0; 2 * FRAMES]);
}

#[test]
fn without_mano_files_the_built_in_hand_approximates_and_the_store_says_so() {
    let (folder, take) = (tempfile::tempdir().unwrap(), &*TAKE);
    let (root, out) = (folder.path().join("h2o"), folder.path().join("h2o.zarr"));
    write_h2o(&root, take);
    succeeded(&import("h2o", &root, &out, &[]));
    let store = open(&out);
    let hand = &store.raw_attributes()["import"]["hand"];
    assert!(hand["exact"] == false && hand["note"].as_str().unwrap().starts_with("approximation"), "{hand}");
    assert_eq!(store.raw_attributes()["topology"], "egotac-hand-1");
    assert_eq!(supervised(&store), [0, FRAMES * 1556]);
}

#[test]
fn damaged_lines_of_h2o_are_named_and_an_unseen_hand_is_unknown() {
    let (folder, take) = (tempfile::tempdir().unwrap(), &*TAKE);
    let (root, out) = (folder.path().join("h2o"), folder.path().join("h2o.zarr"));
    write_h2o(&root, take);
    let camera = sequence(&root);
    let edit = |name: &str, change: &dyn Fn(&str) -> String| {
        let path = camera.join(name);
        write(&path, change(&std::fs::read_to_string(&path).unwrap()));
    };
    edit("hand_pose_mano/000001.txt", &|text| text.replacen("1 ", "1 nan ", 1));
    edit("obj_pose_rt/000002.txt", &|text| text.rsplit_once(' ').unwrap().0.into());
    edit("hand_pose_mano/000003.txt", &|text| text.replacen('1', "0", 1)); // the left hand is not valid
    edit("cam_pose/000004.txt", &|text| text.replacen("0 0 0 1", "0 0 0 2", 1));
    std::fs::write(camera.join("rgb/000005.png"), b"no image").unwrap();
    std::fs::remove_file(camera.join("obj_pose_rt/000006.txt")).unwrap();
    let output = import("h2o", &root, &out, &[]);
    assert_eq!(output.status.code(), Some(3), "{}", String::from_utf8_lossy(&output.stderr));
    let text = String::from_utf8_lossy(&output.stdout);
    for expected in [
        "hand_pose_mano/000001.txt: number 1: expected a finite number, got \"nan\"",
        "obj_pose_rt/000002.txt: class and pose: expected 17 numbers, got 16",
        "cam_pose/000004.txt: camera pose: expected the last row 0 0 0 1",
        "image 5: ",
    ] {
        assert!(text.contains(expected), "{expected} is not in: {text}");
    }
    // Frame 6 has no object pose: unknown, and no damage.
    assert_eq!(supervised(&open(&out)), [0, (FRAMES - 5) * 1556 - 778]);
}

#[test]
fn fpha_fits_the_hand_to_its_joints() {
    // Joints tell nothing of a person's girth.
    let (folder, take) = (tempfile::tempdir().unwrap(), &Take::of_mean_shape());
    let (root, out) = (folder.path().join("fpha"), folder.path().join("fpha.zarr"));
    write_fpha(&root, take);
    succeeded(&import("fpha", &root, &out, &[]));
    let store = open(&out);
    let score = f1(&store, take, &[Side::Right]);
    // Joints do not show the twist of straight fingers; what finger joints allow decides about it.
    assert!(score >= 0.99, "F1 {score}");
    check_stamps(&store, (0..FRAMES).map(|index| index as f64 / 30.0));
    check_poses(&store, "data/object_pose", |index| take.frames[index].object);
    // The left hand is not annotated.
    assert_eq!(supervised(&store), [0, FRAMES * 778]);
    let camera = store.read_f32(CAMERA_POSE, 0..1).unwrap();
    let near = DVec3::new(-0.0257, -0.0013, -0.0039);
    assert!(
        DVec3::from_slice(&camera[..3].iter().map(|x| f64::from(*x)).collect::<Vec<_>>()).distance(near) < 3e-4,
        "{camera:?}"
    );
    write(&root.join("Video_files/Subject_2/wash_sponge/1/color/color_0000.jpeg"), jpeg(&take.frames[0].image));
    // An action without an annotated object has a hand, and no known contact.
    let several = folder.path().join("several");
    succeeded(&import("fpha", &root, &several, &[]));
    assert_eq!(supervised(&open(&several.join("Subject_2_wash_sponge_1.zarr"))), [0, 0]);
    // Without the left hand nothing explains how the box is held.
    assert_eq!(force_validity(&out, &[]), [1, 4].repeat(FRAMES));
}

#[test]
fn neither_training_nor_scoring_takes_a_store_without_a_label() {
    let (folder, take) = (tempfile::tempdir().unwrap(), &*TAKE);
    let (root, store) = (folder.path().join("fpha"), folder.path().join("unlabelled.zarr"));
    // An action without an annotated object.
    write(&root.join("Video_files/Subject_2/wash_sponge/1/color/color_0000.jpeg"), jpeg(&take.frames[0].image));
    succeeded(&import("fpha", &root, &store, &[]));
    let (at, config) = (folder.path().display(), folder.path().join("config.yaml"));
    let text = format!("name: test\ndata: [{at}/unlabelled.zarr]\nout: {at}/run\nmodel: toy\nseed: 5\nsteps: 2\n");
    write(&config, text);
    let error = refused(&["train", "--config", config.to_str().unwrap()], "expected a supervised force or contact");
    assert!(error.contains("unlabelled.zarr") && !folder.path().join("run/checkpoint.safetensors").exists(), "{error}");
    let values = vec![0u8; 4 * 1556];
    let view = || TensorView::new(Dtype::F32, vec![1, 1556], &values).unwrap();
    let fields = folder.path().join("fields.safetensors");
    write(&fields, safetensors::serialize([("force", view()), ("contact", view())], None).unwrap());
    let [fields, store] = [&fields, &store].map(|path| path.to_str().unwrap());
    refused(&["eval", "--pred", fields, "--target", store], "no supervised force or contact to score");
}

#[test]
fn arctic_turns_the_top_part_and_skips_images_without_annotation() {
    let (folder, take) = (tempfile::tempdir().unwrap(), &*TAKE);
    let (root, out) = (folder.path().join("arctic"), folder.path().join("arctic.zarr"));
    let mano = ManoFiles::write(folder.path(), take, false);
    write_arctic(&root, take, &mano);
    succeeded(&import("arctic", &root, &out, &with_mano(&mano)));
    let whole = open(&out);
    let before = OFFSET - 1;
    assert_eq!(whole.len(), FRAMES + OFFSET);
    check_stamps(&whole, (0..FRAMES + OFFSET).map(|index| index as f64 / 30.0));
    assert_eq!(supervised(&whole), [0, FRAMES * 1556]);
    let contact = whole.read_contact(before..before + FRAMES).unwrap();
    let (mut hits, mut wrong) = (0, 0);
    for (index, frame) in take.frames.iter().enumerate() {
        for side in Side::BOTH {
            for (got, want) in contact[1556 * index..][side.range()].iter().zip(frame.touched(take, side)) {
                hits += usize::from(*got == 1.0 && want);
                wrong += usize::from((*got == 1.0) != want);
            }
        }
    }
    let score = 2.0 * hits as f64 / (2 * hits + wrong) as f64;
    assert!(score >= 0.99, "F1 {score}");
    let values = whole.read_f32(CAMERA_POSE, before..before + 1).unwrap();
    let position = DVec3::new(values[0].into(), values[1].into(), values[2].into());
    assert!(position.distance(take.frames[0].camera.translation) < 1e-5);
    assert_eq!(whole.raw_attributes()["camera"]["distortion"][7], 0.1);
    // Images before and after the annotated ones know no poses; the two parts of the box are one articulated object.
    let validity = force_validity(&out, &with_mano(&mano));
    let annotated = 2 * before..2 * (before + FRAMES);
    // The engine knows the box as one object, too: its first part stands for both.
    let bodies = BodyOptions { gravity: Some(DVec3::NEG_Z), ..BodyOptions::default() };
    let models = [(&mano.left, Side::Left), (&mano.right, Side::Right)];
    let models = models.map(|(path, side)| HandModel::load(path, side).unwrap());
    let Replayed { frames, .. } = replay(&out, &models, &bodies).unwrap();
    let annotated_frames = before..before + FRAMES;
    assert_eq!(frames.iter().filter(|frame| annotated_frames.contains(&frame.frame)).count(), FRAMES);
    for frame in frames {
        let known = annotated_frames.contains(&frame.frame);
        assert!(frame.net[0].is_finite() == known && frame.net[1].is_nan(), "{frame:?}");
        let sums = frame.links.map(|links| links.iter().sum::<f64>());
        assert!(sums.iter().all(|sum| if known { *sum > 1.0 } else { sum.is_nan() }), "{frame:?}");
    }
    assert!(validity.iter().enumerate().all(|(at, code)| *code == u8::from(!annotated.contains(&at))), "{validity:?}");
}

#[test]
fn oakink2_has_the_simulators_contact_stamps_poses_and_images() {
    let (folder, take) = (tempfile::tempdir().unwrap(), &*TAKE);
    let (root, out) = (folder.path().join("oakink2"), folder.path().join("oakink2.zarr"));
    write_oakink2(&root, take);
    let mano = ManoFiles::write(folder.path(), take, false);
    succeeded(&import("oakink2", &root, &out, &with_mano(&mano)));
    let store = open(&out);
    let score = f1(&store, take, &Side::BOTH);
    assert!(score >= 0.99, "F1 {score}");
    check_images(&store, take);
    check_stamps(&store, (0..FRAMES).map(|index| (500 + 4 * index) as f64 / 120.0));
    check_hands(&store, take, &mano.models, |_| DAffine3::IDENTITY, 2e-4);
    check_poses(&store, CAMERA_POSE, |index| take.frames[index].camera);
    check_poses(&store, "data/object_pose", |index| take.frames[index].object);
    assert_eq!(store.raw_attributes()["camera"]["fy"], 601.0);
    assert_eq!(force_validity(&out, &with_mano(&mano)), [0; 2 * FRAMES]);
}

#[test]
fn a_pickle_that_would_run_code_is_refused_by_name() {
    let (folder, take) = (tempfile::tempdir().unwrap(), &*TAKE);
    let (root, out) = (folder.path().join("oakink2"), folder.path().join("out"));
    write_oakink2(&root, take);
    write(&root.join("anno_preview/evil.pkl"), b"\x80\x04cposix\nsystem\nX\x02\0\0\0id\x85R.");
    let output = import("oakink2", &root, &out, &[]);
    assert_eq!(output.status.code(), Some(3));
    let error = String::from_utf8_lossy(&output.stderr);
    assert!(error.contains("evil.pkl: the pickle names `posix.system`"), "{error}");
}
