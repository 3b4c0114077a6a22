//! A copy of a labelled LeRobot data set whose fields are carried over to another vertex numbering.

use std::path::Path;

use super::images::LeRobotDataset;
use super::lists::lists;
use super::read_labels::CERTAINTY;
use super::{Episode, LeRobot, numbers, only, reader};
use crate::dataset::labels::{LabelFrames, LabelOutput, Notes, SourceLabels};
use crate::dataset::{LabelFrame, LabelInfo};
use crate::error::{Error, Result};
use crate::hand::{FieldMap, Topology};
use crate::tactile::{Certainty, Doubt, N_FIELD, TactileField};

/// Writes a copy of the data set at `path` into the folder `at`, with force, contact and the forces of regions on the
/// vertices of `to`, and their statistics.
///
/// # Errors
/// If the data set has no labels of egotac, they are of another topology than the map starts from, a file can't be read, or
/// `at` can't be written.
pub(crate) fn carry(path: &Path, at: &Path, map: &FieldMap, to: Topology) -> Result<()> {
    let Some(mut info) = super::read_info(path) else {
        return Err(Error::file(path, "states no topology: it holds no labels of `egotac label`"));
    };
    info.provenance.topology.must_match(to.other()).map_err(|error| Error::file(path, error))?;
    let dataset = LeRobotDataset::labelled(path)?.with_mano_regions(Some(map.regions(Topology::Mano)));
    info.provenance = crate::dataset::Provenance {
        topology: to,
        hand_model: to.hand_model().into(),
        mano_sha256: map.sha256().to_vec(),
        ..info.provenance
    };
    let labels = CarriedLabels { dataset: &dataset.dataset, prefix: dataset.prefix(), map, to };
    write(&dataset, &labels, &mut info, at)
}

fn write(dataset: &LeRobotDataset, labels: &dyn SourceLabels, info: &mut LabelInfo, at: &Path) -> Result<()> {
    dataset.assemble(labels, info, at, at)
}

/// Labels of the data set's own columns, carried over.
struct CarriedLabels<'a> {
    dataset: &'a LeRobot,
    prefix: &'a str,
    map: &'a FieldMap,
    to: Topology,
}

impl CarriedLabels<'_> {
    /// Reads the rows of one episode, batch by batch.
    fn rows(&self, episode: &Episode) -> Result<impl Iterator<Item = Result<LabelFrame>> + Send + '_> {
        let file = self.dataset.data_file(episode.data)?;
        let builder = reader(&file)?;
        let names = ["force", "contact"].map(|name| format!("{}.{name}", self.prefix));
        let certainty = format!("{}.certainty", self.prefix);
        let judged = self.dataset.info["features"].get(&certainty).is_some();
        let is_read =
            |name: &str| name == "timestamp" || name == certainty || names.iter().any(|wanted| wanted == name);
        let mask = only(&builder, is_read);
        let builder = builder.with_projection(mask).with_batch_size(16);
        let builder = builder.with_offset(self.dataset.start_in_file(episode)).with_limit(episode.length);
        let batches = builder.build().map_err(|e| Error::library(&file, e))?;
        Ok(batches.flat_map(move |batch| {
            let labels = batch.map_err(|e| Error::library(&file, e)).and_then(|batch| {
                let stamps = numbers(&batch, "timestamp", &file)?;
                let [force, contact] = names.each_ref().map(|name| lists(&batch, name, N_FIELD, &file));
                let (force, contact) = (force?, contact?);
                let certainty = if judged { lists(&batch, &certainty, CERTAINTY, &file)? } else { Vec::new() };
                let mut certainty = certainty.chunks_exact(CERTAINTY).map(certainty_of);
                let fields = force.chunks_exact(N_FIELD).zip(contact.chunks_exact(N_FIELD)).zip(stamps);
                let label = |((force, contact), stamp_secs): ((&[f32], &[f32]), f64)| {
                    self.label(force, contact, certainty.next().unwrap_or_default(), stamp_secs)
                };
                fields.map(label).collect::<Result<Vec<_>>>()
            });
            match labels {
                Ok(labels) => labels.into_iter().map(Ok).collect(),
                Err(error) => vec![Err(error)],
            }
        }))
    }

    fn label(&self, force: &[f32], contact: &[f32], certainty: Certainty, stamp_secs: f64) -> Result<LabelFrame> {
        let field = TactileField { topology: self.to.other(), force: force.to_vec(), contact: contact.to_vec() };
        let touch = Ok(field.carried(self.map, self.to)?);
        Ok(LabelFrame { stamp_secs, warming_up: false, touch, certainty, further: Vec::new() })
    }
}

/// Returns the certainty of a row of the column. The column does not tell why touch is unknown, and nothing that is written
/// depends on it.
fn certainty_of(row: &[f32]) -> Certainty {
    let estimate = |value: f32| Some(value).filter(|value| !value.is_nan());
    let doubt = |known: f32| (known == 0.0).then_some(Doubt::Unfamiliar);
    Certainty {
        familiarity: estimate(row[0]),
        presence: [estimate(row[1]), estimate(row[2])],
        doubt: [doubt(row[3]), doubt(row[4])],
        masked: true,
    }
}

impl SourceLabels for CarriedLabels<'_> {
    fn topology(&self) -> Topology {
        self.to
    }

    fn labels(&self, unit: usize) -> Result<LabelFrames<'_>> {
        Ok(Box::new(self.rows(&self.dataset.episodes[unit])?))
    }

    fn notes(&self, _: usize) -> Result<Notes<'_>> {
        Ok(Box::new(std::iter::empty()))
    }
}
