//! `egotac label` on bags: original records stay, touch is added beside the images, damage is reported, and a killed run
//! resumes.

use std::collections::BTreeMap;
use std::fs;
use std::io::Cursor;
use std::path::Path;
use std::process::{Command, Output, Stdio};
use std::time::Duration;

use crate::common::egotac;
use egotac::label::Progress;
use egotac::message::{CompressedImage, Header, Image, Message, TactileFrame, Time};
use egotac::model::predictor::{Options, Predictor};
use egotac::model::{Unknown, shipped};
use image::{ImageFormat, Rgb, RgbImage};
use mcap::records::{MessageHeader, Record};
use mcap::{Attachment, Compression, WriteOptions};
use serde_json::Value;

const START: u64 = 1_700_000_000_000_000_000;
const STEP: u64 = 40_000_000;
const QOS: &str = "- history: 3
  depth: 0
  reliability: 1
  durability: 2
  deadline: {sec: 9223372036, nsec: 854775807}
  lifespan: {sec: 9223372036, nsec: 854775807}
  liveliness: 1
  liveliness_lease_duration: {sec: 9223372036, nsec: 854775807}
  avoid_ros_namespace_conventions: false
";

/// Form in which a bag is written.
#[derive(Clone, Copy)]
struct Form {
    compressed_images: bool,
    compression: Option<Compression>,
    chunked: bool,
}

const PLAIN: Form = Form { compressed_images: true, compression: Some(Compression::Zstd), chunked: true };

fn picture(index: u64) -> RgbImage {
    RgbImage::from_fn(40, 32, |x, y| Rgb([(6 * x) as u8, (7 * y) as u8, (5 * index) as u8]))
}

fn stamp(index: u64) -> Time {
    Time::from_nanos((START + index * STEP) as i64)
}

fn image_payload(index: u64, compressed: bool) -> Vec<u8> {
    let header = Header { stamp: stamp(index), frame_id: "head_camera".into() };
    let image = picture(index);
    if compressed {
        let mut data = Cursor::new(Vec::new());
        image.write_to(&mut data, ImageFormat::Png).unwrap();
        return CompressedImage { header, format: "png".into(), data: data.into_inner() }.to_cdr();
    }
    let (width, height) = image.dimensions();
    let (encoding, step, data) = ("rgb8".into(), 3 * width, image.into_raw());
    Image { header, height, width, encoding, is_bigendian: 0, step, data }.to_cdr()
}

/// Writes a recording of `frames` images between other messages, with an attachment and metadata.
fn write_mcap(path: &Path, frames: u64, form: Form) {
    let options = WriteOptions::new().profile("ros2").library("a recorder");
    let options = options.compression(form.compression).use_chunks(form.chunked).chunk_size(Some(12_000));
    let mut writer = options.create(fs::File::create(path).unwrap()).unwrap();
    let (image_type, image_schema) = match form.compressed_images {
        true => (CompressedImage::TYPE, CompressedImage::schema()),
        false => (Image::TYPE, Image::schema()),
    };
    let qos = BTreeMap::from([("offered_qos_profiles".to_string(), QOS.to_string())]);
    let schema = writer.add_schema(image_type, "ros2msg", image_schema.as_bytes()).unwrap();
    let images = writer.add_channel(schema, "/camera/image", "cdr", &qos).unwrap();
    let schema = writer.add_schema("std_msgs/msg/String", "ros2msg", b"string data\n").unwrap();
    let words = writer.add_channel(schema, "/words", "cdr", &BTreeMap::new()).unwrap();
    for index in 0..frames {
        let time = START + index * STEP;
        let word = [&[0, 1, 0, 0, 4, 0, 0, 0][..], format!("{:03}\0", index % 1000).as_bytes()].concat();
        let header =
            |channel_id, log_time| MessageHeader { channel_id, sequence: 0, log_time, publish_time: log_time - 7 };
        writer.write_to_known_channel(&header(words, time + 1000), &word).unwrap();
        let payload = image_payload(index, form.compressed_images);
        writer.write_to_known_channel(&header(images, time + 5000), &payload).unwrap();
        if index == frames / 2 {
            let (name, media_type) = ("notes.txt".into(), "text/plain".into());
            let data = b"the mug is heavy".as_slice().into();
            writer.attach(&Attachment { log_time: time, create_time: time, name, media_type, data }).unwrap();
        }
    }
    let metadata = BTreeMap::from([("operator".to_string(), "nobody".to_string())]);
    writer.write_metadata(&mcap::records::Metadata { name: "session".into(), metadata }).unwrap();
    writer.finish().unwrap();
}

