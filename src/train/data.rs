//! Stores as training sees them: resized images, labels, masks.

use std::cmp::Ordering;
use std::ops::Range;

use rayon::prelude::*;

use super::keypoints::{self, Points};
use super::source::{Source, Supervision};
use crate::dataset::EpisodeReader;
use crate::dataset::zarr::{
    self, CAMERA_EGO_RGB, FRAME_VALIDITY, MANO_CONTACT_VALID, MANO_FORCE, MANO_FORCE_VALID, TIMESTAMPS, ZarrReader,
};
use crate::error::{Error, Result};
use crate::hand::Topology;
use crate::image::{Preparation, resize};
use crate::tactile::{CONTACT_FORCE_N, N_FIELD, TactileSequence, episode_ranges};

/// Frames read at once while a store is scanned.
const BLOCK: usize = 128;

/// Stores, and how their images become the network's input.
#[derive(Debug)]
pub struct Dataset {
    stores: Vec<Store>,
    preparation: Preparation,
}

#[derive(Debug)]
struct Store {
    /// Index of the source it belongs to.
    source: usize,
    /// Whether its images may be mirrored.
    mirrorable: bool,
    supervision: Supervision,
    reader: ZarrReader,
    timestamps: Vec<f64>,
    memory: Option<Block>,
    keypoints: Option<Vec<Points>>,
}

/// Consecutive frames of one store.
#[derive(Debug, Clone, Default)]
pub struct Block {
    /// (n, side, side, 3) u8: resized, not yet normalised.
    pub images: Vec<u8>,
    /// Labels of these frames; the masks are given, and 1 where a label is supervised, known and in a valid frame.
    pub labels: TactileSequence,
}

/// What the supervised labels of a dataset say.
#[derive(Debug, Clone, PartialEq)]
pub struct Statistics {
    /// 99th percentile of the forces above 0.05 N, N: what one unit of the network's output stands for. None without
    /// such a force.
    pub force_scale: Option<f32>,
    /// (1556) N; 0 where nothing is supervised.
    pub mean_force: Vec<f32>,
    /// (1556) share of frames in contact; 0 where nothing is supervised.
    pub contact_rate: Vec<f32>,
}

impl Dataset {
    /// Takes stores; `in_memory` reads them whole at once.
    ///
    /// # Errors
    /// If there is none, or one can't be read.
    pub fn new(readers: Vec<ZarrReader>, preparation: Preparation, in_memory: bool) -> Result<Self> {
        let alike = |reader| (0, Source::of([]), reader);
        Self::from_readers(readers.into_iter().map(alike).collect(), preparation, in_memory)
    }

    /// Opens the stores of several sources.
    ///
    /// # Errors
    /// If one can't be opened or read, or two differ in topology.
    pub fn open(sources: &[Source], preparation: Preparation, in_memory: bool) -> Result<Self> {
        let mut readers: Vec<(usize, Source, ZarrReader)> = Vec::new();
        for (index, source) in sources.iter().enumerate() {
            for reader in zarr::open_all(&source.stores)? {
                if let Some((_, _, first)) = readers.first() {
                    let topology = reader.attributes().topology;
                    let fits = first.attributes().topology.must_match(topology);
                    fits.map_err(|error| Error::file(reader.path(), error))?;
                }
                readers.push((index, source.clone(), reader));
            }
        }
        Self::from_readers(readers, preparation, in_memory)
    }

    /// From stores with index and properties of their sources.
    fn from_readers(
        readers: Vec<(usize, Source, ZarrReader)>,
        preparation: Preparation,
        in_memory: bool,
    ) -> Result<Self> {
        if readers.is_empty() {
            return Err(Error::value("data", "at least one store", "none"));
        }
        let mut dataset = Self { stores: Vec::new(), preparation };
        for (source, Source { mirror: mirrorable, labels: supervision, .. }, reader) in readers {
            let timestamps = reader.read(TIMESTAMPS, 0..reader.len())?.into_f64();
            check_timestamps(&reader, &timestamps)?;
            dataset.stores.push(Store {
                source,
                mirrorable,
                supervision,
                reader,
                timestamps,
                memory: None,
                keypoints: None,
            });
        }
        if in_memory {
            for index in 0..dataset.stores.len() {
                let images = dataset.read(index, 0..dataset.stores[index].reader.len(), false)?.images;
                let store = &mut dataset.stores[index];
                store.memory = Some(Block { images, labels: store.all_labels()? });
            }
        }
        Ok(dataset)
    }

    /// Finds the keypoints in all frames, so that batches hold them.
    ///
    /// # Errors
    /// If a store can't be read, or none says where camera and hands are.
    pub fn find_keypoints(&mut self) -> Result<()> {
        let mut known = false;
        for store in &mut self.stores {
            let points = keypoints::read(&store.reader, 0..store.reader.len(), &self.preparation)?;
            known |= points.iter().flatten().any(|place| !place[0].is_nan());
            store.keypoints = Some(points);
        }
        match known {
            true => Ok(()),
            false => {
                let expected = "a store of the built-in hand with camera and hand poses, as `egotac sim` writes it";
                Err(Error::value("data, for loss.keypoints", expected, "none"))
            }
        }
    }

