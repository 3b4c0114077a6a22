//! Recordings at a path, and the outputs that their labels go to.

use std::fs;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use super::job::is_within;
use crate::dataset::image_folder::ImageFolder;
use crate::dataset::lerobot::{self, ColumnRole, LabelColumn, LeRobotDataset};
use crate::dataset::mcap::{Bag, BagOutput, TOPIC};
use crate::dataset::tensors::TensorOutput;
use crate::dataset::video::VideoFile;
use crate::dataset::zarr::{Store, StoreLocation, StoreOutput};
use crate::dataset::{Format, ImageSource, LabelOutput, base_name};
use crate::error::{Error, Result};
use crate::hand::Region;

/// Format of the output.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, clap::ValueEnum)]
pub enum OutputFormat {
    /// The input's own format; a store for videos and images, which can't hold labels.
    #[default]
    Same,
    /// An OXT Zarr store.
    Store,
    /// A rosbag2 folder.
    Bag,
    /// A safetensors file with the labels alone.
    Tensors,
}

/// Options for reading and writing the formats.
#[derive(Debug, Clone, Default)]
pub struct FormatOptions {
    /// Format of the output.
    pub to: OutputFormat,
    /// Frame rate of a folder of images, 1/s; None = one image per observation step of the network, `frame_dt`.
    pub fps: Option<f64>,
    /// Observation step of the network, s.
    pub frame_dt: f64,
    /// Upper limit of the shorter side of images in a store made from another format, pixels; None = original size.
    pub side: Option<u32>,
    /// Prefix of the new columns of a LeRobot data set.
    pub prefix: Option<String>,
    /// New columns of a LeRobot data set; empty = those that are usual for their role.
    pub columns: Vec<LabelColumn>,
    /// Role of the new columns for policies.
    pub role: ColumnRole,
    /// Array of a store's images, or key of a LeRobot camera.
    pub camera: Option<String>,
    /// Unit of a store's timestamps, s.
    pub time_unit: Option<f64>,
    /// Topic of a bag's images.
    pub topic: Option<String>,
    /// Topic of a bag's labels.
    pub labels_topic: Option<String>,
    /// Regions of MANO's vertices, left hand first, for the region forces of a LeRobot data set; None = unknown.
    pub mano_regions: Option<[Vec<Region>; 2]>,
}

/// One recording to label, and its output.
#[derive(Clone)]
pub struct LabelTask {
    /// Name of the recording.
    pub name: String,
    /// Its images.
    pub source: Arc<dyn ImageSource>,
    /// Writer of the output.
    pub output: Arc<dyn LabelOutput>,
    /// Path of the output.
    pub out: PathBuf,
    /// The input's name, and the choices that decide which images are read and how; part of the provenance.
    pub description: Vec<String>,
}

/// Recordings found at a path.
#[derive(Debug, Default)]
pub struct LabelTasks {
    /// One task per recording, by name.
    pub tasks: Vec<LabelTask>,
    /// Names of recordings that can't be opened, and the reasons.
    pub unreadable: Vec<(String, Error)>,
}

/// Finds the recordings that `input` is or holds, with their outputs at or below `out`. Of several recordings, those that
/// can't be opened are listed and do not stop the others.
///
/// # Errors
/// If there is none, the only one can't be opened, or `out` lies within `input`.
pub fn find_tasks(input: &Path, out: &Path, options: &FormatOptions) -> Result<LabelTasks> {
    if !input.exists() {
        return Err(Error::file(input, "does not exist"));
    }
    if is_within(out, input) {
        return Err(Error::file(out, format!("lies in the input {}, which is never written to", input.display())));
    }
    if let Some(format) = Format::of(input) {
        let opened = open(format, input, out, options)?;
        if let [_] = opened[..] {
            let tasks = opened.into_iter().map(|(_, task)| task).collect::<Result<_>>()?;
            return Ok(LabelTasks { tasks, ..LabelTasks::default() });
        }
        return sorted_out(opened);
    }
    let mut opened = Vec::new();
    for (path, format) in recordings_in(input)? {
        match open(format, &path, &out.join(output_name(&path, format, options.to)), options) {
            Ok(of_path) => opened.extend(of_path),
            Err(error) => opened.push((base_name(&path), Err(error))),
        }
    }
    sorted_out(opened)
}