fn label(input: &Path, out: &Path, more: &[&str]) -> Output {
    let [input, out] = [input, out].map(|path| path.to_str().unwrap());
    egotac(&[&["label", input, "--out", out, "--unknown", "guess", "--json", "-"], more].concat())
}

fn summary(output: &Output, status: i32) -> Value {
    assert_eq!(output.status.code(), Some(status), "{}", String::from_utf8_lossy(&output.stderr));
    serde_json::from_slice(&output.stdout).unwrap()
}

/// Records of a file's data section in order, read by the crate mcap; `ours` are the records of the labels.
struct Read {
    original: Vec<String>,
    labels: Vec<(MessageHeader, TactileFrame)>,
    chunks: Vec<Vec<u8>>,
}

fn read(path: &Path) -> Read {
    let bytes = fs::read(path).unwrap();
    let (mut original, mut labels) = (Vec::new(), Vec::new());
    let mut ours = Vec::new();
    for record in mcap::read::ChunkFlattener::new(&bytes).unwrap() {
        match record.unwrap() {
            Record::Schema { header, .. } if header.name == TactileFrame::TYPE => {}
            Record::Channel(channel) if channel.topic == "/predictor/tactile" => ours.push(channel.id),
            Record::Message { header, data } if ours.contains(&header.channel_id) => {
                labels.push((header, TactileFrame::from_cdr(&data).unwrap()));
            }
            Record::Metadata(metadata) if metadata.name == "egotac_labels" => {}
            Record::DataEnd(_) => break,
            Record::MessageIndex(_) | Record::Chunk { .. } => {}
            record => original.push(format!("{record:?}")),
        }
    }
    let chunk = |record| match record {
        Record::Chunk { data, .. } => Some(data.into_owned()),
        _ => None,
    };
    let chunks = mcap::read::LinearReader::new(&bytes).unwrap().filter_map(|record| chunk(record.unwrap())).collect();
    Read { original, labels, chunks }
}

/// Returns the network's output for images 0..n.
fn expected(frames: u64) -> Vec<egotac::model::Prediction> {
    let mut predictor =
        Predictor::load(&shipped::path().unwrap(), Options { unknown: Unknown::Guess, ..Options::default() }).unwrap();
    (0..frames).map(|index| predictor.push(&picture(index), stamp(index).secs()).unwrap()).collect()
}

/// Reads a file as players do: by its summary, in order of time. Returns the number of messages by topic.
fn indexed(path: &Path) -> BTreeMap<String, usize> {
    let bytes = fs::read(path).unwrap();
    let summary = mcap::Summary::read(&bytes).unwrap().unwrap();
    let statistics = summary.stats.clone().unwrap();
    let mut counts = BTreeMap::new();
    if summary.chunk_indexes.is_empty() {
        mcap::MessageStream::new(&bytes)
            .unwrap()
            .for_each(|m| *counts.entry(m.unwrap().channel.topic.clone()).or_default() += 1);
    }
    for chunk in &summary.chunk_indexes {
        for message in summary.stream_chunk(&bytes, chunk).unwrap() {
            *counts.entry(message.unwrap().channel.topic.clone()).or_default() += 1;
        }
        let indexes = summary.read_message_indexes(&bytes, chunk).unwrap();
        for entry in indexes.values().flatten() {
            summary.seek_message(&bytes, chunk, entry).unwrap();
        }
    }
    for (id, count) in &statistics.channel_message_counts {
        assert_eq!(counts[&summary.channels[id].topic] as u64, *count);
    }
    assert_eq!(counts.values().sum::<usize>() as u64, statistics.message_count);
    counts
}

