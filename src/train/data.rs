//! Training data: stores with resized images, labels and masks.

use std::cmp::Ordering;
use std::collections::BTreeMap;
use std::ops::Range;
use std::path::Path;
use std::sync::Arc;

use rayon::prelude::*;

use super::keypoints::{self, Points};
use super::source::{Supervision, TrainingSource, force_weight};
use crate::dataset::EpisodeReader;
use crate::dataset::zarr::{self, MANO_FORCE_STD, TIMESTAMPS, ZarrReader, read_labels, read_proximity};
use crate::error::{Error, Result};
use crate::hand::{FieldMap, Topology};
use crate::image::{Framing, Preparation, resize};
use crate::tactile::{CONTACT_FORCE_N, ForceKind, N_FIELD, TactileSequence, episode_ranges};

/// Frames read at once while a store is scanned.
const BLOCK: usize = 128;
/// Largest size of the stored images that are read at once, bytes.
const PIECE_BYTES: usize = 128 << 20;

/// Stores, and the preparation that turns their images into the network's input.
#[derive(Debug)]
pub struct Dataset {
    stores: Vec<Store>,
    preparation: Preparation,
    /// MANO files whose vertices all labels are carried over to; None = the stores' topology.
    mano: Option<Arc<FieldMap>>,
}

#[derive(Debug)]
struct Store {
    /// Index of the source that the store belongs to.
    source: usize,
    /// True if the images may be mirrored.
    mirrorable: bool,
    supervision: Supervision,
    /// True if forces weigh by their standard deviation.
    weigh_by_std: bool,
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
    /// (n, 1556) weight of each supervised force, 0 to 1; empty = 1 everywhere.
    pub force_weights: Vec<f32>,
}

/// Statistics of the supervised labels of a dataset.
#[derive(Debug, Clone, PartialEq)]
pub struct Statistics {
    /// 99th percentile of the forces above 0.05 N, N: one unit of the network's output. None without such a force.
    pub force_scale: Option<f32>,
    /// (1556) mean force, N; 0 where nothing is supervised.
    pub mean_force: Vec<f32>,
    /// (1556) share of frames in contact; 0 where nothing is supervised.
    pub contact_rate: Vec<f32>,
}

impl Dataset {
    /// Creates a dataset of one source; `in_memory` reads the stores completely at once.
    ///
    /// # Errors
    /// If there is no store, or one can't be read.
    pub fn new(readers: Vec<ZarrReader>, preparation: Preparation, in_memory: bool) -> Result<Self> {
        let from_one_source = |reader| (0, TrainingSource::of([]), reader);
        Self::from_readers(readers.into_iter().map(from_one_source).collect(), preparation, in_memory, None)
    }

    /// Opens the stores of several sources; `in_memory` reads them completely at once.
    ///
    /// # Errors
    /// If one can't be opened or read, or two differ in topology.
    pub fn open(sources: &[TrainingSource], preparation: Preparation, in_memory: bool) -> Result<Self> {
        Self::open_on(None, sources, preparation, in_memory)
    }

    /// As [`Dataset::open`]; with MANO files, labels of stores of either topology, on MANO's vertices.
    ///
    /// # Errors
    /// If a store can't be opened or read, or two differ in topology and there are no MANO files.
    pub fn open_on(
        mano: Option<Arc<FieldMap>>,
        sources: &[TrainingSource],
        preparation: Preparation,
        in_memory: bool,
    ) -> Result<Self> {
        let mut readers: Vec<(usize, TrainingSource, ZarrReader)> = Vec::new();
        for (index, source) in sources.iter().enumerate() {
            for reader in zarr::open_all(&source.stores)? {
                if let (Some((_, _, first)), None) = (readers.first(), &mano) {
                    let topology = reader.attributes().topology;
                    let fits = first.attributes().topology.must_match(topology);
                    fits.map_err(|error| Error::file(reader.path(), error))?;
                }
                readers.push((index, source.clone(), reader));
            }
        }
        Self::from_readers(readers, preparation, in_memory, mano)
    }

    /// Creates a dataset from stores with the index and properties of their sources.
    fn from_readers(
        readers: Vec<(usize, TrainingSource, ZarrReader)>,
        preparation: Preparation,
        in_memory: bool,
        mano: Option<Arc<FieldMap>>,
    ) -> Result<Self> {
        if readers.is_empty() {
            return Err(Error::value("data", "at least one store", "none"));
        }
        let mut dataset = Self { stores: Vec::new(), preparation, mano };
        for (source, TrainingSource { mirror: mirrorable, labels: supervision, weigh_by_std, .. }, reader) in readers {
            if weigh_by_std && dataset.mano.is_some() {
                let expected = "no MANO files: standard deviations are not carried over to other vertices";
                return Err(Error::file(
                    reader.path(),
                    Error::value("weigh_by_std", expected, "mano_left and mano_right"),
                ));
            }
            let timestamps = reader.read(TIMESTAMPS, 0..reader.len())?.into_f64();
            check_timestamps(&reader, &timestamps)?;
            // All hands are right hands there.
            let mirrorable = mirrorable && reader.framing()?.is_whole();
            dataset.stores.push(Store {
                source,
                mirrorable,
                supervision,
                weigh_by_std,
                reader,
                timestamps,
                memory: None,
                keypoints: None,
            });
        }
        if in_memory {
            for index in 0..dataset.stores.len() {
                let images = dataset.read(index, 0..dataset.stores[index].reader.len(), false)?.images;
                let store = &dataset.stores[index];
                let (labels, force_weights) = (dataset.all_labels(store)?, store.force_weights(0..store.reader.len())?);
                dataset.stores[index].memory = Some(Block { images, labels, force_weights });
            }
        }
        Ok(dataset)
    }

