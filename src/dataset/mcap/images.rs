//! Bags as image sources, one unit per file.

use std::ops::Range;
use std::path::{Path, PathBuf};

use super::messages::Channels;
use super::note::{ChunkNote, ImageHead, LARGEST};
use super::{Piece, Pieces, Survey, Topic, bag_files, survey};
use crate::dataset::base_name;
use crate::dataset::identity::InputFiles;
use crate::dataset::source::{EncodedImage, ImageSource, SourceFrame, SourceFrames, Unit, skip_images};
use crate::error::{Error, Result};
use crate::message::{CompressedImage, Header, Image, Message, Time};

/// A bag whose images are labelled.
#[derive(Debug)]
pub struct Bag {
    pub(super) files: Vec<PathBuf>,
    pub(super) surveys: Vec<Survey>,
    pub(super) units: Vec<Unit>,
    pub(super) topic: String,
    compressed: bool,
    pub(super) labels_topic: String,
    /// The bag's folder; None for an MCAP file by itself.
    pub(super) folder: Option<PathBuf>,
}

impl Bag {
    /// Opens the bag or MCAP file at `path`. Images come from `topic`, by default the only image topic; labels go to
    /// `labels_topic`.
    ///
    /// # Errors
    /// If a file can't be read, `topic` does not exist or is ambiguous, or `labels_topic` exists already.
    pub fn open(path: &Path, topic: Option<&str>, labels_topic: &str) -> Result<Self> {
        let files = bag_files(path)?;
        let surveys = files.iter().map(|file| survey(file)).collect::<Result<Vec<_>>>()?;
        let chosen = image_topic(&surveys, path, topic)?;
        if surveys.iter().flat_map(|survey| survey.topics.values()).any(|topic| topic.name == labels_topic) {
            let message = format!("has a topic {labels_topic} already; choose another with --labels-topic");
            return Err(Error::file(path, message));
        }
        let (topic, compressed) = (chosen.name.clone(), chosen.type_name == CompressedImage::TYPE);
        let unit = |(file, survey): (&PathBuf, &Survey)| Unit {
            name: base_name(file),
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

    /// Returns the topic of the images.
    pub fn topic(&self) -> &str {
        &self.topic
    }

    /// Returns the MCAP files in order.
    pub fn files(&self) -> &[PathBuf] {
        &self.files
    }

    /// Decodes the payload of an image message; `log_time`: ns.
    fn frame(&self, payload: &[u8], log_time: u64, offset: u64) -> SourceFrame {
        let read = || -> Result<(Header, EncodedImage)> {
            if self.compressed {
                let CompressedImage { header, data, .. } = CompressedImage::from_cdr(payload)?;
                return Ok((header, EncodedImage::File(data)));
            }
            let image = Image::from_cdr(payload)?;
            Ok((image.header.clone(), EncodedImage::Raw(image)))
        };
        let (stamp, image) = match read() {
            Ok((header, image)) => (header.stamp, Ok(image)),
            Err(error) => (Time::default(), Err(error.to_string())),
        };
        // An image without a stamp takes the time of its recording.
        let stamp_secs = if stamp.is_zero() { log_time as f64 * 1e-9 } else { stamp.secs() };
        SourceFrame { stamp_secs, offset: Some(offset), image, note: None }
    }
}

/// Returns the image topic called `wanted`, or the only one.
fn image_topic<'a>(surveys: &'a [Survey], path: &Path, wanted: Option<&str>) -> Result<&'a Topic> {
    let all = || surveys.iter().flat_map(|survey| survey.topics.values());
    let is_image = |topic: &&Topic| {
        [Image::TYPE, CompressedImage::TYPE].contains(&topic.type_name.as_str()) && topic.encoding == "cdr"
    };
    let mut images: Vec<&Topic> = all().filter(is_image).collect();
    images.sort_by(|a, b| a.name.cmp(&b.name));
    images.dedup_by(|a, b| a.name == b.name);
    let names = || images.iter().map(|topic| topic.name.as_str());
    match (wanted, images.as_slice()) {
        (Some(wanted), _) => {
            let found = images.iter().find(|topic| topic.name == wanted);
            found.copied().ok_or_else(|| Error::unknown("image topic", wanted, names()))
        }
        (None, [only]) => Ok(only),
        (None, []) => {
            let present = all().map(|topic| format!("{} ({})", topic.name, topic.type_name)).collect::<Vec<_>>();
            let name = format!("a topic of {} or {}", Image::TYPE, CompressedImage::TYPE);
            Err(Error::Missing { name, place: path.display().to_string(), present: present.join(", ") })
        }
        (None, _) => {
            let expected = "one topic of images, or one named by --topic";
            Err(Error::value(path.display(), expected, names().collect::<Vec<_>>().join(", ")))
        }
    }
}

