//! Labels of a LeRobot data set: written as further columns with statistics into a copy of it.

use std::fs;
use std::fs::File;
use std::path::Path;
use std::sync::Arc;

use arrow_array::builder::{Float64Builder, Int64Builder, ListBuilder};
use arrow_array::{ArrayRef, FixedSizeListArray, Float32Array, RecordBatch};
use arrow_schema::{DataType, Field, FieldRef, Schema};
use parquet::arrow::ArrowWriter;
use parquet::basic::Compression;
use parquet::file::metadata::KeyValue;
use parquet::file::properties::WriterProperties;
use serde_json::{Map, Value, json};

use super::columns::{Column, with_types};
use super::finished::FinishedEpisodes;
use super::images::LeRobotDataset;
use super::lists::lists;
use super::policy_input::LabelColumn;
use super::statistics::{EpisodeStatistics, Statistics};
use super::{LeRobot, numbers, only, reader, reader_and_page, v2};
use crate::dataset::copy::{copy_folder, copy_regular};
use crate::dataset::label_info::LabelInfo;
use crate::dataset::labels::{LabelFrames, LabelOutput, SourceLabels};
use crate::dataset::provenance::PROVENANCE_KEY;
use crate::error::{Error, Result};
use crate::file::{input, limits};
use crate::hand::Topology;

/// Largest number of rows rewritten at a time.
const BATCH: usize = 64;
/// Upper limit of the rows in a row group.
const ROW_GROUP: usize = 1 << 13;
/// Size at which a row group is written, bytes; bounds the memory.
const BUFFER: usize = 64 << 20;
/// Key of the Parquet metadata under which the package `datasets` keeps its types.
const HUGGINGFACE: &str = "huggingface";

impl LeRobotDataset {
    /// Writes one file of rows with the values of the new columns.
    fn rewrite_rows(&self, from: &Path, to: &Path, columns: &[Column], labelling: &mut Labelling) -> Result<()> {
        let fail = |error: parquet::errors::ParquetError| Error::library(from, error);
        let not_written = |error: parquet::errors::ParquetError| Error::library(to, error);
        let (builder, page) = reader_and_page(from)?;
        // Fewer rows at a time where a cell may be large.
        let batch = (limits::PAGE.value() / page.max(1)).clamp(1, BATCH as u64) as usize;
        let key_values = builder.metadata().file_metadata().key_value_metadata().cloned().unwrap_or_default();
        let mask = only(&builder, |name| !self.is_replaced(name) || self.is_extended(name));
        let kept = builder.schema().fields().iter().filter(|field| !self.is_replaced(field.name())).cloned();
        let old = Schema::new_with_metadata(kept.collect::<Vec<_>>(), builder.schema().metadata().clone());
        let (schema, key_values) = extended_schema(&old, key_values, columns);
        let properties = WriterProperties::builder()
            .set_compression(Compression::SNAPPY)
            .set_key_value_metadata(Some(key_values))
            .set_max_row_group_row_count(Some(ROW_GROUP))
            .build();
        let file = File::create(to).map_err(Error::io(to))?;
        let mut writer = ArrowWriter::try_new(file, schema.clone(), Some(properties)).map_err(not_written)?;
        let mut place = 0;
        for batch in builder.with_projection(mask).with_batch_size(batch).build().map_err(fail)? {
            let batch = batch.map_err(|e| Error::library(from, e))?;
            let mut values: Vec<Vec<f32>> = columns.iter().map(|_| Vec::new()).collect();
            let extended = columns.iter().filter(|column| column.base > 0);
            let before = extended.map(|column| lists(&batch, &column.name, column.base, from));
            let before = before.collect::<Result<Vec<_>>>()?;
            for (row, episode) in numbers(&batch, "episode_index", from)?.into_iter().enumerate() {
                let row = labelling.next(episode as i64, (from, place), columns, &Before { columns: &before, row })?;
                place += 1;
                values.iter_mut().zip(row).for_each(|(column, value)| column.extend(value));
            }
            let kept = batch.schema().fields().iter().map(|field| !self.is_replaced(field.name())).collect::<Vec<_>>();
            let kept = batch.columns().iter().zip(kept).filter(|(_, kept)| *kept).map(|(array, _)| array.clone());
            let mut arrays: Vec<ArrayRef> = kept.collect();
            for (column, values) in columns.iter().zip(values) {
                let values = Arc::new(Float32Array::from(values));
                let list = FixedSizeListArray::try_new(element(), column.width as i32, values, None);
                arrays.push(Arc::new(list.map_err(|e| Error::file(from, e))?));
            }
            let batch = RecordBatch::try_new(schema.clone(), arrays).map_err(|e| Error::file(from, e))?;
            writer.write(&batch).map_err(not_written)?;
            if writer.in_progress_size() > BUFFER {
                writer.flush().map_err(not_written)?;
            }
        }
        writer.close().map_err(not_written)?;
        Ok(())
    }

