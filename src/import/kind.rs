//! A kind of data sets, and the recordings that it finds.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use super::recording::Reader;
use crate::error::{Error, Result};
use crate::tactile::ForceKind;

/// A kind of data set.
#[derive(Debug)]
pub struct Kind {
    /// Name on the command line.
    pub name: &'static str,
    /// Content that becomes part of the store.
    pub gives: &'static str,
    /// Need of MANO files.
    pub mano: Mano,
    /// Name and origin of the data set.
    pub origin: &'static str,
    /// Licence, as far as its authors state one.
    pub licence: &'static str,
    /// Finds the recordings of a data set.
    pub find: fn(&Path, &Options) -> Result<Found>,
}

/// Need of MANO files.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Mano {
    /// Poses are coefficients of MANO's basis, or exclude its mean: without the files there are no poses.
    Required,
    /// Without the files the built-in hand is posed by the same rotations, approximately.
    Optional,
    /// The hand is fitted to joints; with the files, MANO's hand.
    Fitted,
}

/// Choices that decide which files are read.
#[derive(Debug, Clone, Default)]
pub struct Options {
    /// Folder of the objects' meshes; None = the data set's usual place.
    pub objects: Option<PathBuf>,
    /// Taxel map of the gloves, a shipped one's name or a YAML file; None = that of the data set's glove.
    pub sensor: Option<String>,
    /// Share of the range of an uncalibrated glove above which a reading means contact; None = a tenth.
    pub contact_share: Option<f32>,
    /// Meaning of the forces of gloves; None = readings, as the EgoTac paper has them.
    pub force_kind: Option<ForceKind>,
}

/// Recordings of a data set.
#[derive(Default)]
pub struct Found {
    /// Readers, by the recordings' names.
    pub readers: Vec<Arc<dyn Reader>>,
    /// Names of recordings that can't be read, and the reasons.
    pub unreadable: Vec<(String, Error)>,
}

impl Found {
    /// Adds the reader of a recording, or the reason why it can't be read.
    pub fn add<R: Reader + 'static>(&mut self, name: String, reader: Result<R>) {
        match reader {
            Ok(reader) => self.readers.push(Arc::new(reader)),
            Err(error) => self.unreadable.push((name, error)),
        }
    }
}