    /// What the vertex indices of every store mean.
    pub fn topology(&self) -> Topology {
        self.stores.first().map(|store| store.reader.attributes().topology).unwrap_or_default()
    }

    /// Frames of all stores.
    pub fn n_frames(&self) -> usize {
        self.stores.iter().map(|store| store.reader.len()).sum()
    }

    /// Store and frames of every episode.
    pub fn episodes(&self) -> Vec<(usize, Range<usize>)> {
        let of = |(index, store): (usize, &'_ Store)| {
            episode_ranges(store.reader.episode_ends()).map(|range| (index, range)).collect::<Vec<_>>()
        };
        self.stores.iter().enumerate().flat_map(of).collect()
    }

    /// Index of the source that a store belongs to.
    pub fn source(&self, store: usize) -> usize {
        self.stores[store].source
    }

    /// How images become the network's input.
    pub(super) fn preparation(&self) -> &Preparation {
        &self.preparation
    }

    /// Whether a store's images may be mirrored.
    pub(super) fn mirrorable(&self, store: usize) -> bool {
        self.stores[store].mirrorable
    }

    /// Keypoints of every frame of a store, once they were looked for.
    pub(super) fn keypoints(&self, store: usize) -> Option<&[Points]> {
        self.stores[store].keypoints.as_deref()
    }

    /// Seconds of every frame of a store.
    pub fn timestamps(&self, store: usize) -> &[f64] {
        &self.stores[store].timestamps
    }

    /// Reads frames of a store; without labels, only `images` is filled.
    ///
    /// # Errors
    /// If an array can't be read, or the store has no labels where they are asked for.
    pub fn read(&self, store: usize, frames: Range<usize>, labels: bool) -> Result<Block> {
        let Store { reader, memory, .. } = &self.stores[store];
        let side = self.preparation.side;
        if let Some(memory) = memory {
            let pixels = side * side * 3;
            let images = memory.images[frames.start * pixels..frames.end * pixels].to_vec();
            return Ok(Block { images, labels: memory.labels.select(frames) });
        }
        let mut block = Block::default();
        if labels {
            block.labels = self.stores[store].labels(frames.clone())?;
        }
        let (height, width) = reader.image_size();
        // Stores may be larger than what is kept of them: read and shrink in pieces.
        let mut start = frames.start;
        while start < frames.end {
            let piece = start..(start + BLOCK).min(frames.end);
            let raw = reader.read_u8(CAMERA_EGO_RGB, piece.clone())?;
            let shrunk: Result<Vec<Vec<u8>>> = raw
                .par_chunks(height * width * 3)
                .map(|pixels| {
                    let image =
                        ::image::RgbImage::from_raw(width as u32, height as u32, pixels.to_vec()).ok_or_else(|| {
                            Error::shape(CAMERA_EGO_RGB, format!("({height}, {width}, 3)"), [pixels.len()])
                        })?;
                    let Preparation { resize: how, filter, .. } = self.preparation;
                    Ok(resize(&image, side, how, filter)?.into_raw())
                })
                .collect();
            shrunk?.iter().for_each(|pixels| block.images.extend_from_slice(pixels));
            start = piece.end;
        }
        Ok(block)
    }

    /// What the supervised labels of all stores say, in one pass.
    ///
    /// # Errors
    /// If a store can't be read.
    pub fn statistics(&self) -> Result<Statistics> {
        let mut active = Vec::new();
        let mut sums = [(); 4].map(|()| vec![0f64; N_FIELD]);
        for store in &self.stores {
            let frames = store.reader.len();
            for start in (0..frames).step_by(BLOCK) {
                let labels = match &store.memory {
                    Some(memory) if start == 0 => &memory.labels,
                    Some(_) => break,
                    None => &store.labels(start..(start + BLOCK).min(frames))?,
                };
                for (entry, (force, mask)) in labels.force.iter().zip(&labels.mask_force).enumerate() {
                    if *mask == 1 {
                        sums[0][entry % N_FIELD] += f64::from(*force);
                        sums[1][entry % N_FIELD] += 1.0;
                        active.extend((*force > CONTACT_FORCE_N).then_some(*force));
                    }
                }
                for (entry, (contact, mask)) in labels.contact.iter().zip(&labels.mask_contact).enumerate() {
                    if *mask == 1 {
                        sums[2][entry % N_FIELD] += f64::from(*contact);
                        sums[3][entry % N_FIELD] += 1.0;
                    }
                }
            }
        }
        let [force, force_count, contact, contact_count] = &sums;
        let mean = |sum: &[f64], count: &[f64]| -> Vec<f32> {
            sum.iter().zip(count).map(|(sum, count)| (sum / count.max(1.0)) as f32).collect()
        };
        let force_scale = (!active.is_empty()).then(|| {
            let at = ((active.len() - 1) as f64 * 0.99).round() as usize;
            *active.select_nth_unstable_by(at, f32::total_cmp).1
        });
        Ok(Statistics { force_scale, mean_force: mean(force, force_count), contact_rate: mean(contact, contact_count) })
    }

