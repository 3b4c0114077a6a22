//! Stores written by us or by zarr-python read back, and invalid values are refused.

use std::path::Path;

use egotac::dataset::zarr::{ArraySpec, Contact, Dtype, Values, ZarrReader, ZarrWriter, open_all};
use egotac::dataset::{Attributes, EpisodeReader, EpisodeWriter, Frame};
use egotac::hand::{HandParams, Topology};
use egotac::tactile::{CONTACT_FORCE_N, N_FIELD, TactileField, Validity};
use image::RgbImage;

fn attributes(topology: Topology) -> Attributes {
    Attributes {
        topology,
        sigma: 0.004,
        contact_force: 0.05,
        producer: "test".into(),
        version: "1".into(),
        scene: "formula".into(),
        seed: 3,
    }
}

fn frame(index: usize, size: (u32, u32)) -> Frame {
    let force: Vec<f32> =
        (0..N_FIELD).map(|v| if (v + index).is_multiple_of(50) { 0.001 * v as f32 } else { 0.0 }).collect();
    Frame {
        timestamp: 0.04 * index as f64,
        camera_ego_rgb: RgbImage::from_fn(size.0, size.1, |x, y| image::Rgb([index as u8, x as u8, y as u8])),
        field: TactileField::from_force(Topology::EgotacHand1, force).unwrap(),
        force_valid: vec![1; N_FIELD],
        contact_valid: (0..N_FIELD).map(|v| (v % 2) as u8).collect(),
        validity: Validity::ALL[index % Validity::ALL.len()],
        left_hand_pose: None,
        right_hand_pose: Some(HandParams { betas: [0.1 + index as f32; 10], ..Default::default() }),
    }
}

fn write(path: &Path, episodes: &[usize], size: (u32, u32)) {
    let mut writer = ZarrWriter::create(path, attributes(Topology::EgotacHand1), Contact::Truth, Vec::new()).unwrap();
    let mut index = 0;
    for frames in episodes {
        for _ in 0..*frames {
            writer.push(frame(index, size)).unwrap();
            index += 1;
        }
        writer.end_episode().unwrap();
    }
    writer.finish().unwrap();
}

fn assert_same(read: &Frame, written: &Frame) {
    assert_eq!(read.timestamp, written.timestamp);
    assert_eq!(read.camera_ego_rgb, written.camera_ego_rgb);
    assert_eq!(read.field, written.field);
    assert_eq!((&read.force_valid, &read.contact_valid), (&written.force_valid, &written.contact_valid));
    assert_eq!(read.validity, written.validity);
    assert_eq!((&read.left_hand_pose, &read.right_hand_pose), (&written.left_hand_pose, &written.right_hand_pose));
}

#[test]
fn frames_read_back_as_pushed_over_several_chunks_and_episodes() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.zarr");
    // 12 frames of 200 x 300 x 3 bytes reach 2 MB, so 30 frames span three chunks, the last of them not full.
    write(&path, &[13, 17], (300, 200));
    let store = ZarrReader::open(&path).unwrap();
    assert_eq!(store.episode_ends(), [13, 30]);
    assert_eq!(store.attributes(), &attributes(Topology::EgotacHand1));
    assert_eq!(store.image_size(), (200, 300));
    let rgb = store.arrays().into_iter().find(|a| a.name == "data/camera_ego_rgb").unwrap();
    assert_eq!((rgb.shape, rgb.chunks), (vec![30, 200, 300, 3], vec![12, 200, 300, 3]));
    for index in [29, 0, 11, 12, 13, 28, 1] {
        assert_same(&store.frame(index).unwrap(), &frame(index, (300, 200)));
    }
    let bulk = store.read_f32("data/mano_force", 5..27).unwrap();
    assert_eq!(bulk[3 * N_FIELD..4 * N_FIELD], frame(8, (1, 1)).field.force);
    assert!(store.frame(30).unwrap_err().to_string().contains("30"));
}

