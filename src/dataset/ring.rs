//! A folder of recorded episodes with a size limit: one store per episode, numbered without gaps; the oldest are removed
//! first.

use std::fs;
use std::path::{Path, PathBuf};

use super::zarr::{Compression, Contact, ZarrWriter};
use super::{Attributes, EpisodeWriter, Frame};
use crate::error::{Error, Result};

/// Prefix and suffix of a store's name, around its number.
const NAME: (&str, &str) = ("episode_", ".zarr");
/// Number of digits.
const DIGITS: usize = 8;

/// Episodes on disk, and the one that is being recorded.
#[derive(Debug)]
pub struct EpisodeRing {
    folder: PathBuf,
    most_bytes: u64,
    /// Number and size in bytes of the finished episodes, oldest first.
    episodes: Vec<(u64, u64)>,
    /// Number of the next episode.
    next: u64,
    open: Option<ZarrWriter>,
    counts: RingCounts,
}

/// Counts of a ring since it was opened, and its present size.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct RingCounts {
    /// Number of frames in finished episodes.
    pub frames: u64,
    /// Number of finished episodes.
    pub episodes: u64,
    /// Number of removed episodes.
    pub evicted: u64,
    /// Size of the episodes on disk, bytes.
    pub bytes: u64,
}

impl EpisodeRing {
    /// Opens the ring in `folder`. Numbers continue after those of existing episodes; unfinished stores of a killed process
    /// are removed.
    ///
    /// # Errors
    /// If the folder can't be read or created.
    pub fn open(folder: &Path, most_bytes: u64) -> Result<Self> {
        fs::create_dir_all(folder).map_err(Error::io(folder))?;
        let mut episodes = Vec::new();
        for entry in fs::read_dir(folder).map_err(Error::io(folder))? {
            let path = entry.map_err(Error::io(folder))?.path();
            let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
            if let Some(number) = number(&name) {
                episodes.push((number, size(&path)?));
            } else if name.starts_with(&format!(".{}", NAME.0)) {
                fs::remove_dir_all(&path).map_err(Error::io(&path))?;
            }
        }
        episodes.sort_unstable();
        let next = episodes.last().map_or(0, |(number, _)| number + 1);
        let mut ring = Self {
            folder: folder.to_path_buf(),
            most_bytes,
            episodes,
            next,
            open: None,
            counts: RingCounts::default(),
        };
        ring.evict()?;
        Ok(ring)
    }

    /// Appends a frame to the open episode, or starts one with `attributes`.
    ///
    /// # Errors
    /// If the frame does not fit the episode, or can't be written; the episode stays as it was.
    pub fn push(&mut self, frame: Frame, attributes: impl FnOnce() -> Attributes) -> Result<()> {
        let writer = match &mut self.open {
            Some(writer) => writer,
            none => {
                let path = self.folder.join(name(self.next));
                let writer = ZarrWriter::create(&path, attributes(), Contact::Truth, Vec::new())?;
                none.insert(writer.with_compression(Compression::Pass))
            }
        };
        writer.push(frame)
    }

    /// Returns true if a frame has the image size and topology of the open episode, or none is open.
    pub fn fits(&self, frame: &Frame) -> bool {
        self.open.as_ref().is_none_or(|writer| writer.fits(frame))
    }

    /// Returns the number of frames in the open episode.
    pub fn open_frames(&self) -> usize {
        self.open.as_ref().map_or(0, ZarrWriter::n_frames)
    }

    /// Ends the open episode, if it has frames, and removes the oldest episodes beyond the limit; the newest always stays.
    ///
    /// # Errors
    /// If a store can't be written or removed.
    pub fn end_episode(&mut self) -> Result<()> {
        let Some(mut writer) = self.open.take().filter(|writer| writer.n_frames() > 0) else { return Ok(()) };
        let frames = writer.n_frames() as u64;
        writer.end_episode()?;
        writer.finish()?;
        let path = self.folder.join(name(self.next));
        self.episodes.push((self.next, size(&path)?));
        self.next += 1;
        self.counts.episodes += 1;
        self.counts.frames += frames;
        self.evict()
    }

    /// Returns the stores of the finished episodes, oldest first.
    pub fn stores(&self) -> Vec<PathBuf> {
        self.episodes.iter().map(|(number, _)| self.folder.join(name(*number))).collect()
    }

    /// Returns counts and size.
    pub fn counts(&self) -> RingCounts {
        RingCounts { bytes: self.episodes.iter().map(|(_, bytes)| bytes).sum(), ..self.counts }
    }

    fn evict(&mut self) -> Result<()> {
        while self.episodes.len() > 1 && self.counts().bytes > self.most_bytes {
            let (number, _) = self.episodes.remove(0);
            let path = self.folder.join(name(number));
            // Rename before removing, so that no reader opens a partly removed store.
            let hidden = self.folder.join(format!(".{}", name(number)));
            fs::rename(&path, &hidden).map_err(Error::io(&path))?;
            fs::remove_dir_all(&hidden).map_err(Error::io(&hidden))?;
            self.counts.evicted += 1;
        }
        Ok(())
    }
}

fn name(number: u64) -> String {
    format!("{}{number:0DIGITS$}{}", NAME.0, NAME.1)
}

fn number(name: &str) -> Option<u64> {
    name.strip_prefix(NAME.0)?.strip_suffix(NAME.1)?.parse().ok()
}