    /// Writes one file of `meta/episodes` with the statistics of the new columns.
    fn rewrite_episodes(&self, from: &Path, to: &Path, columns: &[Column], done: &FinishedEpisodes) -> Result<()> {
        let fail = |error: parquet::errors::ParquetError| Error::library(from, error);
        let not_written = |error: parquet::errors::ParquetError| Error::library(to, error);
        let builder = reader(from)?.with_batch_size(BATCH);
        let kept = builder.schema().fields().iter().filter(|field| !self.is_replaced(field.name())).cloned();
        let old = Schema::new_with_metadata(kept.collect::<Vec<_>>(), builder.schema().metadata().clone());
        let mask = only(&builder, |name| !self.is_replaced(name));
        let builder = builder.with_projection(mask);
        let mut metadata = old.metadata().clone();
        // The entry lists types of the old columns alone; without it, readers take the types of the columns themselves.
        metadata.remove(HUGGINGFACE);
        let (mut writer, mut schema) = (None, None);
        for batch in builder.build().map_err(fail)? {
            let batch = batch.map_err(|e| Error::library(from, e))?;
            let mut statistics = Vec::new();
            for index in numbers(&batch, "episode_index", from)? {
                let missing = || Error::file(from, format!("episode {index} has no row in the data"));
                statistics.push(done.get(index as i64)?.ok_or_else(missing)?);
            }
            let mut fields: Vec<FieldRef> = old.fields().iter().cloned().collect();
            let mut arrays: Vec<ArrayRef> = batch.columns().to_vec();
            for (at, column) in columns.iter().enumerate() {
                let of_column: Vec<&Statistics> = statistics.iter().map(|all| &all[at]).collect();
                for (name, array) in statistics_arrays(&column.name, &of_column) {
                    fields.push(Arc::new(Field::new(name, array.data_type().clone(), true)));
                    arrays.push(array);
                }
            }
            let schema = schema.get_or_insert_with(|| Arc::new(Schema::new_with_metadata(fields, metadata.clone())));
            let writer = match &mut writer {
                Some(writer) => writer,
                none => {
                    let properties = WriterProperties::builder().set_compression(Compression::SNAPPY).build();
                    let file = File::create(to).map_err(Error::io(to))?;
                    none.insert(ArrowWriter::try_new(file, schema.clone(), Some(properties)).map_err(not_written)?)
                }
            };
            let batch = RecordBatch::try_new(schema.clone(), arrays).map_err(|e| Error::file(from, e))?;
            writer.write(&batch).map_err(not_written)?;
            if writer.in_progress_size() > BUFFER {
                writer.flush().map_err(not_written)?;
            }
        }
        match writer {
            Some(writer) => writer.close().map(drop).map_err(not_written),
            None => copy_regular(from, to),
        }
    }

    /// Returns the content of `meta/info.json` with the new columns.
    fn extended_info(&self, columns: &[Column]) -> Result<Value> {
        let mut info = self.dataset.info.clone();
        let features = info["features"].as_object_mut();
        let features = features.ok_or_else(|| Error::file(&self.dataset.root, "info.json has no features"))?;
        for column in columns {
            let feature = json!({ "dtype": "float32", "shape": [column.width], "names": column.names });
            features.insert(column.name.clone(), feature);
        }
        Ok(info)
    }

    /// Returns the content of `meta/stats.json` with statistics of the new columns over all episodes.
    fn extended_stats(&self, columns: &[Column], done: &FinishedEpisodes) -> Result<Value> {
        let path = self.dataset.folder.join("meta/stats.json")?;
        let stats: Map<String, Value> = match path.exists() {
            true => {
                let text = input::read_text(&path, limits::TEXT)?;
                serde_json::from_str(&text).map_err(|e| Error::file(&path, e))?
            }
            false => Map::new(),
        };
        Ok(v2::extended(stats, columns, done))
    }
}

