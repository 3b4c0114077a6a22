//! Presence and keypoints are learned with all other weights frozen, by the library, by commands and at the end of a training.

use std::collections::BTreeMap;
use std::path::Path;

use candle_core::Device;
use egotac::dataset::zarr::{ArraySpec, CAMERA_POSE, Contact, Dtype, Values, ZarrReader, ZarrWriter};
use egotac::dataset::{Attributes, EpisodeWriter, Frame};
use egotac::hand::{HandModel, HandParams, Side, Topology};
use egotac::model::predictor::{Options, Predictor};
use egotac::model::{Checkpoint, Config, checkpoint};
use egotac::tactile::{N_FIELD, TactileField, Validity};
use egotac::train::data::Dataset;
use egotac::train::presence::{self, Settings};
use glam::Vec3;
use image::{Rgb, RgbImage};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde_json::{Value, json};

use crate::common::{egotac, network};

const SIDE: u32 = 56;
const FOCAL: f32 = 60.0;

/// Writes episodes of 20 frames: in even ones a left hand, drawn as bright dots on its vertices, moves before a dark, noisy
/// background; in odd ones there is none. A quarter of its vertices is touched.
fn write_store(path: &Path, episodes: usize, seed: u64) {
    let attributes = Attributes {
        topology: Topology::EgotacHand1,
        sigma: 0.0,
        contact_force: 0.05,
        producer: "test".into(),
        version: "1".into(),
        scene: "floating".into(),
        seed,
    };
    let extra = vec![ArraySpec::new(CAMERA_POSE, [7], Dtype::F32)];
    let mut writer = ZarrWriter::create(path, attributes, Contact::Truth, extra).unwrap();
    let centre = 0.5 * SIDE as f32;
    let intrinsics = json!({ "fx": FOCAL, "fy": FOCAL, "cx": centre, "cy": centre });
    writer.set_attribute("episodes", json!(vec![json!({ "intrinsics": intrinsics }); episodes]));
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let model = HandModel::builtin(Side::Left);
    for episode in 0..episodes {
        for t in 0..20 {
            let mut image = RgbImage::from_fn(SIDE, SIDE, |_, _| Rgb([rng.random_range(0..60); 3]));
            let mut force = vec![0.0; N_FIELD];
            let hand = (episode % 2 == 0).then(|| {
                let mut within = |half: f32| rng.random_range(-half..half);
                HandParams { transl: Vec3::new(within(0.12), within(0.12), 0.4), ..HandParams::default() }
            });
            if let Some(hand) = &hand {
                for vertex in model.forward(hand).vertices {
                    let pixel = [vertex.x, vertex.y].map(|x| centre + FOCAL * x / vertex.z);
                    if pixel.iter().all(|p| (0.0..SIDE as f32).contains(p)) {
                        image.put_pixel(pixel[0] as u32, pixel[1] as u32, Rgb([240, 190, 160]));
                    }
                }
                force[..200].fill_with(|| rng.random_range(0.2..1.2));
            }
            let frame = Frame {
                timestamp: 0.04 * f64::from(t),
                camera_ego_rgb: image,
                field: TactileField::from_force(Topology::EgotacHand1, force).unwrap(),
                force_valid: vec![1; N_FIELD],
                contact_valid: vec![1; N_FIELD],
                validity: Validity::Valid,
                left_hand_pose: hand,
                right_hand_pose: None,
            };
            writer.push_with(frame, vec![(CAMERA_POSE, Values::F32(vec![0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]))]).unwrap();
        }
        writer.end_episode().unwrap();
    }
    writer.finish().unwrap();
}

/// Saves a toy network with random weights.
fn save_toy(path: &Path) {
    network::save(path, &Config::toy(), BTreeMap::new());
}

fn run(arguments: &[&str]) -> String {
    let output = egotac(arguments);
    let [out, err] = [output.stdout, output.stderr].map(|bytes| String::from_utf8(bytes).unwrap());
    assert!(output.status.success(), "{arguments:?}: {out}{err}");
    out
}

#[test]
fn presence_of_a_drawn_hand_is_learned_from_frozen_tokens() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    save_toy(&at("toy"));
    write_store(&at("a.zarr"), 20, 1);
    let network = Checkpoint::load(&at("toy"), &Device::Cpu).unwrap();
    let preparation = network.metadata.preparation(&Config::toy());
    let mut data = Dataset::new(vec![ZarrReader::open(&at("a.zarr")).unwrap()], preparation, false).unwrap();
    data.find_keypoints().unwrap();
    let settings = Settings { frames: 400, epochs: 30, seed: 2 };
    let fit = || presence::fit(&network.model, &data, None, &settings, None, &mut |_, _| ()).unwrap();
    let fitted = fit();
    // A random encoder of two layers sees brightness, which is enough for presence as it is.
    assert!(fitted.score.auroc.unwrap() > 0.97, "{}", fitted.score);
    assert!(fitted.score.present > 20 && fitted.score.missed * 5 <= fitted.score.present, "{}", fitted.score);
    assert!(fitted.score.absent > 60 && fitted.score.invented * 5 <= fitted.score.absent, "{}", fitted.score);
    // Uniform guesses are 0.52 of the side away on average.
    assert!(fitted.score.keypoint_error < 0.2, "{}", fitted.score);
    for (name, tensor) in fit().tensors {
        let [again, before] =
            [&tensor, &fitted.tensors[&name]].map(|t| t.flatten_all().unwrap().to_vec1::<f32>().unwrap());
        assert_eq!(again, before, "{name}: the fit is repeatable");
    }
}

