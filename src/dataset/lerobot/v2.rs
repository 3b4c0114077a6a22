//! Metadata of data sets of versions 2.0 and 2.1: JSON lines, one file of rows and one video per episode.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{BufRead, BufReader, BufWriter, Read, Write};
use std::path::{Path, PathBuf};

use serde::Deserialize;
use serde_json::{Map, Value, json};

use super::columns::Column;
use super::finished::FinishedEpisodes;
use super::{Camera, Episode, LeRobot};
use crate::error::{Error, Result};
use crate::file::{input, limits};

/// Patterns of the paths, where `info.json` has none.
pub(super) const DATA_PATH: &str = "data/chunk-{episode_chunk:03d}/episode_{episode_index:06d}.parquet";
pub(super) const VIDEO_PATH: &str = "videos/chunk-{episode_chunk:03d}/{video_key}/episode_{episode_index:06d}.mp4";
/// Episodes of a chunk, where `info.json` does not say.
const CHUNKS_SIZE: i64 = 1000;
/// File of the statistics by episode, of version 2.1.
const EPISODES_STATS: &str = "meta/episodes_stats.jsonl";

#[derive(Deserialize)]
struct EpisodeLine {
    episode_index: i64,
    length: usize,
}

/// Reads the episodes in order.
///
/// # Errors
/// If `meta/episodes.jsonl` can't be read, or a line lacks its index or a length of at least 1.
pub(super) fn read_episodes(dataset: &LeRobot) -> Result<Vec<Episode>> {
    let path = dataset.folder.join("meta/episodes.jsonl")?;
    let per_chunk = dataset.info["chunks_size"].as_i64().filter(|size| *size > 0).unwrap_or(CHUNKS_SIZE);
    let cameras = dataset.cameras();
    let videos: Vec<&String> = cameras.iter().filter(|(_, kind)| **kind == Camera::Video).map(|(key, _)| key).collect();
    let mut episodes = Vec::new();
    for (number, line) in lines(&path)?.enumerate() {
        let wrong = |problem: &dyn std::fmt::Display| Error::file(&path, format!("line {}: {problem}", number + 1));
        let line: EpisodeLine = serde_json::from_str(&line?).map_err(|error| wrong(&error))?;
        let EpisodeLine { episode_index: index, length } = line;
        if index < 0 || length == 0 {
            return Err(wrong(&format!(
                "expected an index from 0 on and a length of at least 1, got {index} and {length}"
            )));
        }
        limits::EPISODES.check(&path, "episodes", episodes.len() as u64 + 1)?;
        let data = (index / per_chunk, index);
        let videos: BTreeMap<_, _> = videos.iter().map(|key| ((*key).clone(), (data.0, data.1, 0.0))).collect();
        episodes.push(Episode { index, length, data, start: 0, videos });
    }
    Ok(episodes)
}

/// Returns the lines of a file that are not empty.
fn lines(path: &Path) -> Result<impl Iterator<Item = Result<String>> + use<>> {
    let path = path.to_path_buf();
    let mut file = BufReader::new(input::open(&path)?);
    Ok(std::iter::from_fn(move || {
        loop {
            let mut line = String::new();
            let most = limits::TEXT.value();
            match file.by_ref().take(most + 1).read_line(&mut line) {
                Ok(0) => return None,
                Ok(_) => {}
                Err(error) => return Some(Err(Error::io(&path)(error))),
            }
            if let Err(error) = limits::TEXT.check(&path, "a line", line.len() as u64) {
                return Some(Err(error));
            }
            if !line.trim().is_empty() {
                return Some(Ok(line));
            }
        }
    }))
}

/// Returns the file of the statistics by episode; None if the data set has none.
///
/// # Errors
/// If it lies outside of the data set.
pub(super) fn episodes_stats(dataset: &LeRobot) -> Result<Option<PathBuf>> {
    let path = dataset.folder.join(EPISODES_STATS)?;
    Ok(path.is_file().then_some(path))
}

/// Writes the statistics by episode with those of the new columns into the data set at `at`.
///
/// # Errors
/// If a line is not an object with an index and statistics, an episode is unknown, or writing fails.
pub(super) fn write_episodes_stats(from: &Path, at: &Path, columns: &[Column], done: &FinishedEpisodes) -> Result<()> {
    let to = at.join(EPISODES_STATS);
    let mut out = BufWriter::new(File::create(&to).map_err(Error::io(&to))?);
    for line in lines(from)? {
        let mut line: Value = serde_json::from_str(&line?).map_err(|error| Error::file(from, error))?;
        let index = line["episode_index"].as_i64();
        let statistics = index.map(|index| done.get(index)).transpose()?.flatten();
        let (Some(statistics), Some(stats)) = (statistics, line.get_mut("stats").and_then(Value::as_object_mut)) else {
            let expected = "expected lines {\"episode_index\": .., \"stats\": {..}} of episodes in the data";
            return Err(Error::file(from, format!("{expected}, got episode {index:?}")));
        };
        for (column, statistics) in columns.iter().zip(&statistics) {
            stats.insert(column.name.clone(), statistics.json());
        }
        writeln!(out, "{line}").map_err(Error::io(&to))?;
    }
    out.flush().map_err(Error::io(&to))
}

/// Returns `stats` of all episodes with those of the new columns.
pub(super) fn extended(mut stats: Map<String, Value>, columns: &[Column], done: &FinishedEpisodes) -> Value {
    for (at, column) in columns.iter().enumerate() {
        stats.insert(column.name.clone(), done.total(at).json());
    }
    json!(stats)
}
