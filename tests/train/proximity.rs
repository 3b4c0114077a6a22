//! Training on contact by distance, beside force from another source.

use std::path::Path;

use crate::common::{egotac, refused};
use candle_core::Device;
use egotac::dataset::zarr::{ArraySpec, Contact, Dtype, MANO_FORCE_STD, MANO_PROXIMITY, Values, ZarrWriter};
use egotac::dataset::{Attributes, EpisodeWriter, Frame};
use egotac::hand::Topology;
use egotac::model::Metadata;
use egotac::model::config::Config as Geometry;
use egotac::tactile::{N_FIELD, TactileField, Validity};
use egotac::train::data::Dataset;
use egotac::train::source::{Supervision, TrainingSource};
use egotac::train::{Config, Control, train};
use image::{Rgb, RgbImage};

const FRAMES: usize = 12;
/// Vertices that are touched with 2 N in every frame.
const PRESSED: std::ops::Range<usize> = 100..110;
/// Vertices within 1 cm of an object.
const NEAR: std::ops::Range<usize> = 90..130;

/// Writes a store of [`FRAMES`] frames; frame 3 is refused by a guard.
fn write_store(path: &Path, proximity: bool) {
    let near = || Values::U8((0..N_FIELD).map(|v| u8::from(NEAR.contains(&v))).collect());
    match proximity {
        true => write_store_with(path, MANO_PROXIMITY, Dtype::U8, near),
        false => write(path, vec![], Vec::new),
    }
}

/// As [`write_store`], with an array (T, 1556) whose frames are all `values`.
fn write_store_with(path: &Path, name: &str, dtype: Dtype, values: impl Fn() -> Values) {
    write(path, vec![ArraySpec::new(name, [N_FIELD], dtype)], || vec![(name, values())]);
}

fn write<'a>(path: &Path, extra: Vec<ArraySpec>, values: impl Fn() -> Vec<(&'a str, Values)>) {
    let attributes = Attributes {
        topology: Topology::EgotacHand1,
        sigma: 0.0,
        contact_force: 0.05,
        producer: "test".into(),
        version: "1".into(),
        scene: "formula".into(),
        seed: 0,
    };
    let mut writer = ZarrWriter::create(path, attributes, Contact::Truth, extra).unwrap();
    for t in 0..FRAMES {
        let force = (0..N_FIELD).map(|v| if PRESSED.contains(&v) { 2.0 } else { 0.0 }).collect();
        let frame = Frame {
            timestamp: 0.1 * t as f64,
            camera_ego_rgb: RgbImage::from_pixel(28, 28, Rgb([17 * t as u8, 90, 40])),
            field: TactileField::from_force(Topology::EgotacHand1, force).unwrap(),
            force_valid: vec![1; N_FIELD],
            contact_valid: vec![1; N_FIELD],
            validity: if t == 3 { Validity::TooDeep } else { Validity::Valid },
            left_hand_pose: None,
            right_hand_pose: None,
        };
        writer.push_with(frame, values()).unwrap();
    }
    writer.end_episode().unwrap();
    writer.finish().unwrap();
}

fn source(path: &Path, labels: Supervision) -> TrainingSource {
    TrainingSource { labels, ..TrainingSource::path(path) }
}

