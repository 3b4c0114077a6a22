//! EgoTac-SC in the OXT layout: taxels of a known touch come out as the force on the vertices.

use std::fs;
use std::path::{Path, PathBuf};

use crate::common::egotac;
use egotac::dataset::zarr::{ArraySpec, Contact, Dtype, Values, ZarrReader, ZarrWriter, read_truth};
use egotac::dataset::{Attributes, EpisodeWriter, Frame};
use egotac::hand::{HandModel, Side, Topology};
use egotac::sensor;
use egotac::sensor::simulated::loads;
use egotac::tactile::{ForceKind, N_FIELD, TactileField, Validity};
use image::RgbImage;

const FRAMES: usize = 6;

/// Returns the image of a frame.
fn picture(index: usize) -> RgbImage {
    RgbImage::from_fn(30, 24, |x, y| [10 * index as u8, x as u8, y as u8].into())
}

/// Returns the true forces of a frame: a touch of both hands around one vertex of each.
fn touch(index: usize) -> Vec<f32> {
    let hand = HandModel::builtin(Side::Right);
    let at = hand.v_template[hand.tip_vertices[index % 5] as usize];
    let one: Vec<f32> =
        hand.v_template.iter().map(|v| (-v.distance_squared(at) / (2.0 * 0.004f32.powi(2))).exp()).collect();
    [0.3, 0.8].iter().flat_map(|newtons| one.iter().map(move |weight| newtons * weight)).collect()
}

/// Returns the taxels of a hand that feel a frame's touch, (132) N.
fn taxels(side: Side, index: usize) -> Vec<f32> {
    loads(&sensor::open("aether_132").unwrap().hands[side as usize], &touch(index)[side.range()])
}

/// Writes a store in the layout of the release: (5, 4, 3) for the fingers, (1, 5, 15) for the palm with three zeros at the end
/// (left) or the start (right), and none of egotac's own arrays.
fn release(path: &Path, sides: &[Side]) {
    let name = |side: Side, group: &str| format!("data/{}_tactile_data_{group}", side.name());
    let mut extra = vec![ArraySpec::new("data/camera_ego_pose", [6], Dtype::F64)];
    for side in sides {
        extra.push(ArraySpec::new(name(*side, "fingers"), [5, 4, 3], Dtype::F32));
        extra.push(ArraySpec::new(name(*side, "palm"), [1, 5, 15], Dtype::F32));
    }
    let attributes: Attributes = serde_json::from_value(serde_json::json!({ "topology": "mano" })).unwrap();
    let mut writer = ZarrWriter::create(path, attributes, Contact::Truth, extra).unwrap();
    for index in 0..FRAMES {
        let names: Vec<_> = sides.iter().map(|side| (name(*side, "fingers"), name(*side, "palm"), *side)).collect();
        let mut values = vec![("data/camera_ego_pose", Values::F64(vec![0.1, 0.2, 0.3, 0.0, 0.0, 0.5]))];
        for (fingers, palm, side) in &names {
            let taxels = taxels(*side, index);
            let mut grid = taxels[60..].to_vec();
            let padding = if *side == Side::Left { 12 } else { 0 };
            grid.splice(padding..padding, [0.0; 3]);
            values.push((fingers, Values::F32(taxels[..60].to_vec())));
            values.push((palm, Values::F32(grid)));
        }
        let frame = Frame {
            timestamp: 100.0 + index as f64 / 30.0,
            camera_ego_rgb: picture(index),
            field: TactileField::zeros(Topology::Mano),
            force_valid: vec![1; N_FIELD],
            contact_valid: vec![1; N_FIELD],
            validity: Validity::Valid,
            left_hand_pose: None,
            right_hand_pose: None,
        };
        writer.push_with(frame, values).unwrap();
    }
    writer.end_episode().unwrap();
    writer.finish().unwrap();
    for own in [
        "mano_force",
        "mano_contact",
        "mano_force_valid",
        "mano_contact_valid",
        "frame_validity",
        "left_hand_pose",
        "right_hand_pose",
    ] {
        fs::remove_dir_all(path.join("data").join(own)).unwrap();
    }
    fs::write(path.join(".zattrs"), "{}").unwrap();
}

fn import(source: &Path, out: &Path, more: &[&str]) -> std::process::Output {
    let [source, out] = [source, out].map(|path| path.to_str().unwrap());
    egotac(&[&["data", "import", "egotac-sc", source, "--out", out, "--size", "0"], more].concat())
}

fn imported(folder: &Path, sides: &[Side], more: &[&str]) -> ZarrReader {
    let (source, out) = (folder.join("trajectory_7.zarr"), folder.join("out.zarr"));
    release(&source, sides);
    let output = import(&source, &out, more);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    ZarrReader::open(&out).unwrap()
}