/// Returns the schema of rows with the new columns, and the file's metadata that fits it.
fn extended_schema(old: &Schema, mut key_values: Vec<KeyValue>, columns: &[Column]) -> (Arc<Schema>, Vec<KeyValue>) {
    let list = |width: usize| DataType::FixedSizeList(element(), width as i32);
    let added = columns.iter().map(|column| Arc::new(Field::new(&column.name, list(column.width), true)));
    let fields: Vec<FieldRef> = old.fields().iter().cloned().chain(added).collect();
    let mut metadata = old.metadata().clone();
    // The writer adds the Arrow schema itself.
    key_values.retain(|entry| entry.key != "ARROW:schema" && entry.key != HUGGINGFACE);
    // Types that lack the new columns are worse than none: extend them, or drop the entry.
    match metadata.get(HUGGINGFACE).and_then(|text| with_types(text, columns)) {
        Some(types) => {
            metadata.insert(HUGGINGFACE, types.clone());
            key_values.push(KeyValue::new(HUGGINGFACE.into(), types));
        }
        None => drop(metadata.remove(HUGGINGFACE)),
    }
    (Arc::new(Schema::new_with_metadata(fields, metadata)), key_values)
}

fn element() -> FieldRef {
    Arc::new(Field::new("element", DataType::Float32, true))
}

/// Returns the columns `stats/COLUMN/...` with one row per episode.
fn statistics_arrays(column: &str, episodes: &[&Statistics]) -> Vec<(String, ArrayRef)> {
    let mut arrays: Vec<(String, ArrayRef)> = Vec::new();
    let lists: Vec<_> = episodes.iter().map(|statistics| statistics.lists()).collect();
    for list in 0..lists.first().map_or(0, Vec::len) {
        let mut builder = ListBuilder::new(Float64Builder::new());
        for lists in &lists {
            builder.values().append_slice(&lists[list].1);
            builder.append(true);
        }
        arrays.push((format!("stats/{column}/{}", lists[0][list].0), Arc::new(builder.finish())));
    }
    let mut counts = ListBuilder::new(Int64Builder::new());
    for statistics in episodes {
        counts.values().append_value(statistics.count as i64);
        counts.append(true);
    }
    arrays.push((format!("stats/{column}/count"), Arc::new(counts.finish())));
    arrays
}

/// Labels in the order of the rows, and statistics of the labels that were written.
struct Labelling<'a> {
    dataset: &'a LeRobot,
    labels: &'a dyn SourceLabels,
    /// The present episode.
    open: Option<OpenEpisode<'a>>,
    done: FinishedEpisodes,
}

/// Values that the extended columns have had so far.
struct Before<'a> {
    /// By extended column: the rows of a batch, one behind the other.
    columns: &'a [Vec<f32>],
    /// The present row.
    row: usize,
}

struct OpenEpisode<'a> {
    index: i64,
    /// Number of its rows that have no label yet.
    left: usize,
    labels: LabelFrames<'a>,
    statistics: Vec<EpisodeStatistics>,
}

