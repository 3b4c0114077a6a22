//! Labels of a bag: a copy of its records, with touch beside the images.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::Path;

use super::ids::{UsedIds, free_id};
use super::images::Bag;
use super::messages::Channels;
use super::note::{ImageHead, OriginalPiece, OriginalPieces};
use super::parse::parse;
use super::{
    BagFile, BagTopic, ChunkOutline, CopyWriter, Piece, Record, Records, bag_files, metadata_yaml, op, put_text, survey,
};
use crate::dataset::base_name;
use crate::dataset::copy::copy_regular;
use crate::dataset::label_frame::LabelFrame;
use crate::dataset::label_info::LabelInfo;
use crate::dataset::labels::{LabelOutput, SourceLabels, next_label};
use crate::dataset::prefetch::{prefetch, prefetch_up_to};
use crate::dataset::provenance::PROVENANCE_KEY;
use crate::error::{Error, Result};
use crate::file::input::InputFolder;
use crate::message::{Header, Message, TactileFrame};

/// Default topic of the labels: the predictor's own.
pub const TOPIC: &str = "/predictor/tactile";

impl LabelOutput for Bag {
    fn assemble(&self, labels: &dyn SourceLabels, info: &mut LabelInfo, at: &Path, out: &Path) -> Result<()> {
        let bare = self.files.len() == 1 && out.extension().is_some_and(|extension| extension == "mcap");
        if bare {
            TactileMessages::new(self, 0, 0, labels)?.copy(labels, at, info)?;
            return Ok(());
        }
        if at.exists() {
            fs::remove_dir_all(at).map_err(Error::io(at))?;
        }
        fs::create_dir_all(at).map_err(Error::io(at))?;
        let (mut files, mut topics) = (Vec::new(), BTreeMap::<String, BagTopic>::new());
        let mut sequence = 0;
        for index in 0..self.files.len() {
            let mut messages = TactileMessages::new(self, index, sequence, labels)?;
            let name = match (&self.folder, out.file_name()) {
                // The name that rosbag2 gives the file of a bag.
                (None, Some(_)) => format!("{}_{index}.mcap", base_name(out)),
                _ => self.units[index].name.clone(),
            };
            let writer = messages.copy(labels, &at.join(&name), info)?;
            sequence = messages.sequence;
            let messages = writer.counts().values().sum();
            files.push(BagFile { path: name, times: writer.times(), messages });
            for topic in topics_of(&writer) {
                let sum = topics.entry(topic.name.clone()).or_insert_with(|| BagTopic { messages: 0, ..topic.clone() });
                sum.messages += topic.messages;
            }
        }
        let yaml = at.join("metadata.yaml");
        let text = metadata_yaml(&topics.into_values().collect::<Vec<_>>(), &files)?;
        fs::write(&yaml, text).map_err(Error::io(&yaml))?;
        self.copy_others(at)
    }

    fn holds_keypoints(&self) -> bool {
        false
    }

    fn info(&self, out: &Path) -> Option<LabelInfo> {
        read_info(out)
    }
}

impl Bag {
    /// Copies files of the bag's folder that are neither recordings nor metadata, such as notes and calibration.
    fn copy_others(&self, to: &Path) -> Result<()> {
        let Some(folder) = &self.folder else { return Ok(()) };
        let inside = InputFolder::open(folder)?;
        for entry in fs::read_dir(folder).map_err(Error::io(folder))? {
            let entry = entry.map_err(Error::io(folder))?;
            let from = entry.path();
            let recording = from.extension().is_some_and(|extension| extension == "mcap");
            if from.is_file() && !recording && entry.file_name() != "metadata.yaml" {
                inside.check(&from)?;
                copy_regular(&from, &to.join(entry.file_name()))?;
            }
        }
        Ok(())
    }
}

/// Reads the description of the labels in a bag; None without one.
pub fn read_info(bag: &Path) -> Option<LabelInfo> {
    let survey = survey(bag_files(bag).ok()?.last()?).ok()?;
    serde_json::from_str(survey.metadata.get(PROVENANCE_KEY)?.get("about")?).ok()
}

/// The labels of one unit in order.
type Labels<'a> = dyn Iterator<Item = Result<LabelFrame>> + 'a;

/// Copies one file of a bag and adds a label after each of its images.
struct TactileMessages<'a> {
    bag: &'a Bag,
    index: usize,
    channels: Channels,
    channel: u16,
    schema: u16,
    /// True once schema and channel are written.
    announced: bool,
    /// Sequence number of the next label.
    sequence: u64,
}

