//! Topics, schemas and metadata of MCAP files, from their summaries where possible.

use std::collections::BTreeMap;
use std::os::unix::fs::FileExt;
use std::path::{Path, PathBuf};

use mcap::MAGIC;
use mcap::records::{Record as Parsed, op};

use super::parse::parse;
use super::piece::{Piece, Pieces};
use super::records::{PREFIX, Records};
use crate::error::{Error, Result};
use crate::file::input::{self, InputFolder};
use crate::file::limits;
use crate::text::parse_yaml;

/// A channel of a file.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Topic {
    /// Name of the topic.
    pub name: String,
    /// Type of its messages; empty without a schema.
    pub type_name: String,
    /// Serialisation of the messages, for instance `cdr`.
    pub encoding: String,
    /// Offered QoS profiles, as the channel states them.
    pub qos: String,
    /// Number of messages.
    pub messages: u64,
}

/// Content of an MCAP file.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Survey {
    /// Channels by id.
    pub topics: BTreeMap<u16, Topic>,
    /// Name, encoding and text of the schemas by id.
    pub schemas: BTreeMap<u16, (String, String, Vec<u8>)>,
    /// True if messages lie in chunks.
    pub chunked: bool,
    /// First and last log time, ns; None without a message.
    pub times: Option<(u64, u64)>,
    /// True if this comes from the file's summary, false if from its records.
    pub from_summary: bool,
    /// Metadata records by name.
    pub metadata: BTreeMap<String, BTreeMap<String, String>>,
}

/// Returns the MCAP files of a bag in order: the files that `metadata.yaml` lists, or else all of the folder by name. For an
/// MCAP file, returns the file itself.
///
/// # Errors
/// If there is none, the bag uses another storage, or a link leads out of it.
pub fn bag_files(path: &Path) -> Result<Vec<PathBuf>> {
    if !path.is_dir() {
        return Ok(vec![path.to_path_buf()]);
    }
    let folder = InputFolder::open(path)?;
    let yaml = folder.join("metadata.yaml")?;
    let mut files = Vec::new();
    if yaml.is_file() {
        let text = input::read_text(&yaml, limits::TEXT)?;
        let metadata: serde_yaml::Value = parse_yaml(&text).map_err(|e| Error::file(&yaml, e))?;
        let bag = &metadata["rosbag2_bagfile_information"];
        if let Some(storage) = bag["storage_identifier"].as_str().filter(|storage| *storage != "mcap") {
            let message = format!("is a bag with storage {storage}; convert it to mcap with `ros2 bag convert`");
            return Err(Error::file(path, message));
        }
        let named = bag["relative_file_paths"].as_sequence().into_iter().flatten();
        // Older bags list their files relative to the parent folder.
        files.extend(named.filter_map(|name| Some(path.join(Path::new(name.as_str()?).file_name()?))));
    }
    if files.is_empty() {
        let entries = std::fs::read_dir(path).map_err(Error::io(path))?;
        files.extend(entries.flatten().map(|entry| entry.path()));
        files.retain(|file| file.extension().is_some_and(|extension| extension == "mcap"));
        files.sort();
    }
    files.iter().try_for_each(|file| folder.check(file))?;
    match files.is_empty() {
        true => Err(Error::file(path, "holds no .mcap file")),
        false => Ok(files),
    }
}

/// Reads the content of one MCAP file from its summary, or from all records without one.
///
/// # Errors
/// If the file can't be read or is not an MCAP file.
pub fn survey(path: &Path) -> Result<Survey> {
    if let Some(survey) = from_summary(&Records::open(path)?, path)? {
        return Ok(survey);
    }
    let mut survey = Survey::default();
    for piece in Pieces::open(path)? {
        let piece = piece?;
        survey.chunked |= matches!(piece, Piece::Chunk(..));
        piece.records().for_each(|(opcode, body)| survey.note(opcode, body));
    }
    Ok(survey)
}

