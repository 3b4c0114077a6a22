//! Writer of bags of our own messages: a folder with one MCAP file and `metadata.yaml`.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::BufWriter;
use std::path::{Path, PathBuf};

use mcap::records::MessageHeader;
use mcap::{Compression, WriteOptions, Writer};

use super::metadata::{BagFile, BagTopic, metadata_yaml};
use crate::error::{Error, Result};
use crate::file;

/// Size at which a chunk is compressed and written, bytes.
const CHUNK: u64 = 4 << 20;
/// QoS of latched topics as rosbag2 writes it: keep last, reliable, transient local, no deadline.
const LATCHED_QOS: &str = "- history: 1
  depth: 1
  reliability: 1
  durability: 1
  deadline:
    sec: 9223372036
    nsec: 854775807
  lifespan:
    sec: 9223372036
    nsec: 854775807
  liveliness: 1
  liveliness_lease_duration:
    sec: 9223372036
    nsec: 854775807
  avoid_ros_namespace_conventions: false
";
/// Suffix of the folder's name during writing.
const UNFINISHED: &str = ".unfinished";

/// Atomic writer of a bag, message by message: [`BagWriter::finish`] gives the complete folder its name.
pub struct BagWriter {
    folder: PathBuf,
    name: String,
    unfinished: PathBuf,
    writer: Writer<BufWriter<File>>,
    topics: BTreeMap<String, Topic>,
    start: Option<u64>,
    end: u64,
}

#[derive(Debug)]
struct Topic {
    channel: u16,
    type_name: String,
    qos: &'static str,
    messages: u64,
}

impl BagWriter {
    /// Starts the bag `folder`.
    ///
    /// # Errors
    /// If `folder` exists, or its parent can't be written.
    pub fn create(folder: &Path) -> Result<Self> {
        Self::create_named(folder, &file_name(folder))
    }

    /// Starts the bag `folder` with an MCAP file called `file`.
    ///
    /// # Errors
    /// As [`Self::create`].
    pub fn create_named(folder: &Path, file: &str) -> Result<Self> {
        if folder.exists() {
            return Err(Error::file(folder, "expected a bag folder that does not exist yet"));
        }
        let mut unfinished = folder.as_os_str().to_owned();
        unfinished.push(UNFINISHED);
        let unfinished = PathBuf::from(unfinished);
        if unfinished.exists() {
            std::fs::remove_dir_all(&unfinished).map_err(Error::io(&unfinished))?;
        }
        std::fs::create_dir_all(&unfinished).map_err(Error::io(&unfinished))?;
        let path = unfinished.join(file);
        let name = file.to_string();
        let file = BufWriter::new(File::create(&path).map_err(Error::io(&path))?);
        let options = WriteOptions::new().profile("ros2").compression(Some(Compression::Zstd)).chunk_size(Some(CHUNK));
        let writer = options.create(file).map_err(|error| Error::file(&path, error))?;
        Ok(Self {
            folder: folder.to_path_buf(),
            name,
            unfinished,
            writer,
            topics: BTreeMap::new(),
            start: None,
            end: 0,
        })
    }

    /// Adds a topic of messages of `type_name` (`package/msg/Name`), defined by `schema` in `ros2msg` form. A `latched` one
    /// is played back as it was: its last message reaches those who subscribe later.
    ///
    /// # Errors
    /// If the topic is there already, or the file can't be written.
    pub fn add_topic(&mut self, topic: &str, type_name: &str, schema: &str, latched: bool) -> Result<()> {
        if self.topics.contains_key(topic) {
            return Err(Error::value("topic", "a new one", topic));
        }
        let wrap = |error| Error::file(&self.folder, error);
        let schema = self.writer.add_schema(type_name, "ros2msg", schema.as_bytes()).map_err(wrap)?;
        let qos = if latched { LATCHED_QOS } else { "" };
        let metadata = BTreeMap::from([("offered_qos_profiles".to_owned(), qos.to_owned())]);
        let channel = self.writer.add_channel(schema, topic, "cdr", &metadata).map_err(wrap)?;
        self.topics.insert(topic.to_owned(), Topic { channel, type_name: type_name.to_owned(), qos, messages: 0 });
        Ok(())
    }

    /// Writes one message: `payload` is its CDR with encapsulation header, times are nanoseconds since 1970.
    ///
    /// # Errors
    /// If the topic was not added, or the file can't be written.
    pub fn write(&mut self, topic: &str, payload: &[u8], log_time: u64, publish_time: u64) -> Result<()> {
        let Some(known) = self.topics.get_mut(topic) else {
            return Err(Error::unknown("topic", topic, self.topics.keys().map(String::as_str)));
        };
        let header = MessageHeader { channel_id: known.channel, sequence: 0, log_time, publish_time };
        self.writer.write_to_known_channel(&header, payload).map_err(|error| Error::file(&self.folder, error))?;
        known.messages += 1;
        self.start = Some(self.start.unwrap_or(log_time).min(log_time));
        self.end = self.end.max(log_time);
        Ok(())
    }

    /// Adds a metadata record.
    ///
    /// # Errors
    /// If the file can't be written.
    pub fn write_metadata(&mut self, name: &str, metadata: BTreeMap<String, String>) -> Result<()> {
        let record = mcap::records::Metadata { name: name.to_string(), metadata };
        self.writer.write_metadata(&record).map_err(|error| Error::file(&self.folder, error))
    }

    /// Closes the bag, writes `metadata.yaml` and gives the folder its name.
    ///
    /// # Errors
    /// If a file can't be written, or another process created the folder.
    pub fn finish(mut self) -> Result<()> {
        self.writer.finish().map_err(|error| Error::file(&self.folder, error))?;
        let path = self.unfinished.join("metadata.yaml");
        std::fs::write(&path, self.metadata()?).map_err(Error::io(&path))?;
        file::sync_tree(&self.unfinished)?;
        file::rename(&self.unfinished, &self.folder)
    }

    fn metadata(&self) -> Result<String> {
        let topic = |(name, topic): (&String, &Topic)| BagTopic {
            name: name.clone(),
            type_name: topic.type_name.clone(),
            encoding: "cdr".into(),
            qos: topic.qos.into(),
            messages: topic.messages,
        };
        let messages = self.topics.values().map(|topic| topic.messages).sum();
        let times = self.start.map(|start| (start, self.end));
        let file = BagFile { path: self.name.clone(), times, messages };
        metadata_yaml(&self.topics.iter().map(topic).collect::<Vec<_>>(), &[file])
    }
}

impl std::fmt::Debug for BagWriter {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("BagWriter").field("folder", &self.folder).field("topics", &self.topics).finish_non_exhaustive()
    }
}

/// Returns the name of the first MCAP file in the bag `folder`, as rosbag2 numbers them.
pub fn file_name(folder: &Path) -> String {
    let name = folder.file_name().map_or_else(|| "bag".into(), |name| name.to_string_lossy());
    format!("{name}_0.mcap")
}
