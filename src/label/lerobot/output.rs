//! A LeRobot data set written anew, with the columns and their statistics.

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

use super::super::copy::copy_folder;
use super::super::journal::Labels;
use super::super::output::{Journals, Output};
use super::super::provenance::NAME;
use super::super::statistics::{EpisodeStatistics, Statistics};
use super::super::summary::About;
use super::LeRobotDataset;
use super::columns::{Column, with_types};
use crate::dataset::lerobot::{LeRobot, numbers, reader};
use crate::error::{Error, Result};

/// Rows rewritten at a time.
const BATCH: usize = 64;
/// Key of the Parquet metadata in which the package datasets keeps its types.
const HUGGINGFACE: &str = "huggingface";

impl LeRobotDataset {
    /// Writes one file of rows with the columns' values beside them.
    fn rewrite_rows(&self, from: &Path, to: &Path, columns: &[Column], labelling: &mut Labelling) -> Result<()> {
        let fail = |error: parquet::errors::ParquetError| Error::file(from, error);
        let builder = reader(from)?;
        let old = builder.schema().clone();
        let list = |width: usize| {
            DataType::FixedSizeList(Arc::new(Field::new("element", DataType::Float32, true)), width as i32)
        };
        let added = columns.iter().map(|column| Arc::new(Field::new(&column.name, list(column.width), true)));
        let fields: Vec<FieldRef> = old.fields().iter().cloned().chain(added).collect();
        let mut metadata = old.metadata().clone();
        let mut key_values = builder.metadata().file_metadata().key_value_metadata().cloned().unwrap_or_default();
        key_values.retain(|entry| entry.key != "ARROW:schema");
        if let Some(types) = metadata.get(HUGGINGFACE).and_then(|text| with_types(text, columns)) {
            metadata.insert(HUGGINGFACE, types.clone());
            key_values.retain(|entry| entry.key != HUGGINGFACE);
            key_values.push(KeyValue::new(HUGGINGFACE.into(), types));
        } else {
            // Types that lack the new columns are worse than none.
            metadata.remove(HUGGINGFACE);
            key_values.retain(|entry| entry.key != HUGGINGFACE);
        }
        let schema = Arc::new(Schema::new_with_metadata(fields, metadata));
        let properties = WriterProperties::builder()
            .set_compression(Compression::SNAPPY)
            .set_key_value_metadata(Some(key_values))
            .set_max_row_group_row_count(Some(1 << 13))
            .build();
        let file = File::create(to).map_err(Error::io(to))?;
        let mut writer = ArrowWriter::try_new(file, schema.clone(), Some(properties)).map_err(fail)?;
        for batch in builder.with_batch_size(BATCH).build().map_err(fail)? {
            let batch = batch.map_err(|e| Error::file(from, e))?;
            let mut values: Vec<Vec<f32>> = columns.iter().map(|_| Vec::new()).collect();
            for episode in numbers(&batch, "episode_index", from)? {
                let row = labelling.next(episode as i64, columns)?;
                values.iter_mut().zip(row).for_each(|(column, value)| column.extend(value));
            }
            let mut arrays: Vec<ArrayRef> = batch.columns().to_vec();
            for (column, values) in columns.iter().zip(values) {
                let element = Arc::new(Field::new("element", DataType::Float32, true));
                let list = FixedSizeListArray::try_new(
                    element,
                    column.width as i32,
                    Arc::new(Float32Array::from(values)),
                    None,
                );
                arrays.push(Arc::new(list.map_err(|e| Error::file(from, e))?));
            }
            let batch = RecordBatch::try_new(schema.clone(), arrays).map_err(|e| Error::file(from, e))?;
            writer.write(&batch).map_err(fail)?;
            if writer.in_progress_size() > 64 << 20 {
                writer.flush().map_err(fail)?;
            }
        }
        writer.close().map_err(fail)?;
        Ok(())
    }