#[test]
fn every_record_stays_and_each_image_gets_a_label() {
    let folder = tempfile::tempdir().unwrap();
    let predictions = expected(20);
    let compressions = [None, Some(Compression::Zstd), Some(Compression::Lz4)];
    let chunked = compressions.map(|compression| Form { compression, compressed_images: false, chunked: true });
    let plain = Form { compression: None, compressed_images: true, chunked: false };
    for (number, form) in chunked.into_iter().chain([plain, PLAIN]).enumerate() {
        let [input, out] = ["in", "out"].map(|name| folder.path().join(format!("{name}{number}.mcap")));
        write_mcap(&input, 20, form);
        let json = summary(&label(&input, &out, &[]), 0);
        assert_eq!((&json["summary"]["frames"], &json["summary"]["labelled"]), (&20.into(), &20.into()));
        let (before, after) = (read(&input), read(&out));
        assert_eq!(before.original, after.original, "form {number}");
        assert!(before.chunks.iter().all(|chunk| after.chunks.contains(chunk)), "a chunk was written anew");
        assert_eq!(after.labels.len(), 20);
        for (index, (header, frame)) in after.labels.iter().enumerate() {
            let log_time = START + index as u64 * STEP + 5000;
            assert_eq!((header.log_time, header.publish_time), (log_time, log_time - 7));
            assert_eq!((frame.header.stamp, frame.header.frame_id.as_str()), (stamp(index as u64), "head_camera"));
            let (field, prediction) = (frame.to_field().unwrap(), &predictions[index]);
            assert_eq!(field, prediction.field, "form {number}, image {index}");
            assert_eq!((frame.warming_up, frame.sequence), (prediction.warming_up, index as u64));
        }
        assert_eq!(indexed(&out)["/predictor/tactile"], 20);
    }
}

#[test]
fn a_bag_of_several_files_is_labelled_file_by_file() {
    let folder = tempfile::tempdir().unwrap();
    let [input, out] = ["in", "out"].map(|name| folder.path().join(name));
    fs::create_dir(&input).unwrap();
    for (file, frames) in [("in_0.mcap", 9), ("in_1.mcap", 4)] {
        write_mcap(&input.join(file), frames, PLAIN);
    }
    let yaml = "rosbag2_bagfile_information:\n  version: 9\n  storage_identifier: mcap\n  relative_file_paths: [in_0.mcap, in_1.mcap]\n";
    fs::write(input.join("metadata.yaml"), yaml).unwrap();
    fs::write(input.join("calibration.yaml"), "fx: 1").unwrap();
    // The second shard is the last one and assembles the bag.
    let waiting = summary(&label(&input, &out, &["--shard", "1/2"]), 0);
    assert!(!out.exists() && waiting["waiting_for_other_shards"].as_array().unwrap().len() == 1);
    summary(&label(&input, &out, &["--shard", "0/2"]), 0);
    let metadata: serde_yaml::Value =
        serde_yaml::from_str(&fs::read_to_string(out.join("metadata.yaml")).unwrap()).unwrap();
    let bag = &metadata["rosbag2_bagfile_information"];
    assert_eq!((bag["version"].as_u64(), bag["message_count"].as_u64()), (Some(5), Some(3 * 13)));
    let topics: BTreeMap<&str, (u64, &str)> = bag["topics_with_message_count"]
        .as_sequence()
        .unwrap()
        .iter()
        .map(|topic| {
            let about = &topic["topic_metadata"];
            let qos = about["offered_qos_profiles"].as_str().unwrap();
            (about["name"].as_str().unwrap(), (topic["message_count"].as_u64().unwrap(), qos))
        })
        .collect();
    assert_eq!(topics["/predictor/tactile"].0, 13);
    assert_eq!(topics["/camera/image"], (13, QOS));
    assert_eq!(bag["files"][1]["message_count"].as_u64(), Some(12));
    assert_eq!(read(&out.join("in_1.mcap")).labels[0].1.sequence, 9);
    assert_eq!(fs::read_to_string(out.join("calibration.yaml")).unwrap(), "fx: 1");
}

