//! `egotac eval` on files written by other tools.

use std::collections::HashMap;
use std::path::Path;

use crate::common::egotac;
use egotac::crates::image::RgbImage;
use egotac::dataset::zarr::{Contact, ZarrWriter};
use egotac::dataset::{Attributes, EpisodeWriter, Frame};
use egotac::hand::Topology;
use egotac::tactile::{N_FIELD, TactileField, Validity};
use safetensors::tensor::{Dtype, TensorView};
use serde_json::Value;

/// Returns forces whose frame t has `scale` x (t + 1) N on vertices 0..10.
fn field(frames: usize, scale: f32) -> Vec<f32> {
    (0..frames * N_FIELD).map(|i| if i % N_FIELD < 10 { scale * (i / N_FIELD + 1) as f32 } else { 0.0 }).collect()
}

fn write(path: &Path, topology: &str, tensors: &[(&str, Dtype, Vec<usize>, Vec<u8>)]) {
    let views = tensors
        .iter()
        .map(|(name, dtype, shape, data)| (name.to_string(), TensorView::new(*dtype, shape.clone(), data).unwrap()));
    let metadata = HashMap::from([("topology".to_string(), topology.to_string())]);
    std::fs::write(path, safetensors::serialize(views, Some(metadata)).unwrap()).unwrap();
}

fn f32_bytes(values: &[f32]) -> Vec<u8> {
    values.iter().flat_map(|x| x.to_le_bytes()).collect()
}

#[test]
fn eval_prints_the_scores_under_their_names() {
    let folder = tempfile::tempdir().unwrap();
    let (pred, target) = (folder.path().join("a.safetensors"), folder.path().join("b.safetensors"));
    let shape = vec![6, N_FIELD];
    let truth = field(6, 1.0);
    let guess = field(6, 0.5);
    let sure: Vec<f32> = truth.iter().map(|f| if *f > 0.0 { 0.9 } else { 0.2 }).collect();
    write(
        &pred,
        "mano",
        &[
            ("force", Dtype::F32, shape.clone(), f32_bytes(&guess)),
            ("contact", Dtype::F32, shape.clone(), f32_bytes(&sure)),
        ],
    );
    // Truth in f64, contact from force, the last vertex of the touched ones masked out.
    let mask = (0..6 * N_FIELD).map(|i| u8::from(i % N_FIELD != 9)).collect();
    write(
        &target,
        "mano",
        &[
            ("force", Dtype::F64, shape.clone(), truth.iter().flat_map(|x| f64::from(*x).to_le_bytes()).collect()),
            ("mask_force", Dtype::BOOL, shape.clone(), mask),
        ],
    );
    let [pred, target] = [&pred, &target].map(|p| p.to_str().unwrap());
    let output = egotac(&["eval", "--pred", pred, "--target", target, "--fps", "30", "--json"]);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let json: Value = serde_json::from_slice(&output.stdout).unwrap();
    // The error is half of 1..6 N on nine vertices: 1.75 N on average.
    assert!((json["active_mae"].as_f64().unwrap() - 1.75).abs() < 1e-6, "{json:#}");
    assert!((json["mae"].as_f64().unwrap() - 1.75 * 9.0 / (N_FIELD - 1) as f64).abs() < 1e-9);
    assert!((json["temporal_pearson"].as_f64().unwrap() - 1.0).abs() < 1e-9);
    for part in ["frame_mean", "pooled"] {
        for score in ["precision", "recall", "f1", "iou", "auroc"] {
            assert_eq!(json[part][score], 1.0, "{part}.{score}");
        }
    }
    for score in ["force_cosine", "rise_f1", "dft_pearson"] {
        assert!((json[score].as_f64().unwrap() - 1.0).abs() < 0.2, "{score}: {json:#}");
    }
    assert_eq!(json["fall_f1"], Value::Null, "nothing ever falls");
    assert_eq!(json["dominant_frequency_error_hz"], 0.0);
    let table = String::from_utf8(egotac(&["eval", "--pred", pred, "--target", target]).stdout).unwrap();
    assert!(table.contains("active MAE (N)") && table.contains("undefined") && table.contains("1.75000"), "{table}");
}