    /// Projects the hands' keypoints into all images, so that batches contain them.
    ///
    /// # Errors
    /// If a store can't be read, or no store has camera and hand poses.
    pub fn find_keypoints(&mut self) -> Result<()> {
        let mut known = false;
        for store in &mut self.stores {
            let points = keypoints::read(&store.reader, 0..store.reader.len(), &self.preparation)?;
            known |= keypoints::has_poses(&store.reader);
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

    /// Returns the meaning of the vertex indices of all labels.
    pub fn topology(&self) -> Topology {
        if self.mano.is_some() {
            return Topology::Mano;
        }
        self.stores.first().map(|store| store.reader.attributes().topology).unwrap_or_default()
    }

    /// Returns the meaning of the forces of all stores whose force is supervised; spread without one.
    ///
    /// # Errors
    /// If two differ, or a store's attribute is unknown.
    pub fn force_kind(&self) -> Result<ForceKind> {
        let mut found: Option<ForceKind> = None;
        for store in self.stores.iter().filter(|store| store.supervision.has_force()) {
            // A store without known force has no meaning of it.
            let Some(kind) = store.reader.force_kind()?.filter(|_| store.reader.has(zarr::MANO_FORCE)) else {
                continue;
            };
            let fits = found.get_or_insert(kind).must_match(kind);
            fits.map_err(|error| Error::file(store.reader.path(), error))?;
        }
        Ok(found.unwrap_or_default())
    }

    /// Returns what the pictures of all stores show.
    ///
    /// # Errors
    /// If two stores differ, or an attribute is unknown.
    pub fn framing(&self) -> Result<Framing> {
        let mut found: Option<Framing> = None;
        for store in &self.stores {
            let own = store.reader.framing()?;
            let first = *found.get_or_insert(own);
            if own != first {
                return Err(Error::file(store.reader.path(), Error::value(Framing::KEY, first.name(), own.name())));
            }
        }
        Ok(found.unwrap_or_default())
    }

    /// Returns the number of frames of all stores.
    pub fn n_frames(&self) -> usize {
        self.stores.iter().map(|store| store.reader.len()).sum()
    }

    /// Returns the store and the frames of every episode.
    pub fn episodes(&self) -> Vec<(usize, Range<usize>)> {
        let of = |(index, store): (usize, &'_ Store)| {
            episode_ranges(store.reader.episode_ends()).map(|range| (index, range)).collect::<Vec<_>>()
        };
        self.stores.iter().enumerate().flat_map(of).collect()
    }

    /// Returns the index of the source that a store belongs to.
    pub fn source(&self, store: usize) -> usize {
        self.stores[store].source
    }

    /// Returns the preparation that turns images into the network's input.
    pub(super) fn preparation(&self) -> &Preparation {
        &self.preparation
    }

    /// Returns whether a store's images may be mirrored.
    pub(super) fn mirrorable(&self, store: usize) -> bool {
        self.stores[store].mirrorable
    }

    /// Returns the keypoints of every frame of a store, after [`find_keypoints`](Self::find_keypoints).
    pub(super) fn keypoints(&self, store: usize) -> Option<&[Points]> {
        self.stores[store].keypoints.as_deref()
    }

    /// True if the keypoints of a store's frames are known, or known not to be in the image.
    pub(super) fn knows_hands(&self, store: usize) -> bool {
        self.stores[store].keypoints.is_some() && keypoints::has_poses(&self.stores[store].reader)
    }

    /// Returns the time stamps of a store, s.
    pub fn timestamps(&self, store: usize) -> &[f64] {
        &self.stores[store].timestamps
    }

    /// Reads frames of a store; without `labels`, only the images.
    ///
    /// # Errors
    /// If an array can't be read, or labels are requested and the store has none.
    pub fn read(&self, store: usize, frames: Range<usize>, labels: bool) -> Result<Block> {
        let Store { reader, memory, .. } = &self.stores[store];
        let side = self.preparation.side;
        if let Some(memory) = memory {
            let pixels = side * side * 3;
            let images = memory.images[frames.start * pixels..frames.end * pixels].to_vec();
            let weights = memory.force_weights.get(frames.start * N_FIELD..frames.end * N_FIELD);
            let force_weights = weights.unwrap_or_default().to_vec();
            return Ok(Block { images, labels: memory.labels.select(frames), force_weights });
        }
        let mut block = Block::default();
        if labels {
            block.labels = self.labels_of(&self.stores[store], frames.clone())?;
            block.force_weights = self.stores[store].force_weights(frames.clone())?;
        }
        let (height, width) = reader.image_size();
        // In pieces, because the stored images may be much larger than the resized ones.
        let most = (PIECE_BYTES / (height * width * 3)).clamp(1, BLOCK);
        let Preparation { resize: how, filter, .. } = self.preparation;
        let mut start = frames.start;
        while start < frames.end {
            let piece = start..(start + most).min(frames.end);
            let images = reader.images(piece.clone())?;
            let shrunk: Result<Vec<Vec<u8>>> =
                images.par_iter().map(|image| Ok(resize(image, side, how, filter)?.into_raw())).collect();
            shrunk?.iter().for_each(|pixels| block.images.extend_from_slice(pixels));
            start = piece.end;
        }
        Ok(block)
    }

    /// Computes statistics of the supervised labels of all stores, in one pass.
    ///
    /// # Errors
    /// If a store can't be read, or no store of a source has a supervised entry.
    pub fn statistics(&self) -> Result<Statistics> {
        let mut active = Vec::new();
        let mut sums = [(); 4].map(|()| vec![0f64; N_FIELD]);
        // By source, the first store, and true if any of its stores has a supervised entry.
        let mut supervised: BTreeMap<usize, (&Path, bool)> = BTreeMap::new();
        for store in &self.stores {
            let import = store.reader.raw_attributes().get("import");
            if import.is_some_and(|import| import["view"] == "none") {
                let path = store.reader.path();
                return Err(Error::file(path, "expected images to learn from, got a recording without a camera"));
            }
            let (_, any) = supervised.entry(store.source).or_insert((store.reader.path(), false));
            let frames = store.reader.len();
            for start in (0..frames).step_by(BLOCK) {
                let labels = match &store.memory {
                    Some(memory) if start == 0 => &memory.labels,
                    Some(_) => break,
                    None => &self.labels_of(store, start..(start + BLOCK).min(frames))?,
                };
                *any |= labels.mask_force.contains(&1) || labels.mask_contact.contains(&1);
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
        if let Some((path, _)) = supervised.into_values().find(|(_, any)| !any) {
            let expected = "expected a supervised force or contact in the source that begins with this store, got none";
            return Err(Error::file(path, format!("{expected}; `egotac data info` tells what a store holds")));
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
                None => all.append(&self.all_labels(store)?)?,
            }
        }
        Ok(all)
    }

    /// Reads the labels of all frames of a store that training uses, with time stamps and episodes.
    fn all_labels(&self, store: &Store) -> Result<TactileSequence> {
        Ok(with_time(self.labels_of(store, 0..store.reader.len())?, &store.reader, store.timestamps.clone()))
    }

    /// Reads supervised labels of a store, on the dataset's topology.
    fn labels_of(&self, store: &Store, frames: Range<usize>) -> Result<TactileSequence> {
        let labels = store.labels(frames)?;
        match &self.mano {
            Some(mano) => labels.carried(mano, Topology::Mano),
            None => Ok(labels),
        }
    }
}

impl Store {
    /// Reads the labels that the source supervises.
    fn labels(&self, frames: Range<usize>) -> Result<TactileSequence> {
        match self.supervision {
            Supervision::Both => read_labels(&self.reader, frames),
            Supervision::Contact => {
                let mut labels = read_labels(&self.reader, frames)?;
                labels.force.fill(f32::NAN);
                labels.mask_force.fill(0);
                Ok(labels)
            }
            Supervision::Force => {
                let mut labels = read_labels(&self.reader, frames)?;
                labels.contact.fill(f32::NAN);
                labels.mask_contact.fill(0);
                Ok(labels)
            }
            Supervision::Felt => {
                let mut labels = read_labels(&self.reader, frames)?;
                for (mask, contact) in labels.mask_contact.iter_mut().zip(&mut labels.contact) {
                    let felt = *mask == 1 && *contact > 0.5;
                    if !felt {
                        (*mask, *contact) = (0, f32::NAN);
                    }
                }
                Ok(labels)
            }
            Supervision::Proximity => read_proximity(&self.reader, frames),
        }
    }

    /// Reads the weights of the forces, (n, 1556); empty if all weigh 1.
    fn force_weights(&self, frames: Range<usize>) -> Result<Vec<f32>> {
        if !self.weigh_by_std {
            return Ok(Vec::new());
        }
        let deviations = self.reader.read_f32(MANO_FORCE_STD, frames.clone())?;
        if deviations.len() != frames.len() * N_FIELD {
            let got = [deviations.len() / frames.len().max(1)];
            return Err(Error::file(self.reader.path(), Error::shape(MANO_FORCE_STD, format!("(T, {N_FIELD})"), got)));
        }
        Ok(deviations.into_iter().map(force_weight).collect())
    }
}

/// Adds time stamps and episodes of a whole store to its labels.
fn with_time(labels: TactileSequence, reader: &ZarrReader, timestamps: Vec<f64>) -> TactileSequence {
    TactileSequence { timestamps, episode_ends: reader.episode_ends().to_vec(), ..labels }
}

/// Checks that time stamps are finite and grow within each episode, because windows are selected by them.
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
