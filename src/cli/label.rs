//! `egotac label`.

use std::ffi::OsString;
use std::path::PathBuf;
use std::process::ExitCode;

use clap::Parser;
use serde_json::Value;

use super::doubt::Doubt;
use super::hands::Hands;
use super::label_physics::Physics;
use super::label_views::Kind;
use super::labelling::{Work, shard};
use super::options::Json;
use super::renamed;
use crate::dataset::Provenance;
use crate::dataset::lerobot::{ColumnRole, LabelColumn};
use crate::dataset::mcap::TOPIC;
use crate::error::Result;
use crate::hand::Topology;
use crate::label::{FormatOptions, Job, LabelTask, LabelTasks, LabelTiming, Outcome, OutputFormat, Shard, find_tasks};
use crate::model::predictor::Options;
use crate::model::{Precision, Predictor, shipped};
use crate::text::tell;

/// Largest number of threads that decode images.
const MAX_DECODERS: usize = 256;

/// Arguments of `egotac label`.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "The input is only read. A run that was stopped, even by a kill, resumes when the same command is \
    given again; its labels so far lie in a hidden folder beside the output. The output appears when it is complete.\n\
    Exit status: 0 = every image is labelled, 3 = every readable image is labelled and the others are listed, 1 = error."
)]
pub struct Args {
    /// A Zarr store (folder or zip file), a bag (folder) or an .mcap file, a LeRobot data set, a video, a
    /// folder of images; or a folder of these.
    input: PathBuf,
    /// The labelled data set. Of several inputs, a folder for them and a manifest.json.
    #[arg(long)]
    out: PathBuf,
    /// Format of the output.
    #[arg(long, value_name = "KIND", default_value = "same")]
    to: OutputFormat,
    /// Checkpoint to run; by default the one shipped with egotac.
    #[arg(long, value_name = "FILE|shipped", value_parser = super::options::checkpoint())]
    checkpoint: Option<PathBuf>,
    /// Number format of the network: f32, bf16 or int8.
    #[arg(long, default_value = "f32")]
    precision: Precision,
    /// Index of the CUDA device; by default the CPU.
    #[arg(long, value_name = "INDEX")]
    cuda: Option<usize>,
    /// Array of a store's images, such as camera_main_rgb (by default camera_ego_rgb, else camera_main_rgb), or key of a
    /// LeRobot camera (by default the only one).
    #[arg(long, value_name = "NAME")]
    camera: Option<String>,
    /// Unit of a store's timestamps: s, ms, us or ns; by default estimated from their steps.
    #[arg(long, value_name = "UNIT", value_parser = time_unit)]
    time_unit: Option<f64>,
    /// Topic of a bag's images; by default the only one.
    #[arg(long)]
    topic: Option<String>,
    /// Topic of a bag's labels.
    #[arg(long, value_name = "TOPIC", default_value = TOPIC)]
    labels_topic: String,
    /// Prefix of a LeRobot data set's new columns; policies ignore it.
    #[arg(long, default_value = "tactile", value_parser = prefix)]
    prefix: String,
    /// New columns of a LeRobot data set: region_force, force, contact, total. Their sizes are 34, 1556, 1556 and 2; forces in N.
    /// The default is force, contact and region_force, and region_force alone as an input of policies.
    #[arg(long, value_name = "NAME,..", value_delimiter = ',', hide_possible_values = true)]
    columns: Vec<LabelColumn>,
    /// Role of a LeRobot data set's new columns. Ignored by policies, appended to observation.state, or as
    /// observation.environment_state. An input of policies has 0 where touch is unknown, and ends with two elements: 1 where
    /// touch of the left and of the right hand is known.
    #[arg(long = "as", value_name = "ROLE", default_value = "inert")]
    role: ColumnRole,
    /// Frame rate of a folder of images, 1/s. By default, one image per observation step of the network.
    #[arg(long, value_name = "F", value_parser = super::positive)]
    fps: Option<f64>,
    /// Upper limit of the shorter side of images in a store made from another format, pixels; 0 = original size.
    #[arg(long, value_name = "PIXELS", default_value_t = 224)]
    size: u32,
    /// Shard: label only every N-th episode or file from the I-th (from 0) on. The last shard assembles the output.
    #[arg(long, value_name = "I/N", value_parser = shard, default_value = "0/1")]
    shard: Shard,
    /// Number of threads that decode images beside the network.
    #[arg(long, default_value_t = 1, value_parser = decoders)]
    decoders: usize,
    /// Adds the keypoints of the hands in the images, predicted_keypoints (T, 2, 21, 3): x and y in pixels of the image, and confidence
    /// from 0 to 1; NaN where a hand's touch is unknown. Not for bags.
    #[arg(long)]
    keypoints: bool,
    #[command(flatten)]
    json: Json,
    /// Video of the images with both hands beside them, coloured by force. Of several inputs, a folder for them.
    #[arg(long, value_name = "FILE")]
    video: Option<PathBuf>,
    /// MCAP file that Foxglove shows with the layout launch/foxglove.json: pictures, coloured hands, forces over time; of several
    /// inputs, a folder for them.
    #[arg(long, value_name = "FILE")]
    foxglove: Option<PathBuf>,
    /// File (.rrd) for the viewer Rerun, or the address of one that runs (rerun+http://127.0.0.1:9876/proxy): images, coloured hands,
    /// forces over time; of several inputs, a folder for files. Needs a build with the feature rerun.
    #[arg(long, value_name = "FILE|ADDRESS")]
    rerun: Option<PathBuf>,
    #[command(flatten)]
    physics: Physics,
    #[command(flatten)]
    doubt: Doubt,
    /// MANO files: the fields are then on MANO's vertices.
    #[command(flatten)]
    hands: Hands,
}

