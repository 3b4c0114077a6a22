//! Labels read from the columns of a LeRobot data set.

use std::path::Path;

use arrow_array::cast::AsArray;
use arrow_array::types::Float32Type;
use arrow_array::{Array, RecordBatch};
use arrow_schema::DataType;

use super::labels::read_info;
use super::{LeRobot, numbers, only, reader};
use crate::dataset::Labelled;
use crate::error::{Error, Result};
use crate::tactile::{N_FIELD, TactileSequence};

/// Reads the columns `PREFIX.force` and `PREFIX.contact`.
///
/// # Errors
/// If there are none, or they can't be read.
pub(crate) fn read_labelled(path: &Path) -> Result<Labelled> {
    let dataset = LeRobot::open(path)?;
    let info = read_info(path);
    let prefix = prefix(&dataset)?;
    let [force, contact] = ["force", "contact"].map(|name| format!("{prefix}.{name}"));
    let topology = info.as_ref().map(|info| info.provenance.topology);
    let mut labels = TactileSequence { topology, ..Default::default() };
    for file in dataset.data_files()? {
        let builder = reader(&file)?;
        let mask = only(&builder, |name| ["timestamp", &force, &contact].contains(&name));
        for batch in builder.with_projection(mask).build().map_err(|e| Error::file(&file, e))? {
            let batch = batch.map_err(|e| Error::file(&file, e))?;
            labels.timestamps.extend(numbers(&batch, "timestamp", &file)?);
            labels.force.extend(lists(&batch, &force, &file)?);
            labels.contact.extend(lists(&batch, &contact, &file)?);
        }
    }
    let mut end = 0;
    for episode in &dataset.episodes {
        end += episode.length;
        labels.episode_ends.push(end);
    }
    Ok(Labelled { labels, truth: None, info })
}

/// Returns the prefix of the columns of labels.
///
/// # Errors
/// If there are none.
pub(super) fn prefix(dataset: &LeRobot) -> Result<&str> {
    let is_force = |(name, feature): (&'_ String, &serde_json::Value)| {
        let prefix = name.strip_suffix(".force");
        prefix.filter(|_| feature["shape"][0].as_u64() == Some(N_FIELD as u64)).map(str::len)
    };
    let features = dataset.info["features"].as_object().into_iter().flatten();
    let found = features.filter_map(|(name, feature)| Some(&name[..is_force((name, feature))?])).next();
    found.ok_or_else(|| Error::file(&dataset.root, "holds no labels: no feature PREFIX.force of 1556 numbers"))
}

/// Returns the numbers of a column of lists.
pub(super) fn lists(batch: &RecordBatch, name: &str, path: &Path) -> Result<Vec<f32>> {
    let column = batch.column_by_name(name);
    let values = column.and_then(|column| match column.data_type() {
        DataType::FixedSizeList(..) => column.as_fixed_size_list_opt().map(|list| list.values().clone()),
        DataType::List(_) => column.as_list_opt::<i32>().map(|list| list.values().clone()),
        _ => None,
    });
    let values = values.as_ref().and_then(|values| values.as_primitive_opt::<Float32Type>());
    match values {
        Some(values) if values.len() == batch.num_rows() * N_FIELD => Ok(values.values().to_vec()),
        _ => Err(Error::file(path, format!("{name}: expected lists of {N_FIELD} float32"))),
    }
}
