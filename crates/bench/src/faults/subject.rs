//! The commands under test.

use std::ffi::OsString;
use std::fs;
use std::path::{Path, PathBuf};

use egotac::dataset::copy_folder;
use egotac::error::{Error, Result};

use super::content;
use super::input;

/// Purpose of a command.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    /// `egotac label`.
    Label,
    /// `egotac data import`.
    Import,
    /// `egotac sim generate`.
    Generate,
    /// `egotac train`.
    Train,
    /// `egotac experiment`.
    Experiment,
}

/// A command with its input and output.
#[derive(Debug, Clone)]
pub struct Subject {
    /// Name in the table.
    pub name: &'static str,
    /// Purpose.
    pub kind: Kind,
    /// Its input; None = it has none that a fault could touch.
    pub input: Option<PathBuf>,
    /// Another input of the same name.
    pub other: Option<PathBuf>,
    /// Its output, relative to the folder of a case.
    pub out: &'static str,
    /// Data sets in the output; empty = the output itself.
    pub sets: &'static [&'static str],
    folder: PathBuf, // of all inputs
}

/// Writer of an input at a path, of the recording with a number.
type Writer = fn(&Path, u16) -> Result<()>;

/// Name of the labelling of a LeRobot data set.
const LEROBOT: &str = "label, LeRobot";

/// Command with an input: name, purpose, file name, output, data sets in it, writer.
type WithInput = (&'static str, Kind, &'static str, &'static str, &'static [&'static str], Writer);

/// Commands with an input.
const WITH_INPUT: [WithInput; 8] = [
    ("label, store", Kind::Label, "table.zarr", "out/table.zarr", &[""], input::store),
    ("label, zip", Kind::Label, "table.zarr.zip", "out/table.zarr", &[""], input::zipped),
    ("label, bag", Kind::Label, "table", "out/table", &[""], input::bag),
    (LEROBOT, Kind::Label, "table", "out/table", &[""], |path, _| input::lerobot(path)),
    ("label, video", Kind::Label, "table.mkv", "out/table.zarr", &[""], input::video),
    ("label, images", Kind::Label, "table", "out/table.zarr", &[""], input::images),
    ("label, folder", Kind::Label, "all", "out/all", &["left.zarr", "right.zarr", "table.zarr"], input::several),
    ("import", Kind::Import, "table", "out/table.zarr", &[""], input::h2o),
];

impl Subject {
    /// Writes the inputs of all commands whose name contains one of `only` into `folder`, and returns the commands.
    ///
    /// # Errors
    /// If an input can't be written.
    pub fn all(folder: &Path, only: &[String], seed: u64) -> Result<Vec<Self>> {
        let is_wanted = |name: &str| only.is_empty() || only.iter().any(|part| name.contains(part.as_str()));
        input::checkpoint(&folder.join("model.safetensors"), seed)?;
        let mut subjects = Vec::new();
        for (name, kind, file, out, sets, write) in WITH_INPUT {
            if !is_wanted(name) || name == "label, video" && !input::has_ffmpeg() {
                continue;
            }
            let place = |which: &str| folder.join(name.replace(", ", "-")).join(which);
            for (which, recording) in [("a", 1), ("b", 20)] {
                fs::create_dir_all(place(which)).map_err(Error::io(place(which)))?;
                write(&place(which).join(file), recording)?;
            }
            let input = Some(place("a").join(file));
            let other = (name != LEROBOT).then(|| place("b").join(file));
            subjects.push(Self { name, kind, input, other, out, sets, folder: folder.to_path_buf() });
        }
        let mut add = |name, kind, out, sets| {
            if is_wanted(name) {
                subjects.push(Self { name, kind, input: None, other: None, out, sets, folder: folder.to_path_buf() });
            }
        };
        if cfg!(feature = "sim") {
            add("sim generate", Kind::Generate, "out/set.zarr", &[""] as &[&str]);
        }
        add("train", Kind::Train, "out/run", &[]);
        if cfg!(feature = "sim") {
            add("experiment", Kind::Experiment, "out/experiment", &[]);
        }
        if subjects.iter().any(|subject| subject.kind == Kind::Train) {
            input::store(&folder.join("train.zarr"), 40)?;
        }
        Ok(subjects)
    }

    /// Writes what the command needs in the folder of a case. `rendered` is the data of earlier runs of the experiment.
    ///
    /// # Errors
    /// If it can't be written.
    pub fn prepare(&self, case: &Path, rendered: &Path) -> Result<()> {
        for folder in ["out", "tmp"] {
            fs::create_dir_all(case.join(folder)).map_err(Error::io(case))?;
        }
        if self.kind == Kind::Train {
            let data = self.folder.join("train.zarr").display().to_string();
            let data = serde_json::to_string(&data).map_err(|error| Error::file(&data, error))?;
            let text = format!(
                "name: faults\ndata: [{data}]\nout: {}\nmodel: toy\nseed: 5\nsteps: 12\nsave_every: 4\n\
                 batch: {{ clips: 2, windows: 4 }}\n",
                self.out
            );
            egotac::file::write(&case.join("train.yaml"), text.as_bytes())?;
        }
        if self.kind == Kind::Experiment && rendered.is_dir() {
            copy_folder(rendered, &case.join(self.out).join("work/data"), false)?;
        }
        Ok(())
    }

    /// Returns the arguments of the command.
    pub fn arguments(&self, input: Option<&Path>) -> Vec<OsString> {
        let words = |text: &str| -> Vec<OsString> { text.split(' ').map(OsString::from).collect() };
        match self.kind {
            Kind::Label => {
                let mut arguments = words("label --checkpoint");
                arguments.push(self.folder.join("model.safetensors").into());
                arguments.extend(words(&format!("--out {}", self.out)));
                if self.name == LEROBOT {
                    arguments.extend(["--camera", content::CAMERA].map(OsString::from));
                }
                arguments.extend(input.map(OsString::from));
                arguments
            }
            Kind::Import => {
                let mut arguments = words(&format!("data import h2o --out {}", self.out));
                arguments.extend(input.map(OsString::from));
                arguments
            }
            Kind::Generate => {
                words(&format!("sim generate poke hover --episodes 3 --jobs 2 --seed 3 --size 32 --out {}", self.out))
            }
            Kind::Train => words("train --config train.yaml"),
            Kind::Experiment => {
                words(&format!("experiment sources --quick --work {0}/work --out {0}/tables", self.out))
            }
        }
    }

    /// True if the exit status says that a part of the input has no label.
    pub fn tells_of_parts(&self) -> bool {
        matches!(self.kind, Kind::Label | Kind::Import)
    }

    /// Returns `text` with names of files below `case` or the inputs, without the folders that hold them in one run alone.
    pub fn shortened(&self, text: &str, case: &Path) -> String {
        let folders = [(case, ""), (&self.folder, "inputs/")];
        folders
            .iter()
            .fold(text.to_owned(), |text, (folder, short)| text.replace(&format!("{}/", folder.display()), short))
    }

    /// Returns the arguments with which a user lets the stopped command go on.
    pub fn resume(&self, input: Option<&Path>) -> Vec<OsString> {
        let mut arguments = self.arguments(input);
        if self.kind == Kind::Train {
            arguments.push("--resume".into());
        }
        arguments
    }

    /// True if the output appears when it is complete; otherwise only each of its files does.
    pub fn is_atomic(&self) -> bool {
        matches!(self.kind, Kind::Label | Kind::Import | Kind::Generate) && self.name != "label, folder"
    }
}
