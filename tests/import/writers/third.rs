//! DexYCB, GRAB, ContactPose: data sets of fixed cameras, or of none.

use std::path::Path;

use egotac::hand::{HandModel, Side};
use glam::{DAffine3, DQuat, DVec3, Vec3};
use serde_json::{Value, json};

use super::files::{ManoFiles, angles, archive, jpeg, npy, obj, ply, write};
use super::pickle::Py;
use super::take::{FRAMES, Take, TakeHand, cuboid, moved, rows};

pub const SERIAL: &str = "836212060125";

pub const SEQUENCE: &str = "20200709-subject-01/20200709_141754";

/// `world_from_camera` of the fixed camera.
pub fn camera() -> DAffine3 {
    DAffine3::from_rotation_translation(DQuat::from_rotation_y(0.7), DVec3::new(0.4, -0.3, 0.9))
}

pub fn f32s(values: impl IntoIterator<Item = f64>) -> Vec<u8> {
    values.into_iter().flat_map(|value| (value as f32).to_le_bytes()).collect()
}

/// Writes DexYCB: the right hand and two objects in the camera's frame. Frame 3 has no annotated hand, and frame 4 no pose of
/// the object that is touched.
pub fn write_dexycb(root: &Path, take: &Take, mano: &ManoFiles) {
    let calibration = root.join("calibration");
    let numbers = |rows: &[f64]| json!(rows[..12]).to_string();
    let betas = take.frames[0].hand(Side::Right).params.betas;
    write(&calibration.join("mano_subject-01_right/mano.yml"), format!("betas: {}\n", json!(betas)));
    write(
        &calibration.join("extrinsics_20200702/extrinsics.yml"),
        format!(
            "extrinsics:\n  '{SERIAL}': {}\n  apriltag: {}\nmaster: '{SERIAL}'\n",
            numbers(&rows(camera())),
            numbers(&rows(DAffine3::IDENTITY))
        ),
    );
    write(
        &calibration.join(format!("intrinsics/{SERIAL}_640x480.yml")),
        "color:\n  fx: 614.5\n  fy: 614.25\n  ppx: 312.0\n  ppy: 241.0\ndepth:\n  fx: 1.0\n",
    );
    let sequence = root.join(SEQUENCE);
    write(
        &sequence.join("meta.yml"),
        format!(
            "serials:\n- '{SERIAL}'\nnum_frames: {FRAMES}\nextrinsics: '20200702'\nmano_calib:\n- subject-01_right\n\
            mano_sides:\n- right\nycb_ids:\n- 2\n- 14\nycb_grasp_ind: 0\n"
        ),
    );
    write(&root.join("models/003_cracker_box/textured_simple.obj"), obj(&take.box_mesh(), 1.0));
    write(&root.join("models/025_mug/textured_simple.obj"), obj(&cuboid(DVec3::splat(0.04)), 1.0));
    let camera_from_world = camera().inverse();
    for (index, frame) in take.frames.iter().enumerate() {
        write(&sequence.join(SERIAL).join(format!("color_{index:06}.jpg")), jpeg(&frame.image));
        let object = if index == 4 { [0.0; 16] } else { rows(camera_from_world * frame.object) };
        let elsewhere = rows(DAffine3::from_translation(DVec3::new(3.0, 0.0, 0.0)));
        let hand = moved(frame.hand(Side::Right), camera_from_world);
        let mut pose = hand.global_orient.to_array().map(f64::from).to_vec();
        pose.extend(mano.coefficients(Side::Right, &angles(&hand.hand_pose)));
        pose.resize(48, 0.0);
        pose.extend(hand.transl.to_array().map(f64::from));
        if index == 3 {
            pose.fill(0.0);
        }
        let label = archive([
            ("seg", npy(&[2, 2], "|u1", &[0; 4])),
            ("pose_y", npy(&[2, 3, 4], "<f4", &f32s([&object[..12], &elsewhere[..12]].concat()))),
            ("pose_m", npy(&[1, 51], "<f4", &f32s(pose))),
        ]);
        write(&sequence.join(SERIAL).join(format!("labels_{index:06}.npz")), label);
    }
}