impl<'a> TactileMessages<'a> {
    fn new(bag: &'a Bag, index: usize, sequence: u64, labels: &dyn SourceLabels) -> Result<Self> {
        let file = &bag.files[index];
        let used = UsedIds::of(file, labels.notes(index)?)?;
        if used.topics.contains(&bag.labels_topic) {
            let message = format!("has a topic {} already; choose another with --labels-topic", bag.labels_topic);
            return Err(Error::file(file, message));
        }
        let free = |ids: &BTreeSet<u16>, kind: &str| {
            let none =
                || Error::file(file, format!("uses all 65535 {kind} ids, so no label can be added; use --to store"));
            free_id(ids).ok_or_else(none)
        };
        let (channel, schema) = (free(&used.channels, "channel")?, free(&used.schemas, "schema")?);
        Ok(Self { bag, index, channels: Channels::default(), channel, schema, announced: false, sequence })
    }

    /// Copies the file to `to`.
    fn copy(&mut self, labels: &dyn SourceLabels, to: &Path, info: &mut LabelInfo) -> Result<CopyWriter> {
        let file = &self.bag.files[self.index];
        let pieces = OriginalPieces::new(Records::open(file)?, labels.notes(self.index)?);
        let (original, labels) = (Records::open(file)?, labels.labels(self.index)?);
        let mut out = CopyWriter::create(to, self.bag.surveys[self.index].chunked)?;
        // Reading and unpacking take as long as writing, so each runs on its own thread. A piece may be as large as a chunk.
        prefetch_up_to(0, pieces, |pieces| {
            prefetch(labels, |labels| {
                for piece in pieces {
                    out.flush_if_full()?;
                    match piece? {
                        OriginalPiece::Piece(piece) => self.piece(&piece, &original, info, labels, &mut out)?,
                        OriginalPiece::Noted(body, note) => {
                            // Later chunks without a note may hold messages of these channels.
                            for (opcode, body) in &note.skeleton.definitions {
                                self.channels.define(*opcode, body);
                            }
                            out.chunk(&body, note.skeleton)?;
                            note.images.iter().try_for_each(|image| self.write(image, info, labels, &mut out))?;
                        }
                    }
                }
                match labels.next().transpose()? {
                    Some(extra) => {
                        let got = format!("a label at {} s without an image", extra.stamp_secs);
                        Err(Error::value(&self.bag.units[self.index].name, "the images that were labelled", got))
                    }
                    None => Ok(()),
                }
            })
        })?;
        out.record(op::METADATA, &metadata(info)?)?;
        out.finish()?;
        Ok(out)
    }

    /// Copies a piece of the file `original` and writes the labels of its images.
    fn piece(
        &mut self,
        piece: &Piece,
        original: &Records,
        info: &mut LabelInfo,
        labels: &mut Labels,
        out: &mut CopyWriter,
    ) -> Result<()> {
        match piece {
            Piece::Lost(damage) => info.summary.lost.push(damage.clone()),
            // `CopyWriter` writes new message indexes: damage may have destroyed some, or the chunks they refer to.
            Piece::Record(Record { opcode: op::MESSAGE_INDEX, .. }, _) => {}
            Piece::Record(record, _) if record.opcode == op::ATTACHMENT => {
                if !out.attachment(original, record)? {
                    info.summary.lost.push(original.lost(record, "an attachment whose checksum is wrong"));
                }
            }
            Piece::Record(record, body) => out.record(record.opcode, body)?,
            Piece::Chunk(_, content) => match &content.lost {
                None => out.chunk(content.body(), ChunkOutline::of(content.records()))?,
                // The readable records of a truncated chunk go into a new chunk.
                Some(lost) => {
                    info.summary.lost.push(lost.clone());
                    piece.records().try_for_each(|(opcode, body)| out.record(opcode, body))?;
                }
            },
        }
        for (opcode, body) in piece.records() {
            let message = self.channels.message(opcode, body).filter(|message| message.topic == self.bag.topic);
            if let Some(head) = message.map(|message| ImageHead::of(&message)) {
                self.write(&head, info, labels, out)?;
            }
        }
        Ok(())
    }