#[test]
fn a_store_appears_only_when_finished_and_leaves_no_temporary_files() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.zarr");
    let create = || ZarrWriter::create(&path, attributes(Topology::EgotacHand1), Contact::Truth, Vec::new());
    let mut writer = create().unwrap();
    writer.push(frame(0, (4, 4))).unwrap();
    assert!(!path.exists());
    assert!(writer.finish().unwrap_err().to_string().contains("episode is still open"));
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
    write(&path, &[1], (4, 4));
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);
    assert!(create().unwrap_err().to_string().contains("exists already"));
}

#[test]
fn extra_arrays_read_back_and_none_may_be_missing() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.zarr");
    let extra = vec![
        ArraySpec::new("data/object_pose", [2, 7], Dtype::F32),
        ArraySpec::new("data/force_residual", [], Dtype::F64),
    ];
    let mut writer = ZarrWriter::create(&path, attributes(Topology::EgotacHand1), Contact::Truth, extra).unwrap();
    let poses = |i: usize| Values::F32((0..14).map(|k| (i * k) as f32).collect());
    for index in 0..3 {
        let extra = vec![("data/object_pose", poses(index)), ("data/force_residual", vec![index as f64].into())];
        writer.push_with(frame(index, (4, 4)), extra).unwrap();
    }
    let missing = writer.push_with(frame(3, (4, 4)), vec![("data/object_pose", poses(3))]).unwrap_err().to_string();
    assert!(missing.contains("data/force_residual"), "{missing}");
    let short = vec![("data/object_pose", vec![0f32; 7].into()), ("data/force_residual", vec![0f64].into())];
    assert!(writer.push_with(frame(3, (4, 4)), short).unwrap_err().to_string().contains("data/object_pose"));
    writer.end_episode().unwrap();
    writer.finish().unwrap();
    let store = ZarrReader::open(&path).unwrap();
    assert_eq!(store.read("data/object_pose", 2..3).unwrap(), poses(2));
    assert_eq!(store.read("data/force_residual", 0..3).unwrap(), Values::F64(vec![0.0, 1.0, 2.0]));
}

#[test]
fn predicted_scores_and_unknown_values_read_back() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.zarr");
    let mut writer = ZarrWriter::create(&path, attributes(Topology::EgotacHand1), Contact::Score, Vec::new()).unwrap();
    let mut predicted = frame(0, (4, 4));
    predicted.field.contact = (0..N_FIELD).map(|v| v as f32 / N_FIELD as f32).collect();
    predicted.field.force[7] = f32::NAN;
    writer.push(predicted.clone()).unwrap();
    writer.end_episode().unwrap();
    writer.finish().unwrap();
    let read = ZarrReader::open(&path).unwrap().frame(0).unwrap();
    assert_eq!(read.field.contact, predicted.field.contact);
    assert!(read.field.force[7].is_nan());
}

#[test]
fn frames_that_do_not_fit_are_refused_by_name() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.zarr");
    let mut writer = ZarrWriter::create(&path, attributes(Topology::EgotacHand1), Contact::Truth, Vec::new()).unwrap();
    writer.push(frame(0, (4, 4))).unwrap();
    let mut refused = |change: &dyn Fn(&mut Frame), word: &str| {
        let mut wrong = frame(1, (4, 4));
        change(&mut wrong);
        let error = writer.push(wrong).unwrap_err().to_string();
        assert!(error.contains(word), "{word} is not in: {error}");
    };
    refused(&|f| f.camera_ego_rgb = RgbImage::new(5, 4), "camera_ego_rgb");
    refused(&|f| f.field.topology = Topology::Mano, "topology");
    refused(&|f| f.field.contact[3] = 0.5, "mano_contact[3]");
    refused(&|f| f.field.force[9] = -1.0, "mano_force[9]");
    refused(&|f| f.force_valid.truncate(778), "mano_force_valid");
    assert_eq!(writer.n_frames(), 1);
}

