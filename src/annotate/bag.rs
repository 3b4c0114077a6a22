//! Bags: touch as a topic beside the images.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

use super::journal::{Label, Labels};
use super::output::{Journals, Output};
use super::provenance::NAME;
use super::source::{Picture, Shot, Shots, Source, Unit};
use super::summary::About;
use crate::dataset::mcap::{
    BagFile, BagTopic, CopyWriter, Lost, Part, Record, Records, Survey, bag_files, inner_records, metadata_yaml, op,
    open_chunk, survey,
};
use crate::dataset::mcap::{Topic, put_text};
use crate::error::{Error, Result};
use crate::message::{CompressedImage, Header, Image, Message, Reader, TactileFrame, Time};

/// Topic of the labels where none is asked for: the predictor's own.
pub const TOPIC: &str = "/predictor/tactile";

/// A bag whose images are labelled: one unit per file.
#[derive(Debug)]
pub struct Bag {
    files: Vec<PathBuf>,
    surveys: Vec<Survey>,
    units: Vec<Unit>,
    topic: String,
    compressed: bool,
    labels_topic: String,
    folder: Option<PathBuf>,
}

impl Bag {
    /// Opens the bag or MCAP file at `path`. Images come from `topic`, or from the only image topic; labels go to
    /// `labels_topic`.
    ///
    /// # Errors
    /// If a file can't be read, there is no such topic or no single one, or `labels_topic` is there already.
    pub fn open(path: &Path, topic: Option<&str>, labels_topic: &str) -> Result<Self> {
        let files = bag_files(path)?;
        let surveys = files.iter().map(|file| survey(file)).collect::<Result<Vec<_>>>()?;
        let all = || surveys.iter().flat_map(|survey| survey.topics.values());
        let mut images: Vec<&Topic> = all().filter(|topic| is_image(topic)).collect();
        images.sort_by(|a, b| a.name.cmp(&b.name));
        images.dedup_by(|a, b| a.name == b.name);
        let names = || images.iter().map(|topic| topic.name.as_str());
        let chosen = match (topic, images.as_slice()) {
            (Some(wanted), _) => images.iter().find(|topic| topic.name == wanted),
            (None, [only]) => Some(only),
            (None, []) => {
                let present = all().map(|topic| format!("{} ({})", topic.name, topic.type_name)).collect::<Vec<_>>();
                let name = format!("a topic of {} or {}", Image::TYPE, CompressedImage::TYPE);
                return Err(Error::Missing { name, place: path.display().to_string(), present: present.join(", ") });
            }
            (None, _) => {
                let expected = "one topic of images, or one named by --topic";
                return Err(Error::value(path.display(), expected, names().collect::<Vec<_>>().join(", ")));
            }
        };
        let chosen = chosen.ok_or_else(|| Error::unknown("image topic", topic.unwrap_or_default(), names()))?;
        if all().any(|topic| topic.name == labels_topic) {
            let message = format!("has a topic {labels_topic} already; choose another with --labels-topic");
            return Err(Error::file(path, message));
        }
        let (topic, compressed) = (chosen.name.clone(), chosen.type_name == CompressedImage::TYPE);
        let unit = |(file, survey): (&PathBuf, &Survey)| Unit {
            name: file_name(file),
            frames: Some(survey.topics.values().filter(|t| t.name == topic).map(|t| t.messages as usize).sum()),
        };
        Ok(Self {
            units: files.iter().zip(&surveys).map(unit).collect(),
            files,
            surveys,
            topic,
            compressed,
            labels_topic: labels_topic.to_string(),
            folder: path.is_dir().then(|| path.to_path_buf()),
        })
    }

    /// The topic of the images.
    pub fn topic(&self) -> &str {
        &self.topic
    }

    /// The MCAP files.
    pub fn files(&self) -> &[PathBuf] {
        &self.files
    }

