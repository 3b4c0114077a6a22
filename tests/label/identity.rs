//! `egotac label` keeps the labels of different inputs apart, stops where a decoder dies, and removes what kills left.

use std::collections::BTreeMap;
use std::fs;
use std::os::unix::fs::{PermissionsExt, symlink};
use std::path::Path;
use std::process::{Command, Output};

use crate::common::egotac;
use crate::common::store::write_plain_store;
use egotac::TactileField;
use egotac::dataset::EpisodeReader;
use egotac::dataset::zarr::ZarrReader;
use egotac::hand::Topology;
use egotac::message::{CompressedImage, Header, Message, TactileFrame, Time};
use image::{ImageFormat, Rgb, RgbImage};
use mcap::records::MessageHeader;
use mcap::{MessageStream, WriteOptions};

fn label(input: &Path, out: &Path, more: &[&str]) -> Output {
    let [input, out] = [input, out].map(|path| path.to_str().unwrap());
    egotac(&[&["label", input, "--out", out, "--unknown", "guess"], more].concat())
}

fn succeeds(output: &Output) {
    assert!(output.status.success(), "{:?}: {}", output.status, errors(output));
}

fn errors(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

fn refused(output: &Output, words: &[&str]) {
    let error = errors(output);
    assert_eq!(output.status.code(), Some(1), "{error}");
    for word in words {
        assert!(error.contains(word), "{word}: {error}");
    }
}

fn picture(index: u32, shade: u8) -> RgbImage {
    RgbImage::from_fn(64, 48, |x, y| Rgb([(4 * x) as u8, (5 * y) as u8 ^ shade, (20 * index) as u8]))
}

fn images(folder: &Path, n: u32, shade: u8) {
    fs::create_dir_all(folder).unwrap();
    for index in 0..n {
        picture(index, shade).save(folder.join(format!("frame_{index}.png"))).unwrap();
    }
}

/// Writes a store of two episodes of four images.
fn store(path: &Path, shade: u8) {
    let touch = || TactileField::zeros(Topology::EgotacHand1);
    write_plain_store(path, &[4, 4], 0.1, |index| (picture(index as u32, shade), touch()));
}

/// Copies a folder as `cp -r`, so that the files get new times.
fn copy(from: &Path, to: &Path) {
    fs::create_dir_all(to.parent().unwrap()).unwrap();
    assert!(Command::new("cp").arg("-r").arg(from).arg(to).status().unwrap().success());
}

#[test]
fn labels_of_one_input_never_go_beside_the_images_of_another() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    // Two stores of one name with two episodes each, that differ in their pixels alone.
    for (name, shade) in [("a", 0), ("b", 64)] {
        fs::create_dir(at(name)).unwrap();
        store(&at(name).join("s.zarr"), shade);
    }
    let [a, b, out] = [at("a/s.zarr"), at("b/s.zarr"), at("out.zarr")];
    // A shard leaves its job unfinished, as a kill does.
    succeeds(&label(&a, &out, &["--shard", "0/2"]));
    refused(&label(&b, &out, &["--shard", "1/2"]), &["another input, store s.zarr", "a/s.zarr", "or remove"]);
    // The same content elsewhere, with other times, is the same input.
    copy(&a, &at("moved/s.zarr"));
    succeeds(&label(&at("moved/s.zarr"), &out, &["--shard", "1/2"]));
    assert_eq!(ZarrReader::open(&out).unwrap().episode_ends(), [4, 8]);
    refused(&label(&b, &out, &[]), &["holds the labels of another input, store s.zarr", "choose another output"]);
    let again = label(&at("moved/s.zarr"), &out, &[]);
    succeeds(&again);
    assert!(String::from_utf8_lossy(&again.stdout).contains("done before"));
}

#[test]
fn an_input_that_changes_before_the_resume_is_noticed() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    images(&at("in"), 6, 0);
    let out = at("out.zarr");
    // The other shard has the only unit: this one leaves an empty journal.
    succeeds(&label(&at("in"), &out, &["--shard", "1/2"]));
    picture(9, 0).save(at("in/frame_6.png")).unwrap();
    refused(&label(&at("in"), &out, &[]), &["as it was before it changed", "or remove"]);
    fs::remove_file(at("in/frame_6.png")).unwrap();
    succeeds(&label(&at("in"), &out, &[]));
}

#[test]
fn what_a_kill_left_is_removed_by_the_next_run() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    images(&at("in"), 3, 0);
    let out = at("out.zarr");
    succeeds(&label(&at("in"), &out, &[]));
    for name in [".out.zarr.unfinished", ".out.zarr.finished"] {
        fs::create_dir(at(name)).unwrap();
        fs::write(at(name).join("000000.labels"), b"left").unwrap();
    }
    succeeds(&label(&at("in"), &out, &[]));
    let mut names: Vec<_> = fs::read_dir(folder.path()).unwrap().map(|entry| entry.unwrap().file_name()).collect();
    names.sort();
    assert_eq!(names, ["in", "out.zarr"]);
}

