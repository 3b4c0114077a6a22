//! Bags: touch as a topic beside the images.

mod note;
mod output;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use self::note::{ChunkNote, ImageHead};
use super::source::{Picture, Shot, Shots, Source, Unit};
use crate::dataset::mcap::{Piece, Pieces, Survey, Topic, bag_files, op, survey};
use crate::error::{Error, Result};
use crate::message::{CompressedImage, Header, Image, Message, Time};

pub use output::about;
pub(super) use output::tactile_frame;

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
        Shot { stamp_secs, offset: Some(offset), picture, note: None }
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
        let pieces = Pieces::open(&self.files[unit])?;
        let walk = Walk { bag: self, pieces, channels: Channels::new(&self.topic), waiting: Vec::new().into_iter() };
        Ok(Box::new(walk.skip(from)))
    }
}

/// The image messages of one file in the order they lie in it.
struct Walk<'a> {
    bag: &'a Bag,
    pieces: Pieces,
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
            let piece = self.pieces.next()?.ok()?;
            let (mut shots, mut heads) = (Vec::new(), Vec::new());
            for (opcode, body) in piece.records() {
                if let Some(message) = self.channels.image(opcode, body) {
                    shots.push(self.bag.shot(&message, piece.offset()));
                    heads.push(ImageHead::of(&message));
                }
            }
            if let (Piece::Chunk(offset, content), Some(first)) = (&piece, shots.first_mut()) {
                first.note = ChunkNote::of(*offset, content, heads);
            }
            self.waiting = shots.into_iter();
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
                let message = ImageMessage { log_time: time(6)?, publish_time: time(14)?, payload: body.get(22..)? };
                (self.ids.get(&id) == Some(&true)).then_some(message)
            }
            _ => None,
        }
    }
}
