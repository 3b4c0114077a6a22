//! MANO files load from all formats in use, and pose as the `smplx` package does.
//!
//! Files and golden values: tests/data/hand/make_golden.py.

use std::io::{Read, Write};

use crate::common::hand_data;
use egotac::hand::{HandModel, HandParams, N_BETAS, N_JOINTS, N_VERTICES, Region, Side, Topology};
use glam::Vec3;
use safetensors::SafeTensors;

/// Loads a fixture, decompressed into a temporary file if necessary.
fn load(name: &str, side: Side) -> HandModel {
    let mut file = tempfile::NamedTempFile::new().unwrap();
    file.write_all(&unpacked(name)).unwrap();
    HandModel::load(file.path(), side).unwrap()
}

fn unpacked(name: &str) -> Vec<u8> {
    let bytes = std::fs::read(hand_data(name)).unwrap();
    if !name.ends_with(".gz") {
        return bytes;
    }
    let mut plain = Vec::new();
    flate2::read::GzDecoder::new(&bytes[..]).read_to_end(&mut plain).unwrap();
    plain
}

fn floats(file: &SafeTensors, name: &str) -> Vec<f32> {
    file.tensor(name).unwrap().data().as_chunks().0.iter().copied().map(f32::from_le_bytes).collect()
}

/// Returns the largest distance between the vertices or joints of `model` and those of smplx for the golden parameters,
/// m.
fn worst_distance(model: &HandModel, vertices: &str, joints: Option<&str>) -> f32 {
    let bytes = std::fs::read(hand_data("golden.safetensors")).unwrap();
    let file = SafeTensors::deserialize(&bytes).unwrap();
    let [betas, orient, pose, transl] =
        ["betas", "global_orient", "hand_pose", "transl"].map(|name| floats(&file, name));
    let vectors =
        |name: &str| floats(&file, name).as_chunks().0.iter().copied().map(Vec3::from_array).collect::<Vec<_>>();
    let (vertices, joints) = (vectors(vertices), joints.map(vectors));
    let mut worst = 0f32;
    for b in 0..betas.len() / N_BETAS {
        let params = HandParams {
            betas: betas[b * N_BETAS..][..N_BETAS].try_into().unwrap(),
            global_orient: Vec3::from_slice(&orient[3 * b..]),
            hand_pose: std::array::from_fn(|joint| Vec3::from_slice(&pose[45 * b + 3 * joint..])),
            transl: Vec3::from_slice(&transl[3 * b..]),
        };
        let posed = model.forward(&params);
        let expected = &vertices[b * N_VERTICES..][..N_VERTICES];
        worst = posed.vertices.iter().zip(expected).map(|(a, b)| a.distance(*b)).fold(worst, f32::max);
        if let Some(joints) = &joints {
            let expected = &joints[b * N_JOINTS..][..N_JOINTS];
            worst = posed.joints.iter().zip(expected).map(|(a, b)| a.distance(*b)).fold(worst, f32::max);
        }
    }
    worst
}

#[test]
fn python2_chumpy_pickle_poses_as_smplx() {
    let model = load("right_chumpy.pkl.gz", Side::Right);
    let worst = worst_distance(&model, "right_vertices", Some("right_joints"));
    assert!(worst < 2e-6, "{worst} m");
}

#[test]
fn npz_poses_as_smplx() {
    let model = load("right.npz", Side::Right);
    let worst = worst_distance(&model, "right_vertices", Some("right_joints"));
    assert!(worst < 2e-6, "{worst} m");
}

#[test]
fn left_shapedirs_change_on_request_only() {
    let mut model = load("left_plain.pkl.gz", Side::Left);
    let worst = worst_distance(&model, "left_vertices", Some("left_joints"));
    assert!(worst < 2e-6, "{worst} m");
    model.fix_left_shapedirs();
    let worst = worst_distance(&model, "left_fixed_vertices", None);
    assert!(worst < 2e-6, "{worst} m");
    assert!(worst_distance(&model, "left_vertices", None) > 1e-3, "the fix changes nothing");
}

#[test]
fn mano_regions_follow_its_joints() {
    let model = load("right_chumpy.pkl.gz", Side::Right);
    assert_eq!(model.topology, Topology::Mano);
    let regions = model.regions();
    let joints = model.forward(&HandParams::default()).joints;
    let centre = |region: Region| {
        let members: Vec<Vec3> =
            model.v_template.iter().zip(&regions).filter(|(_, r)| **r == region).map(|(v, _)| *v).collect();
        assert!(!members.is_empty(), "{} is empty", region.name());
        members.iter().sum::<Vec3>() / members.len() as f32
    };
    for (region, joint) in
        [(Region::ThumbTip, 15), (Region::IndexTip, 3), (Region::LittleTip, 9), (Region::RingTip, 12)]
    {
        assert!(centre(region).distance(joints[joint]) < 0.025, "{}", region.name());
    }
    assert!(centre(Region::Palm).y < centre(Region::Dorsal).y);
}

#[test]
fn missing_arrays_and_wrong_shapes_are_named() {
    let folder = tempfile::tempdir().unwrap();
    let write = |name: &str, bytes: &[u8]| {
        let path = folder.path().join(name);
        std::fs::write(&path, bytes).unwrap();
        HandModel::load(&path, Side::Right).unwrap_err().to_string()
    };
    let message = write("few.pkl", b"(dS'shapedirs'\nL1L\ns.");
    assert!(message.contains("v_template is missing from") && message.contains("shapedirs"), "{message}");
    assert!(message.contains("few.pkl"), "{message}");
    let message = write("shape.pkl", b"(dS'v_template'\n(lI1\naI2\nas.");
    assert!(message.contains("v_template: expected shape [778, 3], got [2]"), "{message}");
    let message = write("text.pkl", b"hello");
    assert!(message.contains("text.pkl") && message.contains("not a MANO pickle"), "{message}");
    let message = write("bad.npz", b"PK\x03\x04 and nothing more");
    assert!(message.contains("bad.npz"), "{message}");
    assert!(
        HandModel::load(&folder.path().join("absent.pkl"), Side::Right).unwrap_err().to_string().contains("absent.pkl")
    );
}

#[test]
fn truncated_files_are_errors() {
    let folder = tempfile::tempdir().unwrap();
    for name in ["right_chumpy.pkl.gz", "right.npz"] {
        let bytes = unpacked(name);
        for part in 1..20 {
            let path = folder.path().join(name);
            std::fs::write(&path, &bytes[..bytes.len() * part / 20]).unwrap();
            assert!(HandModel::load(&path, Side::Right).is_err(), "{name} cut at {part}/20");
        }
    }
}