/// Returns the recordings directly in the folder `input`, by name.
fn recordings_in(input: &Path) -> Result<Vec<(PathBuf, Format)>> {
    let mut paths = Vec::new();
    if input.is_dir() {
        for entry in fs::read_dir(input).map_err(Error::io(input))? {
            let path = entry.map_err(Error::io(input))?.path();
            let hidden = base_name(&path).starts_with('.');
            let format = Format::of(&path).filter(|format| *format != Format::Tensors);
            if let (false, Some(format)) = (hidden, format) {
                paths.push((path, format));
            }
        }
    }
    paths.sort_by(|a, b| a.0.cmp(&b.0));
    if paths.is_empty() {
        let message =
            "holds nothing to label: no Zarr store (folder or zip), bag, .mcap file, LeRobot data set, video or images";
        return Err(Error::file(input, message));
    }
    Ok(paths)
}

/// Separates readable from unreadable recordings, and checks that no two have the same output.
fn sorted_out(opened: Vec<(String, Result<LabelTask>)>) -> Result<LabelTasks> {
    let mut found = LabelTasks::default();
    for (name, task) in opened {
        match task {
            Ok(task) => found.tasks.push(task),
            Err(error) => found.unreadable.push((name, error)),
        }
    }
    let mut outs: Vec<&PathBuf> = found.tasks.iter().map(|task| &task.out).collect();
    outs.sort();
    match outs.windows(2).find(|pair| pair[0] == pair[1]) {
        Some(pair) => Err(Error::file(pair[0], "would be the output of two inputs")),
        None => Ok(found),
    }
}

/// Returns the name of the output of one of several inputs: the input's name, or with the extension of its format.
fn output_name(path: &Path, format: Format, to: OutputFormat) -> String {
    let name = base_name(path);
    let extension = match (format, to) {
        (Format::Bag | Format::LeRobot, OutputFormat::Same) => return name,
        (_, OutputFormat::Same | OutputFormat::Store) => "zarr",
        (_, OutputFormat::Tensors) => "safetensors",
        (_, OutputFormat::Bag) => "",
    };
    let stem = if path.is_dir() && format != Format::Store { &name } else { stem(&name) };
    // A zip file may be called NAME.zarr.zip.
    let stem = stem.strip_suffix(".zarr").unwrap_or(stem);
    if extension.is_empty() { stem.to_string() } else { format!("{stem}.{extension}") }
}

fn stem(name: &str) -> &str {
    name.rsplit_once('.').map_or(name, |(stem, _)| stem)
}

/// Returns the output for labels of `source` in another format; None for the source's own format.
fn converted(source: &Arc<dyn ImageSource>, options: &FormatOptions) -> Option<Arc<dyn LabelOutput>> {
    let source = Arc::clone(source);
    match options.to {
        OutputFormat::Same => None,
        OutputFormat::Store => Some(Arc::new(StoreOutput { source, side: options.side })),
        OutputFormat::Tensors => Some(Arc::new(TensorOutput { source, with_info: true })),
        OutputFormat::Bag => {
            let labels_topic = options.labels_topic.clone().unwrap_or_else(|| TOPIC.into());
            Some(Arc::new(BagOutput { source, labels_topic }))
        }
    }
}

/// Opens the recordings at `path`, by name; a zip file may hold several stores. The inner errors are those of single
/// stores.
fn open(format: Format, path: &Path, out: &Path, options: &FormatOptions) -> Result<Vec<(String, Result<LabelTask>)>> {
    let task = match format {
        Format::Store => return open_stores(path, out, options),
        Format::Bag => open_bag(path, out, options)?,
        Format::LeRobot => open_lerobot(path, out, options)?,
        Format::Video | Format::Images => open_plain(format, path, out, options)?,
        Format::Tensors => return Err(Error::file(path, "holds labels, not images")),
    };
    Ok(vec![(task.name.clone(), Ok(task))])
}

