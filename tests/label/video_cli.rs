//! `egotac label` and `egotac predict` on videos and folders of images; other output formats; `egotac data` on the outputs.

use std::fs;
use std::path::Path;
use std::process::Command;

use crate::common::egotac;
use egotac::dataset::EpisodeReader;
use egotac::dataset::tensors;
use egotac::dataset::video::{VideoFrames, damage, probe};
use egotac::dataset::zarr::ZarrReader;
use egotac::model::predictor::{Options, Predictor};
use egotac::model::{Unknown, shipped};
use image::{Rgb, RgbImage};
use serde_json::Value;

fn json(args: &[&str], status: i32) -> Value {
    let output = egotac(args);
    assert_eq!(output.status.code(), Some(status), "{args:?}: {}", String::from_utf8_lossy(&output.stderr));
    serde_json::from_slice(&output.stdout).unwrap()
}

fn picture(index: u32) -> RgbImage {
    RgbImage::from_fn(64, 48, |x, y| Rgb([(4 * x) as u8, (5 * y) as u8, (20 * index) as u8]))
}

/// Writes images 0..n into a folder: frame_0.png and so on.
fn images(folder: &Path, n: u32) {
    fs::create_dir(folder).unwrap();
    for index in 0..n {
        picture(index).save(folder.join(format!("frame_{index}.png"))).unwrap();
    }
}

/// Encodes a folder of images as a video of 10 frames per second; `more` are further options of ffmpeg.
fn video(images: &Path, out: &Path, more: &[&str]) {
    let mut command = Command::new("ffmpeg");
    command.args(["-v", "error", "-y", "-framerate", "10", "-i"]).arg(images.join("frame_%d.png"));
    let status = command.args(more).arg(out).status().expect("ffmpeg: `make setup` installs it");
    assert!(status.success());
}

fn predictions(stamped: impl IntoIterator<Item = (f64, RgbImage)>) -> Vec<egotac::TactileField> {
    let options = Options { max_gap_secs: None, unknown: Unknown::Guess, ..Options::default() };
    let mut predictor = Predictor::load(&shipped::path().unwrap(), options).unwrap();
    stamped.into_iter().map(|(stamp, image)| predictor.push(&image, stamp).unwrap().field).collect()
}

#[test]
fn every_frame_of_a_video_is_read_once_with_its_time() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    images(&at("in"), 12);
    // Lossless, so that the decoded pixels are known.
    video(&at("in"), &at("plain.mkv"), &["-c:v", "ffv1", "-pix_fmt", "bgr0"]);
    let frames: Vec<(f64, RgbImage)> = VideoFrames::open(&at("plain.mkv"), None).unwrap().map(Result::unwrap).collect();
    assert_eq!(frames.len(), 12);
    for (index, (stamp, image)) in frames.iter().enumerate() {
        assert!((stamp - 0.1 * index as f64).abs() < 1e-3, "{index}: {stamp}");
        assert!(*image == picture(index as u32), "{index}");
    }
    // Frames 3 to 5 are dropped: the others keep their times, and none is repeated to fill the gap.
    let uneven = ["-vf", "select=not(between(n\\,3\\,5))", "-vsync", "vfr", "-c:v", "ffv1", "-pix_fmt", "bgr0"];
    video(&at("in"), &at("uneven.mkv"), &uneven);
    let stamps: Vec<f64> = VideoFrames::open(&at("uneven.mkv"), None).unwrap().map(|frame| frame.unwrap().0).collect();
    let expected = [0.0, 0.1, 0.2, 0.6, 0.7, 0.8, 0.9, 1.0, 1.1];
    assert!(stamps.len() == 9 && stamps.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-3), "{stamps:?}");
    // Seeking: frames from a time on.
    let late: Vec<f64> =
        VideoFrames::open(&at("plain.mkv"), Some(0.65)).unwrap().map(|frame| frame.unwrap().0).collect();
    assert!(late.len() == 5 && (late[0] - 0.7).abs() < 1e-3, "{late:?}");
    assert_eq!(probe(&at("plain.mkv")).unwrap().size, (64, 48));
    assert_eq!(damage(&at("plain.mkv"), 12).unwrap(), None);
    fs::write(at("no.mp4"), b"nothing").unwrap();
    assert!(probe(&at("no.mp4")).is_err());
}

