//! Labels read from the columns of a LeRobot data set.

use std::ops::Range;
use std::path::Path;

use super::labels::read_info;
use super::lists::lists;
use super::prefix::prefix;
use super::{LeRobot, numbers, only, reader};
use crate::dataset::Labelled;
use crate::error::{Error, Result};
use crate::hand::Side;
use crate::tactile::{N_FIELD, TactileSequence};

/// Number of values of a frame in the column of certainty.
pub(super) const CERTAINTY: usize = 5;

/// Reads the columns `PREFIX.force` and `PREFIX.contact`.
///
/// # Errors
/// If there are none, or they can't be read.
pub(crate) fn read_labelled(path: &Path) -> Result<Labelled> {
    let dataset = LeRobot::open(path)?;
    let info = read_info(path);
    let prefix = prefix(&dataset)?;
    let [force, contact, certainty] = ["force", "contact", "certainty"].map(|name| format!("{prefix}.{name}"));
    let judged = dataset.info["features"].as_object().is_some_and(|features| features.contains_key(&certainty));
    let topology = info.as_ref().map(|info| info.provenance.topology);
    let mut labels = TactileSequence { topology, ..Default::default() };
    for file in dataset.data_files()? {
        let builder = reader(&file)?;
        let mask = only(&builder, |name| ["timestamp", &force, &contact, &certainty].contains(&name));
        for batch in builder.with_projection(mask).build().map_err(|e| Error::file(&file, e))? {
            let batch = batch.map_err(|e| Error::file(&file, e))?;
            labels.timestamps.extend(numbers(&batch, "timestamp", &file)?);
            labels.force.extend(lists(&batch, &force, N_FIELD, &file)?);
            labels.contact.extend(lists(&batch, &contact, N_FIELD, &file)?);
            if judged {
                add_certainty(&mut labels, &lists(&batch, &certainty, CERTAINTY, &file)?);
            }
        }
    }
    let mut end = 0;
    for episode in &dataset.episodes {
        end += episode.length;
        labels.episode_ends.push(end);
    }
    Ok(Labelled { labels, truth: None, info })
}

/// Adds familiarity and presence of the newest frames, and makes touch NaN where it is not known. `values`: five for each
/// frame, as the column of certainty holds them.
fn add_certainty(labels: &mut TactileSequence, values: &[f32]) {
    let first = labels.n_frames() - values.len() / CERTAINTY;
    for (frame, row) in (first..).zip(values.chunks_exact(CERTAINTY)) {
        labels.familiarity.push(row[0]);
        labels.presence.extend_from_slice(&row[1..3]);
        for side in Side::BOTH.into_iter().filter(|side| row[3 + *side as usize] == 0.0) {
            let Range { start, end } = side.range();
            for field in [&mut labels.force, &mut labels.contact] {
                field[frame * N_FIELD + start..frame * N_FIELD + end].fill(f32::NAN);
            }
        }
    }
}