/// Returns a PLY file of a hand at rest in a person's shape.
pub fn scan(model: &HandModel, hand: &TakeHand) -> String {
    let shaped = |(vertex, rest): (usize, &Vec3)| {
        let axis = |k: usize| -> f64 {
            let dirs = &model.shapedirs[(3 * vertex + k) * 10..][..10];
            dirs.iter().zip(&hand.params.betas).map(|(dir, beta)| f64::from(*dir) * f64::from(*beta)).sum()
        };
        rest.as_dvec3() + DVec3::new(axis(0), axis(1), axis(2))
    };
    let vertices = model.v_template.iter().enumerate().map(shaped).collect();
    ply(&(vertices, model.faces.iter().map(|face| face.map(|index| index as usize)).collect()))
}

/// Writes GRAB: scanned hands without shape coefficients, rotations of the object for vertices as rows.
pub fn write_grab(root: &Path, take: &Take, mano: &ManoFiles) {
    let of_frames = |width: usize, numbers: &dyn Fn(usize) -> Vec<f64>| {
        Py::Array(vec![FRAMES, width], (0..FRAMES).flat_map(numbers).collect())
    };
    let vector = |v: Vec3| v.to_array().map(f64::from).to_vec();
    let hand = |side: Side, name: &str| {
        let at = |index: usize| &take.frames[index].hand(side).params;
        let template = format!("tools/subject_meshes/male/s1_{name}.ply");
        write(&root.join(&template), scan(&mano.models[side as usize], take.frames[0].hand(side)));
        let params = Py::dict([
            ("global_orient", of_frames(3, &|index| vector(at(index).global_orient))),
            ("hand_pose", of_frames(2, &|_| vec![0.0; 2])),
            ("transl", of_frames(3, &|index| vector(at(index).transl))),
            ("fullpose", of_frames(45, &|index| angles(&at(index).hand_pose))),
        ]);
        Py::dict([("params", params), ("vtemp", Py::text(&template))]).npy()
    };
    let turn = |index: usize| (-DQuat::from_affine3(&take.frames[index].object).to_scaled_axis()).to_array().to_vec();
    let params = Py::dict([
        ("global_orient", of_frames(3, &turn)),
        ("transl", of_frames(3, &|index| take.frames[index].object.translation.to_array().to_vec())),
    ]);
    let object =
        Py::dict([("params", params), ("object_mesh", Py::text("tools/object_meshes/contact_meshes/box.ply"))]);
    write(&root.join("tools/object_meshes/contact_meshes/box.ply"), ply(&take.box_mesh()));
    let members =
        [("lhand", hand(Side::Left, "lhand")), ("rhand", hand(Side::Right, "rhand")), ("object", object.npy())];
    write(&root.join("grab/s1/box_lift_1.npz"), archive(members));
}

pub fn pose(motion: DAffine3) -> Value {
    let q = DQuat::from_affine3(&motion);
    json!({ "translation": motion.translation.to_array(), "rotation": [q.w, q.x, q.y, q.z] })
}

/// Writes ContactPose: the grasp of frame 0, in which the right hand's joints have a moving frame of their own.
pub fn write_contactpose(root: &Path, take: &Take, mano: &ManoFiles) {
    let grasp = root.join("contactpose_data/full3_use/box");
    let frame = &take.frames[0];
    let object_from_world = frame.object.inverse();
    let joints = DAffine3::from_rotation_translation(DQuat::from_rotation_z(0.4), DVec3::new(0.1, 0.2, -0.1));
    let mut fits = Vec::new();
    for side in Side::BOTH {
        let hand = frame.hand(side);
        let object_from_hand = object_from_world * DAffine3::from_translation(hand.params.transl.as_dvec3());
        // The left hand's joints are given in the object's frame.
        let joints_from_hand = if side == Side::Left { object_from_hand } else { joints * object_from_hand };
        let mut numbers = hand.params.global_orient.to_array().map(f64::from).to_vec();
        numbers.extend(mano.coefficients(side, &angles(&hand.params.hand_pose)));
        fits.push(json!({
            "valid": true, "pose": numbers, "betas": hand.params.betas, "mTc": pose(joints_from_hand.inverse()),
        }));
    }
    write(&grasp.join("mano_fits_15.json"), json!(fits).to_string());
    let frames: Vec<Value> = (0..FRAMES)
        .map(|index| {
            json!({
                "object_pose_optimized": true, "oTw": pose(take.frames[index].object.inverse()),
                "hTo": [pose(DAffine3::IDENTITY), pose(joints)],
            })
        })
        .collect();
    let hand = |moving: bool| json!({ "valid": true, "moving": moving, "joints": [] });
    let annotation = json!({
        "object": "box", "frames": frames, "hands": [hand(false), hand(true)],
        "cameras": { "kinect2_middle": {
            "valid": true, "K": { "fx": 540.5, "fy": 540.0, "cx": 480.0, "cy": 270.0 }, "wTc": pose(camera()),
        } },
    });
    write(&grasp.join("annotations.json"), annotation.to_string());
    write(&grasp.join("box.ply"), ply(&take.box_mesh()));
}