fn from_summary(file: &Records, path: &Path) -> Result<Option<Survey>> {
    const FOOTER: u64 = 20;
    let end = MAGIC.len() as u64 + PREFIX + FOOTER;
    let mut footer = vec![0; end as usize];
    let Some(start) = file.size().checked_sub(end) else { return Ok(None) };
    file.file().read_exact_at(&mut footer, start).map_err(Error::io(path))?;
    let body = &footer[PREFIX as usize..(PREFIX + FOOTER) as usize];
    if footer[0] != op::FOOTER || footer[(PREFIX + FOOTER) as usize..] != *MAGIC {
        return Ok(None);
    }
    let Some(Parsed::Footer(parsed)) = parse(op::FOOTER, body) else { return Ok(None) };
    // Beyond the limit the records are read instead.
    let most = limits::RECORD.value();
    let size = start.checked_sub(parsed.summary_start).filter(|size| parsed.summary_start > 0 && *size <= most);
    let Some(size) = size else { return Ok(None) };
    let mut summary = vec![0; size as usize];
    file.file().read_exact_at(&mut summary, parsed.summary_start).map_err(Error::io(path))?;
    let mut survey = Survey { from_summary: true, ..Default::default() };
    let mut counts = None;
    let mut metadata = Vec::new();
    for (opcode, body) in records_in(&summary) {
        match parse(opcode, body) {
            Some(Parsed::Statistics(statistics)) => {
                survey.chunked = statistics.chunk_count > 0;
                survey.times = (statistics.message_count > 0)
                    .then_some((statistics.message_start_time, statistics.message_end_time));
                counts = Some(statistics.channel_message_counts);
            }
            Some(Parsed::ChunkIndex(_)) => survey.chunked = true,
            Some(Parsed::MetadataIndex(index)) => metadata.push(index),
            Some(_) => survey.note(opcode, body),
            None => return Ok(None),
        }
    }
    // All parts of a summary are optional: without counts, or with counts of unlisted channels, read the records.
    let Some(counts) = counts else { return Ok(None) };
    if counts.keys().any(|id| !survey.topics.contains_key(id)) {
        return Ok(None);
    }
    for (id, topic) in &mut survey.topics {
        topic.messages = counts.get(id).copied().unwrap_or(0);
    }
    for index in metadata {
        let record = super::Record {
            opcode: op::METADATA,
            offset: index.offset,
            length: index.length.saturating_sub(PREFIX).min(file.size()),
        };
        if index.offset < file.size() && record.length <= limits::TEXT.value() {
            survey.note(op::METADATA, &file.body(&record)?);
        }
    }
    Ok(Some(survey))
}

impl Survey {
    fn note(&mut self, opcode: u8, body: &[u8]) {
        match parse(opcode, body) {
            Some(Parsed::Schema { header, data }) => {
                self.schemas.insert(header.id, (header.name, header.encoding, data.into_owned()));
            }
            Some(Parsed::Channel(channel)) => {
                let type_name = self.schemas.get(&channel.schema_id).map(|schema| schema.0.clone()).unwrap_or_default();
                let qos = channel.metadata.get("offered_qos_profiles").cloned().unwrap_or_default();
                let messages = self.topics.get(&channel.id).map_or(0, |topic| topic.messages);
                let topic = Topic { name: channel.topic, type_name, encoding: channel.message_encoding, qos, messages };
                self.topics.insert(channel.id, topic);
            }
            Some(Parsed::Message { header, .. }) => {
                if let Some(topic) = self.topics.get_mut(&header.channel_id) {
                    topic.messages += 1;
                }
                let (start, end) = self.times.unwrap_or((header.log_time, header.log_time));
                self.times = Some((start.min(header.log_time), end.max(header.log_time)));
            }
            Some(Parsed::Metadata(metadata)) => {
                self.metadata.insert(metadata.name, metadata.metadata);
            }
            _ => {}
        }
    }

    /// Returns the number of messages over all topics.
    pub fn messages(&self) -> u64 {
        self.topics.values().map(|topic| topic.messages).sum()
    }
}

/// Returns the records in `bytes`, up to the first damage.
fn records_in(bytes: &[u8]) -> impl Iterator<Item = (u8, &[u8])> {
    let mut at = 0;
    std::iter::from_fn(move || {
        let opcode = *bytes.get(at)?;
        let start = at + PREFIX as usize;
        let length = u64::from_le_bytes(bytes.get(at + 1..start)?.try_into().ok()?) as usize;
        let body = bytes.get(start..start.checked_add(length)?)?;
        at = start + length;
        Some((opcode, body))
    })
}
