//! HOT3D clips.

use super::files::{ManoFiles, angles, jpeg};
use super::take::{Take, TakeFrame};
use egotac::hand::{HandParams, Side};
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

/// One frame of a clip.
pub struct ClipFrame<'a> {
    /// Stamp of the image, ns.
    pub stamp: u64,
    /// JPEG file of the image as the sensor sees it: the upright image turned counter-clockwise.
    pub image: Vec<u8>,
    /// Left and right hand in the world; `None` = not annotated.
    pub hands: [Option<&'a HandParams>; 2],
    /// Ids of the objects, and `world_from_object`.
    pub objects: Vec<(i64, DAffine3)>,
    /// `world_from_camera`, of the sensor.
    pub camera: DAffine3,
}

/// Returns the members of a clip of a take, by name.
pub fn clip(take: &Take, mano: &ManoFiles) -> Vec<(String, Vec<u8>)> {
    let elsewhere = DAffine3::from_translation(DVec3::new(3.0, 0.0, 0.0));
    fn of<'a>(index: usize, frame: &'a TakeFrame, elsewhere: DAffine3) -> ClipFrame<'a> {
        ClipFrame {
            stamp: nanoseconds(index),
            image: jpeg(&frame.image),
            hands: frame.hands.each_ref().map(|hand| Some(&hand.params)),
            objects: vec![(7, frame.object), (12, elsewhere)],
            camera: frame.camera,
        }
    }
    let frames: Vec<ClipFrame> =
        take.frames.iter().enumerate().map(|(index, frame)| of(index, frame, elsewhere)).collect();
    members(&frames, &take.frames[0].hands[0].params.betas, mano)
}

/// Returns the members of a clip, by name.
pub fn members(frames: &[ClipFrame], betas: &[f32], mano: &ManoFiles) -> Vec<(String, Vec<u8>)> {
    let mut members = Vec::new();
    for (index, frame) in frames.iter().enumerate() {
        let mut add = |name: &str, content: Vec<u8>| members.push((format!("{index:06}.{name}"), content));
        let hand = |side: Side| {
            let params = frame.hands[side as usize]?;
            let wrist = [params.global_orient.to_array(), params.transl.to_array()].concat();
            let thetas = mano.coefficients(side, &angles(&params.hand_pose));
            Some(json!({ "mano_pose": { "thetas": thetas, "wrist_xform": wrist }, "boxes_amodal": {} }))
        };
        let hands = Side::BOTH.into_iter().filter_map(|side| Some((side.name().to_string(), hand(side)?)));
        let hands: serde_json::Map<String, Value> = hands.collect();
        let object =
            |id: i64, pose: DAffine3| json!([{ "object_bop_id": id.to_string(), "T_world_from_object": motion(pose) }]);
        add("cameras.json", json!({ "214-1": {
            "calibration": { "projection_model_type": "CameraModelType.FISHEYE624", "projection_params": [611.1, 715.2] },
            "T_world_from_camera": motion(frame.camera),
        } }).to_string().into());
        add("hands.json", Value::Object(hands).to_string().into());
        add("image_1201-1.jpg", jpeg(&RgbImage::new(8, 8)));
        add("image_214-1.jpg", frame.image.clone());
        let times = json!({ "214-1": frame.stamp, "1201-1": frame.stamp + 96_500 });
        add(
            "info.json",
            json!({ "sequence_id": "P0001_23fa0ee8", "device": "Aria", "image_timestamps_ns": times })
                .to_string()
                .into(),
        );
        let objects: serde_json::Map<String, Value> =
            frame.objects.iter().map(|(id, pose)| (id.to_string(), object(*id, *pose))).collect();
        add("objects.json", Value::Object(objects).to_string().into());
    }
    members.push(("__hand_shapes.json__".into(), json!({ "mano": betas, "umetrack": {} }).to_string().into()));
    members
}