fn open_stores(path: &Path, out: &Path, options: &FormatOptions) -> Result<Vec<(String, Result<LabelTask>)>> {
    let places = if path.is_dir() { vec![StoreLocation::only(path)?] } else { StoreLocation::find(path)? };
    let several = places.len() > 1;
    // Several stores go into a folder, which must not look like a store itself.
    let folder = if out.extension().is_some_and(|e| e == "zarr") { out.with_extension("") } else { out.into() };
    let task = |place: StoreLocation| -> Result<LabelTask> {
        let store = Arc::new(Store::open(&place, options.camera.as_deref(), options.time_unit)?);
        let description = vec![
            format!("store {}", place.name()),
            format!("images {}", store.camera()),
            format!("time unit {} s", store.time_unit()),
        ];
        let out = match several {
            true => folder.join(output_name(Path::new(&place.name()), Format::Store, options.to)),
            false => out.to_path_buf(),
        };
        let source: Arc<dyn ImageSource> = store.clone();
        let output = converted(&source, options).unwrap_or(store);
        Ok(LabelTask { name: place.name(), source, output, out, description })
    };
    Ok(places.into_iter().map(|place| (place.name(), task(place))).collect())
}

fn open_bag(path: &Path, out: &Path, options: &FormatOptions) -> Result<LabelTask> {
    let labels_topic = options.labels_topic.as_deref().unwrap_or(TOPIC);
    let bag = Arc::new(Bag::open(path, options.topic.as_deref(), labels_topic)?);
    let name = base_name(path);
    let mut description =
        vec![format!("bag {name}"), format!("images {}", bag.topic()), format!("labels {labels_topic}")];
    for file in bag.files() {
        let bytes = file.metadata().map_err(Error::io(file))?.len();
        description.push(format!("{}, {bytes} bytes", base_name(file)));
    }
    let source: Arc<dyn ImageSource> = bag.clone();
    let output = converted(&source, options).unwrap_or(bag);
    Ok(LabelTask { name, source, output, out: out.to_path_buf(), description })
}

fn open_lerobot(path: &Path, out: &Path, options: &FormatOptions) -> Result<LabelTask> {
    let prefix = options.prefix.as_deref().unwrap_or(lerobot::PREFIX);
    let dataset = LeRobotDataset::open(path, options.camera.as_deref(), prefix)?;
    let dataset = dataset.with_columns(&options.columns, options.role)?;
    let dataset = Arc::new(dataset.with_mano_regions(options.mano_regions.clone()));
    let name = base_name(path);
    let description = vec![
        format!("LeRobot data set {name}"),
        format!("images {}", dataset.camera()),
        format!("columns {}", dataset.columns_text()),
    ];
    let source: Arc<dyn ImageSource> = dataset.clone();
    let output = converted(&source, options).unwrap_or(dataset);
    Ok(LabelTask { name, source, output, out: out.to_path_buf(), description })
}

/// Opens a format that can't hold labels: a video or a folder of images.
fn open_plain(format: Format, path: &Path, out: &Path, options: &FormatOptions) -> Result<LabelTask> {
    let name = base_name(path);
    let (source, description): (Arc<dyn ImageSource>, Vec<String>) = match format {
        Format::Video => {
            let bytes = path.metadata().map_err(Error::io(path))?.len();
            (Arc::new(VideoFile::open(path)?), vec![format!("video {name}, {bytes} bytes")])
        }
        _ => {
            let step = options.fps.map_or(options.frame_dt, |fps| 1.0 / fps);
            (Arc::new(ImageFolder::open(path, step)?), vec![format!("images {name}"), format!("{step} s apart")])
        }
    };
    let to = if options.to == OutputFormat::Same { OutputFormat::Store } else { options.to };
    let output = converted(&source, &FormatOptions { to, ..options.clone() });
    let output = output.ok_or_else(|| Error::file(path, "can't hold labels"))?;
    Ok(LabelTask { name, source, output, out: out.to_path_buf(), description })
}

impl std::fmt::Debug for LabelTask {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("LabelTask").field("name", &self.name).field("out", &self.out).finish_non_exhaustive()
    }
}
