//! Kinds of data sets that can be imported.

use std::fmt::Write;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use super::readers;
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

/// All kinds, in the order of the table.
pub static ALL: [Kind; 9] = [
    readers::hot3d::KIND,
    readers::h2o::KIND,
    readers::taco::KIND,
    readers::fpha::KIND,
    readers::egopressure::KIND,
    readers::arctic::KIND,
    readers::hoi4d::KIND,
    readers::oakink2::KIND,
    readers::egotac_sc::KIND,
];

impl Kind {
    /// Returns the kind of a name.
    ///
    /// # Errors
    /// If there is none; the error lists the names.
    pub fn of(name: &str) -> Result<&'static Self> {
        let known = || ALL.iter().map(|kind| kind.name);
        ALL.iter().find(|kind| kind.name == name).ok_or_else(|| Error::unknown("data set kind", name, known()))
    }
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

/// Formats the table of all kinds in Markdown.
pub fn table() -> String {
    let mut text = String::from("| kind | gives | MANO files | data set | licence |\n|---|---|---|---|---|\n");
    for kind in &ALL {
        let mano = match kind.mano {
            Mano::Required => "required",
            Mano::Optional => "for exact hands",
            Mano::Fitted => "for MANO's vertices",
        };
        let Kind { name, gives, origin, licence, .. } = kind;
        // Writing to a String cannot fail.
        let _ = writeln!(text, "| {name} | {gives} | {mano} | {origin} | {licence} |");
    }
    text
}
