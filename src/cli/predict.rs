//! `egotac predict`.

use std::fs::{self, File};
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::Arc;

use anyhow::{Context, bail};

use super::doubt::Doubt;
use crate::dataset::image_folder::{ImageFolder, image_files, is_image};
use crate::dataset::source::SourceChain;
use crate::dataset::tensors::TensorOutput;
use crate::dataset::zarr::{Store, StoreLocation};
use crate::dataset::{ImageSource, LabelSummary, Provenance, UnlabelledImage};
use crate::label::{FormatOptions, Job, LabelTasks, LabelTiming, Outcome, OutputFormat, Shard, find_tasks};
use crate::model::predictor::Options;
use crate::model::{Precision, Predictor, shipped};
use crate::text::tell;

use super::hands::Hands;

/// Arguments of `egotac predict`.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "The file holds force (T, 1556) in N, contact (T, 1556) as probability, timestamps (T) in s and \
    episode_ends; of a network that judges its images also mask_force, mask_contact (T, 1556), familiarity (T) and presence \
    (T, 2); ready for `egotac eval`. Vertices: left hand 0..777, right hand 778..1555; the metadata's `topology` \
    defines the meaning of an index. `egotac label --to tensors` writes the same arrays for every format."
)]
pub struct Args {
    /// Checkpoint to run; by default the one shipped with egotac.
    #[arg(long, value_name = "FILE|shipped", value_parser = super::options::checkpoint())]
    checkpoint: Option<PathBuf>,
    /// Zarr stores, bags, LeRobot data sets, videos, or folders of these, one behind the other; or PNG and JPEG files or
    /// folders of them, which form one sequence. Files of a folder are taken in natural order: frame_2 before frame_10.
    #[arg(long, value_name = "PATH", num_args = 1.., required = true)]
    data: Vec<PathBuf>,
    /// Frame rate of an image sequence, 1/s; by default one image per observation step of the checkpoint.
    #[arg(long, value_name = "F", value_parser = super::positive)]
    fps: Option<f64>,
    /// Array of a store's images, or key of a LeRobot camera.
    #[arg(long, value_name = "NAME")]
    camera: Option<String>,
    /// Topic of a bag's images; by default the only one.
    #[arg(long)]
    topic: Option<String>,
    /// Field file to write.
    #[arg(long, value_name = "FILE")]
    out: PathBuf,
    /// Index of the CUDA device; by default the CPU.
    #[arg(long, value_name = "INDEX")]
    cuda: Option<usize>,
    /// Number format of the network: f32, bf16 or int8.
    #[arg(long, default_value = "f32")]
    precision: Precision,
    #[command(flatten)]
    doubt: Doubt,
    /// MANO files: the fields are then on MANO's vertices.
    #[command(flatten)]
    hands: Hands,
}

/// Runs the command.
pub fn run(args: Args) -> anyhow::Result<ExitCode> {
    let path = args.checkpoint.map_or_else(shipped::path, Ok)?;
    let options = Options { device: super::device(args.cuda)?, precision: args.precision, ..stream() };
    let mut predictor = Predictor::load(&path, args.doubt.apply(options))?;
    super::progress::tell_network(&path, &predictor);
    if let Some(warning) = predictor.warning() {
        tell(format_args!("warning: {warning}"));
    }
    if let Some(mano) = args.hands.map()? {
        predictor = predictor.with_mano(mano);
    }
    let files = images(&args.data)?;
    let summary = match files.is_empty() {
        true => {
            let options = FormatOptions {
                to: OutputFormat::Tensors,
                frame_dt: predictor.metadata().frame_dt,
                camera: args.camera.clone(),
                topic: args.topic.clone(),
                ..FormatOptions::default()
            };
            predict_recordings(&args.data, &options, &mut predictor, args.precision, &args.out)?
        }
        false => {
            let step = args.fps.map_or(predictor.metadata().frame_dt, |fps| 1.0 / fps);
            let source = Arc::new(ImageFolder::from_files("images".into(), files.clone(), step));
            let name = |fault: &UnlabelledImage| files[fault.frame as usize].display().to_string();
            predict(source, name, &mut predictor, args.precision, &args.out)?
        }
    };
    println!("{}: {} frames", args.out.display(), summary.counts.frames);
    if let Some(warning) = summary.warning() {
        tell(format_args!("warning: {warning}"));
    }
    Ok(ExitCode::SUCCESS)
}

/// Returns the predictor's options for recorded sequences: each episode is one stream, whatever its frame rate.
pub(super) fn stream() -> Options {
    Options { max_gap_secs: Some(f64::MAX), ..Options::default() }
}

/// Predicts touch for all stores that `paths` name, one behind the other. Returns the summary.
pub(super) fn predict_stores(
    paths: &[PathBuf],
    predictor: &mut Predictor,
    precision: Precision,
    out: &Path,
) -> anyhow::Result<LabelSummary> {
    let mut sources = Vec::new();
    for path in paths {
        sources.extend(stores(StoreLocation::find(path)?, None)?);
    }
    predict_sources(sources, predictor, precision, out)
}

