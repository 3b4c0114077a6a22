//! What lies at a path, and what becomes of it.

use std::fs;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use super::bag::{self, Bag};
use super::images::{Images, image_files};
use super::job::is_within;
use super::lerobot::{self, LeRobotDataset};
use super::output::Output;
use super::source::Source;
use super::store::{self, Store};
use super::summary::About;
use super::to_bag::ToBag;
use super::to_store::ToStore;
use super::to_tensors::{self, ToTensors};
use super::video::VideoFile;
use crate::dataset::video::EXTENSIONS;
use crate::dataset::zarr::Place;
use crate::error::{Error, Result};

/// A format of recordings.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    /// A Zarr store in a folder, or stores in a zip file.
    Store,
    /// A bag's folder or an MCAP file.
    Bag,
    /// A LeRobot data set of version 3.
    LeRobot,
    /// A video file.
    Video,
    /// A folder of PNG and JPEG files.
    Images,
    /// A safetensors file: what labels alone are written to.
    Tensors,
}

/// Kind of output.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, clap::ValueEnum)]
pub enum Target {
    /// The input's own kind; a store for videos and images, which can't hold labels.
    #[default]
    Same,
    /// An OXT Zarr store.
    Store,
    /// A rosbag2 folder.
    Bag,
    /// A safetensors file with the labels alone.
    Tensors,
}

/// What the formats leave open.
#[derive(Debug, Clone, Default)]
pub struct Choices {
    /// Kind of output.
    pub to: Target,
    /// Images per second of a folder of images; None = one per observation step of the network, `frame_dt`.
    pub fps: Option<f64>,
    /// The network's observation step, s.
    pub frame_dt: f64,
    /// Shorter side that images have in a store made from other formats at most, pixels; None = as they are.
    pub side: Option<u32>,
    /// Prefix of a LeRobot data set's new columns.
    pub prefix: Option<String>,
    /// Array of a store's images, or key of a LeRobot camera.
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
            } else if has("meta/info.json") {
                Some(Self::LeRobot)
            } else {
                image_files(path).is_ok_and(|files| !files.is_empty()).then_some(Self::Images)
            };
        }
        let extension = path.extension()?.to_string_lossy().to_lowercase();
        match extension.as_str() {
            "zip" => Some(Self::Store),
            "mcap" => Some(Self::Bag),
            "safetensors" => Some(Self::Tensors),
            video if EXTENSIONS.contains(&video) => Some(Self::Video),
            _ => None,
        }
    }

    /// What the data set at `path` says about labels of ours in it; None = there are none.
    pub fn about(self, path: &Path) -> Option<About> {
        match self {
            Self::Store => store::about(path),
            Self::Bag => bag::about(path),
            Self::LeRobot => lerobot::about(path),
            Self::Tensors => to_tensors::about(path),
            Self::Video | Self::Images => None,
        }
    }
}

/// What an input holds.
#[derive(Debug, Default)]
pub struct Found {
    /// Recordings, by name.
    pub items: Vec<Item>,
    /// Names of those that can't be opened, and why.
    pub unreadable: Vec<(String, Error)>,
}