    /// The image in a message's payload.
    fn shot(&self, message: &ImageMessage, offset: u64) -> Shot {
        let read = || -> Result<(Header, Picture)> {
            if self.compressed {
                let CompressedImage { header, data, .. } = CompressedImage::from_cdr(message.payload)?;
                return Ok((header, Picture::File(data)));
            }
            let image = Image::from_cdr(message.payload)?;
            Ok((image.header.clone(), Picture::Raw(image)))
        };
        let (stamp, picture) = match read() {
            Ok((header, picture)) => (header.stamp, Ok(picture)),
            Err(error) => (Time::default(), Err(error.to_string())),
        };
        // An image that nobody stamped is as old as its recording.
        let stamp_secs = if stamp.is_zero() { message.log_time as f64 * 1e-9 } else { stamp.secs() };
        Shot { stamp_secs, offset: Some(offset), picture }
    }
}

fn is_image(topic: &Topic) -> bool {
    [Image::TYPE, CompressedImage::TYPE].contains(&topic.type_name.as_str()) && topic.encoding == "cdr"
}

fn file_name(path: &Path) -> String {
    path.file_name().unwrap_or_default().to_string_lossy().into_owned()
}

impl Source for Bag {
    fn units(&self) -> &[Unit] {
        &self.units
    }

    fn shots(&self, unit: usize, from: usize) -> Result<Shots<'_>> {
        let records = Records::open(&self.files[unit])?;
        let walk = Walk { bag: self, records, channels: Channels::new(&self.topic), waiting: Vec::new().into_iter() };
        Ok(Box::new(walk.skip(from)))
    }
}

/// The image messages of one file in the order they lie in it.
struct Walk<'a> {
    bag: &'a Bag,
    records: Records,
    channels: Channels,
    waiting: std::vec::IntoIter<Shot>,
}

impl Iterator for Walk<'_> {
    type Item = Shot;

    fn next(&mut self) -> Option<Shot> {
        loop {
            if let Some(shot) = self.waiting.next() {
                return Some(shot);
            }
            // What can't be read here can't be read when the bag is put together, which says so.
            let part = self.records.next_part().ok()??;
            let (offset, content) = match &part {
                Part::Lost(_) => continue,
                Part::Record(record) if record.opcode != op::CHUNK => {
                    if !matches!(record.opcode, op::CHANNEL | op::MESSAGE) {
                        continue;
                    }
                    (record.offset, Inner::Single(record.opcode, self.records.body(record).ok()?))
                }
                Part::Record(record) | Part::CutOff(record) => match open_chunk(&self.records, &part).ok()? {
                    Ok(content) => (record.offset, Inner::Chunk(content.records)),
                    Err(_) => continue,
                },
            };
            let mut shots = Vec::new();
            let channels = &mut self.channels;
            content.for_each(|opcode, body| {
                if let Some(message) = channels.image(opcode, body) {
                    shots.push(self.bag.shot(&message, offset));
                }
            });
            self.waiting = shots.into_iter();
        }
    }
}

/// One record, or those of a chunk.
enum Inner {
    Single(u8, Vec<u8>),
    Chunk(Vec<u8>),
}

impl Inner {
    fn for_each(&self, mut take: impl FnMut(u8, &[u8])) {
        match self {
            Self::Single(opcode, body) => take(*opcode, body),
            Self::Chunk(records) => inner_records(records).for_each(|(_, opcode, body)| take(opcode, body)),
        }
    }
}

/// Finds the messages of one topic.
struct Channels {
    topic: String,
    ids: BTreeMap<u16, bool>,
}

/// A message of the images' topic.
struct ImageMessage<'a> {
    log_time: u64,
    publish_time: u64,
    payload: &'a [u8],
}

impl Channels {
    fn new(topic: &str) -> Self {
        Self { topic: topic.to_string(), ids: BTreeMap::new() }
    }