#[test]
fn a_truncated_recording_is_labelled_up_to_its_end() {
    let folder = tempfile::tempdir().unwrap();
    for (form, name) in
        [(PLAIN, "zstd"), (Form { compression: None, ..PLAIN }, "none"), (Form { chunked: false, ..PLAIN }, "plain")]
    {
        let whole = folder.path().join(format!("{name}.mcap"));
        write_mcap(&whole, 16, form);
        let bytes = fs::read(&whole).unwrap();
        // Behind the data section nothing is lost that could not be made anew.
        let footer = mcap::read::footer(&bytes).unwrap();
        for share in [0.03, 0.31, 0.5, 0.77, 0.9, 0.99] {
            let cut = (footer.summary_start as f64 * share) as usize - 13;
            let [input, out] = ["cut", "out"].map(|part| folder.path().join(format!("{part}-{name}-{share}.mcap")));
            fs::write(&input, &bytes[..cut]).unwrap();
            // Without any image there is nothing to label.
            let images = |bytes: &[u8]| {
                let stream = mcap::MessageStream::new_with_options(bytes, mcap::read::Options::IgnoreEndMagic.into());
                stream.unwrap().map_while(Result::ok).filter(|m| m.channel.topic == "/camera/image").count()
            };
            let readable = images(&bytes[..cut]);
            let output = label(&input, &out, &[]);
            if output.status.code() == Some(1) {
                assert!(readable == 0 && !out.exists(), "{name} {share}: {}", String::from_utf8_lossy(&output.stderr));
                continue;
            }
            let json = summary(&output, 3);
            let lost = &json["summary"]["lost"][0];
            let (offset, size) = (lost["offset"].as_u64().unwrap(), lost["bytes"].as_u64().unwrap());
            assert_eq!(offset + size, cut as u64, "{name} {share}: {lost}");
            let counts = indexed(&out);
            let labelled = counts.get("/predictor/tactile").copied().unwrap_or(0);
            assert_eq!(labelled, counts.get("/camera/image").copied().unwrap_or(0));
            // The other reader gives up a chunk that is cut off; we read it as far as it goes.
            assert!(labelled >= readable && labelled <= 16, "{name} {share}: {labelled} of {readable}");
            assert_eq!(json["summary"]["labelled"].as_u64(), Some(labelled as u64));
        }
    }
}

#[test]
fn a_damaged_chunk_is_left_out_and_listed() {
    let folder = tempfile::tempdir().unwrap();
    for (name, compression) in [("none", None), ("zstd", Some(Compression::Zstd)), ("lz4", Some(Compression::Lz4))] {
        let [input, out] = ["in", "out"].map(|part| folder.path().join(format!("{part}-{name}.mcap")));
        write_mcap(&input, 30, Form { compression, ..PLAIN });
        let mut bytes = fs::read(&input).unwrap();
        let summary_before = mcap::Summary::read(&bytes).unwrap().unwrap();
        let chunk = &summary_before.chunk_indexes[1];
        let lost_images = summary_before
            .stream_chunk(&bytes, chunk)
            .unwrap()
            .filter(|m| m.as_ref().unwrap().channel.topic == "/camera/image")
            .count();
        let middle = (chunk.chunk_start_offset + chunk.chunk_length / 2) as usize;
        bytes[middle] ^= 0x10;
        fs::write(&input, &bytes).unwrap();
        let json = summary(&label(&input, &out, &[]), 3);
        let lost = &json["summary"]["lost"];
        assert_eq!(lost.as_array().unwrap().len(), 1, "{lost}");
        assert_eq!(lost[0]["offset"].as_u64(), Some(chunk.chunk_start_offset));
        assert_eq!(lost[0]["bytes"].as_u64(), Some(chunk.chunk_length));
        assert_eq!(indexed(&out)["/predictor/tactile"], 30 - lost_images, "{name}");
        // A length that points nowhere: what follows is found again.
        let at = chunk.chunk_start_offset as usize + 1;
        bytes[at..at + 8].copy_from_slice(&u64::MAX.to_le_bytes());
        fs::write(&input, &bytes).unwrap();
        let out = folder.path().join(format!("again-{name}.mcap"));
        let json = summary(&label(&input, &out, &[]), 3);
        assert_eq!(json["summary"]["lost"][0]["offset"].as_u64(), Some(chunk.chunk_start_offset));
        assert!(indexed(&out)["/predictor/tactile"] >= 30 - lost_images);
    }
}