#[test]
fn videos_of_more_than_eight_bits_per_channel_give_the_same_images() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    images(&at("in"), 12);
    for format in ["gbrp12le", "gbrp16le", "gray16le"] {
        let file = at(format).with_extension("mkv");
        video(&at("in"), &file, &["-c:v", "ffv1", "-pix_fmt", format]);
        let frames: Vec<RgbImage> = VideoFrames::open(&file, None).unwrap().map(|frame| frame.unwrap().1).collect();
        assert_eq!(frames.len(), 12, "{format}");
        for (index, image) in frames.iter().enumerate().filter(|_| format != "gray16le") {
            let differ = image.iter().zip(picture(index as u32).iter()).any(|(got, own)| got.abs_diff(*own) > 1);
            assert!(!differ, "{format} {index}");
        }
    }
}

#[test]
fn a_damaged_video_gives_the_images_of_one_thread() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    images(&at("in"), 30);
    video(&at("in"), &at("whole.mkv"), &["-c:v", "libx264", "-qp", "8"]);
    let whole = fs::read(at("whole.mkv")).unwrap();
    for seed in 1..5_u64 {
        let (mut bytes, mut random) = (whole.clone(), seed);
        for bit in 0..60 {
            random = random.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            let place = whole.len() / 4 + (random >> 33) as usize % (whole.len() * 3 / 4);
            bytes[place] ^= 1 << (bit % 8);
        }
        fs::write(at("damaged.mkv"), bytes).unwrap();
        let mut reference = Command::new("ffmpeg");
        reference.args(["-v", "quiet", "-threads", "1", "-i"]).arg(at("damaged.mkv"));
        reference.args(["-map", "0:v:0", "-fps_mode", "passthrough", "-f", "rawvideo", "-pix_fmt", "rgb24", "-"]);
        let expected = reference.output().unwrap().stdout;
        let frames = VideoFrames::open(&at("damaged.mkv"), None).unwrap();
        let pixels: Vec<u8> = frames.flat_map(|frame| frame.unwrap().1.into_raw()).collect();
        // Threads that decode frames side by side replace lost blocks by those of other frames, as they come upon them.
        assert!(!pixels.is_empty() && pixels == expected, "seed {seed}: {} bytes of {}", pixels.len(), expected.len());
    }
}

#[test]
fn a_video_becomes_a_store_with_labels() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    images(&at("in"), 10);
    video(&at("in"), &at("clip.mkv"), &["-c:v", "ffv1", "-pix_fmt", "bgr0"]);
    let [clip, out] = ["clip.mkv", "clip.zarr"].map(|name| at(name).to_str().unwrap().to_string());
    let done = json(&["label", &clip, "--out", &out, "--size", "24", "--unknown", "guess", "--json", "-"], 0);
    assert_eq!(done["summary"]["labelled"], 10);
    let store = ZarrReader::open(Path::new(&out)).unwrap();
    assert_eq!((store.len(), store.image_size()), (10, (24, 32)));
    let expected = predictions((0..10).map(|index| (0.1 * f64::from(index), picture(index))));
    for (index, expected) in expected.iter().enumerate() {
        assert_eq!(store.frame(index).unwrap().field, *expected, "image {index}");
    }
    let info = json(&["data", "info", &clip, "--json"], 0);
    assert_eq!((&info["kind"], &info["image"]["width"]), (&"video".into(), &64.into()));
}

#[test]
fn a_truncated_video_is_labelled_up_to_its_end() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    images(&at("in"), 40);
    // The index lies in front and still lists all frames.
    video(&at("in"), &at("whole.mp4"), &["-c:v", "mjpeg", "-movflags", "faststart"]);
    let bytes = fs::read(at("whole.mp4")).unwrap();
    fs::write(at("cut.mp4"), &bytes[..bytes.len() * 6 / 10]).unwrap();
    let [cut, out] = ["cut.mp4", "cut.zarr"].map(|name| at(name).to_str().unwrap().to_string());
    let done = json(&["label", &cut, "--out", &out, "--unknown", "guess", "--json", "-"], 3);
    let labelled = done["summary"]["labelled"].as_u64().unwrap();
    assert!((10..40).contains(&labelled), "{done}");
    let lost = &done["summary"]["lost"][0];
    assert!(lost["reason"].as_str().unwrap().starts_with(&format!("{labelled} of 40 images")), "{lost}");
    assert_eq!(ZarrReader::open(Path::new(&out)).unwrap().len() as u64, labelled);
}

