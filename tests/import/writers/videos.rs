//! TACO, HOI4D: data sets of videos.

use std::path::Path;

use super::files::{angles, npy_f64, obj, video, write};
use super::pickle::Py;
use super::take::{FRAMES, Take, cuboid, moved, rows};
use egotac::hand::Side;
use glam::{DAffine3, DVec3};
use serde_json::json;

pub const SEQUENCE: &str = "(stir, spoon, bowl)/20231105_019";

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
