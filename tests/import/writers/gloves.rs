//! OpenTouch, TouchAnything, EgoDex: data sets in HDF5.

use std::path::Path;

use egotac::hand::Side;
use egotac::sensor::{self, simulated::loads};
use glam::{DAffine3, DMat4, Vec3};

use super::files::{jpeg, video, write};
use super::h5::Node;
use super::take::{FRAMES, Take, TakeFrame};

/// Returns the newtons on each taxel of a glove with this map.
pub fn newtons(frame: &TakeFrame, side: Side, map: &str) -> Vec<f32> {
    loads(&sensor::open(map).unwrap().hands[side as usize], &frame.hand(side).forces)
}

/// Returns the 63 numbers of a hand's keypoints in another frame, m.
pub fn keypoints(frame: &TakeFrame, side: Side, to_world: DAffine3) -> Vec<f32> {
    let moved = |point: &Vec3| to_world.transform_point3(point.as_dvec3()).as_vec3().to_array();
    frame.hand(side).keypoints.iter().flat_map(moved).collect()
}

/// Counts of the OpenTouch glove: fewer counts for more force.
pub fn counts(frame: &TakeFrame, side: Side) -> Vec<f32> {
    let newtons = newtons(frame, side, "opentouch_169");
    newtons.into_iter().map(|newtons| (3072.0 - 2000.0 * newtons).max(0.0).round()).collect()
}

/// Writes a scene of OpenTouch with one clip: the last frame has no landmarks of the left hand.
pub fn write_opentouch(path: &Path, take: &Take) {
    let n = FRAMES as u64;
    let landmarks = |side: Side| {
        let of_frame = move |(index, frame): (usize, &TakeFrame)| match (side, index + 1 == FRAMES) {
            (Side::Left, true) => vec![f32::NAN; 63],
            _ => keypoints(frame, side, DAffine3::IDENTITY),
        };
        Node::f32s(&[n, 21, 3], take.frames.iter().enumerate().flat_map(of_frame))
    };
    let pressure =
        |side: Side| Node::f32s(&[n, 16, 16], take.frames.iter().flat_map(move |frame| counts(frame, side))).chunked(4);
    let clip = Node::group([
        ("rgb_images_jpeg", Node::Lists(take.frames.iter().map(|frame| jpeg(&frame.image)).collect())),
        ("timestamps", Node::i64s((0..FRAMES as i64).map(|index| 1_700_000_000_123_456_789 + 33_333_333 * index))),
        ("left_pressure", pressure(Side::Left)),
        ("right_pressure", pressure(Side::Right)),
        ("left_hand_landmarks", landmarks(Side::Left)),
        ("right_hand_landmarks", landmarks(Side::Right)),
    ]);
    let camera = Node::group([("T_device_camera", Node::f64s(&[4, 4], DMat4::IDENTITY.to_cols_array()))]);
    let file =
        Node::group([("data", Node::group([("demo_00", clip)])), ("calibration", Node::group([("rgb", camera)]))]);
    write(path, file.file());
}

/// Readings of the TouchAnything glove: parts of 2 N, and no taxel in the first corner.
pub fn parts(frame: &TakeFrame, side: Side) -> Vec<f32> {
    let newtons = newtons(frame, side, "touchanything_21x21");
    let mut parts: Vec<f32> = newtons.into_iter().map(|newtons| (newtons / 2.0).min(1.0)).collect();
    parts[0] = f32::NAN;
    parts
}

