//! A bag put together anew: its own records, and touch beside its images.

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;

use super::super::journal::Label;
use super::super::output::{Journals, Output};
use super::super::prefetch::ahead;
use super::super::provenance::NAME;
use super::super::summary::About;
use super::note::{ImageHead, Original, Originals};
use super::{Bag, Channels};
use crate::dataset::mcap::{
    BagFile, BagTopic, CopyWriter, Piece, Record, Records, Skeleton, bag_files, metadata_yaml, op, put_text, survey,
};
use crate::error::{Error, Result};
use crate::message::{Header, Message, TactileFrame};

impl Output for Bag {
    fn assemble(&self, journals: &Journals, about: &mut About, at: &Path, out: &Path) -> Result<()> {
        let bare = self.files.len() == 1 && out.extension().is_some_and(|extension| extension == "mcap");
        if bare {
            let mut labels = TactileMessages::new(self, 0);
            labels.copy(journals, at, about)?;
            return Ok(());
        }
        if at.exists() {
            fs::remove_dir_all(at).map_err(Error::io(at))?;
        }
        fs::create_dir_all(at).map_err(Error::io(at))?;
        let (mut files, mut topics) = (Vec::new(), BTreeMap::<String, BagTopic>::new());
        let mut sequence = 0;
        for index in 0..self.files.len() {
            let mut messages = TactileMessages::new(self, index);
            messages.sequence = sequence;
            let name = match (&self.folder, out.file_name()) {
                // As rosbag2 names the file of a bag.
                (None, Some(out)) => format!("{}_{index}.mcap", out.to_string_lossy()),
                _ => self.units[index].name.clone(),
            };
            let writer = messages.copy(journals, &at.join(&name), about)?;
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

    fn about(&self, out: &Path) -> Option<About> {
        about(out)
    }
}

impl Bag {
    /// Files of the bag's folder that are neither recordings nor metadata: notes, calibration.
    fn copy_others(&self, to: &Path) -> Result<()> {
        let Some(folder) = &self.folder else { return Ok(()) };
        for entry in fs::read_dir(folder).map_err(Error::io(folder))?.flatten() {
            let from = entry.path();
            let recording = from.extension().is_some_and(|extension| extension == "mcap");
            if from.is_file() && !recording && entry.file_name() != "metadata.yaml" {
                fs::copy(&from, to.join(entry.file_name())).map_err(Error::io(&from))?;
            }
        }
        Ok(())
    }
}

/// What a labelled bag says about its labels.
pub fn about(bag: &Path) -> Option<About> {
    let survey = survey(bag_files(bag).ok()?.last()?).ok()?;
    serde_json::from_str(survey.metadata.get(NAME)?.get("about")?).ok()
}

/// The labels of one unit, as they are read.
type Labels<'a> = dyn Iterator<Item = Result<Label>> + 'a;

/// Copies one file of a bag and puts labels beside its images.
struct TactileMessages<'a> {
    bag: &'a Bag,
    index: usize,
    channels: Channels,
    channel: u16,
    schema: u16,
    // Whether schema and channel are written.
    announced: bool,
    sequence: u64,
}

impl<'a> TactileMessages<'a> {
    fn new(bag: &'a Bag, index: usize) -> Self {
        let survey = &bag.surveys[index];
        let free = |used: Option<&u16>| used.map_or(1, |last| last.saturating_add(1));
        Self {
            bag,
            index,
            channels: Channels::new(&bag.topic),
            channel: free(survey.topics.keys().last()),
            schema: free(survey.schemas.keys().last()),
            announced: false,
            sequence: 0,
        }
    }

    fn copy(&mut self, journals: &Journals, to: &Path, about: &mut About) -> Result<CopyWriter> {
        let file = &self.bag.files[self.index];
        let (original, labels) = (Records::open(file)?, journals.labels(self.index)?);
        let pieces = Originals::new(Records::open(file)?, journals.heads(self.index)?);
        let mut out = CopyWriter::create(to, self.bag.surveys[self.index].chunked)?;
        // Reading, and unpacking what has no note, takes as long as writing.
        ahead(pieces, |pieces| {
            ahead(labels, |labels| {
                for piece in pieces {
                    out.flush_if_full()?;
                    match piece? {
                        Original::Piece(piece) => self.piece(&piece, &original, about, labels, &mut out)?,
                        Original::Noted(body, note) => {
                            // Chunks without a note may come after this one, with messages of its channels.
                            for (opcode, body) in &note.skeleton.definitions {
                                self.channels.image(*opcode, body);
                            }
                            out.chunk(&body, note.skeleton)?;
                            note.images.iter().try_for_each(|image| self.write(image, about, labels, &mut out))?;
                        }
                    }
                }
                match labels.next().transpose()? {
                    Some(extra) => {
                        let got = format!("a label at {} s without one", extra.stamp_secs);
                        Err(Error::value(&self.bag.units[self.index].name, "the images that were labelled", got))
                    }
                    None => Ok(()),
                }
            })
        })?;
        out.record(op::METADATA, &metadata(about)?)?;
        out.finish()?;
        Ok(out)
    }

