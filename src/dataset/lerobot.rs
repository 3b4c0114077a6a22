//! LeRobot data sets of versions 2.0, 2.1 and 3: rows in Parquet, images in videos or in the rows.

mod carry;
mod columns;
mod finished;
mod images;
mod labels;
mod lists;
mod pages;
mod policy_input;
mod prefix;
mod read_labels;
mod rows;
mod statistics;
mod v2;

use std::collections::BTreeMap;
use std::fs::File;
use std::path::{Path, PathBuf};

use arrow_array::cast::AsArray;
use arrow_array::types::{Float32Type, Float64Type, Int32Type, Int64Type};
use arrow_array::{Array, RecordBatch};
use arrow_schema::DataType;
use parquet::arrow::ProjectionMask;
use parquet::arrow::arrow_reader::ParquetRecordBatchReaderBuilder;
use serde_json::Value;

use crate::error::{Error, Result};
use crate::file::input::{self, InputFolder};
use crate::file::limits;

pub(crate) use carry::carry;
pub(crate) use images::{LeRobotDataset, PREFIX};
pub(crate) use labels::read_info;
pub use policy_input::{ColumnRole, LabelColumn, policy_input, policy_input_names, policy_input_width};
pub(crate) use read_labels::read_labelled;
pub(crate) use rows::Row;
use rows::Rows;

/// Largest width to which a pattern of `info.json` pads a number: a file's name has at most 255 bytes.
const MOST_DIGITS: usize = 255;

/// Metadata of a data set, from its folder `meta/`.
#[derive(Debug, Clone)]
pub(crate) struct LeRobot {
    /// Folder of the data set.
    pub root: PathBuf,
    folder: InputFolder,
    /// Content of `meta/info.json`.
    pub info: Value,
    /// Frame rate, 1/s.
    pub fps: f64,
    /// True for versions 2.0 and 2.1: one file of rows per episode, which `meta/episodes.jsonl` lists.
    is_v2: bool,
    /// Episodes in order.
    pub episodes: Vec<Episode>,
    /// `index` of the first frame of each file of rows, by chunk and file.
    first: BTreeMap<(i64, i64), i64>,
}

/// One episode.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Episode {
    /// `episode_index` of its rows.
    pub index: i64,
    /// Number of frames.
    pub length: usize,
    /// Chunk and file of its rows.
    pub data: (i64, i64),
    /// `index` of its first frame over the whole data set.
    pub start: i64,
    /// Chunk and file of the video, and start of the episode in it (s), by key of the camera.
    pub videos: BTreeMap<String, (i64, i64, f64)>,
}

/// Storage of the images of a camera.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Camera {
    /// Video files.
    Video,
    /// PNG or JPEG files in the rows.
    Rows,
}

impl LeRobot {
    /// Opens the data set in the folder `root`.
    ///
    /// # Errors
    /// If it can't be read, or is of another version.
    pub fn open(root: &Path) -> Result<Self> {
        let folder = InputFolder::open(root)?;
        let path = folder.join("meta/info.json")?;
        let text = input::read_text(&path, limits::TEXT)?;
        let info: Value = serde_json::from_str(&text).map_err(|e| Error::file(&path, e))?;
        let version = info["codebase_version"].as_str().unwrap_or_default();
        let is_v2 = ["v2.0", "v2.1"].contains(&version);
        if !is_v2 && !version.starts_with("v3.") {
            let expected = "expected codebase_version v2.0, v2.1 or v3";
            return Err(Error::file(
                &path,
                format!("{expected}, got {version:?}; convert it with the package lerobot"),
            ));
        }
        let fps = info["fps"].as_f64().filter(|fps| *fps > 0.0);
        let fps = fps.ok_or_else(|| Error::file(&path, format!("expected fps above 0, got {}", info["fps"])))?;
        let (episodes, first) = (Vec::new(), BTreeMap::new());
        let mut dataset = Self { root: root.to_path_buf(), folder, info, fps, is_v2, episodes, first };
        if is_v2 {
            dataset.episodes = v2::read_episodes(&dataset)?;
        }
        for file in dataset.episode_files()? {
            dataset.read_episodes(&file)?;
        }
        dataset.episodes.sort_by_key(|episode| episode.index);
        if dataset.episodes.is_empty() {
            return Err(Error::file(root, "has no episode"));
        }
        if let Some(pair) = dataset.episodes.windows(2).find(|pair| pair[0].index == pair[1].index) {
            let message = format!("meta/episodes: expected each episode once, got episode {} twice", pair[0].index);
            return Err(Error::file(root, message));
        }
        for episode in &dataset.episodes {
            let first = dataset.first.entry(episode.data).or_insert(episode.start);
            *first = episode.start.min(*first);
        }
        let frames = dataset.episodes.iter().fold(0u64, |sum, episode| sum.saturating_add(episode.length as u64));
        limits::FRAMES.check(root, "frames of all episodes", frames)?;
        Ok(dataset)
    }