#[test]
fn eval_refuses_invalid_input_with_one_line() {
    let folder = tempfile::tempdir().unwrap();
    let file = |name: &str| folder.path().join(name).to_str().unwrap().to_string();
    let force = |frames: usize| ("force", Dtype::F32, vec![frames, N_FIELD], f32_bytes(&field(frames, 1.0)));
    write(Path::new(&file("six")), "mano", &[force(6)]);
    write(Path::new(&file("five")), "mano", &[force(5)]);
    write(Path::new(&file("ours")), "egotac-hand-1", &[force(6)]);
    write(Path::new(&file("flat")), "mano", &[("force", Dtype::F32, vec![N_FIELD], f32_bytes(&field(1, 1.0)))]);
    write(Path::new(&file("other")), "mano", &[("pressure", Dtype::U8, vec![1], vec![0])]);
    std::fs::write(file("text"), "no tensors").unwrap();
    std::fs::write(file("range"), r#"{"min": 3, "max": 3}"#).unwrap();
    for (pred, extra, word) in [
        ("five", None, "5 frames"),
        ("ours", None, "topology"),
        ("flat", None, "force"),
        ("other", None, "pressure"),
        ("text", None, "safetensors"),
        ("absent", None, "absent"),
        ("six", Some("range"), "min < max"),
    ] {
        let (pred, target) = (file(pred), file("six"));
        let mut args = vec!["eval", "--pred", &pred, "--target", &target];
        let extra = extra.map(file);
        extra.iter().for_each(|extra| args.extend(["--calibration", extra]));
        let output = egotac(&args);
        let error = String::from_utf8(output.stderr).unwrap();
        assert!(!output.status.success() && error.contains(word) && error.lines().count() == 1, "{word}: {error}");
    }
}

#[test]
fn eval_also_scores_hands_regions_and_another_estimator() {
    let folder = tempfile::tempdir().unwrap();
    let file = |name: &str| folder.path().join(name).to_str().unwrap().to_string();
    let ends = ("episode_ends", Dtype::I64, vec![3], [4i64, 8, 12].iter().flat_map(|x| x.to_le_bytes()).collect());
    let force = |scale: f32| {
        // One vertex of each hand has a force that grows from frame to frame.
        let values: Vec<f32> = (0..12 * N_FIELD)
            .map(|i| if [100, 778 + 300].contains(&(i % N_FIELD)) { scale * (1 + i / N_FIELD % 4) as f32 } else { 0.0 })
            .collect();
        ("force", Dtype::F32, vec![12, N_FIELD], f32_bytes(&values))
    };
    write(Path::new(&file("truth")), "egotac-hand-1", &[force(1.0), ends]);
    write(Path::new(&file("pred")), "egotac-hand-1", &[force(0.9)]);
    write(Path::new(&file("other")), "egotac-hand-1", &[force(0.5)]);
    let (pred, truth, other) = (file("pred"), file("truth"), file("other"));
    let json = |more: &[&str]| -> Value {
        let output = egotac(&[&["eval", "--pred", &pred, "--target", &truth, "--json"], more].concat());
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        serde_json::from_slice(&output.stdout).unwrap()
    };
    let all = json(&["--by", "side,region", "--against", &other]);
    // 2.5 N on average; a tenth and a half of it are the errors.
    assert!((all["active_mae"].as_f64().unwrap() - 0.25).abs() < 1e-6);
    let difference = |name: &str| {
        all["against"]["differences"].as_array().unwrap().iter().find(|d| d["name"] == name).unwrap().clone()
    };
    let active = difference("active_mae");
    assert!((active["other"].as_f64().unwrap() - 1.25).abs() < 1e-6, "{active}");
    assert!((active["difference"].as_f64().unwrap() + 1.0).abs() < 1e-6);
    let interval: Vec<f64> = active["interval"].as_array().unwrap().iter().map(|x| x.as_f64().unwrap()).collect();
    assert!(interval.iter().all(|x| (x + 1.0).abs() < 1e-6), "all episodes are alike: {interval:?}");
    assert_eq!(difference("pooled.f1")["difference"], 0.0);
    let entries = |value: &Value| value["counts"]["active_entries"].as_u64().unwrap();
    let sides = &all["by"]["side"];
    assert_eq!((entries(&sides["left"]), entries(&sides["right"]), entries(&all)), (12, 12, 24));
    let regions: u64 = all["by"]["region"].as_object().unwrap().values().map(entries).sum();
    assert_eq!(regions, 24, "each vertex is in one region");
    let right = json(&["--right-hand-only"]);
    assert_eq!((entries(&right), right["counts"]["force_entries"].as_u64().unwrap()), (12, 12 * 778));
    let table = egotac(&["eval", "--pred", &pred, "--target", &truth, "--by", "region", "--against", &other]).stdout;
    let table = String::from_utf8(table).unwrap();
    assert!(table.contains("95 % interval") && table.contains("thumb_tip") && table.contains("3 episodes"), "{table}");
    // An estimator of right-hand contact only: force and the left hand are unknown.
    let contact: Vec<f32> = (0..12 * N_FIELD)
        .map(|i| match i % N_FIELD {
            0..778 => f32::NAN,
            vertex => f32::from(vertex == 778 + 300 || vertex == 778 + 301),
        })
        .collect();
    write(
        Path::new(&file("contact")),
        "egotac-hand-1",
        &[("contact", Dtype::F32, vec![12, N_FIELD], f32_bytes(&contact))],
    );
    let right = json(&["--right-hand-only", "--against", &file("contact")]);
    let other = &right["against"]["other"];
    assert_eq!((&other["pooled"]["precision"], &other["pooled"]["recall"]), (&0.5.into(), &1.0.into()));
    assert!(other["mae"].is_null() && right["mae"].is_number(), "{other}");
    let both = json(&["--against", &file("contact")]);
    assert!(both["against"]["other"]["pooled"]["f1"].is_null(), "nothing is known of the left hand");
    // Regions of MANO need the MANO files; an estimate of another length or topology is refused, with its name.
    write(Path::new(&file("mano")), "mano", &[force(1.0)]);
    let mano = file("mano");
    let refused = |args: &[&str]| String::from_utf8(egotac(args).stderr).unwrap();
    let error = refused(&["eval", "--pred", &mano, "--target", &mano, "--by", "region"]);
    assert!(error.contains("--mano-left"), "{error}");
    let error = refused(&["eval", "--pred", &pred, "--target", &truth, "--by-scene"]);
    assert!(error.contains("--by scene: expected truth from stores"), "{error}");
    // Two predictions that see no image stand beside it: no touch at all, and the truth of the frame before.
    let baselines = &all["baselines"];
    assert_eq!(
        (&baselines["zero"]["frame_mean"]["f1"], &baselines["zero"]["temporal_pearson"]),
        (&0.0.into(), &0.0.into())
    );
    // Force grows by 1 N per frame, from nothing.
    assert!((baselines["persistence"]["active_mae"].as_f64().unwrap() - 1.0).abs() < 1e-6, "{baselines:#}");
    assert_eq!(baselines["persistence"]["frame_mean"]["f1"], 0.75, "the first of four frames has no frame before");
    assert!(all["persistence_secs"].is_null() && all["episodes_defined"]["temporal_pearson"] == 3);
    let interval: Vec<f64> = serde_json::from_value(all["intervals"]["active_mae"].clone()).unwrap();
    assert!(interval.iter().all(|x| (x - 0.25).abs() < 1e-6), "all episodes are alike: {interval:?}");
    let error = refused(&["eval", "--pred", &pred, "--target", &truth, "--against", &mano]);
    assert!(error.contains("mano") && error.contains("topology"), "{error}");
}

#[test]
fn eval_measures_a_calibration_and_scores_by_scene_and_source() {
    let folder = tempfile::tempdir().unwrap();
    let file = |name: &str| folder.path().join(name).to_str().unwrap().to_string();
    for (store, scene, peak) in [("a.zarr", "poke", 2.0), ("split.zarr", "wipe", 8.0)] {
        write_store(Path::new(&file(store)), scene, peak);
    }
    // Predictions in another unit: ten times the truth.
    let louder = |peak: f32| f32_bytes(&store_force(10.0 * peak));
    write(Path::new(&file("pred_a")), "mano", &[("force", Dtype::F32, vec![4, N_FIELD], louder(2.0))]);
    write(Path::new(&file("pred_split")), "mano", &[("force", Dtype::F32, vec![4, N_FIELD], louder(8.0))]);

    let (store, pred, split, split_pred, out) =
        (file("a.zarr"), file("pred_a"), file("split.zarr"), file("pred_split"), file("ranges.json"));
    let base = ["eval", "--pred", &pred, "--target", &store, "--json"];
    let json = |more: &[&str]| -> Value {
        let output = egotac(&[&base[..], more].concat());
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        serde_json::from_slice(&output.stdout).unwrap()
    };
    let from = ["--calibration-from", &split, "--calibration-pred", &split_pred];
    let measured = json(&[&from[..], &["--calibration-out", &out]].concat());
    let ranges: Value = serde_json::from_str(&std::fs::read_to_string(&out).unwrap()).unwrap();
    assert_eq!(ranges, serde_json::json!({"pred": {"min": 0.0, "max": 80.0}, "target": {"min": 0.0, "max": 8.0}}));
    assert_eq!(measured["calibration"], ranges);
    // The written file gives the same scores. Normalised traces are equal, those in newtons are not.
    assert_eq!(json(&["--calibration", &out]), measured);
    assert!(measured["spectral_convergence"].as_f64().unwrap() < 1e-6, "{measured:#}");
    assert!(json(&[])["spectral_convergence"].as_f64().unwrap() > 8.0);

    let refused = |more: &[&str]| String::from_utf8(egotac(&[&base[..], more].concat()).stderr).unwrap();
    assert!(refused(&["--calibration-from", &split]).contains("give --calibration-pred"));
    assert!(refused(&[&from[..], &["--calibration", &out]].concat()).contains("cannot be used with"));
    assert!(refused(&["--by", "colour"]).contains("scene, source, side, region"));

    let by = json(&["--by", "scene,source", "--by-scene"]);
    let names = |by: &Value| by.as_object().unwrap().keys().cloned().collect::<Vec<_>>();
    assert_eq!((names(&by["by"]["scene"]), names(&by["by"]["source"])), (vec!["poke".into()], vec!["a.zarr".into()]));
    assert_eq!(by["by"]["scene"]["poke"]["counts"], by["counts"]);

    // EgoPHI's protocol has other thresholds and averages, and no groups.
    let other = json(&["--protocol", "egophi"]);
    assert_eq!((&other["protocol"], &other["hands"], &other["f1"]), (&"egophi".into(), &3.into(), &1.0.into()));
    // Nine times the true force, (1, 2 and 1 N on one vertex); nothing else is touched.
    assert!((other["masked_mae"].as_f64().unwrap() - 9.0 * 4.0 / 3.0).abs() < 1e-6, "{other:#}");
    assert!((other["volumetric_iou"].as_f64().unwrap() - 0.1).abs() < 1e-6);
    assert_eq!(other["baselines"]["zero"]["recall"], 0.0);
    assert!(refused(&["--protocol", "egophi", "--by-scene"]).contains("without --by"));
}

/// Four frames in which the force on one vertex rises to `peak` and falls: 0, half, all, half.
fn store_force(peak: f32) -> Vec<f32> {
    let at = |frame: usize| [0.0, 0.5, 1.0, 0.5][frame] * peak;
    (0..4 * N_FIELD).map(|i| if i % N_FIELD == 900 { at(i / N_FIELD) } else { 0.0 }).collect()
}

/// Writes a store of one episode with that force.
fn write_store(path: &Path, scene: &str, peak: f32) {
    let attributes = Attributes {
        topology: Topology::Mano,
        sigma: 0.0,
        contact_force: 0.05,
        producer: "test".into(),
        version: "1".into(),
        scene: scene.into(),
        seed: 0,
    };
    let mut writer = ZarrWriter::create(path, attributes, Contact::Truth, Vec::new()).unwrap();
    for (at, force) in store_force(peak).chunks(N_FIELD).enumerate() {
        writer
            .push(Frame {
                timestamp: 0.04 * at as f64,
                camera_ego_rgb: RgbImage::new(8, 8),
                field: TactileField::from_force(Topology::Mano, force.to_vec()).unwrap(),
                force_valid: vec![1; N_FIELD],
                contact_valid: vec![1; N_FIELD],
                validity: Validity::Valid,
                left_hand_pose: None,
                right_hand_pose: None,
            })
            .unwrap();
    }
    writer.end_episode().unwrap();
    writer.finish().unwrap();
}