/// The recordings that `input` is or holds, with their outputs at or below `out`. Of several, those that can't be opened
/// don't stand in the way of the others.
///
/// # Errors
/// If there is none, the only one can't be opened, or `out` lies within `input`.
pub fn items(input: &Path, out: &Path, choices: &Choices) -> Result<Found> {
    if !input.exists() {
        return Err(Error::file(input, "does not exist"));
    }
    if is_within(out, input) {
        return Err(Error::file(out, format!("lies in the input {}, which is never written to", input.display())));
    }
    if let Some(kind) = Kind::of(input) {
        let opened = open(kind, input, out, choices)?;
        if let [_] = opened[..] {
            let items = opened.into_iter().map(|(_, item)| item).collect::<Result<_>>()?;
            return Ok(Found { items, ..Found::default() });
        }
        return sorted_out(opened);
    }
    let mut paths = Vec::new();
    if input.is_dir() {
        for entry in fs::read_dir(input).map_err(Error::io(input))? {
            let path = entry.map_err(Error::io(input))?.path();
            let hidden = path.file_name().is_some_and(|name| name.to_string_lossy().starts_with('.'));
            let kind = Kind::of(&path).filter(|kind| *kind != Kind::Tensors);
            if let (false, Some(kind)) = (hidden, kind) {
                paths.push((path, kind));
            }
        }
    }
    paths.sort_by(|a, b| a.0.cmp(&b.0));
    if paths.is_empty() {
        let message =
            "holds nothing to label: no Zarr store (folder or zip), bag, .mcap file, LeRobot data set, video or images";
        return Err(Error::file(input, message));
    }
    let mut opened = Vec::new();
    for (path, kind) in paths {
        match open(kind, &path, &out.join(output_name(&path, kind, choices.to)), choices) {
            Ok(of_path) => opened.extend(of_path),
            Err(error) => {
                opened.push((path.file_name().unwrap_or_default().to_string_lossy().into_owned(), Err(error)))
            }
        }
    }
    sorted_out(opened)
}

fn sorted_out(opened: Vec<(String, Result<Item>)>) -> Result<Found> {
    let mut found = Found::default();
    for (name, item) in opened {
        match item {
            Ok(item) => found.items.push(item),
            Err(error) => found.unreadable.push((name, error)),
        }
    }
    let mut outs: Vec<&PathBuf> = found.items.iter().map(|item| &item.out).collect();
    outs.sort();
    match outs.windows(2).find(|pair| pair[0] == pair[1]) {
        Some(pair) => Err(Error::file(pair[0], "would be the output of two inputs")),
        None => Ok(found),
    }
}

/// The images of the labelled data set at `path`, in the order of its labels; None where it has none, or they can't be
/// found.
pub fn images_of(path: &Path, about: Option<&About>) -> Option<Arc<dyn Source>> {
    let noted =
        |what: &str| about?.provenance.source.iter().find_map(|line| line.strip_prefix(what).map(str::to_string));
    let camera = noted("images ");
    match Kind::of(path)? {
        Kind::Store => {
            let place = Place::only(path).ok()?;
            let named = Store::open(&place, camera.as_deref(), None);
            // A store made from another format has its images under the usual name.
            Some(Arc::new(named.or_else(|_| Store::open(&place, None, None)).ok()?))
        }
        Kind::Bag => {
            let named = Bag::open(path, camera.as_deref(), "");
            Some(Arc::new(named.or_else(|_| Bag::open(path, None, "")).ok()?))
        }
        Kind::LeRobot => {
            let named = LeRobotDataset::open(path, camera.as_deref(), "images only");
            Some(Arc::new(named.or_else(|_| LeRobotDataset::open(path, None, "images only")).ok()?))
        }
        Kind::Video | Kind::Images | Kind::Tensors => None,
    }
}

/// Name of the output for one of several inputs: its own, or with its kind's extension.
fn output_name(path: &Path, kind: Kind, to: Target) -> String {
    let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
    let extension = match (kind, to) {
        (Kind::Bag | Kind::LeRobot, Target::Same) => return name,
        (_, Target::Same | Target::Store) => "zarr",
        (_, Target::Tensors) => "safetensors",
        (_, Target::Bag) => "",
    };
    let stem = if path.is_dir() && kind != Kind::Store { &name } else { stem(&name) };
    // A zip file may be called NAME.zarr.zip.
    let stem = stem.strip_suffix(".zarr").unwrap_or(stem);
    if extension.is_empty() { stem.to_string() } else { format!("{stem}.{extension}") }
}

fn stem(name: &str) -> &str {
    name.rsplit_once('.').map_or(name, |(stem, _)| stem)
}

/// Where the labels of `source` go if not into its own kind of data set.
fn converted(source: &Arc<dyn Source>, choices: &Choices) -> Option<Arc<dyn Output>> {
    let source = Arc::clone(source);
    match choices.to {
        Target::Same => None,
        Target::Store => Some(Arc::new(ToStore { source, side: choices.side })),
        Target::Tensors => Some(Arc::new(ToTensors { source })),
        Target::Bag => {
            let labels_topic = choices.labels_topic.clone().unwrap_or_else(|| bag::TOPIC.into());
            Some(Arc::new(ToBag { source, labels_topic }))
        }
    }
}