    /// Returns the cameras by their keys in `features`.
    pub fn cameras(&self) -> BTreeMap<String, Camera> {
        let features = self.info["features"].as_object().into_iter().flatten();
        let camera = |(name, feature): (&String, &Value)| match feature["dtype"].as_str() {
            Some("video") => Some((name.clone(), Camera::Video)),
            Some("image") => Some((name.clone(), Camera::Rows)),
            _ => None,
        };
        features.filter_map(camera).collect()
    }

    /// Returns the Parquet files of `meta/episodes` in order; none of versions 2.0 and 2.1.
    ///
    /// # Errors
    /// If the folder can't be read.
    pub fn episode_files(&self) -> Result<Vec<PathBuf>> {
        if self.is_v2 {
            return Ok(Vec::new());
        }
        parquet_files(&self.folder, "meta/episodes")
    }

    /// Returns the Parquet files of the rows in order.
    ///
    /// # Errors
    /// If the folder can't be read.
    pub fn data_files(&self) -> Result<Vec<PathBuf>> {
        parquet_files(&self.folder, "data")
    }

    /// Returns the file of rows with this chunk and number.
    fn data_file(&self, (chunk, file): (i64, i64)) -> Result<PathBuf> {
        let pattern = self.info["data_path"].as_str();
        let default = match self.is_v2 {
            true => v2::DATA_PATH,
            false => "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet",
        };
        let pattern = pattern.unwrap_or(default);
        self.folder.join(filled(pattern, chunk, file))
    }

    /// Returns the video file of a camera and the start of the episode in it, s; None if the episode names none.
    ///
    /// # Errors
    /// If the file lies outside of the data set.
    pub fn video_file(&self, camera: &str, episode: &Episode) -> Result<Option<(PathBuf, f64)>> {
        let Some((chunk, file, start)) = episode.videos.get(camera) else { return Ok(None) };
        let pattern = self.info["video_path"].as_str();
        let default = match self.is_v2 {
            true => v2::VIDEO_PATH,
            false => "videos/{video_key}/chunk-{chunk_index:03d}/file-{file_index:03d}.mp4",
        };
        let pattern = pattern.unwrap_or(default);
        let path = self.folder.join(filled(&pattern.replace("{video_key}", camera), *chunk, *file))?;
        Ok(Some((path, *start)))
    }

    /// Reads the rows of an episode from index `from` on, with the images of `camera` if they lie in the rows.
    ///
    /// # Errors
    /// If the file can't be opened, or lacks a column.
    pub fn rows(
        &self,
        episode: &Episode,
        camera: Option<&str>,
        from: usize,
    ) -> Result<impl Iterator<Item = Result<Row>> + use<>> {
        let path = self.data_file(episode.data)?;
        let start = self.start_in_file(episode);
        let end = start.saturating_add(episode.length);
        Rows::open(&path, camera, start.saturating_add(from.min(episode.length)), end)
    }

    /// Returns the number of the episode's first row within its file.
    fn start_in_file(&self, episode: &Episode) -> usize {
        let first = self.first.get(&episode.data).copied().unwrap_or(episode.start);
        episode.start.saturating_sub(first).max(0) as usize
    }

    fn read_episodes(&mut self, path: &Path) -> Result<()> {
        let builder = reader(path)?;
        // Skip the statistics, which are most of the file.
        let mask = only(&builder, |name| !name.starts_with("stats/") && name != "tasks");
        let cameras = self.cameras();
        for batch in builder.with_projection(mask).build().map_err(|e| Error::file(path, e))? {
            let batch = batch.map_err(|e| Error::file(path, e))?;
            let number = |name: &str| numbers(&batch, name, path);
            let [index, length, chunk, file, start] =
                ["episode_index", "length", "data/chunk_index", "data/file_index", "dataset_from_index"].map(number);
            let (index, length, chunk, file, start) = (index?, length?, chunk?, file?, start?);
            let mut videos = Vec::new();
            for (key, _) in cameras.iter().filter(|(_, camera)| **camera == Camera::Video) {
                let part = |part: &str| number(&format!("videos/{key}/{part}"));
                videos.push((key, part("chunk_index")?, part("file_index")?, part("from_timestamp")?));
            }
            limits::EPISODES.check(path, "episodes", (self.episodes.len() + batch.num_rows()) as u64)?;
            if let Some(row) = length.iter().position(|length| !(1.0..=f64::MAX).contains(length)) {
                let got = format!("expected a length of at least 1 frame, got {}", length[row]);
                return Err(Error::file(path, format!("episode {}: {got}", index[row])));
            }
            for row in 0..batch.num_rows() {
                let video = |(key, chunk, file, start): &(&String, Vec<f64>, Vec<f64>, Vec<f64>)| {
                    ((*key).clone(), (chunk[row] as i64, file[row] as i64, start[row]))
                };
                self.episodes.push(Episode {
                    index: index[row] as i64,
                    length: length[row] as usize,
                    data: (chunk[row] as i64, file[row] as i64),
                    start: start[row] as i64,
                    videos: videos.iter().map(video).collect(),
                });
            }
        }
        Ok(())
    }
}