#[test]
fn an_image_that_cant_be_decoded_gets_a_frame_without_hands() {
    let folder = tempfile::tempdir().unwrap();
    let [input, out] = ["in.mcap", "out.mcap"].map(|name| folder.path().join(name));
    let mut writer = WriteOptions::new().profile("ros2").create(fs::File::create(&input).unwrap()).unwrap();
    let schema = writer.add_schema(CompressedImage::TYPE, "ros2msg", CompressedImage::schema().as_bytes()).unwrap();
    let channel_id = writer.add_channel(schema, "/camera/image", "cdr", &BTreeMap::new()).unwrap();
    for index in 0..5 {
        let mut payload = image_payload(index, true);
        match index {
            2 => payload.truncate(payload.len() / 2),
            3 => payload[100..].fill(0),
            _ => {}
        }
        let header = MessageHeader { channel_id, sequence: 0, log_time: START + index, publish_time: START + index };
        writer.write_to_known_channel(&header, &payload).unwrap();
    }
    writer.finish().unwrap();
    let json = summary(&label(&input, &out, &[]), 3);
    let faults = json["summary"]["faults"].as_array().unwrap();
    let frames: Vec<u64> = faults.iter().map(|fault| fault["frame"].as_u64().unwrap()).collect();
    assert_eq!(frames, [2, 3]);
    assert!(faults.iter().all(|fault| fault["reason"].as_str().unwrap().starts_with("at byte ")), "{faults:?}");
    let hands: Vec<usize> = read(&out).labels.iter().map(|(_, frame)| frame.hands.len()).collect();
    assert_eq!(hands, [2, 2, 0, 0, 2]);
}

#[test]
fn a_killed_run_resumes_to_the_same_bytes() {
    let folder = tempfile::tempdir().unwrap();
    let [input, alone, killed] = ["in.mcap", "alone.mcap", "killed.mcap"].map(|name| folder.path().join(name));
    // Three images per observation step: the window that the resumed run must replay spans several images.
    write_mcap(&input, 250, PLAIN);
    summary(&label(&input, &alone, &[]), 0);
    let journal = folder.path().join(".killed.mcap.unfinished/000000.labels");
    let labelled = || Progress::read(&journal).map_or(0, |progress| progress.frames as u64);
    let mut done = 0;
    for _ in 0..2 {
        let mut child = Command::new(env!("CARGO_BIN_EXE_egotac"));
        child.args(["label", input.to_str().unwrap(), "--out", killed.to_str().unwrap(), "--unknown", "guess"]);
        let mut child = child.stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap();
        while labelled() <= done && child.try_wait().unwrap().is_none() {
            std::thread::sleep(Duration::from_millis(1));
        }
        child.kill().unwrap(); // SIGKILL
        child.wait().unwrap();
        assert!(!killed.exists(), "the run was over before it was killed");
        done = labelled();
        // What a kill in the middle of a write leaves behind.
        let mut bytes = fs::read(&journal).unwrap();
        bytes.extend_from_slice(&[17; 100]);
        fs::write(&journal, &bytes).unwrap();
    }
    let json = summary(&label(&input, &killed, &[]), 0);
    assert!(done > 0 && done < 250);
    assert_eq!(json["images_labelled_now"].as_u64(), Some(250 - done));
    assert_eq!(json["summary"]["labelled"].as_u64(), Some(250));
    assert!(fs::read(&alone).unwrap() == fs::read(&killed).unwrap());
    assert!(!folder.path().join(".killed.mcap.unfinished").exists());
}

