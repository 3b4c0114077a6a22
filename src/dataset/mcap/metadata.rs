//! Content of a bag's `metadata.yaml`.

use serde::Serialize;

use crate::error::{Error, Result};
use crate::text::parse_yaml;

/// Version of the layout; all distributions from Humble on read version 5.
const VERSION: u32 = 5;

/// A topic of a bag.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct BagTopic {
    /// Name of the topic.
    pub name: String,
    /// Type of its messages, for instance `sensor_msgs/msg/Image`.
    pub type_name: String,
    /// Serialisation of the messages, for instance `cdr`.
    pub encoding: String,
    /// Offered QoS profiles, YAML in a string; may be empty.
    pub qos: String,
    /// Number of messages.
    pub messages: u64,
}

/// A file of a bag.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct BagFile {
    /// Name in the bag's folder.
    pub path: String,
    /// First and last log time, ns; None without a message.
    pub times: Option<(u64, u64)>,
    /// Number of messages.
    pub messages: u64,
}

/// Returns the text of `metadata.yaml` for a bag with these topics and files. QoS profiles that are not a YAML list are left out:
/// no player could read the bag.
///
/// # Errors
/// If a name can't be written as YAML that reads back.
pub fn metadata_yaml(topics: &[BagTopic], files: &[BagFile]) -> Result<String> {
    let span = |files: &[BagFile]| {
        let times = files.iter().filter_map(|file| file.times);
        let (start, end) = times.reduce(|a, b| (a.0.min(b.0), a.1.max(b.1))).unwrap_or((0, 0));
        (SinceEpoch { nanoseconds_since_epoch: start }, Nanoseconds { nanoseconds: end - start })
    };
    let (starting_time, duration) = span(files);
    let count = |topic: &BagTopic| TopicCount {
        topic_metadata: TopicMetadata {
            name: topic.name.clone(),
            r#type: topic.type_name.clone(),
            serialization_format: topic.encoding.clone(),
            offered_qos_profiles: if is_list(&topic.qos) { topic.qos.clone() } else { String::new() },
        },
        message_count: topic.messages,
    };
    let information = |file: &BagFile| {
        let (starting_time, duration) = span(std::slice::from_ref(file));
        FileInformation { path: file.path.clone(), starting_time, duration, message_count: file.messages }
    };
    let metadata = Metadata {
        rosbag2_bagfile_information: Information {
            version: VERSION,
            storage_identifier: "mcap",
            duration,
            starting_time,
            message_count: files.iter().map(|file| file.messages).sum(),
            topics_with_message_count: topics.iter().map(count).collect(),
            compression_format: "",
            compression_mode: "",
            relative_file_paths: files.iter().map(|file| file.path.clone()).collect(),
            files: files.iter().map(information).collect(),
        },
    };
    let failed = |error| Error::file("metadata.yaml", error);
    let text = serde_yaml::to_string(&metadata).map_err(failed)?;
    parse_yaml::<serde_yaml::Value>(&text).map_err(failed)?;
    Ok(text)
}

fn is_list(qos: &str) -> bool {
    parse_yaml::<serde_yaml::Value>(qos).is_ok_and(|value| value.is_sequence())
}

#[derive(Serialize)]
struct Metadata {
    rosbag2_bagfile_information: Information,
}

#[derive(Serialize)]
struct Information {
    version: u32,
    storage_identifier: &'static str,
    duration: Nanoseconds,
    starting_time: SinceEpoch,
    message_count: u64,
    topics_with_message_count: Vec<TopicCount>,
    compression_format: &'static str,
    compression_mode: &'static str,
    relative_file_paths: Vec<String>,
    files: Vec<FileInformation>,
}

#[derive(Serialize, Clone, Copy)]
struct Nanoseconds {
    nanoseconds: u64,
}

#[derive(Serialize, Clone, Copy)]
struct SinceEpoch {
    nanoseconds_since_epoch: u64,
}

#[derive(Serialize)]
struct TopicCount {
    topic_metadata: TopicMetadata,
    message_count: u64,
}

#[derive(Serialize)]
struct TopicMetadata {
    name: String,
    r#type: String,
    serialization_format: String,
    offered_qos_profiles: String,
}

#[derive(Serialize)]
struct FileInformation {
    path: String,
    starting_time: SinceEpoch,
    duration: Nanoseconds,
    message_count: u64,
}