/// The recordings that `path` is or, as a zip file of several stores, holds, by name; why one of several can't be opened.
fn open(kind: Kind, path: &Path, out: &Path, choices: &Choices) -> Result<Vec<(String, Result<Item>)>> {
    match kind {
        Kind::Store => {
            let places = if path.is_dir() { vec![Place::only(path)?] } else { Place::find(path)? };
            let several = places.len() > 1;
            // The folder of several stores is none itself.
            let folder = if out.extension().is_some_and(|e| e == "zarr") { out.with_extension("") } else { out.into() };
            let item = |place: Place| -> Result<Item> {
                let store = Arc::new(Store::open(&place, choices.camera.as_deref(), choices.time_unit)?);
                let about = vec![
                    format!("store {}", place.name()),
                    format!("images {}", store.camera()),
                    format!("time unit {} s", store.time_unit()),
                ];
                let out = match several {
                    true => folder.join(output_name(Path::new(&place.name()), kind, choices.to)),
                    false => out.to_path_buf(),
                };
                let source: Arc<dyn Source> = store.clone();
                let output = converted(&source, choices).unwrap_or(store);
                Ok(Item { name: place.name(), source, output, out, about })
            };
            Ok(places.into_iter().map(|place| (place.name(), item(place))).collect())
        }
        Kind::Bag => {
            let labels_topic = choices.labels_topic.as_deref().unwrap_or(bag::TOPIC);
            let bag = Arc::new(Bag::open(path, choices.topic.as_deref(), labels_topic)?);
            let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
            let mut about =
                vec![format!("bag {name}"), format!("images {}", bag.topic()), format!("labels {labels_topic}")];
            for file in bag.files() {
                let bytes = file.metadata().map_err(Error::io(file))?.len();
                about.push(format!("{}, {bytes} bytes", file.file_name().unwrap_or_default().to_string_lossy()));
            }
            let source: Arc<dyn Source> = bag.clone();
            let output = converted(&source, choices).unwrap_or(bag);
            Ok(vec![(name.clone(), Ok(Item { name, source, output, out: out.to_path_buf(), about }))])
        }
        Kind::LeRobot => {
            let prefix = choices.prefix.as_deref().unwrap_or(lerobot::PREFIX);
            let dataset = Arc::new(LeRobotDataset::open(path, choices.camera.as_deref(), prefix)?);
            let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
            let about = vec![
                format!("LeRobot data set {name}"),
                format!("images {}", dataset.camera()),
                format!("columns {}", dataset.prefix()),
            ];
            let source: Arc<dyn Source> = dataset.clone();
            let output = converted(&source, choices).unwrap_or(dataset);
            Ok(vec![(name.clone(), Ok(Item { name, source, output, out: out.to_path_buf(), about }))])
        }
        Kind::Video | Kind::Images => {
            let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
            let (source, about): (Arc<dyn Source>, Vec<String>) = match kind {
                Kind::Video => {
                    let bytes = path.metadata().map_err(Error::io(path))?.len();
                    (Arc::new(VideoFile::open(path)?), vec![format!("video {name}, {bytes} bytes")])
                }
                _ => {
                    let step = choices.fps.map_or(choices.frame_dt, |fps| 1.0 / fps);
                    (Arc::new(Images::open(path, step)?), vec![format!("images {name}"), format!("{step} s apart")])
                }
            };
            let to = if choices.to == Target::Same { Target::Store } else { choices.to };
            let output = converted(&source, &Choices { to, ..choices.clone() });
            let output = output.ok_or_else(|| Error::file(path, "can't hold labels"))?;
            Ok(vec![(name.clone(), Ok(Item { name, source, output, out: out.to_path_buf(), about }))])
        }
        Kind::Tensors => Err(Error::file(path, "holds labels, not images")),
    }
}

impl std::fmt::Debug for Item {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Item").field("name", &self.name).field("out", &self.out).finish_non_exhaustive()
    }
}
