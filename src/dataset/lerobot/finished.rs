//! Statistics of the finished episodes of a data set, on disk: those of many episodes would not fit into memory.

use std::collections::BTreeMap;
use std::fs::File;
use std::os::unix::fs::FileExt;
use std::path::{Path, PathBuf};

use super::statistics::Statistics;
use crate::error::{Error, Result};

/// Statistics of the columns by episode, and over all episodes.
#[derive(Debug)]
pub(super) struct FinishedEpisodes {
    folder: PathBuf,
    /// A file without a name: it ends with the process.
    file: File,
    /// Offset and length of an episode's statistics in the file, bytes.
    places: BTreeMap<i64, (u64, u64)>,
    end: u64,
    totals: Vec<Statistics>,
}

impl FinishedEpisodes {
    /// Starts without episodes; the file lies in `folder`.
    ///
    /// # Errors
    /// If it can't be created.
    pub fn new(folder: &Path) -> Result<Self> {
        let file = tempfile::tempfile_in(folder).map_err(Error::io(folder))?;
        Ok(Self { folder: folder.to_path_buf(), file, places: BTreeMap::new(), end: 0, totals: Vec::new() })
    }

    /// True if episode `index` was added.
    pub fn contains(&self, index: i64) -> bool {
        self.places.contains_key(&index)
    }

    /// Adds the statistics of episode `index`, one per column.
    ///
    /// # Errors
    /// If they can't be written.
    pub fn add(&mut self, index: i64, statistics: &[Statistics]) -> Result<()> {
        self.totals.resize(statistics.len(), Statistics::default());
        self.totals.iter_mut().zip(statistics).for_each(|(total, one)| total.add(one));
        let bytes: Vec<u8> = statistics.iter().flat_map(Statistics::words).flat_map(u64::to_le_bytes).collect();
        self.file.write_all_at(&bytes, self.end).map_err(Error::io(&self.folder))?;
        self.places.insert(index, (self.end, bytes.len() as u64));
        self.end += bytes.len() as u64;
        Ok(())
    }

    /// Returns the statistics of episode `index`, one per column; None without that episode.
    ///
    /// # Errors
    /// If they can't be read.
    pub fn get(&self, index: i64) -> Result<Option<Vec<Statistics>>> {
        let Some((offset, length)) = self.places.get(&index).copied() else { return Ok(None) };
        let mut bytes = vec![0; length as usize];
        self.file.read_exact_at(&mut bytes, offset).map_err(Error::io(&self.folder))?;
        let mut words = bytes.as_chunks().0.iter().map(|word| u64::from_le_bytes(*word));
        Ok(Some(std::iter::from_fn(|| Statistics::from_words(&mut words)).collect()))
    }

    /// Returns the statistics of column `column` over all episodes.
    pub fn total(&self, column: usize) -> Statistics {
        self.totals.get(column).cloned().unwrap_or_default()
    }
}

#[cfg(test)]
mod tests {
    use super::super::statistics::EpisodeStatistics;
    use super::*;

    #[test]
    fn statistics_come_back_as_they_were_added() {
        let folder = tempfile::tempdir().unwrap();
        let mut finished = FinishedEpisodes::new(folder.path()).unwrap();
        let of = |width: usize, first: f32| {
            let mut episode = EpisodeStatistics::new(width, 3);
            (0..3).for_each(|i| episode.push(&vec![first + i as f32; width]));
            episode.finish()
        };
        let episodes = [(7, vec![of(2, 0.5), of(5, -1.0)]), (-3, vec![of(2, 8.0), of(5, 2.0)])];
        let mut total = Statistics::default();
        for (index, statistics) in &episodes {
            finished.add(*index, statistics).unwrap();
            total.add(&statistics[1]);
        }
        for (index, statistics) in &episodes {
            assert_eq!(finished.get(*index).unwrap().as_ref(), Some(statistics));
        }
        assert_eq!(finished.get(0).unwrap(), None);
        assert_eq!(finished.total(1), total);
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0, "the file has no name");
    }
}