impl Labelling<'_> {
    /// Returns the values of the columns for the next row, which belongs to episode `index` and lies at a place of a file.
    ///
    /// # Errors
    /// If the row is not the one whose image was labelled: rows must lie where `meta/episodes` says.
    fn next(&mut self, index: i64, row: (&Path, usize), columns: &[Column], before: &Before) -> Result<Vec<Vec<f32>>> {
        if self.open.as_ref().is_none_or(|open| open.index != index) {
            self.close()?;
            self.open(index, row, columns)?;
        }
        let more = self.error(index, "has more rows than meta/episodes says");
        let Some(open) = self.open.as_mut().filter(|open| open.left > 0) else { return Err(more) };
        open.left -= 1;
        let label = open.labels.next().ok_or(more)??;
        let mut before = before.columns.iter().map(|values| (values, before.row));
        let value = |column: &Column| match column.base {
            0 => (column.value)(&label),
            base => {
                let first = before.next().map(|(values, row)| values[row * base..(row + 1) * base].to_vec());
                [first.unwrap_or_default(), (column.value)(&label)].concat()
            }
        };
        let values: Vec<Vec<f32>> = columns.iter().map(value).collect();
        open.statistics.iter_mut().zip(&values).for_each(|(statistics, values)| statistics.push(values));
        Ok(values)
    }

    /// Starts episode `index`, whose first row lies at a place of a file.
    fn open(&mut self, index: i64, (file, place): (&Path, usize), columns: &[Column]) -> Result<()> {
        let dataset = self.dataset;
        let unit = dataset.episodes.binary_search_by_key(&index, |episode| episode.index);
        let unit = unit.map_err(|_| self.error(index, "is in the data but not in meta/episodes"))?;
        let episode = &dataset.episodes[unit];
        let (told, start) = (dataset.data_file(episode.data)?, dataset.start_in_file(episode));
        if self.done.contains(index) || told != file || start != place {
            let expected = format!("starts at row {start} of {}, as meta/episodes says", told.display());
            return Err(self.error(index, &format!("{expected}, but also at row {place} of {}", file.display())));
        }
        let statistics = columns.iter().map(|column| EpisodeStatistics::new(column.width, episode.length)).collect();
        self.open = Some(OpenEpisode { index, left: episode.length, labels: self.labels.labels(unit)?, statistics });
        Ok(())
    }

    fn close(&mut self) -> Result<()> {
        let Some(OpenEpisode { index, left, statistics, .. }) = self.open.take() else { return Ok(()) };
        if left > 0 {
            return Err(self.error(index, &format!("lacks {left} of the rows that meta/episodes says")));
        }
        let statistics: Vec<Statistics> = statistics.into_iter().map(EpisodeStatistics::finish).collect();
        self.done.add(index, &statistics)
    }

    fn error(&self, index: i64, problem: &str) -> Error {
        Error::file(&self.dataset.root, format!("episode {index} {problem}"))
    }
}

impl LabelOutput for LeRobotDataset {
    fn assemble(&self, labels: &dyn SourceLabels, info: &mut LabelInfo, at: &Path, _: &Path) -> Result<()> {
        let root = &self.dataset.root;
        let columns = self.columns(labels.topology(), info.provenance.doubt.is_some(), info.provenance.keypoints);
        fs::create_dir_all(at).map_err(Error::io(at))?;
        let done = FinishedEpisodes::new(at)?;
        let mut labelling = Labelling { dataset: &self.dataset, labels, open: None, done };
        let place = |path: &Path| at.join(path.strip_prefix(root).unwrap_or(path));
        for file in self.dataset.data_files()? {
            let to = place(&file);
            create_parent(&to)?;
            self.rewrite_rows(&file, &to, &columns, &mut labelling)?;
        }
        labelling.close()?;
        for file in self.dataset.episode_files()? {
            let to = place(&file);
            create_parent(&to)?;
            self.rewrite_episodes(&file, &to, &columns, &labelling.done)?;
        }
        write_json(&at.join("meta/info.json"), &self.extended_info(&columns)?)?;
        match v2::episodes_stats(&self.dataset)? {
            Some(file) => v2::write_episodes_stats(&file, at, &columns, &labelling.done)?,
            None => write_json(&at.join("meta/stats.json"), &self.extended_stats(&columns, &labelling.done)?)?,
        }
        write_json(&info_file(at), &json!(info))?;
        // Copy videos, tasks and everything else; existing files were written above.
        copy_folder(root, at, false)
    }

    fn check(&self, topology: Topology) -> Result<()> {
        let wanted = self.input.is_some() && self.chosen.contains(&LabelColumn::RegionForce);
        match wanted && topology == Topology::Mano && self.mano_regions.is_none() {
            true => Err(Error::value(
                "--columns region_force",
                "--mano-left and --mano-right, whose regions are known",
                "neither",
            )),
            false => Ok(()),
        }
    }

    fn info(&self, out: &Path) -> Option<LabelInfo> {
        read_info(out)
    }
}

/// Reads the description of the labels in a data set; None without one.
pub fn read_info(root: &Path) -> Option<LabelInfo> {
    serde_json::from_str(&input::read_text(&info_file(root), limits::TEXT).ok()?).ok()
}

fn info_file(root: &Path) -> std::path::PathBuf {
    root.join(format!("meta/{PROVENANCE_KEY}.json"))
}

fn create_parent(file: &Path) -> Result<()> {
    file.parent().map_or(Ok(()), |folder| fs::create_dir_all(folder).map_err(Error::io(folder)))
}

fn write_json(path: &Path, value: &Value) -> Result<()> {
    create_parent(path)?;
    fs::write(path, format!("{value:#}\n")).map_err(Error::io(path))
}
