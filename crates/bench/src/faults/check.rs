//! Comparison of an output with that of an undisturbed run.

use std::collections::BTreeMap;
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
}

impl Reference {
    /// Reads the output of two undisturbed runs; `sets` are the data sets in it.
    ///
    /// # Errors
    /// If one can't be read, or two of its images are equal: then a mix-up could not be seen.
    pub fn read(first: &Path, second: &Path, sets: &[&str]) -> Result<Self> {
        let (mut files, other) = (content::files(first)?, content::files(second)?);
        let varies =
            |(name, bytes): (&PathBuf, &Vec<u8>)| !other.get(name).is_some_and(|b| content::is_same(name, bytes, b));
        let varying: Vec<PathBuf> = files.iter().filter(|file| varies(*file)).map(|(name, _)| name.clone()).collect();
        files.retain(|name, _| !varying.contains(name));
        let mut entries = BTreeMap::new();
        for set in sets {
            let path = if set.is_empty() { first.to_path_buf() } else { first.join(set) };
            entries.insert(PathBuf::from(set), content::entries(&path)?);
        }
        let mut pictures: Vec<_> = entries.values().flatten().map(|entry: &Entry| &entry.picture).collect();
        pictures.sort();
        if pictures.windows(2).any(|pair| pair[0] == pair[1]) {
            return Err(egotac::Error::file(first, "expected images that all differ, got two equal ones"));
        }
        Ok(Self { entries, files, varying })
    }

    /// Compares the finished output at `out`. If `partly`, labels may be missing, as the exit status says.
    pub fn compare(&self, out: &Path, partly: bool, harm: &mut Harm) {
        for (set, expected) in &self.entries {
            let path = if set.as_os_str().is_empty() { out.to_path_buf() } else { out.join(set) };
            match content::entries(&path) {
                Ok(got) => compare_entries(expected, &got, partly, harm),
                Err(_) if partly && !path.exists() => {}
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
    for entry in expected {
        match got.iter().filter(|other| other.picture == entry.picture).count() {
            0 if partly => {}
            0 => harm.add(|harm| &mut harm.lost, "an image is missing"),
            1 => {}
            n => harm.add(|harm| &mut harm.doubled, format!("an image is there {n} times")),
        }
    }
    for entry in got {
        let own = expected.iter().find(|own| own.picture == entry.picture);
        match (own, &entry.label) {
            // Damage that came between labelling and copying hides an image whose label is right.
            (None, _) if partly && entry.picture.is_none() => {}
            (None, _) => harm.add(|harm| &mut harm.mixed_up, "an image of another recording"),
            (Some(own), None) if own.label.is_some() && !partly => {
                harm.add(|harm| &mut harm.lost, "a label is missing");
            }
            (Some(own), Some(label)) => {
                // After an image without a label, the window of the next one holds other images.
                let is_anothers =
                    expected.iter().any(|other| other.picture != own.picture && other.label.as_ref() == Some(label));
                let differs = own.label != entry.label || own.stamp != entry.stamp;
                if own.label != entry.label && is_anothers || differs && !partly {
                    harm.add(|harm| &mut harm.mixed_up, "a label that is not its image's own");
                }
            }
            (Some(_), None) => {}
        }
    }
    harm.notes.dedup();
}