#[test]
fn labels_are_the_same_in_every_output_format() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name).to_str().unwrap().to_string();
    images(Path::new(&at("in")), 12);
    fs::write(format!("{}/frame_7.png", at("in")), b"not an image").unwrap();
    let expected = predictions((0..12).filter(|i| *i != 7).map(|index| (f64::from(index) / 20.0, picture(index))));
    for (kind, out) in [("store", "a.zarr"), ("tensors", "b.safetensors"), ("bag", "c")] {
        let done = json(
            &["label", &at("in"), "--out", &at(out), "--to", kind, "--fps", "20", "--unknown", "guess", "--json", "-"],
            3,
        );
        assert_eq!(done["summary"]["faults"][0]["frame"], 7);
        let info = json(&["data", "info", &at(out), "--json"], 0);
        let about = if kind == "store" { &info["attributes"]["egotac_labels"] } else { &info["labels"] };
        assert_eq!(about["summary"]["labelled"], 11, "{info}");
        // Whatever the format, the labels are the same: no difference, and the unlabelled frame counts for neither.
        let diff = json(&["data", "diff", &at(out), &at("a.zarr"), "--json"], 0);
        assert_eq!((&diff["mae"], &diff["unmatched"]["a"]), (&0.0.into(), &0.into()), "{kind}");
        assert_eq!(diff["counts"]["force_entries"], 11 * 1556);
    }
    let tensors = tensors::read(Path::new(&at("b.safetensors"))).unwrap();
    assert_eq!(tensors.episode_ends, [12]);
    for (frame, expected) in (0..12).filter(|i| *i != 7).zip(&expected) {
        assert_eq!(tensors.force[frame * 1556..(frame + 1) * 1556], expected.force);
    }
    // With unequal numbers of frames, frames pair by time.
    fs::remove_file(format!("{}/frame_11.png", at("in"))).unwrap();
    json(&["label", &at("in"), "--out", &at("d.zarr"), "--fps", "20", "--unknown", "guess", "--json", "-"], 3);
    let diff = json(&["data", "diff", &at("d.zarr"), &at("c"), "--json"], 0);
    assert_eq!((&diff["unmatched"]["b"], &diff["mae"]), (&1.into(), &0.0.into()));
    // The unlabelled frame and the one without a partner are gaps.
    let counts = &diff["counts"];
    assert_eq!(counts["trace_frames"], 10, "{counts}");
}

#[test]
fn a_folder_is_predicted_in_the_order_of_its_numbers() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name).to_str().unwrap().to_string();
    fs::create_dir(at("in")).unwrap();
    for index in 1..=12 {
        picture(index).save(format!("{}/frame_{index}.png", at("in"))).unwrap();
    }
    let output = egotac(&["predict", "--data", &at("in"), "--fps", "25", "--unknown", "guess", "--out", &at("fields")]);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    assert_eq!(String::from_utf8(output.stdout).unwrap(), format!("{}: 12 frames\n", at("fields")));
    let fields = tensors::read(Path::new(&at("fields"))).unwrap();
    let expected = predictions((0..12).map(|index| (f64::from(index) / 25.0, picture(index + 1))));
    for (frame, expected) in expected.iter().enumerate() {
        assert_eq!(fields.field(frame).unwrap(), *expected, "frame_{}", frame + 1);
    }
    // The same arrays as those of `label`; an image that can't be read is an error that names it.
    json(
        &[
            "label",
            &at("in"),
            "--out",
            &at("labels"),
            "--to",
            "tensors",
            "--fps",
            "25",
            "--unknown",
            "guess",
            "--json",
            "-",
        ],
        0,
    );
    assert_eq!(tensors::read(Path::new(&at("labels"))).unwrap(), fields);
    fs::write(format!("{}/frame_7.png", at("in")), b"not an image").unwrap();
    let output = egotac(&["predict", "--data", &at("in"), "--out", &at("fields")]);
    assert!(!output.status.success() && String::from_utf8_lossy(&output.stderr).contains("frame_7.png"));
    assert_eq!(tensors::read(Path::new(&at("fields"))).unwrap(), fields, "the earlier file stays");
}