    /// Copies a piece of the file `original`, and writes the labels of its images.
    fn piece(
        &mut self,
        piece: &Piece,
        original: &Records,
        about: &mut About,
        labels: &mut Labels,
        out: &mut CopyWriter,
    ) -> Result<()> {
        match piece {
            Piece::Lost(damage) => about.summary.lost.push(damage.clone()),
            // Made anew: damage may have taken some of them, and what they point to.
            Piece::Record(Record { opcode: op::MESSAGE_INDEX, .. }, _) => {}
            Piece::Record(record, _) if record.opcode == op::ATTACHMENT => {
                if !out.attachment(original.file(), record)? {
                    about.summary.lost.push(original.lost(record, "an attachment whose checksum is wrong"));
                }
            }
            Piece::Record(record, body) => out.record(record.opcode, body)?,
            Piece::Chunk(_, content) => match &content.lost {
                None => out.chunk(content.body(), Skeleton::of(content.records()))?,
                // What a chunk without end still gives becomes a whole one.
                Some(lost) => {
                    about.summary.lost.push(lost.clone());
                    piece.records().try_for_each(|(opcode, body)| out.record(opcode, body))?;
                }
            },
        }
        for (opcode, body) in piece.records() {
            if let Some(image) = self.channels.image(opcode, body) {
                self.write(&ImageHead::of(&image), about, labels, out)?;
            }
        }
        Ok(())
    }

    /// Writes the label that belongs to an image's message.
    fn write(&mut self, image: &ImageHead, about: &About, labels: &mut Labels, out: &mut CopyWriter) -> Result<()> {
        let label = labels.next().transpose()?.ok_or_else(|| {
            Error::value(&self.bag.units[self.index].name, "the images that were labelled", "more of them")
        })?;
        if !self.announced {
            self.announce(out)?;
            self.announced = true;
        }
        let mut frame = tactile_frame(image.header(), &label, about)?;
        frame.sequence = self.sequence;
        let mut body = self.channel.to_le_bytes().to_vec();
        body.extend_from_slice(&(self.sequence as u32).to_le_bytes());
        body.extend_from_slice(&image.log_time.to_le_bytes());
        body.extend_from_slice(&image.publish_time.to_le_bytes());
        body.extend_from_slice(&frame.to_cdr());
        self.sequence += 1;
        out.record(op::MESSAGE, &body)
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

/// The message of a label; without hands if there is none, which says that there is no result for this image.
pub(in crate::label) fn tactile_frame(header: Header, label: &Label, about: &About) -> Result<TactileFrame> {
    let (model_id, topology) = (about.provenance.model_id(), about.provenance.topology.id().to_string());
    Ok(match &label.touch {
        Ok(field) => {
            TactileFrame { model_id, warming_up: label.warming_up, ..TactileFrame::from_field(header, field)? }
        }
        Err(_) => TactileFrame {
            header,
            hands: Vec::new(),
            sequence: 0,
            inference_secs: f64::NAN,
            model_id,
            topology,
            warming_up: label.warming_up,
        },
    })
}

/// The metadata record that says where the labels come from.
fn metadata(about: &About) -> Result<Vec<u8>> {
    let json = serde_json::to_string(about).map_err(|e| Error::value(NAME, "JSON", e))?;
    let mut body = Vec::new();
    put_text(&mut body, NAME);
    let mut map = Vec::new();
    let provenance = &about.provenance;
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

/// Topics of a written file as `metadata.yaml` names them.
fn topics_of(writer: &CopyWriter) -> Vec<BagTopic> {
    let type_of = |id: u16| match writer.schemas().get(&id).map(|body| mcap::parse_record(op::SCHEMA, body)) {
        Some(Ok(mcap::records::Record::Schema { header, .. })) => header.name,
        _ => String::new(),
    };
    let topic = |body: &Vec<u8>| match mcap::parse_record(op::CHANNEL, body) {
        Ok(mcap::records::Record::Channel(channel)) => Some(BagTopic {
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
