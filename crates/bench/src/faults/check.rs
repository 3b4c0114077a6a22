//! Comparison of an output with that of an undisturbed run.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use egotac::error::Result;
use serde::Serialize;

use super::content::{self, Entry};

/// Kinds of harm that a case found.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize)]
pub struct Harm {
    /// An image, label or file of the undisturbed run is missing.
    pub lost: bool,
    /// A label stands beside another image than its own, or beside an image of another recording.
    pub mixed_up: bool,
    /// An image is there twice.
    pub doubled: bool,
    /// An output is there that is not whole, or differs from the undisturbed run's.
    pub half_written: bool,
    /// An exit status or signal other than documented, or a hang.
    pub wrong_status: bool,
    /// Files or processes that the finished command left behind.
    pub leftovers: bool,
    /// One sentence for each finding.
    pub notes: Vec<String>,
}

impl Harm {
    /// True if nothing was found.
    pub fn is_none(&self) -> bool {
        *self == Self::default()
    }

    /// Adds a finding.
    pub fn add(&mut self, kind: fn(&mut Self) -> &mut bool, note: impl Into<String>) {
        *kind(self) = true;
        self.notes.push(note.into());
    }
}

/// Output of an undisturbed run.
#[derive(Debug, Default)]
pub struct Reference {
    /// Images and labels of each data set in the output, by relative path.
    pub entries: BTreeMap<PathBuf, Vec<Entry>>,
    /// All files but those that differ between two undisturbed runs.
    pub files: BTreeMap<PathBuf, Vec<u8>>,
    /// Files that differ between two undisturbed runs.
    pub varying: Vec<PathBuf>,
    /// Size of all files, bytes.
    pub bytes: u64,
}

impl Reference {
    /// Reads the output of two undisturbed runs; `sets` are the data sets in it.
    ///
    /// # Errors
    /// If one can't be read, or many of its images are equal: then a mix-up could not be seen.
    pub fn read(first: &Path, second: &Path, sets: &[&str]) -> Result<Self> {
        let (mut files, other) = (content::files(first)?, content::files(second)?);
        let varies =
            |(name, bytes): (&PathBuf, &Vec<u8>)| !other.get(name).is_some_and(|b| content::is_same(name, bytes, b));
        let bytes = files.values().map(|bytes| bytes.len() as u64).sum();
        let varying: Vec<PathBuf> = files.iter().filter(|file| varies(*file)).map(|(name, _)| name.clone()).collect();
        files.retain(|name, _| !varying.contains(name));
        let mut entries = BTreeMap::new();
        for set in sets {
            let path = if set.is_empty() { first.to_path_buf() } else { first.join(set) };
            entries.insert(PathBuf::from(set), content::entries(&path)?);
        }
        let all: Vec<_> = entries.values().flatten().map(|entry: &Entry| &entry.picture).collect();
        let different: BTreeSet<_> = all.iter().collect();
        if 2 * different.len() < all.len() {
            let message = format!("expected images that differ, got {} of {} images", different.len(), all.len());
            return Err(egotac::Error::file(first, message));
        }
        Ok(Self { entries, files, varying, bytes })
    }

    /// Compares the finished output at `out`. If `partly`, labels may be missing, as the exit status says.
    pub fn compare(&self, out: &Path, partly: bool, harm: &mut Harm) {
        for (set, expected) in &self.entries {
            let path = if set.as_os_str().is_empty() { out.to_path_buf() } else { out.join(set) };
            match content::entries(&path) {
                Ok(got) => compare_entries(expected, &got, partly, harm),
                Err(_) if partly && !path.exists() => {}
                Err(error) if !path.exists() => harm.add(|harm| &mut harm.lost, error.to_string()),
                Err(error) => harm.add(|harm| &mut harm.half_written, error.to_string()),
            }
        }
        if !partly {
            self.compare_files(out, harm);
        }
    }

    fn compare_files(&self, out: &Path, harm: &mut Harm) {
        let got = match content::files(out) {
            Ok(got) => got,
            Err(error) => return harm.add(|harm| &mut harm.lost, error.to_string()),
        };
        for (name, bytes) in &self.files {
            match got.get(name) {
                None => harm.add(|harm| &mut harm.lost, format!("{} is missing", name.display())),
                Some(there) if !content::is_same(name, bytes, there) => {
                    harm.add(|harm| &mut harm.half_written, format!("{} has other bytes", name.display()));
                }
                Some(_) => {}
            }
        }
        for name in got.keys().filter(|name| !self.files.contains_key(*name) && !self.varying.contains(name)) {
            harm.add(|harm| &mut harm.leftovers, format!("{} was left in the output", name.display()));
        }
    }
}

fn compare_entries(expected: &[Entry], got: &[Entry], partly: bool, harm: &mut Harm) {
    let number = |entries: &[Entry], picture| entries.iter().filter(|entry| entry.picture == picture).count();
    for picture in expected.iter().map(|entry| &entry.picture).collect::<BTreeSet<_>>() {
        let [before, now] = [expected, got].map(|entries| number(entries, picture.clone()));
        if now < before && !partly {
            harm.add(|harm| &mut harm.lost, "an image is missing");
        }
        if now > before && picture.is_some() {
            harm.add(|harm| &mut harm.doubled, format!("{now} images in place of {before}"));
        }
    }
    for entry in got {
        let mut own = expected.iter().filter(|own| own.picture == entry.picture).peekable();
        match (own.peek(), &entry.label) {
            // Damage that came between labelling and copying hides an image whose label is right.
            (None, _) if partly && entry.picture.is_none() => {}
            // In a store, an image that can't be read is black, and has no label.
            (None, None) if partly => {}
            (None, _) => harm.add(|harm| &mut harm.mixed_up, "an image of another recording"),
            (Some(own), None) if own.label.is_some() && !partly => {
                harm.add(|harm| &mut harm.lost, "a label is missing");
            }
            (Some(_), None) => {}
            (Some(_), Some(label)) => {
                let (same_label, same) = own.fold((false, false), |(label, same), own| {
                    (label || own.label == entry.label, same || own == entry)
                });
                // After an image without a label, the window of the next one holds other images.
                let is_anothers = !same_label && expected.iter().any(|other| other.label.as_ref() == Some(label));
                if is_anothers || !same && !partly {
                    harm.add(|harm| &mut harm.mixed_up, "a label that is not its image's own");
                }
            }
        }
    }
    harm.notes.dedup();
}
