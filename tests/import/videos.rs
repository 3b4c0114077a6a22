//! Data sets of videos become stores: TACO, HOI4D, EPIC-KITCHENS, Ego4D, EgoPAT3D.

use std::sync::LazyLock;

use crate::check::{check_hands, check_images, check_poses, check_stamps, f1, open, supervised};
use crate::common::egotac;
use crate::run::{force_validity, import, imported, succeeded, with_mano};
use crate::writers::files::{ManoFiles, video, write};
use crate::writers::take::{FRAMES, Take};
use crate::writers::videos::{SEQUENCE, write_hoi4d, write_taco};
use egotac::dataset::zarr::CAMERA_POSE;
use egotac::hand::Side;
use glam::DAffine3;
use serde_json::json;

static TAKE: LazyLock<Take> = LazyLock::new(Take::simulated);

#[test]
fn taco_has_the_simulators_contact_stamps_poses_and_images() {
    let (folder, take) = (tempfile::tempdir().unwrap(), &*TAKE);
    let (root, out) = (folder.path().join("taco"), folder.path().join("taco.zarr"));
    write_taco(&root, take);
    let mano = ManoFiles::write(folder.path(), take, false);
    succeeded(&import("taco", &root, &out, &with_mano(&mano)));
    let store = open(&out);
    let score = f1(&store, take, &Side::BOTH);
    assert!(score >= 0.99, "F1 {score}");
    check_images(&store, take);
    check_stamps(&store, (0..FRAMES).map(|index| index as f64 / 30.0));
    check_hands(&store, take, &mano.models, |_| DAffine3::IDENTITY, 2e-4);
    check_poses(&store, CAMERA_POSE, |index| take.frames[index].camera);
    assert_eq!(supervised(&store), [0, FRAMES * 1556]);
    assert_eq!(store.raw_attributes()["import"]["objects"], json!(["target_003", "tool_017"]));
    assert_eq!(force_validity(&out, &with_mano(&mano)), [0; 2 * FRAMES]);
}

#[test]
fn taco_leaves_out_a_video_that_lost_frames_and_names_damaged_tensors() {
    let (folder, take) = (tempfile::tempdir().unwrap(), &*TAKE);
    let (root, out) = (folder.path().join("taco"), folder.path().join("out"));
    write_taco(&root, take);
    let mano = ManoFiles::write(folder.path(), take, false);
    for part in ["Object_Poses", "Hand_Poses", "Egocentric_RGB_Videos"] {
        let other = root.join(part).join("(stir, spoon, bowl)/20231105_020");
        std::fs::create_dir_all(&other).unwrap();
        for entry in std::fs::read_dir(root.join(part).join(SEQUENCE)).unwrap() {
            let path = entry.unwrap().path();
            std::fs::copy(&path, other.join(path.file_name().unwrap())).unwrap();
        }
    }
    let images: Vec<_> = take.frames.iter().skip(1).map(|frame| &frame.image).collect();
    video(&root.join("Egocentric_RGB_Videos/(stir, spoon, bowl)/20231105_020/color.mp4"), &images);
    let hands = root.join("Hand_Poses").join(SEQUENCE).join("left_hand.pkl");
    let mut bytes = std::fs::read(&hands).unwrap();
    let at = bytes.windows(12).position(|window| window == b"FloatStorage").unwrap();
    bytes[at] = b'f';
    write(&hands, bytes);
    let output = import("taco", &root, &out, &with_mano(&mano));
    assert_eq!(output.status.code(), Some(3));
    let (text, error) = (String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr));
    assert!(error.contains("color.mp4: expected 9 frames, one per annotation, got 8"), "{error}");
    assert!(text.contains("left_hand.pkl: 00009.hand_pose: "), "{text}");
    assert_eq!(supervised(&open(&out.join("stir_spoon_bowl_20231105_019.zarr"))), [0, 0]);
}

