//! H2O, FPHA, ARCTIC, OakInk2: data sets of image files.

use std::path::Path;

use super::files::{ManoFiles, angles, jpeg, npy_f64, obj, ply, png, write};
use super::pickle::Py;
use super::take::{FRAMES, Take, cuboid, moved, rows};
use egotac::hand::Side;
use glam::{DAffine3, DMat4, DQuat, DVec3, Vec3};
use serde_json::json;

pub fn joined(numbers: &[f64]) -> String {
    numbers.iter().map(ToString::to_string).collect::<Vec<_>>().join(" ")
}

pub fn sequence(root: &Path) -> std::path::PathBuf {
    root.join("subject1_ego/h1/0/cam4")
}

/// Writes H2O: everything in the frame of the head camera, hands without a correction of the left `shapedirs`.
pub fn write_h2o(root: &Path, take: &Take) {
    let camera = sequence(root);
    write(&camera.join("cam_intrinsics.txt"), "636.6593 636.2520 635.2839 366.8740 1280 720");
    write(&root.join("object/spray/lotion_spray.obj"), obj(&take.box_mesh(), 1.0));
    for (index, frame) in take.frames.iter().enumerate() {
        let camera_from_world = frame.camera.inverse();
        let hand = |side: Side| {
            let params = moved(frame.hand(side), camera_from_world);
            let mut numbers = vec![1.0];
            numbers.extend(params.transl.to_array().map(f64::from));
            numbers.extend(params.global_orient.to_array().map(f64::from));
            numbers.extend(angles(&params.hand_pose));
            numbers.extend(params.betas.map(f64::from));
            numbers
        };
        let hands = [hand(Side::Left), hand(Side::Right)].concat();
        // Class 4 is the spray.
        let object = [&[4.0][..], &rows(camera_from_world * frame.object)].concat();
        let name = format!("{index:06}");
        write(&camera.join(format!("rgb/{name}.png")), png(&frame.image));
        write(&camera.join(format!("hand_pose_mano/{name}.txt")), joined(&hands));
        write(&camera.join(format!("obj_pose_rt/{name}.txt")), joined(&object));
        write(&camera.join(format!("cam_pose/{name}.txt")), joined(&rows(frame.camera)));
    }
}

/// Writes FPHA: joints of the right hand and one object in millimetres, in a world beside the colour camera.
pub fn write_fpha(root: &Path, take: &Take) {
    const PLACES: [usize; 21] = [0, 1, 5, 9, 13, 17, 2, 3, 4, 6, 7, 8, 10, 11, 12, 14, 15, 16, 18, 19, 20];
    let name = "Subject_1/open_liquid_soap/2";
    write(&root.join("Object_models/liquid_soap_model/liquid_soap_model.ply"), ply(&take.box_mesh()));
    let (mut skeleton, mut poses) = (String::new(), String::new());
    for (index, frame) in take.frames.iter().enumerate() {
        write(&root.join(format!("Video_files/{name}/color/color_{index:04}.jpeg")), jpeg(&frame.image));
        let joints = PLACES.map(|keypoint| frame.hand(Side::Right).keypoints[keypoint]);
        let numbers: Vec<f64> =
            joints.iter().flat_map(|joint| joint.to_array()).map(|x| 1000.0 * f64::from(x)).collect();
        skeleton += &format!("{index} {}\n", joined(&numbers));
        let mut pose = DMat4::from(frame.object);
        pose.w_axis = (pose.w_axis.truncate() * 1000.0).extend(1.0);
        poses += &format!("{index} {}\n", joined(&pose.to_cols_array()));
    }
    write(&root.join(format!("Hand_pose_annotation_v1/{name}/skeleton.txt")), skeleton);
    write(&root.join(format!("Object_6D_pose_annotation_v1/{name}/object_pose.txt")), poses);
}

/// Number of the image of the first annotation in ARCTIC.
pub const OFFSET: usize = 3;