/// Opens a Parquet file.
///
/// # Errors
/// If it can't be read or is not a Parquet file.
pub fn reader(path: &Path) -> Result<ParquetRecordBatchReaderBuilder<File>> {
    Ok(reader_and_page(path)?.0)
}

/// Opens a Parquet file; also returns the size of its largest page, which no cell exceeds, bytes.
///
/// # Errors
/// As [`reader`].
fn reader_and_page(path: &Path) -> Result<(ParquetRecordBatchReaderBuilder<File>, u64)> {
    let file = input::open(path)?;
    let same = file.try_clone().map_err(Error::io(path))?;
    let builder = ParquetRecordBatchReaderBuilder::try_new(file).map_err(|e| Error::library(path, e))?;
    let page = pages::check(path, &same, builder.metadata())?;
    Ok((builder, page))
}

/// Selects the columns whose names are `wanted`. Selects by index, since the library's selection by name treats dots as
/// levels of nesting.
pub(crate) fn only(builder: &ParquetRecordBatchReaderBuilder<File>, wanted: impl Fn(&str) -> bool) -> ProjectionMask {
    let fields = builder.schema().fields().iter().enumerate();
    let places: Vec<usize> = fields.filter(|(_, field)| wanted(field.name())).map(|(place, _)| place).collect();
    ProjectionMask::roots(builder.parquet_schema(), places)
}

/// Returns a column of numbers of any type as f64.
///
/// # Errors
/// If it is missing, not numeric, or has missing values.
pub(crate) fn numbers(batch: &RecordBatch, name: &str, path: &Path) -> Result<Vec<f64>> {
    let schema = batch.schema();
    let present = || schema.fields().iter().map(|field| field.name().clone()).collect::<Vec<_>>().join(", ");
    let column = batch.column_by_name(name).ok_or_else(|| Error::Missing {
        name: name.to_string(),
        place: path.display().to_string(),
        present: present(),
    })?;
    let values: Vec<f64> = match column.data_type() {
        DataType::Int64 => column.as_primitive::<Int64Type>().values().iter().map(|n| *n as f64).collect(),
        DataType::Int32 => column.as_primitive::<Int32Type>().values().iter().map(|n| f64::from(*n)).collect(),
        DataType::Float32 => column.as_primitive::<Float32Type>().values().iter().map(|n| f64::from(*n)).collect(),
        DataType::Float64 => column.as_primitive::<Float64Type>().values().to_vec(),
        other => return Err(Error::file(path, format!("{name}: expected numbers, got {other}"))),
    };
    match column.null_count() {
        0 => Ok(values),
        gaps => Err(Error::file(path, format!("{name}: {gaps} values are missing"))),
    }
}

/// Returns the Parquet files below `name` in the data set by name.
fn parquet_files(folder: &InputFolder, name: &str) -> Result<Vec<PathBuf>> {
    let mut files = Vec::new();
    let below = folder.join(name)?;
    for chunk in std::fs::read_dir(&below).map_err(Error::io(&below))?.flatten().filter(|entry| entry.path().is_dir()) {
        let chunk = chunk.path();
        for file in std::fs::read_dir(&chunk).map_err(Error::io(&chunk))?.flatten() {
            files.push(file.path());
        }
    }
    files.retain(|file| file.extension().is_some_and(|extension| extension == "parquet"));
    files.iter().try_for_each(|file| folder.check(file))?;
    files.sort();
    Ok(files)
}

/// Fills a pattern of `info.json`: `{chunk_index:03d}` and `{file_index:03d}`, of versions 2.0 and 2.1 `{episode_chunk:03d}` and
/// `{episode_index:06d}`.
fn filled(pattern: &str, chunk: i64, file: i64) -> String {
    let put = |text: String, name: &str, number: i64| {
        let Some((before, rest)) = text.split_once(&format!("{{{name}")) else { return text };
        let Some((format, after)) = rest.split_once('}') else { return text.clone() };
        let width: usize = format.trim_start_matches(":0").trim_end_matches('d').parse().unwrap_or(0);
        let width = width.min(MOST_DIGITS);
        format!("{before}{number:0width$}{after}")
    };
    let filled = put(put(pattern.to_string(), "chunk_index", chunk), "file_index", file);
    put(put(filled, "episode_chunk", chunk), "episode_index", file)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn patterns_are_filled_as_in_python() {
        let pattern = "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet";
        assert_eq!(filled(pattern, 0, 12), "data/chunk-000/file-012.parquet");
        assert_eq!(filled(pattern, 1234, 5), "data/chunk-1234/file-005.parquet");
        assert_eq!(filled("{chunk_index}/{file_index:06d}", 7, 8), "7/000008");
        assert_eq!(filled(v2::DATA_PATH, 2, 2001), "data/chunk-002/episode_002001.parquet");
        for width in ["70000", "9223372036854775808", "99999999999999999999"] {
            assert!(filled(&format!("{{chunk_index:0{width}d}}"), 1, 2).len() <= MOST_DIGITS);
        }
    }
}
