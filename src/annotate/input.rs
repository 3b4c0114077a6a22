//! What lies at a path, and what becomes of it.

use std::fs;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use super::bag::{self, Bag};
use super::job::is_within;
use super::output::Output;
use super::source::Source;
use super::store::{self, Store};
use super::summary::About;
use crate::dataset::zarr::Place;
use crate::error::{Error, Result};

/// A format of recordings.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    /// A Zarr store in a folder, or stores in a zip file.
    Store,
    /// A bag's folder or an MCAP file.
    Bag,
}

/// What the formats leave open.
#[derive(Debug, Clone, Default)]
pub struct Choices {
    /// Array of a store's images.
    pub camera: Option<String>,
    /// What one unit of a store's time stamps is, s.
    pub time_unit: Option<f64>,
    /// Topic of a bag's images.
    pub topic: Option<String>,
    /// Topic for a bag's labels.
    pub labels_topic: Option<String>,
}

/// One recording, and where its labelled form goes.
#[derive(Clone)]
pub struct Item {
    /// The recording's name.
    pub name: String,
    /// Its images.
    pub source: Arc<dyn Source>,
    /// What is made of the labels.
    pub output: Arc<dyn Output>,
    /// Where that goes.
    pub out: PathBuf,
    /// The input's name, and the choices that decide which images are read and how.
    pub about: Vec<String>,
}

impl Kind {
    /// What lies at `path`; None = nothing that can be labelled.
    pub fn of(path: &Path) -> Option<Self> {
        if path.is_dir() {
            let has = |name: &str| path.join(name).is_file();
            return if has(".zgroup") || has("zarr.json") {
                Some(Self::Store)
            } else if has("metadata.yaml") {
                Some(Self::Bag)
            } else {
                None
            };
        }
        let extension = path.extension()?.to_string_lossy().to_lowercase();
        match extension.as_str() {
            "zip" => Some(Self::Store),
            "mcap" => Some(Self::Bag),
            _ => None,
        }
    }

    /// What the data set at `path` says about labels of ours in it; None = there are none.
    pub fn about(self, path: &Path) -> Option<About> {
        match self {
            Self::Store => store::about(path),
            Self::Bag => bag::about(path),
        }
    }
}

/// The recordings that `input` is or holds, by name, with their outputs at or below `out`.
///
/// # Errors
/// If there is none, one can't be opened, or `out` lies within `input`.
pub fn items(input: &Path, out: &Path, choices: &Choices) -> Result<Vec<Item>> {
    if !input.exists() {
        return Err(Error::file(input, "does not exist"));
    }
    if is_within(out, input) {
        return Err(Error::file(out, format!("lies in the input {}, which is never written to", input.display())));
    }
    if let Some(kind) = Kind::of(input) {
        return open(kind, input, out, choices);
    }
    let mut paths = Vec::new();
    if input.is_dir() {
        for entry in fs::read_dir(input).map_err(Error::io(input))? {
            let path = entry.map_err(Error::io(input))?.path();
            let hidden = path.file_name().is_some_and(|name| name.to_string_lossy().starts_with('.'));
            if let (false, Some(kind)) = (hidden, Kind::of(&path)) {
                paths.push((path, kind));
            }
        }
    }
    paths.sort_by(|a, b| a.0.cmp(&b.0));
    if paths.is_empty() {
        return Err(Error::file(input, "holds nothing to label: no Zarr store (folder or zip) and no bag or .mcap file"));
    }
    let mut items = Vec::new();
    for (path, kind) in paths {
        items.extend(open(kind, &path, &out.join(output_name(&path)), choices)?);
    }
    if let Some(pair) = items.windows(2).find(|pair| pair[0].out == pair[1].out) {
        return Err(Error::file(&pair[1].out, "would be the output of two inputs"));
    }
    Ok(items)
}

/// Name of the output for one of several inputs: its own, without `.zip`.
fn output_name(path: &Path) -> String {
    let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
    match name.strip_suffix(".zip") {
        Some(stem) if stem.ends_with(".zarr") => stem.to_string(),
        Some(stem) => format!("{stem}.zarr"),
        None => name,
    }
}

fn open(kind: Kind, path: &Path, out: &Path, choices: &Choices) -> Result<Vec<Item>> {
    match kind {
        Kind::Store => {
            let places = if path.is_dir() { vec![Place::only(path)?] } else { Place::find(path)? };
            let several = places.len() > 1;
            let item = |place: Place| {
                let store = Arc::new(Store::open(&place, choices.camera.as_deref(), choices.time_unit)?);
                let about = vec![
                    format!("store {}", place.name()),
                    format!("images {}", store.camera()),
                    format!("time unit {} s", store.time_unit()),
                ];
                let out = if several { out.join(place.name()) } else { out.to_path_buf() };
                Ok(Item { name: place.name(), source: store.clone(), output: store, out, about })
            };
            places.into_iter().map(item).collect()
        }
        Kind::Bag => {
            let labels_topic = choices.labels_topic.as_deref().unwrap_or(bag::TOPIC);
            let bag = Arc::new(Bag::open(path, choices.topic.as_deref(), labels_topic)?);
            let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
            let mut about = vec![format!("bag {name}"), format!("images {}", bag.topic()), format!("labels {labels_topic}")];
            for file in bag.files() {
                let bytes = file.metadata().map_err(Error::io(file))?.len();
                about.push(format!("{}, {bytes} bytes", file.file_name().unwrap_or_default().to_string_lossy()));
            }
            Ok(vec![Item { name, source: bag.clone(), output: bag, out: out.to_path_buf(), about }])
        }
    }
}

impl std::fmt::Debug for Item {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Item").field("name", &self.name).field("out", &self.out).finish_non_exhaustive()
    }
}