#[test]
fn topologies_do_not_mix() {
    let folder = tempfile::tempdir().unwrap();
    write(&folder.path().join("a.zarr"), &[1], (4, 4));
    let mut mano =
        ZarrWriter::create(&folder.path().join("b.zarr"), attributes(Topology::Mano), Contact::Truth, Vec::new())
            .unwrap();
    let mut other = frame(0, (4, 4));
    other.field.topology = Topology::Mano;
    mano.push(other).unwrap();
    mano.end_episode().unwrap();
    mano.finish().unwrap();
    let error = open_all(&[folder.path().to_path_buf()]).unwrap_err().to_string();
    assert!(error.contains("b.zarr") && error.contains("topology mismatch"), "{error}");
    assert_eq!(open_all(&[folder.path().join("a.zarr")]).unwrap().len(), 1);
}

/// tests/data/zarr/make.py: Blosc lz4, zlib, zstd, gzip and no compression; bool and big-endian values; missing chunks.
#[test]
fn zarr_written_by_python_reads_back() {
    let store = ZarrReader::open(Path::new("tests/data/zarr/python.zarr")).unwrap();
    assert_eq!(store.episode_ends(), [2, 5]);
    assert_eq!(store.attributes().seed, 7);
    for t in 0..5 {
        let frame = store.frame(t).unwrap();
        assert_eq!(frame.timestamp, 0.04 * t as f64);
        for (x, y, pixel) in frame.camera_ego_rgb.enumerate_pixels() {
            let expected = [0, 1, 2].map(|c| ((50 * t as u32 + 10 * y + 3 * x + 80 * c) % 256) as u8);
            assert_eq!(pixel.0, expected, "frame {t}, pixel {x} {y}");
        }
        for v in 0..N_FIELD {
            let force = if t != 3 && (v + t) % 97 == 0 { 0.01 * v as f64 * (1 + t) as f64 / 100.0 } else { 0.0 };
            assert!((f64::from(frame.field.force[v]) - force).abs() < 1e-6);
            assert_eq!(frame.field.contact[v], f32::from(frame.field.force[v] > CONTACT_FORCE_N));
            assert_eq!(frame.force_valid[v], u8::from(t != 4 || v >= 778));
            assert_eq!(frame.contact_valid[v], 1, "absent validity of present labels is 1");
        }
        assert_eq!(frame.validity.code(), if t == 3 { 4 } else { 0 });
        assert_eq!(frame.left_hand_pose.is_some(), t > 0);
        assert!(frame.right_hand_pose.is_none());
    }
    let pose = store.frame(4).unwrap().left_hand_pose.unwrap().to_array();
    assert!((pose[60] - 0.01 * 60.0 * 4.0).abs() < 1e-6);
}

#[test]
fn damaged_stores_are_refused_with_the_array_named() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.zarr");
    let damaged = |word: &str, damage: &dyn Fn()| {
        let _ = std::fs::remove_dir_all(&path);
        write(&path, &[3], (4, 4));
        damage();
        let error = ZarrReader::open(&path).and_then(|store| store.frame(0)).unwrap_err().to_string();
        assert!(error.contains(word) && error.contains("a.zarr"), "{word} is not in: {error}");
    };
    let edit = |file: &str, from: &str, to: &str| {
        let file = path.join(file);
        let text = std::fs::read_to_string(&file).unwrap();
        assert!(text.contains(from), "{from} is not in {text}");
        std::fs::write(file, text.replace(from, to)).unwrap();
    };
    damaged("data/timestamps", &|| std::fs::remove_dir_all(path.join("data/timestamps")).unwrap());
    damaged("data/mano_force", &|| edit("data/mano_force/.zarray", "1556", "1555"));
    damaged("data/frame_validity", &|| edit("data/frame_validity/.zarray", "3", "2"));
    damaged("data/mano_force", &|| std::fs::write(path.join("data/mano_force/0.0"), b"no blosc").unwrap());
    damaged("data/camera_ego_rgb", &|| edit("data/camera_ego_rgb/.zarray", "\"zstd\"", "\"zzz\""));
    damaged("topology", &|| edit(".zattrs", "topology", "topologie"));
    damaged("hand-9", &|| edit(".zattrs", "egotac-hand-1", "hand-9"));
    damaged("meta/episode_ends", &|| std::fs::write(path.join("meta/episode_ends/0"), [0; 8]).unwrap());
    assert!(ZarrReader::open(folder.path()).unwrap_err().to_string().contains("not a Zarr store"));
}