#[test]
fn a_source_by_distance_supervises_nearness_and_no_force() {
    let folder = tempfile::tempdir().unwrap();
    let [force, near] = ["force.zarr", "near.zarr"].map(|name| folder.path().join(name));
    write_store(&force, false);
    write_store(&near, true);
    let preparation = Metadata::new("any", 1.0, 0.1).preparation(&Geometry::toy());
    for in_memory in [true, false] {
        let sources = [source(&force, Supervision::Both), source(&near, Supervision::Proximity)];
        let data = Dataset::open(&sources, preparation.clone(), in_memory).unwrap();
        let labels = data.labels().unwrap();
        for frame in 0..2 * FRAMES {
            let (by_distance, refused) = (frame >= FRAMES, frame % FRAMES == 3);
            for vertex in 0..N_FIELD {
                let at = frame * N_FIELD + vertex;
                let touched = if by_distance { NEAR.contains(&vertex) } else { PRESSED.contains(&vertex) };
                assert_eq!(labels.contact[at], f32::from(touched), "frame {frame}, vertex {vertex}");
                assert_eq!(labels.mask_contact[at], u8::from(!refused));
                assert_eq!(labels.mask_force[at], u8::from(!refused && !by_distance));
                assert_eq!(labels.force[at].is_nan(), by_distance);
            }
        }
        // Force statistics come from the one source that has forces, contact rates from both.
        let statistics = data.statistics().unwrap();
        assert_eq!((statistics.force_scale, statistics.mean_force[105]), (Some(2.0), 2.0));
        assert_eq!([105, 120, 200].map(|vertex| statistics.contact_rate[vertex]), [1.0, 0.5, 0.0]);
    }
}

#[test]
fn a_source_of_force_supervises_no_contact() {
    let folder = tempfile::tempdir().unwrap();
    let [force, near] = ["force.zarr", "near.zarr"].map(|name| folder.path().join(name));
    write_store(&force, false);
    write_store(&near, true);
    let preparation = Metadata::new("any", 1.0, 0.1).preparation(&Geometry::toy());
    let sources = [source(&force, Supervision::Force), source(&near, Supervision::Proximity)];
    let data = Dataset::open(&sources, preparation, false).unwrap();
    let labels = data.labels().unwrap();
    for frame in 0..2 * FRAMES {
        let (by_distance, refused) = (frame >= FRAMES, frame % FRAMES == 3);
        for at in N_FIELD * frame..N_FIELD * (frame + 1) {
            assert_eq!(labels.mask_force[at], u8::from(!refused && !by_distance));
            assert_eq!(labels.mask_contact[at], u8::from(!refused && by_distance));
            assert_eq!(labels.contact[at].is_nan(), !by_distance);
        }
    }
    // Each statistic comes from the one source that supervises it.
    let statistics = data.statistics().unwrap();
    assert_eq!((statistics.force_scale, statistics.mean_force[105]), (Some(2.0), 2.0));
    assert_eq!([105, 120, 200].map(|vertex| statistics.contact_rate[vertex]), [1.0, 1.0, 0.0]);
    // Neither force alone nor felt contact trains a contact head.
    let config = folder.path().join("run.yaml");
    let [store, out] = [&force, &folder.path().join("run")].map(|path| path.display().to_string());
    for labels in ["force", "felt"] {
        let text = format!(
            "{{name: a, data: [{{stores: [{store}], labels: {labels}}}], out: {out}, model: toy, seed: 1, steps: 2}}"
        );
        std::fs::write(&config, text).unwrap();
        refused(&["train", "--config", config.to_str().unwrap()], "a source that knows contact and its absence");
    }
}

#[test]
fn a_source_of_felt_contact_supervises_contact_where_there_is_some() {
    let folder = tempfile::tempdir().unwrap();
    let force = folder.path().join("force.zarr");
    write_store(&force, false);
    let preparation = Metadata::new("any", 1.0, 0.1).preparation(&Geometry::toy());
    let labels_of = |supervision| {
        let data = Dataset::open(&[source(&force, supervision)], preparation.clone(), false).unwrap();
        data.labels().unwrap()
    };
    let (all, felt) = (labels_of(Supervision::Both), labels_of(Supervision::Felt));
    assert_eq!(felt.mask_force, all.mask_force);
    let touched = |at: &usize| all.mask_contact[*at] == 1 && all.contact[*at] == 1.0;
    assert_eq!((0..all.contact.len()).filter(touched).count(), PRESSED.len() * (FRAMES - 1));
    for at in 0..all.contact.len() {
        assert_eq!(felt.mask_contact[at] == 1, touched(&at), "{at}");
        assert!(if touched(&at) { felt.contact[at] == 1.0 } else { felt.contact[at].is_nan() }, "{at}");
    }
}

