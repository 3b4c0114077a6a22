//! Moments of recordings: the numbers of the source, predictions beside truth, and touch that is not known.

use std::process::Command;

use egotac::dataset::EpisodeReader;
use egotac::dataset::zarr::ZarrReader;
use egotac::model::predictor::{Options, Predictor};
use egotac::model::{Unknown, shipped};
use serde_json::json;

use crate::client::View;
use crate::common::store::write_bright_store;

#[test]
fn each_image_comes_with_the_touch_of_its_store_in_any_order() {
    let folder = tempfile::tempdir().unwrap();
    let store = folder.path().join("bright.zarr");
    write_bright_store(&store, 12);
    let reader = ZarrReader::open(&store).unwrap();
    let view = View::start(&[store.to_str().unwrap(), "--labels-only"]);
    let mut page = view.page(None).unwrap();
    for frame in [0, 1, 2, 11, 5, 4] {
        let answer = page.ask(&json!({ "source": 0, "frame": frame }).to_string());
        let stored = reader.frame(frame).unwrap();
        assert_eq!(answer.arrays["force"], stored.field.force, "{frame}");
        assert!((answer.head["stamp"].as_f64().unwrap() - stored.timestamp).abs() < 1e-9);
        let total: f32 = stored.field.force[..778].iter().sum();
        assert!((answer.head["total"][0].as_f64().unwrap() - f64::from(total)).abs() < 1e-3);
        // The image's red is the force: JPEG changes it little.
        let image = image::load_from_memory(&answer.jpeg).unwrap().to_rgb8();
        let [red, wanted] = [image.get_pixel(30, 30).0[0], stored.camera_ego_rgb.get_pixel(30, 30).0[0]];
        assert!(red.abs_diff(wanted) < 6, "{red} {wanted}");
    }
    assert_eq!(page.ask(r#"{"source": 0, "frame": 12}"#).head, json!({ "end": 12 }));
    assert!(page.ask(r#"{"source": 1}"#).head["failed"].is_string());
}

#[test]
fn a_store_with_truth_alone_gets_predictions_beside_it_as_the_predictor_makes_them() {
    let folder = tempfile::tempdir().unwrap();
    let store = folder.path().join("bright.zarr");
    write_bright_store(&store, 8);
    let view = View::start(&[store.to_str().unwrap(), "--unknown", "guess"]);
    let about: serde_json::Value = serde_json::from_str(&view.http("GET", "/about", &view.address).1).unwrap();
    assert_eq!((&about["sources"][0]["truth"], &about["sources"][0]["frames"]), (&json!(true), &json!(8)));
    let options = Options { unknown: Unknown::Guess, max_gap_secs: Some(f64::MAX), ..Options::default() };
    let mut predictor = Predictor::load(&shipped::path().unwrap(), options).unwrap();
    let reader = ZarrReader::open(&store).unwrap();
    let mut page = view.page(None).unwrap();
    for frame in 0..8 {
        let stored = reader.frame(frame).unwrap();
        let wanted = predictor.push(&stored.camera_ego_rgb, stored.timestamp).unwrap();
        let answer = page.ask(&json!({ "source": 0, "frame": frame }).to_string());
        assert_eq!(answer.arrays["force"], wanted.field.force, "{frame}");
        assert_eq!(answer.arrays["truth"], stored.field.force, "{frame}");
    }
}

#[test]
fn touch_in_images_that_the_network_does_not_know_is_unknown_and_not_zero() {
    let folder = tempfile::tempdir().unwrap();
    let video = folder.path().join("bars.mp4");
    let mut command = Command::new("ffmpeg");
    command.args(["-v", "error", "-f", "lavfi", "-i", "testsrc=size=320x240:rate=30:duration=1"]).arg(&video);
    assert!(command.status().unwrap().success());
    let view = View::start(&[video.to_str().unwrap()]);
    let mut page = view.page(None).unwrap();
    for frame in [0, 9] {
        let answer = page.ask(&json!({ "source": 0, "frame": frame }).to_string());
        assert_eq!(answer.head["total"], json!([null, null]));
        assert!(answer.head["regions"].as_array().unwrap().iter().all(serde_json::Value::is_null));
        assert!(answer.arrays["force"].iter().all(|force| force.is_nan()));
        assert!(answer.head["reason"].as_str().unwrap().contains("unlike those of the training"));
        assert!(answer.head["familiarity"].as_f64().unwrap() < 0.1);
    }
}