    /// Writes one file of `meta/episodes` with the columns' statistics.
    fn rewrite_episodes(
        &self,
        from: &Path,
        to: &Path,
        columns: &[Column],
        done: &[(i64, Vec<Statistics>)],
    ) -> Result<()> {
        let fail = |error: parquet::errors::ParquetError| Error::file(from, error);
        let builder = reader(from)?;
        let old = builder.schema().clone();
        let (mut writer, mut schema) = (None, None);
        for batch in builder.build().map_err(fail)? {
            let batch = batch.map_err(|e| Error::file(from, e))?;
            let indexes = numbers(&batch, "episode_index", from)?;
            let statistics: Vec<&Vec<Statistics>> = indexes
                .iter()
                .map(|index| {
                    let found = done.iter().find(|(episode, _)| *episode == *index as i64);
                    found
                        .map(|(_, statistics)| statistics)
                        .ok_or_else(|| Error::file(from, format!("episode {index} has no row in the data")))
                })
                .collect::<Result<_>>()?;
            let mut fields: Vec<FieldRef> = old.fields().iter().cloned().collect();
            let mut arrays: Vec<ArrayRef> = batch.columns().to_vec();
            for (at, column) in columns.iter().enumerate() {
                let lists: Vec<_> = statistics.iter().map(|all| all[at].lists()).collect();
                let n_lists = lists.first().map_or(0, Vec::len);
                for list in 0..n_lists {
                    let mut builder = ListBuilder::new(Float64Builder::new());
                    for lists in &lists {
                        builder.values().append_slice(&lists[list].1);
                        builder.append(true);
                    }
                    let name = format!("stats/{}/{}", column.name, lists[0][list].0);
                    push(&mut fields, &mut arrays, name, Arc::new(builder.finish()));
                }
                let mut counts = ListBuilder::new(Int64Builder::new());
                for all in &statistics {
                    counts.values().append_value(all[at].count as i64);
                    counts.append(true);
                }
                push(&mut fields, &mut arrays, format!("stats/{}/count", column.name), Arc::new(counts.finish()));
            }
            let mut metadata = old.metadata().clone();
            // It names types of the old columns alone; without it they are those of the columns themselves.
            metadata.remove(HUGGINGFACE);
            let schema = schema.get_or_insert_with(|| Arc::new(Schema::new_with_metadata(fields, metadata))).clone();
            let writer = match &mut writer {
                Some(writer) => writer,
                none => {
                    let properties = WriterProperties::builder().set_compression(Compression::SNAPPY).build();
                    let file = File::create(to).map_err(Error::io(to))?;
                    none.insert(ArrowWriter::try_new(file, schema.clone(), Some(properties)).map_err(fail)?)
                }
            };
            writer.write(&RecordBatch::try_new(schema, arrays).map_err(|e| Error::file(from, e))?).map_err(fail)?;
        }
        match writer {
            Some(writer) => writer.close().map(drop).map_err(fail),
            None => fs::copy(from, to).map(drop).map_err(Error::io(to)),
        }
    }
}

fn push(fields: &mut Vec<FieldRef>, arrays: &mut Vec<ArrayRef>, name: String, array: ArrayRef) {
    fields.push(Arc::new(Field::new(name, array.data_type().clone(), true)));
    arrays.push(array);
}

/// Labels in the order of the rows, and statistics of what went by.
struct Labelling<'a> {
    dataset: &'a LeRobot,
    journals: &'a Journals,
    open: Option<(i64, Labels, Vec<EpisodeStatistics>)>,
    done: Vec<(i64, Vec<Statistics>)>,
}