#[test]
fn a_decoder_that_dies_stops_the_recording_and_the_next_run_goes_on() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    images(&at("in"), 12, 0);
    let clip = at("clip.mkv");
    let mut encode = Command::new("ffmpeg");
    encode.args(["-v", "error", "-framerate", "10", "-i"]).arg(at("in").join("frame_%d.png"));
    assert!(encode.args(["-c:v", "ffv1", "-pix_fmt", "bgr0"]).arg(&clip).status().unwrap().success());
    // A decoder that gives a part of the frames, then dies or says that it can't read on.
    let real = Command::new("sh").args(["-c", "command -v ffmpeg"]).output().unwrap().stdout;
    let real = String::from_utf8(real).unwrap();
    let fake = |end: &str| {
        fs::create_dir_all(at("bin")).unwrap();
        let part = format!("{} \"$@\" | head -c 46200", real.trim());
        let script =
            format!("#!/bin/sh\ncase \"$*\" in *-version*) exec {} -version;; esac\n{part}\n{end}\n", real.trim());
        fs::write(at("bin/ffmpeg"), script).unwrap();
        fs::set_permissions(at("bin/ffmpeg"), fs::Permissions::from_mode(0o755)).unwrap();
        let path = format!("{}:{}", at("bin").display(), std::env::var("PATH").unwrap());
        let mut command = Command::new(env!("CARGO_BIN_EXE_egotac"));
        command
            .env("PATH", path)
            .arg("label")
            .arg(&clip)
            .arg("--out")
            .arg(at("out.zarr"))
            .args(["--unknown", "guess"])
            .output()
            .unwrap()
    };
    for (end, words) in [
        ("kill -9 $$", "ended by signal 9"),
        ("exit 1", "failed with exit status: 1"),
        ("echo '[error] clip.mkv: Input/output error' >&2; exit 0", "could not read on"),
    ] {
        refused(&fake(end), &[words, "images of clip.mkv are labelled"]);
        assert!(!at("out.zarr").exists());
    }
    succeeds(&label(&clip, &at("out.zarr"), &[]));
    succeeds(&label(&clip, &at("whole.zarr"), &[]));
    let [out, whole] = ["out.zarr", "whole.zarr"].map(|name| ZarrReader::open(&at(name)).unwrap());
    assert_eq!((out.len(), whole.len()), (12, 12));
    for index in 0..12 {
        assert_eq!(out.frame(index).unwrap().field, whole.frame(index).unwrap().field, "image {index}");
    }
}

/// Writes a bag of three images without a summary, whose channel and schema have this id.
fn bag(path: &Path, id: u16, topic: &str) {
    let options = WriteOptions::new().profile("ros2").use_chunks(false).emit_summary_records(false);
    let mut writer = options.create(fs::File::create(path).unwrap()).unwrap();
    writer.add_schema_with_id(id, CompressedImage::TYPE, "ros2msg", CompressedImage::schema().as_bytes()).unwrap();
    writer.add_channel_with_id(id, id, topic, "cdr", &BTreeMap::new()).unwrap();
    for index in 0..3u32 {
        let mut data = std::io::Cursor::new(Vec::new());
        picture(index, 0).write_to(&mut data, ImageFormat::Png).unwrap();
        let header = Header { stamp: Time { sec: 5, nanosec: index }, frame_id: "head".into() };
        let data = CompressedImage { header, format: "png".into(), data: data.into_inner() }.to_cdr();
        let time = 1000 + u64::from(index);
        let header = MessageHeader { channel_id: id, sequence: index, log_time: time, publish_time: time };
        writer.write_to_known_channel(&header, &data).unwrap();
    }
    writer.finish().unwrap();
}

#[test]
fn labels_take_a_channel_that_no_record_uses() {
    let folder = tempfile::tempdir().unwrap();
    let [input, out] = ["in.mcap", "out.mcap"].map(|name| folder.path().join(name));
    bag(&input, u16::MAX, "/camera");
    succeeds(&label(&input, &out, &[]));
    let bytes = fs::read(&out).unwrap();
    let mut counts = BTreeMap::new();
    for message in MessageStream::new(&bytes).unwrap() {
        let message = message.unwrap();
        let name = message.channel.schema.as_ref().unwrap().name.clone();
        match message.channel.topic.as_str() {
            "/camera" => drop(CompressedImage::from_cdr(&message.data).unwrap()),
            _ => drop(TactileFrame::from_cdr(&message.data).unwrap()),
        }
        *counts.entry((message.channel.topic.clone(), name)).or_insert(0) += 1;
    }
    let expected = [("/camera", CompressedImage::TYPE), ("/predictor/tactile", TactileFrame::TYPE)];
    assert_eq!(counts, expected.map(|(topic, name)| ((topic.to_string(), name.to_string()), 3)).into());
}