impl ImageSource for Bag {
    fn units(&self) -> &[Unit] {
        &self.units
    }

    fn files(&self) -> Result<InputFiles> {
        let folder = self.folder.as_deref();
        let mut files = InputFiles::new(folder.or(self.files.first().map(PathBuf::as_path)).unwrap_or(Path::new("")));
        files.add(folder.map(|folder| folder.join("metadata.yaml")));
        files.add(self.files.iter().cloned());
        Ok(files)
    }

    fn frames(&self, unit: usize, from: usize) -> Result<SourceFrames<'_>> {
        let pieces = Pieces::open(&self.files[unit])?;
        let frames = BagFrames { bag: self, pieces, channels: Channels::default(), open: None };
        Ok(skip_images(frames, from))
    }
}

/// Image messages of one file in their order.
struct BagFrames<'a> {
    bag: &'a Bag,
    pieces: Pieces,
    channels: Channels,
    open: Option<OpenPiece>,
}

/// A piece whose images are decoded one by one: a chunk and one of its images are in memory, not all images.
struct OpenPiece {
    piece: Piece,
    /// Images that are not decoded yet.
    images: std::vec::IntoIter<ImagePlace>,
    /// Note of the chunk, which goes with its first image.
    note: Option<String>,
}

/// An image message within the bytes of a piece.
struct ImagePlace {
    /// Time of recording, ns.
    log_time: u64,
    payload: Range<usize>,
}

impl BagFrames<'_> {
    /// Finds the images of a piece.
    fn find_images(&mut self, mut piece: Piece) -> OpenPiece {
        let (mut images, mut heads, mut size) = (Vec::new(), Vec::new(), 0);
        for (end, opcode, body) in piece.entries() {
            if let Some(message) = self.channels.message(opcode, body).filter(|m| m.topic == self.bag.topic) {
                images.push(ImagePlace { log_time: message.log_time, payload: end - message.payload.len()..end });
                if size <= LARGEST {
                    let head = ImageHead::of(&message);
                    size += head.memory();
                    heads.push(head);
                }
            }
        }
        let mut note = None;
        if let Piece::Chunk(offset, content) = &mut piece {
            note = (heads.len() == images.len()).then(|| ChunkNote::of(*offset, content, heads)).flatten();
            content.forget_body();
        }
        OpenPiece { piece, images: images.into_iter(), note }
    }
}

impl Iterator for BagFrames<'_> {
    type Item = Result<SourceFrame>;

    fn next(&mut self) -> Option<Self::Item> {
        loop {
            if let Some(OpenPiece { piece, images, note }) = &mut self.open
                && let Some(ImagePlace { log_time, payload }) = images.next()
            {
                let payload = piece.bytes().get(payload).unwrap_or_default();
                let frame = self.bag.frame(payload, log_time, piece.offset());
                return Some(Ok(SourceFrame { note: note.take(), ..frame }));
            }
            // Free the piece before the next one is read.
            self.open = None;
            self.open = match self.pieces.next()? {
                Ok(piece) => Some(self.find_images(piece)),
                Err(error) => return Some(Err(error)),
            };
        }
    }
}