/// Video, first frame and step of the frames of the clip of EPIC-Contact.
pub const EPIC_CLIP: (&str, usize, usize) = ("P01_103", 1201, 2);

/// Writes EPIC-Contact: hands and object in the camera's frame, with the object's mesh padded to a larger one. The left hand is not
/// valid in frame 2, and the object has no pose in frame 3. Frame 4 was not extracted.
pub fn write_epic_contact(root: &Path, take: &Take) {
    let (video, first, step) = EPIC_CLIP;
    let (corners, triangles) = take.box_mesh();
    let in_camera = |index: usize| take.frames[index].camera.inverse();
    let object = |index: usize| in_camera(index) * take.frames[index].object;
    let of_frames = |numbers: &dyn Fn(usize) -> Vec<f64>| f32s((0..FRAMES).flat_map(numbers));
    let points = |index: usize, points: &[Vec3]| -> Vec<f64> {
        points.iter().flat_map(|point| in_camera(index).transform_point3(point.as_dvec3()).to_array()).collect()
    };
    let hand = |side: Side, letter: &str, word: &str| {
        let valid = |index: usize| f64::from(u8::from(side == Side::Right || index != 2));
        let vertices = |index: usize| points(index, &take.frames[index].hand(side).vertices);
        let joints = |index: usize| points(index, &take.frames[index].hand(side).keypoints);
        [
            (format!("{word}_valid"), npy(&[FRAMES], "<f4", &of_frames(&|index| vec![valid(index)]))),
            (format!("mano.v3d.cam.{letter}"), npy(&[FRAMES, 778, 3], "<f4", &of_frames(&vertices))),
            (format!("mano.j3d.cam.{letter}"), npy(&[FRAMES, 21, 3], "<f4", &of_frames(&joints))),
        ]
    };
    let padded = corners.len() + 2;
    let placed = |index: usize| -> Vec<f64> {
        let mut values: Vec<f64> =
            corners.iter().flat_map(|corner| object(index).transform_point3(*corner).to_array()).collect();
        values.resize(3 * padded, 0.0);
        values
    };
    let rotation = |index: usize| match index {
        3 => vec![f64::NAN; 9],
        _ => object(index).matrix3.transpose().to_cols_array().to_vec(),
    };
    let place = |index: usize| object(index).translation.to_array().to_vec();
    let i64s = |values: Vec<i64>| -> Vec<u8> { values.into_iter().flat_map(i64::to_le_bytes).collect() };
    let faces: Vec<i64> = triangles.iter().flatten().map(|index| *index as i64).collect();
    let text: Vec<u8> = video.chars().flat_map(|char| (char as u32).to_le_bytes()).collect();
    let mut members = vec![
        (
            "_frame_num".to_string(),
            npy(&[FRAMES], "<i8", &i64s((0..FRAMES).map(|k| (first + step * k) as i64).collect())),
        ),
        ("video_id".to_string(), npy(&[1], &format!("<U{}", video.len()), &text)),
        ("object.v.cam".to_string(), npy(&[FRAMES, padded, 3], "<f4", &of_frames(&placed))),
        ("object.v_len".to_string(), npy(&[FRAMES], "<i8", &i64s(vec![corners.len() as i64; FRAMES]))),
        ("object.f".to_string(), npy(&[FRAMES, triangles.len(), 3], "<i8", &i64s(faces.repeat(FRAMES)))),
        ("object.rot".to_string(), npy(&[FRAMES, 3, 3], "<f4", &of_frames(&rotation))),
        ("object.cam_t".to_string(), npy(&[FRAMES, 3], "<f4", &of_frames(&place))),
    ];
    members.extend(hand(Side::Left, "l", "left"));
    members.extend(hand(Side::Right, "r", "right"));
    let members = members.iter().map(|(name, content)| (name.as_str(), content.clone()));
    write(&root.join(format!("clips/{video}_12_bottle.npz")), archive(members));
    for (index, frame) in take.frames.iter().enumerate().filter(|(index, _)| *index != 4) {
        let number = first + step * index;
        write(&root.join(format!("P01/rgb_frames/{video}/frame_{number:010}.jpg")), jpeg(&frame.image));
    }
}