/// Writes ARCTIC: the box is the top part, turned about the hinge; the bottom part lies elsewhere.
pub fn write_arctic(root: &Path, take: &Take, mano: &ManoFiles) {
    let name = "s01/box_grab_01";
    let templates = root.join("meta/object_vtemplates/box");
    write(&templates.join("top.obj"), obj(&take.box_mesh(), 1000.0));
    let (mut corners, triangles) = cuboid(DVec3::splat(0.05));
    corners.iter_mut().for_each(|corner| corner.x += 2.0);
    write(&templates.join("bottom.obj"), obj(&(corners, triangles), 1000.0));
    write(&root.join("meta/misc.json"), json!({ "s01": { "ioi_offset": OFFSET } }).to_string());
    let array = |width: usize, values: Vec<f64>| Py::Array(vec![FRAMES, width], values);
    let hand = |side: Side| {
        let of_frames = |numbers: &dyn Fn(&super::take::TakeHand) -> Vec<f64>| -> Vec<f64> {
            take.frames.iter().flat_map(|frame| numbers(frame.hand(side))).collect()
        };
        let vector = |v: Vec3| v.to_array().map(f64::from).to_vec();
        let pose = |hand: &super::take::TakeHand| {
            let pose = angles(&hand.params.hand_pose);
            pose.iter().zip(mano.mean(side)).map(|(angle, mean)| angle - mean).collect()
        };
        let betas = take.frames[0].hand(side).params.betas.map(f64::from).to_vec();
        Py::dict([
            ("rot", array(3, of_frames(&|hand| vector(hand.params.global_orient)))),
            ("pose", array(45, of_frames(&pose))),
            ("trans", array(3, of_frames(&|hand| vector(hand.params.transl)))),
            ("shape", Py::Array(vec![10], betas)),
            ("fitting_err", Py::Array(vec![FRAMES], vec![0.0; FRAMES])),
        ])
    };
    let sequence = root.join("raw_seqs").join(name);
    let beside = |ending: &str| sequence.with_file_name(format!("box_grab_01{ending}"));
    let hands = Py::dict([("right", hand(Side::Right)), ("left", hand(Side::Left))]);
    write(&beside(".mano.npy"), hands.npy());
    let (mut object, mut rotations, mut translations) = (Vec::new(), Vec::new(), Vec::new());
    for (index, frame) in take.frames.iter().enumerate() {
        let angle = 0.1 * index as f64;
        // The top part turns about -z of the object by the angle.
        let bottom = frame.object * DAffine3::from_quat(DQuat::from_rotation_z(angle));
        let turn = DQuat::from_affine3(&bottom).to_scaled_axis();
        object.push(angle);
        object.extend(turn.to_array());
        object.extend((bottom.translation * 1000.0).to_array());
        let camera_from_world = frame.camera.inverse();
        rotations.extend(camera_from_world.matrix3.transpose().to_cols_array());
        translations.extend(camera_from_world.translation.to_array());
    }
    write(&beside(".object.npy"), npy_f64(&[FRAMES, 7], &object));
    let camera = Py::dict([
        ("R_k_cam_np", Py::Array(vec![FRAMES, 3, 3], rotations)),
        ("T_k_cam_np", Py::Array(vec![FRAMES, 3, 1], translations)),
        ("intrinsics", Py::Array(vec![3, 3], vec![1440.0, 0.0, 1400.0, 0.0, 1441.0, 1000.0, 0.0, 0.0, 1.0])),
        ("dist8", Py::Array(vec![8], vec![0.1; 8])),
    ]);
    write(&beside(".egocam.dist.npy"), camera.npy());
    // Two images before the first annotation, one after the last.
    for number in 1..FRAMES + OFFSET + 1 {
        let frame = number.saturating_sub(OFFSET).min(FRAMES - 1);
        write(&root.join(format!("images/{name}/0/{number:05}.jpg")), jpeg(&take.frames[frame].image));
    }
}

/// Writes OakInk2: quaternions, wrist positions, PyTorch tensors and numpy arrays by frame number.
pub fn write_oakink2(root: &Path, take: &Take) {
    const SERIAL: &str = "914412060001";
    let name = "scene_01__A001++seq__2023-04-27-19-17-25";
    let frame_number = |index: usize| 500 + 4 * index as i64;
    let matrix = |pose: DAffine3| Py::Array(vec![4, 4], rows(pose).to_vec());
    let of_frames = |value: &dyn Fn(usize) -> Py| {
        Py::Dict((0..FRAMES).map(|index| (Py::Int(frame_number(index)), value(index))).collect())
    };
    let hands = |index: usize| {
        let mut entries = Vec::new();
        for (prefix, side) in [("rh", Side::Right), ("lh", Side::Left)] {
            let hand = take.frames[index].hand(side);
            let rotations = std::iter::once(hand.params.global_orient).chain(hand.params.hand_pose);
            let quaternions = rotations.flat_map(|rotation| {
                let q = DQuat::from_scaled_axis(rotation.as_dvec3());
                [q.w, q.x, q.y, q.z].map(|value| value as f32)
            });
            let field = |field: &str| Py::text(&format!("{prefix}__{field}"));
            entries.push((field("pose_coeffs"), Py::Tensor(vec![1, 16, 4], quaternions.collect())));
            entries.push((field("tsl"), Py::Tensor(vec![1, 3], hand.wrist.as_vec3().to_array().to_vec())));
            entries.push((field("betas"), Py::Tensor(vec![1, 10], hand.params.betas.to_vec())));
        }
        Py::Dict(entries)
    };
    let elsewhere = DAffine3::from_translation(DVec3::new(5.0, 0.0, 0.0));
    let annotation = Py::dict([
        ("cam_def", Py::dict([("900000000001", Py::text("allocentric_top")), (SERIAL, Py::text("egocentric"))])),
        ("cam_selection", Py::List(vec![Py::text("egocentric")])),
        ("frame_id_list", Py::List((0..FRAMES).map(|index| Py::Int(frame_number(index))).collect())),
        (
            "cam_intr",
            Py::dict([(
                "egocentric",
                of_frames(&|_| Py::Array(vec![3, 3], vec![600.0, 0.0, 424.0, 0.0, 601.0, 240.0, 0.0, 0.0, 1.0])),
            )]),
        ),
        ("cam_extr", Py::dict([("egocentric", of_frames(&|index| matrix(take.frames[index].camera.inverse())))])),
        ("obj_list", Py::List(vec![Py::text("O02@0015@00001"), Py::text("C10001")])),
        (
            "obj_transf",
            Py::dict([
                ("O02@0015@00001", of_frames(&|index| matrix(take.frames[index].object))),
                ("C10001", of_frames(&|_| matrix(elsewhere))),
            ]),
        ),
        ("raw_mano", of_frames(&hands)),
    ]);
    write(&root.join(format!("anno_preview/{name}.pkl")), annotation.pickle());
    write(&root.join("object_raw/align_ds/O02@0015@00001/scan.obj"), obj(&take.box_mesh(), 1.0));
    write(&root.join("object_raw/align_ds/C10001/model.ply"), ply(&cuboid(DVec3::splat(0.1))));
    for (index, frame) in take.frames.iter().enumerate() {
        write(&root.join(format!("data/{name}/{SERIAL}/{:06}.png", frame_number(index))), png(&frame.image));
    }
}