fn known(force: &[f32]) -> f64 {
    force.iter().filter(|force| !force.is_nan()).map(|force| f64::from(*force)).sum()
}

#[test]
fn readings_of_a_known_touch_lie_where_it_was() {
    let folder = tempfile::tempdir().unwrap();
    let store = imported(folder.path(), &Side::BOTH, &[]);
    assert_eq!(store.force_kind().unwrap(), Some(ForceKind::Reading));
    assert_eq!(store.raw_attributes()["import"]["force_kind"], "reading");
    let truth = read_truth(&store).unwrap();
    let map = sensor::open("aether_132").unwrap();
    for index in 0..FRAMES {
        assert!(store.image(index).unwrap() == picture(index), "image {index}");
        assert_eq!(truth.timestamps[index], 100.0 + index as f64 / 30.0);
        let (left, right) = (taxels(Side::Left, index), taxels(Side::Right, index));
        let wanted = map.reading([Some(&left), Some(&right)]).unwrap();
        for (vertex, (got, want)) in truth.force_at(index).iter().zip(&wanted).enumerate() {
            let (mask, contact) = (truth.mask_force[index * N_FIELD + vertex], truth.contact_at(index)[vertex]);
            assert_eq!(mask == 1, !want.is_nan(), "vertex {vertex}");
            assert!(mask == 0 || (got == want && (contact == 1.0) == (*want > 0.05)), "vertex {vertex}: {got} {want}");
        }
        // The strongest reading is at the fingertip that was touched.
        let right = &truth.force_at(index)[Side::Right.range()];
        let strongest =
            (0..778).filter(|v| !right[*v].is_nan()).max_by(|a, b| right[*a].total_cmp(&right[*b])).unwrap();
        let hand = HandModel::builtin(Side::Right);
        let tip = hand.v_template[hand.tip_vertices[index % 5] as usize];
        assert!(hand.v_template[strongest].distance(tip) < 0.012, "frame {index}");
    }
    let pose = store.read_f32("data/camera_pose", 0..1).unwrap();
    let half = 0.25f32;
    let wanted = [0.1, 0.2, 0.3, half.cos(), 0.0, 0.0, half.sin()];
    assert!(pose.iter().zip(wanted).all(|(got, want)| (got - want).abs() < 1e-6), "{pose:?}");
}

#[test]
fn spread_forces_sum_to_the_taxels() {
    let folder = tempfile::tempdir().unwrap();
    let store = imported(folder.path(), &Side::BOTH, &["--force-kind", "spread"]);
    assert_eq!(store.force_kind().unwrap(), Some(ForceKind::Spread));
    let truth = read_truth(&store).unwrap();
    for index in 0..FRAMES {
        for side in Side::BOTH {
            let wanted: f64 = taxels(side, index).iter().map(|newtons| f64::from(*newtons)).sum();
            let got = known(&truth.force_at(index)[side.range()]);
            assert!(wanted > 0.5 && (got - wanted).abs() < 1e-5 * wanted, "{got} N of {wanted} N");
        }
    }
}

#[test]
fn a_hand_without_a_glove_is_unknown_and_a_foreign_store_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let store = imported(folder.path(), &[Side::Right], &[]);
    let truth = read_truth(&store).unwrap();
    assert!(
        truth.mask_force[Side::Left.range()]
            .iter()
            .chain(&truth.mask_contact[Side::Left.range()])
            .all(|mask| *mask == 0)
    );
    assert!(truth.mask_force[Side::Right.range()].contains(&1));
    let foreign = folder.path().join("foreign.zarr");
    release(&foreign, &[]);
    let output = import(&foreign, &folder.path().join("none.zarr"), &[]);
    let error = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(
        !output.status.success() && error.contains("foreign") && error.contains("right_tactile_data_fingers"),
        "{error}"
    );
    let other =
        import(&folder.path().join("trajectory_7.zarr"), &folder.path().join("x.zarr"), &["--sensor", "opentouch_169"]);
    assert!(String::from_utf8_lossy(&other.stderr).contains("a map of 132 channels"));
}

#[test]
fn a_folder_of_trajectories_becomes_a_folder_of_stores() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| -> PathBuf { folder.path().join("aether").join(name) };
    release(&path("a.zarr"), &Side::BOTH);
    release(&path("b.zarr"), &Side::BOTH);
    fs::remove_dir_all(path("b.zarr/data/left_tactile_data_palm")).unwrap();
    let out = folder.path().join("out");
    let output = import(folder.path().join("aether").as_path(), &out, &[]);
    assert_eq!(output.status.code(), Some(3), "{}", String::from_utf8_lossy(&output.stderr));
    assert!(String::from_utf8_lossy(&output.stderr).contains("left_tactile_data_palm"));
    assert_eq!(ZarrReader::open(&out.join("a.zarr")).unwrap().len(), FRAMES);
}
