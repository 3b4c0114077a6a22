//! LeRobot data sets: `info.json`, and Parquet files whose values, metadata or pages lie.

use std::path::Path;
use std::sync::Arc;

use arrow_array::cast::AsArray;
use arrow_array::types::{Float32Type, Float64Type, Int64Type};
use arrow_array::{ArrayRef, Float32Array, Float64Array, Int64Array, RecordBatch};
use arrow_schema::{DataType, Schema};
use egotac::Result;
use parquet::arrow::ArrowWriter;
use parquet::arrow::arrow_reader::ParquetRecordBatchReaderBuilder;
use parquet::file::properties::WriterProperties;

use super::repository;
use crate::case::Case;
use crate::mutate::{Rng, below, bytes, chance, extreme, json, pick};

/// Values that `huggingface` in the metadata of a Parquet file may have instead of an object.
const HUGGINGFACE: [&str; 6] = ["[]", "\"text\"", "{}", "{\"info\": []}", "{\"info\": {\"features\": 1}}", "{"];

/// Labels the data set by one of its two cameras.
pub fn read(path: &Path, scratch: &Path) -> Result<()> {
    super::label_camera(path, scratch, Some("observation.images.head"))
}

/// Changes files of the data set of the tests whose images lie in the rows.
pub fn make(rng: &mut Rng) -> Case {
    let mut files = match Case::read(&repository("tests/data/lerobot/image")) {
        Ok(Case::Folder(files)) => files,
        other => panic!("seed lerobot: {other:?}"),
    };
    let names: Vec<String> = files.keys().cloned().collect();
    for _ in 0..1 + below(rng, 3) {
        let name = pick(rng, &names).clone();
        let Some(content) = files.get(&name).cloned() else { continue };
        let new = match (name.ends_with(".parquet"), below(rng, 4)) {
            (true, 0) => changed_bytes(rng, content),
            (true, _) => rewritten(rng, content.clone()).unwrap_or(content),
            (false, _) => json::change_text(rng, &String::from_utf8_lossy(&content)).into_bytes(),
        };
        files.insert(name, new);
        if chance(rng, 0.03) {
            files.remove(pick(rng, &names));
        }
    }
    Case::Folder(files)
}

/// Changes a byte field, mostly in the footer.
fn changed_bytes(rng: &mut Rng, mut content: Vec<u8>) -> Vec<u8> {
    let n = content.len();
    if chance(rng, 0.3) || n < 600 {
        bytes::change(rng, &mut content);
        return content;
    }
    let at = n - 8 - below(rng, 500);
    let value = (extreme(rng) as u16).to_le_bytes();
    content[at] = value[0];
    if chance(rng, 0.5) {
        content[at + 1] = value[1];
    }
    content
}

/// Writes the table again with another value in a column, or other metadata.
fn rewritten(rng: &mut Rng, content: Vec<u8>) -> Option<Vec<u8>> {
    let folder = tempfile::tempdir().ok()?;
    let path = folder.path().join("a.parquet");
    std::fs::write(&path, content).ok()?;
    let builder = ParquetRecordBatchReaderBuilder::try_new(std::fs::File::open(&path).ok()?).ok()?;
    let schema = builder.schema().clone();
    let batches: Vec<RecordBatch> = builder.build().ok()?.flatten().collect();
    let mut metadata = schema.metadata().clone();
    let change_values = chance(rng, 0.7);
    if !change_values {
        metadata.insert("huggingface".to_string(), pick(rng, &HUGGINGFACE).to_string());
    }
    let schema = Arc::new(Schema::new_with_metadata(schema.fields().clone(), metadata));
    let column = numeric(rng, &schema)?;
    let mut out = Vec::new();
    let mut writer = ArrowWriter::try_new(&mut out, schema.clone(), Some(WriterProperties::builder().build())).ok()?;
    for batch in batches {
        let mut columns = batch.columns().to_vec();
        if change_values {
            columns[column] = other_values(rng, &columns[column]);
        }
        writer.write(&RecordBatch::try_new(schema.clone(), columns).ok()?).ok()?;
    }
    writer.close().ok()?;
    Some(out)
}

/// Draws a column of numbers, among the first ones most of the time: statistics come last.
fn numeric(rng: &mut Rng, schema: &Schema) -> Option<usize> {
    let numbers = [DataType::Int64, DataType::Float32, DataType::Float64];
    let places: Vec<usize> = (0..schema.fields().len())
        .filter(|i| numbers.contains(schema.field(*i).data_type()) && !schema.field(*i).name().starts_with("stats/"))
        .collect();
    (!places.is_empty()).then(|| *pick(rng, &places))
}

fn other_values(rng: &mut Rng, column: &ArrayRef) -> ArrayRef {
    let at = below(rng, column.len());
    let real = *pick(rng, &[f64::NAN, f64::INFINITY, -1.0, 1e300, 0.0]);
    match column.data_type() {
        DataType::Int64 => {
            let mut values = column.as_primitive::<Int64Type>().values().to_vec();
            values.iter_mut().skip(at).take(1).for_each(|value| *value = extreme(rng));
            Arc::new(Int64Array::from(values))
        }
        DataType::Float32 => {
            let mut values = column.as_primitive::<Float32Type>().values().to_vec();
            values.iter_mut().skip(at).take(1).for_each(|value| *value = real as f32);
            Arc::new(Float32Array::from(values))
        }
        DataType::Float64 => {
            let mut values = column.as_primitive::<Float64Type>().values().to_vec();
            values.iter_mut().skip(at).take(1).for_each(|value| *value = real);
            Arc::new(Float64Array::from(values))
        }
        _ => column.clone(),
    }
}