/// Runs the command.
pub fn run(args: Args) -> anyhow::Result<ExitCode> {
    if args.physics.physics {
        return args.physics.run(&args.input, &args.out, &args.hands, &args.json);
    }
    label(&args, |work, run| work.run(&args.json, run))
}

/// Runs the command with the arguments behind `egotac label`, prints nothing but warnings, and returns the content of the
/// JSON file of `--json`.
///
/// # Errors
/// If an argument is wrong, the only recording can't be labelled, or none of several.
pub fn summary(arguments: impl IntoIterator<Item = OsString>) -> anyhow::Result<Value> {
    let command = OsString::from("label");
    let arguments: Vec<OsString> = std::iter::once(command).chain(arguments).collect();
    // Of the command line `egotac label`, whose names errors tell.
    let line = std::iter::once(OsString::from("egotac")).chain(arguments.iter().cloned()).collect::<Vec<_>>();
    let Parsed { args } = Parsed::try_parse_from(&arguments).map_err(|error| renamed::explain(error, &line))?;
    anyhow::ensure!(
        !args.physics.physics,
        "--physics: expected a prediction of a network here, got forces from motion: run the command `egotac label`"
    );
    label(&args, |work, run| work.summary(run))
}

/// The arguments as a command of its own.
#[derive(clap::Parser)]
#[command(name = "label")]
struct Parsed {
    #[command(flatten)]
    args: Args,
}

/// Runs a job with the number of its first unit, the times to add to, and a function to call after each image.
type RunJob<'a> = &'a mut dyn FnMut(usize, usize, &mut LabelTiming, &mut dyn FnMut()) -> Result<Outcome>;

/// Finds the recordings and hands their jobs to `finish`.
fn label<T>(args: &Args, finish: impl FnOnce(&Work, RunJob) -> anyhow::Result<T>) -> anyhow::Result<T> {
    if let Some(option) = args.physics.bodies.given() {
        anyhow::bail!("{option}: expected together with --physics, which estimates forces from the motion of objects");
    }
    let path = args.checkpoint.clone().map_or_else(shipped::path, Ok)?;
    let options = Options { device: super::device(args.cuda)?, precision: args.precision, ..Default::default() };
    let mut predictor = Predictor::load(&path, args.doubt.apply(options))?;
    super::progress::tell_network(&path, &predictor);
    if let Some(warning) = predictor.warning() {
        tell(format_args!("warning: {warning}"));
    }
    if args.keypoints && !predictor.estimates_presence() {
        anyhow::bail!(
            "--keypoints: expected a network that estimates keypoints, got {}; `egotac model presence` adds that to a checkpoint",
            path.display()
        );
    }
    if let Some(mano) = args.hands.map()? {
        predictor = predictor.with_mano(mano);
    }
    let options = FormatOptions {
        to: args.to,
        fps: args.fps,
        frame_dt: predictor.metadata().frame_dt,
        side: (args.size > 0).then_some(args.size),
        prefix: Some(args.prefix.clone()),
        columns: args.columns.clone(),
        role: args.role,
        camera: args.camera.clone(),
        time_unit: args.time_unit,
        topic: args.topic.clone(),
        labels_topic: Some(args.labels_topic.clone()),
        mano_regions: predictor.mano().map(|mano| mano.regions(Topology::Mano)),
    };
    let LabelTasks { tasks, unreadable } = find_tasks(&args.input, &args.out, &options)?;
    let views = [(Kind::Video, &args.video), (Kind::Foxglove, &args.foxglove), (Kind::Rerun, &args.rerun)];
    let views = views.into_iter().filter_map(|(kind, path)| Some((kind, kind.paths(path.as_ref()?, &tasks))));
    let views = views.map(|(kind, paths)| Ok((kind, paths?))).collect::<anyhow::Result<Vec<_>>>()?;
    let jobs: Vec<Job> = tasks.iter().map(|task| job(task, &predictor, args)).collect();
    let work = Work { input: &args.input, out: &args.out, tasks: &tasks, jobs: &jobs, unreadable: &unreadable };
    let done = finish(&work, &mut |index, number, timing, progress| {
        jobs[index].run(&mut predictor, args.shard, number, timing, progress)
    })?;
    views.into_iter().try_for_each(|(kind, paths)| kind.write_all(&paths, &tasks, &args.hands))?;
    Ok(done)
}

fn job<'a>(task: &'a LabelTask, predictor: &Predictor, args: &Args) -> Job<'a> {
    Job {
        source: task.source.as_ref(),
        output: task.output.as_ref(),
        out: task.out.clone(),
        provenance: Provenance {
            keypoints: args.keypoints,
            ..Provenance::of(predictor, args.precision, task.description.clone())
        },
        decoders: args.decoders,
    }
}

/// Parses a prefix that policies ignore.
fn prefix(text: &str) -> std::result::Result<String, String> {
    match ["observation", "action"].iter().find(|word| text.starts_with(*word)) {
        Some(word) => Err(format!(
            "policies take or refuse names that begin with {word:?}: choose another, and --as for an input"
        )),
        None => Ok(text.to_string()),
    }
}

fn time_unit(text: &str) -> std::result::Result<f64, String> {
    match text {
        "s" => Ok(1.0),
        "ms" => Ok(1e-3),
        "us" => Ok(1e-6),
        "ns" => Ok(1e-9),
        _ => Err("expected s, ms, us or ns".into()),
    }
}

fn decoders(text: &str) -> std::result::Result<usize, String> {
    match text.parse() {
        Ok(number) if (1..=MAX_DECODERS).contains(&number) => Ok(number),
        _ => Err(format!("expected 1 to {MAX_DECODERS}")),
    }
}
