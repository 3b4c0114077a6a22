//! HOT3D clips.

use super::files::{ManoFiles, angles, jpeg};
use super::take::Take;
use egotac::hand::Side;
use glam::{DAffine3, DQuat, DVec3};
use image::RgbImage;
use serde_json::{Value, json};

/// Stamp of a frame, ns: those of the device's clock, which starts at boot.
pub fn nanoseconds(index: usize) -> u64 {
    54_971_174_871_117 + 33_327_462 * index as u64
}

pub fn motion(pose: DAffine3) -> Value {
    let (q, p) = (DQuat::from_affine3(&pose), pose.translation);
    json!({ "quaternion_wxyz": [q.w, q.x, q.y, q.z], "translation_xyz": [p.x, p.y, p.z] })
}

/// Returns the members of a clip, by name.
pub fn clip(take: &Take, mano: &ManoFiles) -> Vec<(String, Vec<u8>)> {
    let mut members = Vec::new();
    let betas = &take.frames[0].hands[0].params.betas;
    for (index, frame) in take.frames.iter().enumerate() {
        let mut add = |name: &str, content: Vec<u8>| members.push((format!("{index:06}.{name}"), content));
        let hand = |side: Side| {
            let params = &frame.hand(side).params;
            let wrist = [params.global_orient.to_array(), params.transl.to_array()].concat();
            let thetas = mano.coefficients(side, &angles(&params.hand_pose));
            json!({ "mano_pose": { "thetas": thetas, "wrist_xform": wrist }, "boxes_amodal": {} })
        };
        let elsewhere = DAffine3::from_translation(DVec3::new(3.0, 0.0, 0.0));
        let object =
            |id: i64, pose: DAffine3| json!([{ "object_bop_id": id.to_string(), "T_world_from_object": motion(pose) }]);
        add("cameras.json", json!({ "214-1": {
            "calibration": { "projection_model_type": "CameraModelType.FISHEYE624", "projection_params": [611.1, 715.2] },
            "T_world_from_camera": motion(frame.camera),
        } }).to_string().into());
        add("hands.json", json!({ "left": hand(Side::Left), "right": hand(Side::Right) }).to_string().into());
        add("image_1201-1.jpg", jpeg(&RgbImage::new(8, 8)));
        add("image_214-1.jpg", jpeg(&frame.image));
        let times = json!({ "214-1": nanoseconds(index), "1201-1": nanoseconds(index) + 96_500 });
        add(
            "info.json",
            json!({ "sequence_id": "P0001_23fa0ee8", "device": "Aria", "image_timestamps_ns": times })
                .to_string()
                .into(),
        );
        add("objects.json", json!({ "7": object(7, frame.object), "12": object(12, elsewhere) }).to_string().into());
    }
    members.push(("__hand_shapes.json__".into(), json!({ "mano": betas, "umetrack": {} }).to_string().into()));
    members
}