#[test]
fn a_bag_with_several_cameras_needs_a_topic() {
    let folder = tempfile::tempdir().unwrap();
    let [input, out] = ["in.mcap", "out.mcap"].map(|name| folder.path().join(name));
    let mut writer = WriteOptions::new().profile("ros2").create(fs::File::create(&input).unwrap()).unwrap();
    let schema = writer.add_schema(CompressedImage::TYPE, "ros2msg", CompressedImage::schema().as_bytes()).unwrap();
    for (topic, frames) in [("/head", 3), ("/wrist", 2)] {
        let channel_id = writer.add_channel(schema, topic, "cdr", &BTreeMap::new()).unwrap();
        for index in 0..frames {
            let header = MessageHeader { channel_id, sequence: 0, log_time: START + index, publish_time: START };
            writer.write_to_known_channel(&header, &image_payload(index, true)).unwrap();
        }
    }
    writer.finish().unwrap();
    let output = label(&input, &out, &[]);
    let error = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(output.status.code() == Some(1) && error.contains("/head, /wrist") && error.contains("--topic"), "{error}");
    summary(&label(&input, &out, &["--topic", "/wrist"]), 0);
    assert_eq!(indexed(&out)["/predictor/tactile"], 2);
    // Labels of the second camera go to another topic.
    let second = folder.path().join("second.mcap");
    let taken = label(&out, &second, &["--topic", "/head"]);
    assert!(String::from_utf8_lossy(&taken.stderr).contains("--labels-topic"));
    summary(&label(&out, &second, &["--topic", "/head", "--labels-topic", "/head/tactile"]), 0);
    assert_eq!((indexed(&second)["/predictor/tactile"], indexed(&second)["/head/tactile"]), (2, 3));
}

/// Needs the Python environment of `make setup`.
#[cfg(feature = "ros")]
#[test]
fn rosbags_and_rclpy_read_the_labelled_bag() {
    let folder = tempfile::tempdir().unwrap();
    let (input, out) = (folder.path().join("in.mcap"), folder.path().join("out"));
    write_mcap(&input, 12, PLAIN);
    summary(&label(&input, &out, &[]), 0);
    let script = r#"
import sys
from pathlib import Path
from rosbags.highlevel import AnyReader
from rclpy.serialization import deserialize_message
from egotac_msgs.msg import TactileFrame
with AnyReader([Path(sys.argv[1])]) as reader:
    counts = {}
    for connection, time, data in reader.messages():
        message = reader.deserialize(data, connection.msgtype)
        counts[connection.topic] = counts.get(connection.topic, 0) + 1
        if connection.topic == "/predictor/tactile":
            ros = deserialize_message(data, TactileFrame)
            assert ros.header.stamp.sec == message.header.stamp.sec and len(ros.hands) == len(message.hands) == 2
            for a, b in zip(ros.hands, message.hands):
                assert (a.force == b.force).all() and (a.contact == b.contact).all()
            force = sum(float(f) for hand in ros.hands for f in hand.force)
            print(time, ros.header.stamp.sec, ros.header.stamp.nanosec, ros.header.frame_id, ros.sequence, ros.topology, force)
    assert counts == {"/camera/image": 12, "/words": 12, "/predictor/tactile": 12}, counts
"#;
    let python = std::env::var("EGOTAC_PYTHON").expect("EGOTAC_PYTHON: source env.sh, which `make setup` writes");
    let output = Command::new(python).args(["-c", script]).arg(&out).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let lines = String::from_utf8(output.stdout).unwrap();
    let expected = expected(12).into_iter().enumerate().map(|(index, prediction)| {
        let force: f64 = prediction.field.force.iter().map(|force| f64::from(*force)).sum();
        let (time, stamp) = (START + index as u64 * STEP + 5000, stamp(index as u64));
        (format!("{time} {} {} head_camera {index} egotac-hand-1", stamp.sec, stamp.nanosec), force)
    });
    for (line, (start, force)) in lines.lines().zip(expected) {
        let (words, got) = line.rsplit_once(' ').unwrap();
        assert_eq!(words, start);
        assert!((got.parse::<f64>().unwrap() - force).abs() < 1e-9 * force.max(1.0));
    }
    assert_eq!(lines.lines().count(), 12);
}

#[test]
fn a_bag_written_by_rosbags_is_labelled() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("out");
    summary(&label(Path::new("tests/data/bag/table"), &out, &[]), 0);
    assert_eq!(indexed(&out.join("table.mcap"))["/predictor/tactile"], 15);
    assert_eq!(read(&out.join("table.mcap")).original, read(Path::new("tests/data/bag/table/table.mcap")).original);
}