/// Writes a trajectory of TouchAnything: hands in the camera's frame, images in chunks of four frames.
pub fn write_touchanything(path: &Path, take: &Take) {
    let n = FRAMES as u64;
    let (width, height) = take.frames[0].image.dimensions();
    let images = |mirrored: bool| {
        let pixels = take.frames.iter().flat_map(|frame| match mirrored {
            true => image::imageops::flip_horizontal(&frame.image).into_raw(),
            false => frame.image.as_raw().clone(),
        });
        Node::u8s(&[n, u64::from(height), u64::from(width), 3], pixels.collect()).chunked(4)
    };
    let joints = |side: Side| {
        let of_frame = move |frame: &TakeFrame| keypoints(frame, side, frame.camera.inverse());
        Node::f32s(&[n, 21, 3], take.frames.iter().flat_map(of_frame))
    };
    // The estimator does not find the right hand in frame 3.
    let valid =
        |side: Side| Node::u8s(&[n], (0..FRAMES).map(|index| u8::from(side == Side::Left || index != 3)).collect());
    let grid =
        |side: Side| Node::f32s(&[n, 21, 21], take.frames.iter().flat_map(move |frame| parts(frame, side))).chunked(5);
    let file = Node::group([
        ("metadata", Node::Group(Vec::new(), vec![("task_name", "pour_water".into())])),
        ("timestamps", Node::i64s((0..FRAMES as i64).map(|index| 33_333 * index))),
        (
            "images",
            Node::group([("chest_color", images(false)), ("left_color", images(true)), ("right_color", images(false))]),
        ),
        (
            "hands",
            Node::group([
                ("wilor_left_joint_xyz", joints(Side::Left)),
                ("wilor_right_joint_xyz", joints(Side::Right)),
                ("wilor_left_valid", valid(Side::Left)),
                ("wilor_right_valid", valid(Side::Right)),
            ]),
        ),
        (
            "pressure",
            Node::group([("left_pressure_grid", grid(Side::Left)), ("right_pressure_grid", grid(Side::Right))]),
        ),
    ]);
    write(path, file.file());
}

/// Names of the joints of a finger in EgoDex, from the palm to the tip.
pub const FINGER: [&str; 4] = ["Knuckle", "IntermediateBase", "IntermediateTip", "Tip"];

pub const FINGERS: [&str; 5] = ["Thumb", "IndexFinger", "MiddleFinger", "RingFinger", "LittleFinger"];

/// Writes an episode of EgoDex: joints in the world; the tracker does not see the left hand in frame 2.
pub fn write_egodex(root: &Path, take: &Take) {
    let n = FRAMES as u64;
    let motions = |motion: &dyn Fn(&TakeFrame) -> DAffine3| {
        let rows = take.frames.iter().flat_map(|frame| DMat4::from(motion(frame)).transpose().to_cols_array());
        Node::f32s(&[n, 4, 4], rows.map(|value| value as f32).collect::<Vec<_>>())
    };
    let mut transforms = vec![("camera".to_string(), motions(&|frame| frame.camera))];
    let mut confidences = Vec::new();
    for side in Side::BOTH {
        let mut joint = |name: String, keypoint: usize| {
            let at = move |frame: &TakeFrame| frame.hand(side).keypoints[keypoint].as_dvec3();
            transforms
                .push((format!("{}{name}", side.name()), motions(&|frame| DAffine3::from_translation(at(frame)))));
        };
        joint("Hand".into(), 0);
        for (finger, name) in FINGERS.iter().enumerate() {
            FINGER.iter().enumerate().for_each(|(k, part)| joint(format!("{name}{part}"), 1 + 4 * finger + k));
        }
        let seen = (0..FRAMES).map(|index| if (side, index) == (Side::Left, 2) { 0.1 } else { 0.9 });
        confidences.push((format!("{}Hand", side.name()), Node::f32s(&[n], seen)));
    }
    let intrinsic = [736.6, 0.0, 960.0, 0.0, 736.5, 540.0, 0.0, 0.0, 1.0];
    let attributes = vec![
        ("llm_description", "stack the cups".to_string()),
        ("llm_description2", "unstack the cups".to_string()),
        ("which_llm_description", "2".to_string()),
    ];
    let members = vec![
        ("transforms".to_string(), Node::Group(transforms, Vec::new())),
        ("confidences".to_string(), Node::Group(confidences, Vec::new())),
        ("camera".to_string(), Node::group([("intrinsic", Node::f32s(&[3, 3], intrinsic))])),
    ];
    write(&root.join("test/stack_cups/0.hdf5"), Node::Group(members, attributes).file());
    let images: Vec<_> = take.frames.iter().map(|frame| &frame.image).collect();
    video(&root.join("test/stack_cups/0.mp4"), &images);
}