#[test]
fn a_channel_that_the_summary_omits_keeps_its_id() {
    let folder = tempfile::tempdir().unwrap();
    let [input, out] = ["in.mcap", "out.mcap"].map(|name| folder.path().join(name));
    // Repeat the channels in the summary, but not the channel of the words, which has the next id.
    let mut writer =
        WriteOptions::new().profile("ros2").use_chunks(false).create(fs::File::create(&input).unwrap()).unwrap();
    let schema = writer.add_schema(CompressedImage::TYPE, "ros2msg", CompressedImage::schema().as_bytes()).unwrap();
    let camera = writer.add_channel(schema, "/camera", "cdr", &BTreeMap::new()).unwrap();
    let words = writer.add_channel(0, "/words", "cdr", &BTreeMap::new()).unwrap();
    for index in 0..3u32 {
        let mut data = std::io::Cursor::new(Vec::new());
        picture(index, 0).write_to(&mut data, ImageFormat::Png).unwrap();
        let header = Header { stamp: Time { sec: 5, nanosec: index }, frame_id: "head".into() };
        let image = CompressedImage { header, format: "png".into(), data: data.into_inner() }.to_cdr();
        for (channel_id, payload) in [(camera, &image[..]), (words, &b"\0\x01\0\0word"[..])] {
            let time = 1000 + u64::from(index);
            let header = MessageHeader { channel_id, sequence: index, log_time: time, publish_time: time };
            writer.write_to_known_channel(&header, payload).unwrap();
        }
    }
    writer.finish().unwrap();
    let bytes = fs::read(&input).unwrap();
    fs::write(&input, without_words_in_summary(&bytes)).unwrap();
    succeeds(&label(&input, &out, &[]));
    let bytes = fs::read(&out).unwrap();
    let mut topics = BTreeMap::new();
    for message in MessageStream::new(&bytes).unwrap() {
        let message = message.unwrap();
        let is_word = &message.data[..] == b"\0\x01\0\0word";
        assert_eq!(is_word, message.channel.topic == "/words");
        *topics.entry(message.channel.topic.clone()).or_insert(0) += 1;
    }
    assert_eq!(topics, ["/camera", "/predictor/tactile", "/words"].map(|topic| (topic.to_string(), 3)).into());
}

/// Returns a file whose summary holds no channel `/words` and no count of it.
fn without_words_in_summary(bytes: &[u8]) -> Vec<u8> {
    let end = bytes.len() - 8;
    let footer = end - 20;
    let start = u64::from_le_bytes(bytes[footer..footer + 8].try_into().unwrap()) as usize;
    let mut out = bytes[..start].to_vec();
    let mut at = start;
    while at < footer - 9 {
        let length = u64::from_le_bytes(bytes[at + 1..at + 9].try_into().unwrap()) as usize;
        let body = &bytes[at + 9..at + 9 + length];
        let words = body.windows(6).any(|window| window == b"/words");
        match bytes[at] {
            0x04 if words => {}
            0x0b => {
                // The counts by channel are the last field: keep the first entry, that of the camera.
                let fixed = body.len() - 4 - 20;
                let mut body = body[..fixed].to_vec();
                body.extend(10u32.to_le_bytes());
                body.extend(&bytes[at + 9 + fixed + 4..at + 9 + fixed + 14]);
                out.push(0x0b);
                out.extend((body.len() as u64).to_le_bytes());
                out.extend(body);
            }
            0x03 | 0x04 => out.extend(&bytes[at..at + 9 + length]),
            _ => {}
        }
        at += 9 + length;
    }
    out.push(0x02);
    out.extend(20u64.to_le_bytes());
    out.extend((start as u64).to_le_bytes());
    out.extend([0; 12]);
    out.extend(&bytes[end..]);
    out
}

#[test]
fn names_from_a_file_cannot_act_on_the_terminal() {
    let folder = tempfile::tempdir().unwrap();
    let input = folder.path().join("in.mcap");
    bag(&input, 1, "/camera\u{1b}[2J\u{9b}31m\n/forged: 7 messages of nothing");
    for form in [&[][..], &["--json"]] {
        let output = egotac(&[&["data", "info", input.to_str().unwrap()], form].concat());
        succeeds(&output);
        let text = String::from_utf8_lossy(&output.stdout);
        assert!(!text.contains(['\u{1b}', '\u{9b}']) && text.contains("/camera\\u001b[2J\\u009b31m"), "{text}");
        assert!(!text.lines().any(|line| line.trim_start().starts_with("/forged")), "{text}");
    }
    refused(&label(&input, &folder.path().join("out"), &["--topic", "\u{1b}[2J"]), &["\\u"]);
}

#[test]
fn links_out_of_a_data_set_are_not_copied() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    fs::create_dir(at("bag")).unwrap();
    bag(&at("bag/bag_0.mcap"), 1, "/camera");
    let metadata = "rosbag2_bagfile_information:\n  relative_file_paths: [bag_0.mcap]\n";
    fs::write(at("bag/metadata.yaml"), metadata).unwrap();
    symlink("/etc/passwd", at("bag/notes.txt")).unwrap();
    refused(&label(&at("bag"), &at("out"), &[]), &["notes.txt", "outside of"]);
    assert!(!at("out").exists());
}
