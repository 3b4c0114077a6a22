//! Predictions that lie in files: a Zarr store or a tensor file, frame by frame.

use std::path::{Path, PathBuf};

use crate::dataset::tensors::FieldFile;
use crate::dataset::zarr::{MANO_FORCE, ZarrReader, open_all};
use crate::error::{Error, Result};
use crate::hand::Topology;
use crate::score::metrics::Fields;
use crate::tactile::{N_FIELD, TactileField};

/// Predicted fields, one behind the other.
#[derive(Debug, Clone)]
pub struct Predicted {
    topology: Option<Topology>,
    fields: Fields,
}

impl Predicted {
    /// Reads tensor files or stores (or folders of stores), in the given order.
    ///
    /// # Errors
    /// If there is none, one can't be read, or two differ in topology.
    pub fn read(paths: &[PathBuf]) -> Result<Self> {
        let mut all = Self { topology: None, fields: Fields::default() };
        for path in paths {
            if path.is_dir() {
                for store in open_all(std::slice::from_ref(path))? {
                    let range = 0..store.len();
                    let force = match store.has(MANO_FORCE) {
                        true => store.read_f32(MANO_FORCE, range.clone())?,
                        false => vec![f32::NAN; range.len() * N_FIELD],
                    };
                    let fields = Fields { force, contact: store.read_contact(range)? };
                    all.append(Some(crate::dataset::EpisodeReader::attributes(&store).topology), fields, path)?;
                }
            } else {
                let file = FieldFile::read(path)?;
                all.append(file.topology, file.fields, path)?;
            }
        }
        match all.fields.n_frames() {
            0 => Err(Error::value("predictions", "at least one frame", "none")),
            _ => Ok(all),
        }
    }

    fn append(&mut self, topology: Option<Topology>, fields: Fields, path: &Path) -> Result<()> {
        if let (Some(before), Some(this)) = (self.topology, topology) {
            before.must_match(this).map_err(|error| Error::file(path, error))?;
        }
        self.topology = self.topology.or(topology);
        self.fields.force.extend(fields.force);
        self.fields.contact.extend(fields.contact);
        Ok(())
    }

    /// Frames.
    pub fn n_frames(&self) -> usize {
        self.fields.n_frames()
    }

    /// The field of one frame for truth on `topology`; files that don't say what their vertices mean are taken at their
    /// number.
    ///
    /// # Errors
    /// If the topologies differ, or there is no such frame.
    pub fn frame(&self, index: usize, topology: Topology) -> Result<TactileField> {
        self.topology.unwrap_or(topology).must_match(topology)?;
        let rows = index * N_FIELD..(index + 1) * N_FIELD;
        let of = |values: &[f32]| values.get(rows.clone()).map(<[f32]>::to_vec);
        match (of(&self.fields.force), of(&self.fields.contact)) {
            (Some(force), Some(contact)) => Ok(TactileField { topology, force, contact }),
            _ => Err(Error::value("predictions", format!("more than {index} frames"), self.n_frames())),
        }
    }
}

/// Refuses predictions that are not as many frames as the stores are.
///
/// # Errors
/// If they are more or less.
pub fn must_fit(predicted: &Predicted, stores: &[ZarrReader]) -> Result<()> {
    let frames: usize = stores.iter().map(ZarrReader::len).sum();
    match predicted.n_frames() == frames {
        true => Ok(()),
        false => {
            Err(Error::value("predictions", format!("{frames} frames, as the episodes have"), predicted.n_frames()))
        }
    }
}