/// Predicts touch for all recordings that `paths` name, one behind the other. Returns the summary.
fn predict_recordings(
    paths: &[PathBuf],
    options: &FormatOptions,
    predictor: &mut Predictor,
    precision: Precision,
    out: &Path,
) -> anyhow::Result<LabelSummary> {
    let mut sources = Vec::new();
    for path in paths {
        if let Ok(places) = StoreLocation::find(path) {
            sources.extend(stores(places, options.camera.as_deref())?);
            continue;
        }
        let LabelTasks { tasks, unreadable } = find_tasks(path, out, options)?;
        if let Some((name, error)) = unreadable.into_iter().next() {
            return Err(error).with_context(|| name);
        }
        sources.extend(tasks.into_iter().map(|task| (task.name, task.source)));
    }
    predict_sources(sources, predictor, precision, out)
}

/// Source of images with its name.
type Named = (String, Arc<dyn ImageSource>);

/// Opens stores. Like training and `egotac eval`, their timestamps are taken as seconds.
fn stores(places: Vec<StoreLocation>, camera: Option<&str>) -> anyhow::Result<Vec<Named>> {
    let open = |place: StoreLocation| -> anyhow::Result<Named> {
        Ok((place.name(), Arc::new(Store::open(&place, camera, Some(1.0))?)))
    };
    places.into_iter().map(open).collect()
}

fn predict_sources(
    sources: Vec<Named>,
    predictor: &mut Predictor,
    precision: Precision,
    out: &Path,
) -> anyhow::Result<LabelSummary> {
    let name = |fault: &UnlabelledImage| format!("{}, image {}", fault.unit, fault.frame);
    predict(Arc::new(SourceChain::new(sources)), name, predictor, precision, out)
}

/// Predicts touch for every image of `source` and writes the field file `out`, as `egotac label --to tensors` does, but
/// replaces an existing file, resumes no earlier run, and fails at an image that can't be labelled, which `name` names.
/// Returns the summary.
fn predict(
    source: Arc<dyn ImageSource>,
    name: impl Fn(&UnlabelledImage) -> String,
    predictor: &mut Predictor,
    precision: Precision,
    out: &Path,
) -> anyhow::Result<LabelSummary> {
    let out = out.canonicalize().unwrap_or_else(|_| out.to_path_buf());
    // A pipe or device, such as /dev/stdout, can't be replaced: copy the finished file to it.
    let device = out.metadata().is_ok_and(|there| !there.is_file() && !there.is_dir());
    let folder = match device {
        true => tempfile::tempdir()?,
        false => {
            let parent = out.parent().filter(|parent| !parent.as_os_str().is_empty()).unwrap_or(Path::new("."));
            fs::create_dir_all(parent).with_context(|| parent.display().to_string())?;
            tempfile::Builder::new()
                .prefix(".predict-")
                .tempdir_in(parent)
                .with_context(|| out.display().to_string())?
        }
    };
    let frames: Option<usize> = source.units().iter().map(|unit| unit.frames).sum();
    let bar = super::progress::bar("images");
    bar.set_length(frames.unwrap_or(0) as u64);
    let job = Job {
        source: source.as_ref(),
        output: &TensorOutput { source: source.clone(), with_info: false },
        out: folder.path().join("fields"),
        provenance: Provenance::of(predictor, precision, Vec::new()),
        decoders: 1,
    };
    let all = Shard { index: 0, of: 1 };
    let outcome = job.run(predictor, all, 0, &mut LabelTiming::default(), &mut || bar.inc(1))?;
    bar.finish_and_clear();
    let (Outcome::Done(info) | Outcome::DoneBefore(info)) = outcome else {
        bail!("{}: another process predicts it", out.display());
    };
    if let Some(fault) = info.summary.faults.first() {
        bail!("{}: {}", name(fault), fault.reason);
    }
    let named = || out.display().to_string();
    match device {
        true => {
            let mut to = File::options().write(true).open(&out).with_context(named)?;
            std::io::copy(&mut File::open(&job.out)?, &mut to).with_context(named)?;
        }
        false => fs::rename(&job.out, &out).with_context(named)?,
    }
    Ok(info.summary)
}

/// Returns the image files that `paths` name, the files of a folder in natural order; empty if the paths are stores.
fn images(paths: &[PathBuf]) -> anyhow::Result<Vec<PathBuf>> {
    let mut images = Vec::new();
    let mut others = Vec::new();
    for path in paths {
        let before = images.len();
        if path.is_dir() {
            images.extend(image_files(path)?);
        } else if is_image(path) {
            images.push(path.clone());
        }
        if images.len() == before {
            others.push(path);
        }
    }
    if let (Some(image), Some(other)) = (images.first(), others.first()) {
        bail!("images and others don't mix: {} and {}", image.display(), other.display());
    }
    Ok(images)
}
