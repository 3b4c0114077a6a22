//! Written bags read back byte for byte, by the Python package rosbags as well.

use std::path::Path;

use egotac::dataset::mcap::{BagWriter, file_name};
use egotac::hand::Side;
use egotac::message::{Header, Message, TactileFrame, Time};
use egotac::{TactileField, Topology};

fn frame(index: u32) -> TactileFrame {
    let mut field = TactileField::zeros(Topology::EgotacHand1);
    field.force[Side::Right.range().start + index as usize] = 0.5 + index as f32;
    let header = Header { stamp: Time { sec: 12, nanosec: index }, frame_id: "camera".into() };
    TactileFrame { sequence: u64::from(index), ..TactileFrame::from_field(header, &field).unwrap() }
}

fn write_bag(folder: &Path) -> Vec<Vec<u8>> {
    let mut writer = BagWriter::create(folder).unwrap();
    writer.add_topic("/tactile", TactileFrame::TYPE, &TactileFrame::schema(), false).unwrap();
    let payloads: Vec<_> = (0..5).map(|index| frame(index).to_cdr()).collect();
    for (index, payload) in payloads.iter().enumerate() {
        writer.write("/tactile", payload, 1_000 + index as u64, 900 + index as u64).unwrap();
    }
    writer.finish().unwrap();
    payloads
}

#[test]
fn written_messages_read_back() {
    let temp = tempfile::tempdir().unwrap();
    let folder = temp.path().join("run");
    let payloads = write_bag(&folder);
    let bytes = std::fs::read(folder.join(file_name(&folder))).unwrap();
    let messages: Vec<_> = mcap::MessageStream::new(&bytes).unwrap().map(Result::unwrap).collect();
    assert_eq!(messages.len(), payloads.len());
    for (index, (message, payload)) in messages.iter().zip(&payloads).enumerate() {
        assert_eq!(&message.data[..], &payload[..]);
        assert_eq!((message.log_time, message.publish_time), (1_000 + index as u64, 900 + index as u64));
        assert_eq!(message.channel.topic, "/tactile");
        assert_eq!(TactileFrame::from_cdr(&message.data).unwrap().sequence, index as u64);
    }
}

#[test]
fn an_existing_folder_is_refused_and_stays() {
    let temp = tempfile::tempdir().unwrap();
    let error = BagWriter::create(temp.path()).unwrap_err().to_string();
    assert!(error.contains("does not exist yet"), "{error}");
}

#[test]
fn an_unfinished_bag_has_another_name() {
    let temp = tempfile::tempdir().unwrap();
    let folder = temp.path().join("run");
    drop(BagWriter::create(&folder).unwrap());
    assert!(!folder.exists());
}

#[test]
fn an_unknown_topic_is_named_with_the_known_ones() {
    let temp = tempfile::tempdir().unwrap();
    let mut writer = BagWriter::create(&temp.path().join("run")).unwrap();
    writer.add_topic("/a", TactileFrame::TYPE, &TactileFrame::schema(), false).unwrap();
    let error = writer.write("/b", &[], 0, 0).unwrap_err().to_string();
    assert!(error.contains("/b") && error.contains("/a"), "{error}");
}

#[test]
fn a_latched_topic_states_its_qos() {
    let temp = tempfile::tempdir().unwrap();
    let folder = temp.path().join("run");
    let mut writer = BagWriter::create(&folder).unwrap();
    writer.add_topic("/a", TactileFrame::TYPE, &TactileFrame::schema(), true).unwrap();
    writer.add_topic("/b", TactileFrame::TYPE, &TactileFrame::schema(), false).unwrap();
    writer.finish().unwrap();
    let text = std::fs::read_to_string(folder.join("metadata.yaml")).unwrap();
    let metadata: serde_yaml::Value = serde_yaml::from_str(&text).unwrap();
    let topics = &metadata["rosbag2_bagfile_information"]["topics_with_message_count"];
    let profiles = [0, 1].map(|i| topics[i]["topic_metadata"]["offered_qos_profiles"].as_str().unwrap().to_owned());
    // YAML within YAML: reliability 1 is reliable, durability 1 transient local (rmw/types.h).
    let profile: serde_yaml::Value = serde_yaml::from_str(&profiles[0]).unwrap();
    assert_eq!((profile[0]["reliability"].as_u64(), profile[0]["durability"].as_u64()), (Some(1), Some(1)));
    assert_eq!(profiles[1], "");
}

/// Needs the Python environment of `make setup`.
#[cfg(feature = "ros")]
#[test]
fn the_rosbags_package_reads_the_same_bytes() {
    let temp = tempfile::tempdir().unwrap();
    let folder = temp.path().join("run");
    let payloads = write_bag(&folder);
    let python = std::env::var("EGOTAC_PYTHON").expect("EGOTAC_PYTHON: source env.sh, which `make setup` writes");
    let script = "\
import sys
from pathlib import Path
from rosbags.highlevel import AnyReader
with AnyReader([Path(sys.argv[1])]) as reader:
    for connection, time, data in reader.messages():
        message = reader.deserialize(data, connection.msgtype)
        print(connection.topic, connection.msgtype, time, data.hex(), message.sequence, float(max(message.hands[1].force)))
";
    let output = std::process::Command::new(python).args(["-c", script]).arg(&folder).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let lines = String::from_utf8(output.stdout).unwrap();
    let expected: Vec<String> = payloads
        .iter()
        .enumerate()
        .map(|(index, payload)| {
            let hex: String = payload.iter().map(|byte| format!("{byte:02x}")).collect();
            format!("/tactile egotac_msgs/msg/TactileFrame {} {hex} {index} {:?}", 1_000 + index, 0.5 + index as f64)
        })
        .collect();
    assert_eq!(lines.lines().collect::<Vec<_>>(), expected);
}
