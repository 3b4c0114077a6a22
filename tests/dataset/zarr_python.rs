//! zarr-python opens our stores. Needs the Python environment of `make setup`.

use std::process::Command;

use egotac::dataset::zarr::{ArraySpec, Contact, Dtype, ZarrWriter};
use egotac::dataset::{Attributes, EpisodeWriter, Frame};
use egotac::hand::Topology;
use egotac::tactile::{N_FIELD, TactileField, Validity};
use image::RgbImage;

const CHECK: &str = r#"
import sys, numpy as np, zarr
root = zarr.open_group(sys.argv[1], mode="r")
assert root.attrs["topology"] == "egotac-hand-1" and root.attrs["thresholds"]["contact_force"] == 0.05, dict(root.attrs)
assert root.attrs["camera"] == {"fx": 100.0}, dict(root.attrs)
data, T = root["data"], 40
want = dict(camera_ego_rgb=((T, 200, 300, 3), "u1"), timestamps=((T,), "<f8"), mano_force=((T, 1556), "<f4"),
            mano_contact=((T, 1556), "u1"), mano_force_valid=((T, 1556), "u1"), mano_contact_valid=((T, 1556), "u1"),
            frame_validity=((T,), "u1"), left_hand_pose=((T, 61), "<f4"), right_hand_pose=((T, 61), "<f4"),
            object_pose=((T, 1, 7), "<f4"))
assert sorted(data.array_keys()) == sorted(want), sorted(data.array_keys())
for name, (shape, dtype) in want.items():
    assert data[name].shape == shape and data[name].dtype == np.dtype(dtype), (name, data[name].shape, data[name].dtype)
t = np.arange(T)
assert np.array_equal(data["timestamps"][:], 0.04 * t)
y, x = np.mgrid[:200, :300]
for i in (0, 11, 12, 39):
    assert np.array_equal(data["camera_ego_rgb"][i], np.stack([np.full_like(x, i), x % 256, y], -1)), i
force = data["mano_force"][:]
v = np.arange(1556)
assert np.array_equal(force, np.where((v + t[:, None]) % 50 == 0, v.astype("f4") / 1024, 0).astype("f4"))
assert np.array_equal(data["mano_contact"][:], force > np.float32(0.05))
assert (data["object_pose"][:, 0, 3] == t).all() and not data["left_hand_pose"][:].any()
assert list(root["meta/episode_ends"][:]) == [15, 40] and root["meta/episode_ends"].dtype == "<i8"
blosc = data["mano_force"].compressor
assert (blosc.cname, blosc.clevel, blosc.shuffle) == ("zstd", 5, 2), blosc
assert root["meta/episode_ends"].compressor is None and data["camera_ego_rgb"].chunks == (12, 200, 300, 3)
"#;

#[test]
fn zarr_python_opens_our_stores() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("ours.zarr");
    let attributes = Attributes {
        topology: Topology::EgotacHand1,
        sigma: 0.004,
        contact_force: 0.05,
        producer: "test".into(),
        version: "1".into(),
        scene: "formula".into(),
        seed: 3,
    };
    let extra = vec![ArraySpec::new("data/object_pose", [1, 7], Dtype::F32)];
    let mut writer = ZarrWriter::create(&path, attributes, Contact::Truth, extra).unwrap();
    writer.set_attribute("camera", serde_json::json!({"fx": 100.0}));
    for index in 0..40 {
        let force = (0..N_FIELD).map(|v| if (v + index) % 50 == 0 { v as f32 / 1024.0 } else { 0.0 }).collect();
        let frame = Frame {
            timestamp: 0.04 * index as f64,
            camera_ego_rgb: RgbImage::from_fn(300, 200, |x, y| image::Rgb([index as u8, x as u8, y as u8])),
            field: TactileField::from_force(Topology::EgotacHand1, force).unwrap(),
            force_valid: vec![1; N_FIELD],
            contact_valid: vec![1; N_FIELD],
            validity: Validity::Valid,
            left_hand_pose: None,
            right_hand_pose: None,
        };
        writer.push_with(frame, vec![("data/object_pose", vec![index as f32; 7].into())]).unwrap();
        if [14, 39].contains(&index) {
            writer.end_episode().unwrap();
        }
    }
    writer.finish().unwrap();

    let python = std::env::var("EGOTAC_PYTHON").expect("EGOTAC_PYTHON names the set-up's Python: source env.sh");
    let output = Command::new(&python).args(["-c", CHECK]).arg(&path).output().expect(&python);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
}
