//! Data sets of videos become stores: TACO, HOI4D, EPIC-KITCHENS, Ego4D, EgoPAT3D.

use std::path::Path;
use std::sync::LazyLock;

use crate::check::{check_hands, check_images, check_poses, check_stamps, f1, open, supervised};
use crate::common::egotac;
use crate::files::{ManoFiles, angles, npy_f64, obj, video, write};
use crate::pickle::Py;
use crate::run::{import, imported, rows, succeeded, with_mano};
use crate::take::{FRAMES, Take, cuboid, moved};
use egotac::dataset::zarr::CAMERA_POSE;
use egotac::hand::Side;
use glam::{DAffine3, DVec3};
use serde_json::json;

static TAKE: LazyLock<Take> = LazyLock::new(Take::simulated);

const SEQUENCE: &str = "(stir, spoon, bowl)/20231105_019";

/// Writes TACO: hands in the world as tensors, with the position of the wrist; meshes in centimetres.
pub fn write_taco(root: &Path, take: &Take) {
    write(&root.join("Object_Models/017_cm.obj"), obj(&take.box_mesh(), 100.0));
    write(&root.join("Object_Models/003_cm.obj"), obj(&cuboid(DVec3::splat(0.04)), 100.0));
    let at = |folder: &str, name: &str| root.join(folder).join(SEQUENCE).join(name);
    let elsewhere = DAffine3::from_translation(DVec3::new(0.0, 4.0, 0.0));
    let poses = |pose: &dyn Fn(usize) -> DAffine3| {
        npy_f64(&[FRAMES, 4, 4], &(0..FRAMES).flat_map(|index| rows(pose(index))).collect::<Vec<_>>())
    };
    write(&at("Object_Poses", "tool_017.npy"), poses(&|index| take.frames[index].object));
    write(&at("Object_Poses", "target_003.npy"), poses(&|_| elsewhere));
    let camera = "Egocentric_Camera_Parameters";
    write(&at(camera, "egocentric_frame_extrinsic.npy"), poses(&|index| take.frames[index].camera.inverse()));
    write(&at(camera, "egocentric_intrinsic.txt"), "1.1e+03 0.0 960.5\n0.0 1.2e+03 540.5\n0.0 0.0 1.0\n");
    for side in Side::BOTH {
        let frame = |index: usize| {
            let hand = take.frames[index].hand(side);
            let pose =
                [hand.params.global_orient.to_array().map(f64::from).to_vec(), angles(&hand.params.hand_pose)].concat();
            let pose = pose.into_iter().map(|angle| angle as f32).collect();
            Py::dict([
                ("hand_pose", Py::Tensor(vec![48], pose)),
                ("hand_trans", Py::Tensor(vec![3], hand.wrist.as_vec3().to_array().to_vec())),
            ])
        };
        // The file's order is not that of time: keys are to be sorted.
        let frames = (0..FRAMES).rev().map(|index| (Py::text(&format!("{:05}", index + 1)), frame(index)));
        write(&at("Hand_Poses", &format!("{}_hand.pkl", side.name())), Py::Dict(frames.collect()).pickle());
        let betas = take.frames[0].hand(side).params.betas.to_vec();
        let shape = Py::dict([("hand_shape", Py::Tensor(vec![10], betas))]);
        write(&at("Hand_Poses", &format!("{}_hand_shape.pkl", side.name())), shape.pickle());
    }
    let images: Vec<_> = take.frames.iter().map(|frame| &frame.image).collect();
    video(&at("Egocentric_RGB_Videos", "color.mp4"), &images);
}

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

/// Writes HOI4D: the right hand and the object in the camera's frame, one file per frame.
pub fn write_hoi4d(root: &Path, take: &Take) {
    let name = "ZY20210800001/H1/C2/N12/S55/s02/T1";
    write(&root.join("HOI4D_CAD_Model_for_release/rigid/Mug/012.obj"), obj(&take.box_mesh(), 1.0));
    write(
        &root.join("camera_params/ZY20210800001/intrin.npy"),
        npy_f64(&[3, 3], &[910.0, 0.0, 960.0, 0.0, 911.0, 540.0, 0.0, 0.0, 1.0]),
    );
    for (index, frame) in take.frames.iter().enumerate() {
        let camera_from_world = frame.camera.inverse();
        let object = camera_from_world * frame.object;
        let r = object.matrix3;
        // Entries (row, column) of Rx(a) Ry(b) Rz(c).
        let entry = |row: usize, column: usize| r.col(column)[row];
        let angles_xyz = [(-entry(1, 2)).atan2(entry(2, 2)), entry(0, 2).asin(), (-entry(0, 1)).atan2(entry(0, 0))];
        let vector = |v: [f64; 3]| json!({ "x": v[0], "y": v[1], "z": v[2] });
        let list = if index % 2 == 0 { "dataList" } else { "objects" };
        let pose = json!({ list: [{
            "label": "Mug", "center": vector(object.translation.to_array()), "rotation": vector(angles_xyz),
            "dimensions": { "length": 1, "width": 1, "height": 1 },
        }] });
        // Both forms of file names occur.
        let file = if index % 2 == 0 { format!("{index}.json") } else { format!("{index:05}.json") };
        write(&root.join("HOI4D_annotations").join(name).join("objpose").join(file), pose.to_string());
        let params = moved(frame.hand(Side::Right), camera_from_world);
        let theta = [params.global_orient.to_array().map(f64::from).to_vec(), angles(&params.hand_pose)].concat();
        let hand = Py::dict([
            ("poseCoeff", Py::Array(vec![48], theta)),
            ("beta", Py::Array(vec![10], params.betas.map(f64::from).to_vec())),
            ("trans", Py::Array(vec![3], params.transl.to_array().map(f64::from).to_vec())),
        ]);
        let folder = root.join("handpose/refinehandpose_right").join(name);
        // One frame is not annotated, as in many sequences.
        if index != 4 {
            write(&folder.join(format!("{index}.pickle")), hand.pickle());
        }
    }
    let images: Vec<_> = take.frames.iter().map(|frame| &frame.image).collect();
    video(&root.join("HOI4D_release").join(name).join("align_rgb/image.mp4"), &images);
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