#[test]
fn a_folder_of_recordings_is_labelled_one_by_one() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    fs::create_dir(at("all")).unwrap();
    images(&at("all/table"), 3);
    images(&at("all/wall"), 2);
    fs::copy("tests/data/oxt/many.zip", at("all/many.zip")).unwrap();
    let (input, out) = (at("all").to_str().unwrap().to_string(), at("out"));
    let done = json(&["label", &input, "--out", out.to_str().unwrap(), "--unknown", "guess", "--json", "-"], 0);
    assert_eq!(done["summary"]["labelled"], 3 + 2 + 24);
    let manifest: Value = serde_json::from_str(&fs::read_to_string(out.join("manifest.json")).unwrap()).unwrap();
    assert_eq!((&manifest["summary"]["frames"], &manifest["missing"]), (&29.into(), &serde_json::json!([])));
    assert_eq!(manifest["outputs"][3]["output"], "wall.zarr");
    for (name, frames) in
        [("table.zarr", 3), ("wall.zarr", 2), ("many/batch_000.zarr", 12), ("many/batch_001.zarr", 12)]
    {
        assert_eq!(ZarrReader::open(&out.join(name)).unwrap().len(), frames, "{name}");
    }
}

#[test]
fn an_unreadable_recording_does_not_stop_the_others() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    fs::create_dir(at("all")).unwrap();
    fs::write(at("all/a_bag.mcap"), b"not a bag").unwrap();
    fs::write(at("all/b_store.zarr.zip"), b"not a zip file").unwrap();
    fs::write(at("all/c_film.mp4"), b"not a film").unwrap();
    images(&at("all/table"), 3);
    let (input, out) = (at("all").to_str().unwrap().to_string(), at("out"));
    let done = json(&["label", &input, "--out", out.to_str().unwrap(), "--unknown", "guess", "--json", "-"], 3);
    assert_eq!(done["summary"]["labelled"], 3);
    let manifest: Value = serde_json::from_str(&fs::read_to_string(out.join("manifest.json")).unwrap()).unwrap();
    let names = |list: &Value| -> Vec<String> {
        list.as_array().unwrap().iter().map(|entry| entry["input"].as_str().unwrap().to_string()).collect()
    };
    let broken = ["a_bag.mcap", "b_store.zarr.zip", "c_film.mp4"];
    assert_eq!(
        (names(&done["failed"]), names(&manifest["unreadable"])),
        (broken.map(String::from).into(), broken.map(String::from).into())
    );
    assert_eq!(
        fs::read_dir(&out)
            .unwrap()
            .filter(|entry| !entry.as_ref().unwrap().file_name().to_string_lossy().starts_with('.'))
            .count(),
        2
    );

    fs::remove_dir_all(at("all/table")).unwrap();
    let none = egotac(&["label", &input, "--out", at("none").to_str().unwrap()]);
    assert_eq!(none.status.code(), Some(1));
    let told = String::from_utf8_lossy(&none.stderr).into_owned();
    assert!(broken.iter().all(|name| told.contains(name)) && told.contains("none of 3 recordings"), "{told}");
}

#[test]
fn a_closed_pipe_ends_the_command_without_an_error_text() {
    let mut child = Command::new(env!("CARGO_BIN_EXE_egotac"))
        .args(["data", "info", "tests/data/bag/table"])
        .stdout(std::process::Stdio::piped())
        .stderr(std::process::Stdio::piped())
        .spawn()
        .unwrap();
    drop(child.stdout.take());
    let output = child.wait_with_output().unwrap();
    assert_eq!(String::from_utf8_lossy(&output.stderr), "");
    assert_eq!(output.status.code(), Some(141));
}