    fn image<'a>(&mut self, opcode: u8, body: &'a [u8]) -> Option<ImageMessage<'a>> {
        match opcode {
            op::CHANNEL => {
                if let Ok(mcap::records::Record::Channel(channel)) = mcap::parse_record(opcode, body) {
                    self.ids.insert(channel.id, channel.topic == self.topic);
                }
                None
            }
            op::MESSAGE => {
                // Channel, sequence, two times, payload.
                let id = u16::from_le_bytes(*body.first_chunk()?);
                let time = |at: usize| Some(u64::from_le_bytes(*body.get(at..)?.first_chunk()?));
                let message =
                    ImageMessage { log_time: time(6)?, publish_time: time(14)?, payload: body.get(22..)? };
                (self.ids.get(&id) == Some(&true)).then_some(message)
            }
            _ => None,
        }
    }
}

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
        let mut records = Records::open(&self.bag.files[self.index])?;
        let mut labels = journals.labels(self.index)?;
        let mut out = CopyWriter::create(to, self.bag.surveys[self.index].chunked)?;
        let mut lost: Vec<Lost> = Vec::new();
        while let Some(part) = records.next_part()? {
            let content = match &part {
                Part::Lost(damage) => {
                    lost.push(damage.clone());
                    continue;
                }
                Part::Record(record) if record.opcode != op::CHUNK => {
                    match record.opcode {
                        op::DATA_END => break,
                        // Made anew: damage may have taken some of them, and what they point to.
                        op::MESSAGE_INDEX => {}
                        op::ATTACHMENT => self.attachment(&records, record, &mut out, &mut lost)?,
                        _ => {
                            out.flush_if_full()?;
                            let body = records.body(record)?;
                            out.record(record.opcode, &body)?;
                            Inner::Single(record.opcode, body).label(self, about, &mut labels, &mut out)?;
                        }
                    }
                    continue;
                }
                chunk => chunk,
            };
            out.flush_if_full()?;
            let (Part::Record(record) | Part::CutOff(record)) = content else { continue };
            match open_chunk(&records, content)? {
                Err(reason) => lost.push(records.lost(record, reason)),
                Ok(content) => {
                    if content.whole {
                        out.chunk(&records.body(record)?, &content.records)?;
                    } else {
                        // What a chunk without end still gives becomes a whole one.
                        let got = inner_records(&content.records).count();
                        let reason = format!("the file ends within this chunk, of which {got} records were read");
                        lost.push(records.lost(record, reason));
                        for (_, opcode, body) in inner_records(&content.records) {
                            out.record(opcode, body)?;
                        }
                    }
                    Inner::Chunk(content.records).label(self, about, &mut labels, &mut out)?;
                }
            }
        }
        about.summary.lost.append(&mut lost);
        if let Some(extra) = labels.next().transpose()? {
            let got = format!("a label at {} s without one", extra.stamp_secs);
            return Err(Error::value(&self.bag.units[self.index].name, "the images that were labelled", got));
        }
        out.record(op::METADATA, &metadata(about)?)?;
        out.finish()?;
        Ok(out)
    }

    fn attachment(&self, from: &Records, record: &Record, out: &mut CopyWriter, lost: &mut Vec<Lost>) -> Result<()> {
        if !out.attachment(from.file(), record)? {
            lost.push(from.lost(record, "an attachment whose checksum is wrong"));
        }
        Ok(())
    }

    /// Writes the label that belongs to an image's message.
    fn write(
        &mut self,
        image: &ImageMessage,
        about: &About,
        labels: &mut Labels,
        out: &mut CopyWriter,
    ) -> Result<()> {
        let label = labels.next().transpose()?.ok_or_else(|| {
            Error::value(&self.bag.units[self.index].name, "the images that were labelled", "more of them")
        })?;
        if !self.announced {
            self.announce(out)?;
            self.announced = true;
        }
        let header = Reader::leading::<Header>(Image::TYPE, image.payload).unwrap_or_else(|_| Header {
            stamp: Time::from_nanos(image.log_time as i64),
            frame_id: String::new(),
        });
        let mut frame = tactile_frame(header, &label, about)?;
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

impl Inner {
    /// Writes the labels of the images among these records.
    fn label(&self, to: &mut TactileMessages, about: &About, labels: &mut Labels, out: &mut CopyWriter) -> Result<()> {
        let mut result = Ok(());
        self.for_each(|opcode, body| {
            if let Some(image) = to.channels.image(opcode, body)
                && result.is_ok()
            {
                result = to.write(&image, about, labels, out);
            }
        });
        result
    }
}

/// The message of a label; without hands if there is none, which says that there is no result for this image.
pub(super) fn tactile_frame(header: Header, label: &Label, about: &About) -> Result<TactileFrame> {
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