#[test]
fn the_commands_add_presence_and_calibration_and_leave_the_network_as_it_is() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    save_toy(Path::new(&at("toy")));
    write_store(Path::new(&at("a.zarr")), 10, 1);
    write_store(Path::new(&at("b.zarr")), 4, 2);
    let text = run(&[
        "model",
        "presence",
        "--checkpoint",
        &at("toy"),
        "--data",
        &at("a.zarr"),
        "--held-out",
        &at("b.zarr"),
        "--epochs",
        "8",
        "--threshold",
        "0.25",
        "--out",
        &at("with"),
    ]);
    assert!(text.contains("AUROC of presence") && text.contains("unknown below 0.25"), "{text}");
    let text =
        run(&["model", "calibrate", "--checkpoint", &at("with"), "--data", &at("a.zarr"), "--out", &at("calibrated")]);
    assert!(text.contains("temperature") && text.contains("200 frames"), "{text}");

    let load = |name: &str| checkpoint::load_tensors(Path::new(&at(name))).unwrap();
    let ((_, _, before), (_, metadata, after)) = (load("toy"), load("calibrated"));
    for (name, tensor) in &before {
        let [before, after] = [tensor, &after[name]].map(|t| t.flatten_all().unwrap().to_vec1::<f32>().unwrap());
        assert_eq!(before, after, "{name}");
    }
    assert_eq!(metadata.doubt.presence, 0.25);
    assert!(metadata.contact_temperature > 0.0 && metadata.contact_temperature != 1.0);
    let info: Value =
        serde_json::from_str(&run(&["model", "info", "--checkpoint", &at("calibrated"), "--json"])).unwrap();
    assert_eq!((&info["presence"], &info["spread"], &info["familiarity"]), (&json!(true), &json!(true), &json!(false)));
    assert_eq!(info["metadata"]["presence_threshold"], "0.25");

    let eval = |checkpoint: &str| -> Value {
        let arguments =
            ["eval", "--checkpoint", &at(checkpoint), "--data", &at("a.zarr"), "--unknown", "guess", "--json"];
        serde_json::from_str(&run(&arguments)).unwrap()
    };
    let (plain, calibrated) = (eval("with"), eval("calibrated"));
    assert_eq!(plain["coverage"], Value::Null);
    assert_eq!(plain["pooled"]["f1"], calibrated["pooled"]["f1"], "the threshold stays where it was");
    let error = |of: &Value| of["reliability"]["expected_calibration_error"].as_f64().unwrap();
    assert!(error(&calibrated) < error(&plain), "{} {}", error(&calibrated), error(&plain));
    // Fitted to these frames, but to the hands whose touch is known alone.
    let known: Value =
        serde_json::from_str(&run(&["eval", "--checkpoint", &at("calibrated"), "--data", &at("a.zarr"), "--json"]))
            .unwrap();
    let share = known["coverage"]["pressed"].as_f64().unwrap();
    assert!((0.85..=0.97).contains(&share), "{}", known["coverage"]);
    assert!(known["unknown_share"].as_f64().unwrap() > 0.2, "half of the hands are not in the images: {known}");
    let table = run(&["eval", "--checkpoint", &at("calibrated"), "--data", &at("a.zarr")]);
    assert!(table.contains("expected calibration error") && table.contains("90 % intervals"), "{table}");
}

#[test]
fn a_training_with_the_keypoint_task_keeps_presence_and_one_without_it_does_not() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    write_store(&at("a.zarr"), 10, 1);
    for (weight, kept) in [(0.3, true), (0.0, false)] {
        let out = at(&format!("run_{kept}"));
        let config = json!({
            "name": "presence", "data": [at("a.zarr")], "out": out, "model": "toy", "seed": 1, "steps": 6,
            "loss": { "keypoints": weight },
        });
        let path = at("train.yaml");
        std::fs::write(&path, config.to_string()).unwrap();
        run(&["train", "--config", path.to_str().unwrap()]);
        let file = out.join("checkpoint.safetensors");
        let predictor = Predictor::load(&file, Options::default()).unwrap();
        assert_eq!(predictor.estimates_presence(), kept);
    }
}

#[test]
fn stores_without_poses_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    save_toy(Path::new(&at("toy")));
    crate::common::small_store(Path::new(&at("a.zarr")));
    let output = egotac(&["model", "presence", "--checkpoint", &at("toy"), "--data", &at("a.zarr"), "--out", &at("b")]);
    let error = String::from_utf8(output.stderr).unwrap();
    assert!(!output.status.success() && error.contains("camera and hand poses"), "{error}");
}