    /// Writes the label of an image.
    fn write(&mut self, image: &ImageHead, info: &LabelInfo, labels: &mut Labels, out: &mut CopyWriter) -> Result<()> {
        let label = next_label(labels, &self.bag.units[self.index].name)?;
        if !self.announced {
            self.announce(out)?;
            self.announced = true;
        }
        let mut frame = tactile_frame(image.header(), &label, info)?;
        frame.sequence = self.sequence;
        let mut body = self.channel.to_le_bytes().to_vec();
        body.extend_from_slice(&(self.sequence as u32).to_le_bytes());
        body.extend_from_slice(&image.log_time.to_le_bytes());
        body.extend_from_slice(&image.publish_time.to_le_bytes());
        body.extend_from_slice(&frame.to_cdr());
        self.sequence += 1;
        out.record(op::MESSAGE, &body)?;
        // A chunk of the input may hold any number of small images.
        out.flush_if_full()
    }

    /// Writes schema and channel of the labels.
    fn announce(&self, out: &mut CopyWriter) -> Result<()> {
        let text = TactileFrame::schema();
        let mut schema = self.schema.to_le_bytes().to_vec();
        put_text(&mut schema, TactileFrame::TYPE);
        put_text(&mut schema, "ros2msg");
        put_text(&mut schema, &text);
        out.record(op::SCHEMA, &schema)?;
        let mut channel = [self.channel.to_le_bytes(), self.schema.to_le_bytes()].concat();
        put_text(&mut channel, &self.bag.labels_topic);
        put_text(&mut channel, "cdr");
        let mut metadata = Vec::new();
        put_text(&mut metadata, "offered_qos_profiles");
        put_text(&mut metadata, "");
        channel.extend_from_slice(&(metadata.len() as u32).to_le_bytes());
        channel.extend_from_slice(&metadata);
        out.record(op::CHANNEL, &channel)
    }
}

/// Returns the message of a label. Without a label the message has no hands, which means no result for this image.
pub(super) fn tactile_frame(header: Header, label: &LabelFrame, info: &LabelInfo) -> Result<TactileFrame> {
    let (model_id, topology) = (info.provenance.model_id(), info.provenance.topology.id().to_string());
    Ok(match &label.touch {
        Ok(field) => {
            let frame = TactileFrame::from_field(header, field)?.with_certainty(&label.certainty);
            TactileFrame { model_id, warming_up: label.warming_up, ..frame }
        }
        Err(reason) => TactileFrame {
            header,
            hands: Vec::new(),
            sequence: 0,
            inference_secs: f64::NAN,
            model_id,
            topology,
            warming_up: label.warming_up,
            familiarity: f32::NAN,
            reason: reason.clone(),
        },
    })
}

/// Returns the metadata record that describes the labels.
fn metadata(info: &LabelInfo) -> Result<Vec<u8>> {
    let json = serde_json::to_string(info).map_err(|e| Error::value(PROVENANCE_KEY, "JSON", e))?;
    let mut body = Vec::new();
    put_text(&mut body, PROVENANCE_KEY);
    let mut map = Vec::new();
    let provenance = &info.provenance;
    let entries = [
        ("about", json.as_str()),
        ("model", &provenance.model),
        ("model_sha256", &provenance.model_sha256),
        ("topology", provenance.topology.id()),
        ("version", &provenance.version),
    ];
    for (key, value) in entries {
        put_text(&mut map, key);
        put_text(&mut map, value);
    }
    body.extend_from_slice(&(map.len() as u32).to_le_bytes());
    body.extend_from_slice(&map);
    Ok(body)
}

/// Returns the topics of a written file as `metadata.yaml` lists them.
fn topics_of(writer: &CopyWriter) -> Vec<BagTopic> {
    let type_of = |id: u16| match writer.schemas().get(&id).and_then(|body| parse(op::SCHEMA, body)) {
        Some(mcap::records::Record::Schema { header, .. }) => header.name,
        _ => String::new(),
    };
    let topic = |body: &Vec<u8>| match parse(op::CHANNEL, body) {
        Some(mcap::records::Record::Channel(channel)) => Some(BagTopic {
            type_name: type_of(channel.schema_id),
            messages: writer.counts().get(&channel.id).copied().unwrap_or(0),
            name: channel.topic,
            encoding: channel.message_encoding,
            qos: channel.metadata.get("offered_qos_profiles").cloned().unwrap_or_default(),
        }),
        _ => None,
    };
    writer.channels().values().filter_map(topic).collect()
}