impl Labelling<'_> {
    /// Values of the columns for the next row, which is of episode `episode`.
    fn next(&mut self, episode: i64, columns: &[Column]) -> Result<Vec<Vec<f32>>> {
        if self.open.as_ref().is_none_or(|(open, ..)| *open != episode) {
            self.close();
            let unit = self.dataset.episodes.iter().position(|other| other.index == episode);
            let unit = unit.ok_or_else(|| self.error(episode, "is in the data but not in meta/episodes"))?;
            let frames = self.dataset.episodes[unit].length;
            let statistics = columns.iter().map(|column| EpisodeStatistics::new(column.width, frames)).collect();
            self.open = Some((episode, self.journals.labels(unit)?, statistics));
        }
        let missing = self.error(episode, "has more rows than meta/episodes says");
        let Some((_, labels, statistics)) = &mut self.open else { return Err(missing) };
        let label = labels.next().ok_or(missing)??;
        let values: Vec<Vec<f32>> = columns.iter().map(|column| (column.value)(&label)).collect();
        statistics.iter_mut().zip(&values).for_each(|(statistics, values)| statistics.push(values));
        Ok(values)
    }

    fn close(&mut self) {
        if let Some((episode, _, statistics)) = self.open.take() {
            self.done.push((episode, statistics.into_iter().map(EpisodeStatistics::finish).collect()));
        }
    }

    fn error(&self, episode: i64, what: &str) -> Error {
        Error::file(&self.dataset.root, format!("episode {episode} {what}"))
    }
}

impl Output for LeRobotDataset {
    fn assemble(&self, journals: &Journals, about: &mut About, at: &Path, _: &Path) -> Result<()> {
        let root = &self.dataset.root;
        let columns = self.columns(journals.topology());
        let mut labelling = Labelling { dataset: &self.dataset, journals, open: None, done: Vec::new() };
        let place = |path: &Path| at.join(path.strip_prefix(root).unwrap_or(path));
        for file in self.dataset.data_files()? {
            let to = place(&file);
            make_folder(&to)?;
            self.rewrite_rows(&file, &to, &columns, &mut labelling)?;
        }
        labelling.close();
        for file in self.dataset.episode_files()? {
            let to = place(&file);
            make_folder(&to)?;
            self.rewrite_episodes(&file, &to, &columns, &labelling.done)?;
        }
        let mut info = self.dataset.info.clone();
        let features =
            info["features"].as_object_mut().ok_or_else(|| Error::file(root, "info.json has no features"))?;
        let mut totals = Map::new();
        for (at, column) in columns.iter().enumerate() {
            let feature = json!({ "dtype": "float32", "shape": [column.width], "names": column.names });
            features.insert(column.name.clone(), feature);
            let mut total = Statistics::default();
            labelling.done.iter().for_each(|(_, statistics)| total.add(&statistics[at]));
            totals.insert(column.name.clone(), total.json());
        }
        let stats = root.join("meta/stats.json");
        let mut all: Map<String, Value> = match fs::read_to_string(&stats) {
            Ok(text) => serde_json::from_str(&text).map_err(|e| Error::file(&stats, e))?,
            Err(_) => Map::new(),
        };
        all.extend(totals);
        write_json(&at.join("meta/info.json"), &info)?;
        write_json(&at.join("meta/stats.json"), &Value::Object(all))?;
        write_json(&about_file(at), &json!(about))?;
        // Videos, tasks and whatever else there is; rows and metadata were written anew.
        copy_folder(root, at, false)
    }

    fn about(&self, out: &Path) -> Option<About> {
        about(out)
    }
}

/// What a labelled data set says about its labels.
pub fn about(root: &Path) -> Option<About> {
    serde_json::from_str(&fs::read_to_string(about_file(root)).ok()?).ok()
}

fn about_file(root: &Path) -> std::path::PathBuf {
    root.join(format!("meta/{NAME}.json"))
}

fn make_folder(file: &Path) -> Result<()> {
    file.parent().map_or(Ok(()), |folder| fs::create_dir_all(folder).map_err(Error::io(folder)))
}

fn write_json(path: &Path, value: &Value) -> Result<()> {
    make_folder(path)?;
    fs::write(path, format!("{value:#}\n")).map_err(Error::io(path))
}