#[test]
fn hoi4d_has_the_simulators_contact_in_the_cameras_frame() {
    let (folder, take) = (tempfile::tempdir().unwrap(), &*TAKE);
    let (root, out) = (folder.path().join("hoi4d"), folder.path().join("hoi4d.zarr"));
    write_hoi4d(&root, take);
    let mano = ManoFiles::write(folder.path(), take, false);
    succeeded(&import("hoi4d", &root, &out, &with_mano(&mano)));
    let store = open(&out);
    check_images(&store, take);
    check_stamps(&store, (0..FRAMES).map(|index| index as f64 / 30.0));
    check_poses(&store, "data/object_pose", |index| take.frames[index].camera.inverse() * take.frames[index].object);
    assert_eq!(supervised(&store), [0, (FRAMES - 1) * 778]);
    let contact = store.read_contact(0..FRAMES).unwrap();
    let (mut hits, mut wrong) = (0, 0);
    for (index, frame) in take.frames.iter().enumerate().filter(|(index, _)| *index != 4) {
        for (got, want) in contact[1556 * index..][Side::Right.range()].iter().zip(frame.touched(take, Side::Right)) {
            hits += usize::from(*got == 1.0 && want);
            wrong += usize::from((*got == 1.0) != want);
        }
    }
    let score = 2.0 * f64::from(hits as u32) / f64::from((2 * hits + wrong) as u32);
    assert!(score >= 0.99, "F1 {score}");
    // Without the left hand nothing explains how the box is held; in frame 4 no pose is known.
    let validity = force_validity(&out, &with_mano(&mano));
    assert!(
        validity.chunks(2).enumerate().all(|(frame, of)| *of == [1, if frame == 4 { 1 } else { 4 }]),
        "{validity:?}"
    );
}

#[test]
fn videos_to_be_labelled_keep_their_actions() {
    let (folder, take) = (tempfile::tempdir().unwrap(), &*TAKE);
    let images: Vec<_> = take.frames.iter().map(|frame| &frame.image).collect();
    let epic = folder.path().join("epic");
    video(&epic.join("P01/videos/P01_01.MP4"), &images);
    write(
        &epic.join("epic-kitchens-100-annotations/EPIC_100_train.csv"),
        "narration_id,video_id,start_timestamp,stop_timestamp,narration,all_nouns\n\
        P01_01_0,P01_01,00:00:00.10,00:00:01.25,\"open door, slowly\",\"['door', 'hand']\"\n\
        P02_01_0,P02_01,00:00:05.00,00:00:06.00,wash cup,['cup']\n",
    );
    let ego4d = folder.path().join("ego4d");
    video(&ego4d.join("full_scale/0a1b.mp4"), &images);
    let pass =
        json!({ "narrations": [{ "timestamp_sec": 0.2, "timestamp_frame": 6, "narration_text": "#C C opens" }] });
    let narrations = json!({ "videos": { "0a1b": { "narration_pass_1": pass } } });
    write(&ego4d.join("annotations/narration.json"), narrations.to_string());
    let egopat3d = folder.path().join("egopat3d");
    video(&egopat3d.join("3/bin_1/rgb_video.mp4"), &images);
    write(&egopat3d.join("3/bin_1/hand_frames/clip_ranges.txt"), "0 3\n5 8\n");
    let actions = [
        ("epic", &epic, json!([{ "secs": [0.1, 1.25], "text": "open door, slowly" }])),
        ("ego4d", &ego4d, json!([{ "secs": [0.2, 0.2], "text": "#C C opens" }])),
        ("egopat3d", &egopat3d, serde_json::Value::Null),
    ];
    for (kind, root, actions) in actions {
        let out = folder.path().join(format!("{kind}.zarr"));
        let store = imported(kind, root, &out, &[]);
        check_images(&store, take);
        check_stamps(&store, (0..FRAMES).map(|index| index as f64 / 30.0));
        assert_eq!(supervised(&store), [0, 0]);
        assert_eq!(store.raw_attributes()["import"]["about"]["actions"], actions, "{kind}");
    }
    let store = open(&folder.path().join("egopat3d.zarr"));
    assert_eq!(store.raw_attributes()["import"]["about"]["clips_frames"], json!([[0.0, 3.0], [5.0, 8.0]]));
    // An imported store can be labelled.
    let [out, labelled] = ["epic.zarr", "labelled.zarr"].map(|name| folder.path().join(name));
    let output = egotac(&["label", out.to_str().unwrap(), "--out", labelled.to_str().unwrap()]);
    succeeded(&output);
    assert_eq!(open(&labelled).len(), FRAMES);
    write(&egopat3d.join("3/bin_2/hand_frames/clip_ranges.txt"), "0 3 5\n");
    video(&egopat3d.join("3/bin_2/rgb_video.mp4"), &images);
    write(&egopat3d.join("3/bin_3/rgb_video.mp4"), "no video");
    let output = import("egopat3d", &egopat3d, &folder.path().join("several"), &[]);
    assert_eq!(output.status.code(), Some(3));
    let error = String::from_utf8_lossy(&output.stderr);
    assert!(error.contains("clip_ranges.txt: expected pairs of frame numbers, got 3 numbers"), "{error}");
    assert!(error.contains("bin_3/rgb_video.mp4: "), "{error}");
}