/// Returns the size of all files in a folder, bytes.
fn size(folder: &Path) -> Result<u64> {
    let mut bytes = 0;
    for entry in fs::read_dir(folder).map_err(Error::io(folder))? {
        let path = entry.map_err(Error::io(folder))?.path();
        let metadata = path.metadata().map_err(Error::io(&path))?;
        bytes += if metadata.is_dir() { size(&path)? } else { metadata.len() };
    }
    Ok(bytes)
}

#[cfg(test)]
mod tests {
    use ::image::RgbImage;

    use super::*;
    use crate::dataset::EpisodeReader;
    use crate::dataset::zarr::{TIMESTAMPS, ZarrReader};
    use crate::hand::Topology;
    use crate::tactile::{N_FIELD, TactileField, Validity};

    fn attributes() -> Attributes {
        serde_json::from_value(serde_json::json!({ "topology": Topology::Mano })).unwrap()
    }

    /// Creates a frame of noise, which does not compress.
    fn frame(at: u64) -> Frame {
        let noise = |x: u32, y: u32| (u64::from(x * 7919 + y * 104_729) ^ at).wrapping_mul(0x9E37_79B9_7F4A_7C15) as u8;
        Frame {
            timestamp: at as f64,
            camera_ego_rgb: RgbImage::from_fn(64, 64, |x, y| [noise(x, y), noise(y, x), noise(x + 1, y)].into()),
            field: TactileField::zeros(Topology::Mano),
            force_valid: vec![1; N_FIELD],
            contact_valid: vec![1; N_FIELD],
            validity: Validity::Valid,
            left_hand_pose: None,
            right_hand_pose: None,
        }
    }

    fn record(ring: &mut EpisodeRing, from: u64, frames: u64) {
        (from..from + frames).for_each(|at| ring.push(frame(at), attributes).unwrap());
        ring.end_episode().unwrap();
    }

    #[test]
    fn the_oldest_episodes_are_removed_first_and_numbers_have_no_gap() {
        let folder = tempfile::tempdir().unwrap();
        // Four episodes of some 37 kB fit.
        let mut ring = EpisodeRing::open(folder.path(), 160_000).unwrap();
        for episode in 0..10 {
            record(&mut ring, 3 * episode, 3);
            assert!(ring.counts().bytes <= 160_000);
            assert_eq!(ring.stores(), stores(folder.path()), "the ring lists the stores on disk");
        }
        let counts = ring.counts();
        assert_eq!((counts.frames, counts.episodes, counts.evicted), (30, 10, 10 - ring.stores().len() as u64));
        let kept: Vec<u64> =
            ring.stores().iter().map(|p| number(&p.file_name().unwrap().to_string_lossy()).unwrap()).collect();
        assert!(kept.len() >= 2);
        assert_eq!(kept, (10 - kept.len() as u64..10).collect::<Vec<_>>());
        // Each store holds the frames that were pushed into it.
        for (path, number) in ring.stores().iter().zip(kept) {
            let store = ZarrReader::open(path).unwrap();
            let stamps = store.read(TIMESTAMPS, 0..store.len()).unwrap().into_f64();
            assert_eq!(stamps, (3 * number..3 * number + 3).map(|at| at as f64).collect::<Vec<_>>());
            assert_eq!(store.episode_ends(), [3]);
        }
    }

    fn stores(folder: &Path) -> Vec<PathBuf> {
        let mut paths: Vec<_> = fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()).collect();
        paths.sort();
        paths
    }

    #[test]
    fn a_ring_resumes_after_a_killed_process() {
        let folder = tempfile::tempdir().unwrap();
        let mut ring = EpisodeRing::open(folder.path(), u64::MAX).unwrap();
        record(&mut ring, 0, 2);
        record(&mut ring, 2, 2);
        ring.push(frame(4), attributes).unwrap();
        // Simulates a kill: no destructor runs.
        std::mem::forget(ring);
        assert_eq!(stores(folder.path()).len(), 3, "two episodes and an unfinished one");
        let mut ring = EpisodeRing::open(folder.path(), u64::MAX).unwrap();
        assert_eq!(stores(folder.path()), ring.stores());
        record(&mut ring, 5, 1);
        let names: Vec<_> = ring.stores().iter().map(|p| p.file_name().unwrap().to_owned()).collect();
        assert_eq!(names, ["episode_00000000.zarr", "episode_00000001.zarr", "episode_00000002.zarr"]);
    }

    #[test]
    fn the_newest_episode_stays_even_if_it_exceeds_the_limit() {
        let folder = tempfile::tempdir().unwrap();
        let mut ring = EpisodeRing::open(folder.path(), 10).unwrap();
        ring.end_episode().unwrap();
        assert!(ring.stores().is_empty());
        record(&mut ring, 0, 1);
        record(&mut ring, 1, 1);
        assert_eq!((ring.stores().len(), ring.counts().evicted), (1, 1));
    }

    #[test]
    fn a_refused_frame_leaves_the_episode_open() {
        let folder = tempfile::tempdir().unwrap();
        let mut ring = EpisodeRing::open(folder.path(), u64::MAX).unwrap();
        ring.push(frame(0), attributes).unwrap();
        let other = Frame { camera_ego_rgb: RgbImage::new(8, 8), ..frame(1) };
        assert!(!ring.fits(&other) && ring.fits(&frame(1)));
        assert!(ring.push(other, attributes).is_err());
        ring.push(frame(1), attributes).unwrap();
        ring.end_episode().unwrap();
        assert_eq!(ZarrReader::open(&ring.stores()[0]).unwrap().len(), 2);
    }
}