#[test]
fn a_store_without_distances_is_refused_by_name() {
    let folder = tempfile::tempdir().unwrap();
    let store = folder.path().join("plain.zarr");
    write_store(&store, false);
    let config = folder.path().join("run.yaml");
    let text = format!(
        "{{name: a, data: [{{stores: [{}], labels: proximity}}], out: {}, model: toy, seed: 1, steps: 2}}",
        store.display(),
        folder.path().join("run").display()
    );
    std::fs::write(&config, text).unwrap();
    let error = refused(&["train", "--config", config.to_str().unwrap()], "data/mano_proximity");
    assert!(error.contains("plain.zarr"), "{error}");
}

/// Trains for a few steps; returns the path of the checkpoint.
fn trained(folder: &Path, data: &str) -> String {
    let out = folder.join("run");
    let text = format!(
        "{{name: a, data: [{data}], out: {}, model: toy, seed: 1, steps: 3, frame_dt: 0.1, batch: {{clips: 2, windows: 4}}, ema: 0}}",
        out.display()
    );
    let config: Config = serde_yaml::from_str(&text).unwrap();
    let outcome = train(&config, false, &Device::Cpu, &mut |_| Control::Continue).unwrap();
    outcome.checkpoint.display().to_string()
}

#[test]
fn a_force_head_that_no_force_trained_is_unknown_unless_it_is_scored_as_it_is() {
    let folder = tempfile::tempdir().unwrap();
    let store = folder.path().join("near.zarr");
    write_store(&store, true);
    let store = store.to_str().unwrap();
    let checkpoint = trained(folder.path(), &format!("{{stores: [{store}], labels: proximity}}"));
    let score = |more: &[&str]| -> serde_json::Value {
        let output = egotac(&[&["eval", "--checkpoint", &checkpoint, "--data", store, "--json"], more].concat());
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        serde_json::from_slice(&output.stdout).unwrap()
    };
    let (unknown, as_it_is) = (score(&[]), score(&["--untrained-force"]));
    assert!(unknown["active_mae"].is_null(), "{unknown}");
    // 2 N are true; the head begins at 0, and the consistency loss alone can pull it up in three steps by a little.
    let error = as_it_is["active_mae"].as_f64().unwrap();
    assert!((1.5..=2.0).contains(&error), "{error}");
    assert_eq!(unknown["pooled"]["auroc"], as_it_is["pooled"]["auroc"]);
}

#[test]
fn forces_weigh_by_their_deviation_and_a_store_without_deviations_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let [with, without] = ["with.zarr", "without.zarr"].map(|name| folder.path().join(name));
    write_store(&without, false);
    write_store_with(&with, MANO_FORCE_STD, Dtype::F32, || {
        Values::F32((0..N_FIELD).map(|v| [0.0, 0.05, f32::NAN][v % 3]).collect())
    });
    for in_memory in [false, true] {
        let source = |path: &Path| TrainingSource { weigh_by_std: true, ..TrainingSource::path(path) };
        let geometry = Geometry::preset("toy").unwrap();
        let preparation = Metadata::new("test", 1.0, 0.1).preparation(&geometry);
        let data = Dataset::open(&[source(&with)], preparation.clone(), in_memory).unwrap();
        let block = data.read(0, 2..4, true).unwrap();
        let expected: Vec<f32> = (0..N_FIELD).map(|v| [1.0, 0.5, 0.0][v % 3]).collect();
        assert_eq!(block.force_weights, [expected.clone(), expected].concat());
        let refused = Dataset::open(&[source(&without)], preparation, in_memory);
        let error = refused.and_then(|data| data.read(0, 0..1, true).map(|_| ())).unwrap_err().to_string();
        assert!(error.contains("data/mano_force_std") && error.contains("without.zarr"), "{error}");
    }
}