    /// Reads the labels of all stores, one behind the other.
    ///
    /// # Errors
    /// If a store can't be read.
    pub fn labels(&self) -> Result<TactileSequence> {
        let mut all = TactileSequence::default();
        for store in &self.stores {
            match &store.memory {
                Some(memory) => all.append(&memory.labels)?,
                None => all.append(&store.all_labels()?)?,
            }
        }
        Ok(all)
    }
}

impl Store {
    /// Reads the labels of all frames that training uses, with time stamps and episodes.
    fn all_labels(&self) -> Result<TactileSequence> {
        Ok(with_time(self.labels(0..self.reader.len())?, &self.reader, self.timestamps.clone()))
    }

    /// The labels that are learned from.
    fn labels(&self, frames: Range<usize>) -> Result<TactileSequence> {
        let mut labels = read_labels(&self.reader, frames)?;
        if self.supervision == Supervision::Contact {
            labels.force.fill(f32::NAN);
            labels.mask_force.fill(0);
        }
        Ok(labels)
    }
}

/// Adds time stamps and episodes of a whole store to its labels.
fn with_time(labels: TactileSequence, reader: &ZarrReader, timestamps: Vec<f64>) -> TactileSequence {
    TactileSequence { timestamps, episode_ends: reader.episode_ends().to_vec(), ..labels }
}

/// Time must go on within an episode: windows are found by it.
fn check_timestamps(reader: &ZarrReader, timestamps: &[f64]) -> Result<()> {
    let mut start = 0;
    for end in reader.episode_ends() {
        let episode = &timestamps[start..*end];
        if let Some(at) = episode.iter().position(|stamp| !stamp.is_finite()) {
            let got = format!("{} at frame {}", episode[at], start + at);
            return Err(Error::file(reader.path(), Error::value(TIMESTAMPS, "finite seconds", got)));
        }
        let stops = episode.windows(2).position(|pair| pair[1].partial_cmp(&pair[0]) != Some(Ordering::Greater));
        if let Some(at) = stops {
            let got = format!("{} after {} at frame {}", episode[at + 1], episode[at], start + at + 1);
            let error = Error::value(TIMESTAMPS, "seconds that grow within an episode", got);
            return Err(Error::file(reader.path(), error));
        }
        start = *end;
    }
    Ok(())
}

/// Reads the labels of a whole store, with time stamps and episodes, masked as [`read_labels`] does.
///
/// # Errors
/// If an array can't be read.
pub fn read_truth(reader: &ZarrReader) -> Result<TactileSequence> {
    let frames = 0..reader.len();
    let timestamps = reader.read(TIMESTAMPS, frames.clone())?.into_f64();
    Ok(with_time(read_labels(reader, frames)?, reader, timestamps))
}

/// Reads the labels of a range of frames, without time stamps and episodes; the masks are 0 where a label is unknown or a
/// guard refused the frame.
///
/// # Errors
/// If an array can't be read.
pub fn read_labels(reader: &ZarrReader, frames: Range<usize>) -> Result<TactileSequence> {
    let n = frames.len();
    let force = match reader.has(MANO_FORCE) {
        true => reader.read_f32(MANO_FORCE, frames.clone())?,
        false => vec![f32::NAN; n * N_FIELD],
    };
    let contact = reader.read_contact(frames.clone())?;
    let validity = match reader.has(FRAME_VALIDITY) {
        true => reader.read_u8(FRAME_VALIDITY, frames.clone())?,
        false => vec![0; n],
    };
    let mask = |name: &str, label: &[f32]| -> Result<Vec<u8>> {
        let mut mask = match reader.has(name) {
            true => reader.read_u8(name, frames.clone())?,
            false => vec![1; n * N_FIELD],
        };
        for (entry, (mask, label)) in mask.iter_mut().zip(label).enumerate() {
            // What is no number, or no force, is unknown too: one of them would make every loss NaN.
            let known = label.is_finite() && *label >= 0.0;
            *mask = u8::from(*mask != 0 && known && validity[entry / N_FIELD] == 0);
        }
        Ok(mask)
    };
    let (mask_force, mask_contact) = (mask(MANO_FORCE_VALID, &force)?, mask(MANO_CONTACT_VALID, &contact)?);
    let topology = Some(reader.attributes().topology);
    Ok(TactileSequence { topology, force, contact, mask_force, mask_contact, validity, ..Default::default() })
}
