//! `egotac bench model`.

use std::path::{Path, PathBuf};

use anyhow::{Context as _, bail, ensure};
use candle_nn::VarMap;
use egotac::cli::progress;
use egotac::dataset::zarr;
use egotac::file;
use egotac::machine::Machine;
use egotac::model::predictor::Options;
use egotac::model::{Checkpoint, Config, EgoTac, Metadata, Precision, Predictor, init, shipped};

use crate::cli::output::Output;
use crate::model::{Plan, Setup, estimates, growth, measure, pareto, sweep, table};

/// Largest allowed growth of a stream's memory, MB.
const GROWTH_MB: f64 = 8.0;

/// Largest share of an image's time that the estimates may cost.
const MAX_SHARE: f64 = 0.03;

/// Arguments of `egotac bench model`.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Without --out one configuration is timed in this process. With it every combination of the lists is, each in a \
    process of its own, and model.md, model.json, model.png and model.svg are written.\n\
    Weights are random, unless --checkpoint names trained ones; with --data these are scored as well."
)]
pub struct Args {
    /// Presets, comma separated: toy, pocket, tiny, small, base.
    #[arg(long, value_delimiter = ',', default_value = "tiny")]
    preset: Vec<String>,
    /// For this preset also vary horizon, input size and threads, one at a time.
    #[arg(long, value_name = "PRESET", requires = "out")]
    vary: Option<String>,
    /// Observation horizons, comma separated; the preset's own without it.
    #[arg(long, value_delimiter = ',')]
    horizon: Vec<usize>,
    /// Sides of the input image in pixels, comma separated; the preset's own without it.
    #[arg(long, value_name = "PIXELS,..", value_delimiter = ',')]
    size: Vec<usize>,
    /// Number formats, comma separated: f32, bf16, int8.
    #[arg(long, value_delimiter = ',', default_value = "f32")]
    precision: Vec<Precision>,
    /// Threads, comma separated.
    #[arg(long, value_delimiter = ',', default_value = "2")]
    threads: Vec<usize>,
    /// Timed runs of each kind.
    #[arg(long, default_value_t = 20, value_parser = clap::value_parser!(u64).range(1..=1_000_000))]
    runs: u64,
    /// Clips of a batch whose throughput is timed as well.
    #[arg(long, default_value_t = 1, value_parser = clap::value_parser!(u64).range(1..=4096))]
    batch: u64,
    /// Checkpoint with trained weights; `shipped` is the one that comes with egotac. Takes its own geometry.
    #[arg(long, value_name = "FILE|shipped", value_parser = egotac::cli::options::checkpoint(), num_args = 1..)]
    checkpoint: Vec<PathBuf>,
    /// Held-out stores that checkpoints are scored on.
    #[arg(long, value_name = "STORE", num_args = 1.., requires = "checkpoint")]
    data: Vec<PathBuf>,
    /// Also run this command with --preset, --threads and --runs, in turn with ours (crates/bench/benches/peer.py prints what is
    /// expected).
    #[arg(long, value_name = "COMMAND", requires = "out")]
    peer: Option<String>,
    /// Rounds beside the peer.
    #[arg(long, default_value_t = 3)]
    rounds: usize,
    /// Send this number of frames through a stream; exit status 1 if memory grows.
    /// With --out the result is written as growth-PRESET.json.
    #[arg(long, value_name = "FRAMES", conflicts_with_all = ["checkpoint", "vary", "peer"])]
    growth: Option<u64>,
    /// Time a checkpoint with and without its estimates of familiarity, presence and keypoints, image by image in turn; exit
    /// status 1 if they cost more than 3 % of an image.
    #[arg(long, value_name = "IMAGES", requires = "checkpoint", conflicts_with_all = ["growth", "out", "data"])]
    estimates: Option<usize>,
    /// CUDA device, by index; the CPU without it.
    #[arg(long, value_name = "INDEX", conflicts_with = "out")]
    cuda: Option<usize>,
    #[command(flatten)]
    output: Output,
}

/// Runs the subject; false if memory grew by more than [`GROWTH_MB`].
pub fn run(args: &Args) -> anyhow::Result<bool> {
    ensure!(args.threads.iter().all(|threads| (1..=1024).contains(threads)), "--threads: expected 1 to 1024");
    for preset in args.preset.iter().chain(&args.vary) {
        Config::preset(preset)?;
    }
    if let Some(images) = args.estimates {
        return cost_of_estimates(args, images);
    }
    match (args.output.folder(), args.growth) {
        (_, Some(frames)) => grow(args, frames as usize),
        (Some(folder), None) => write(args, folder, &sweep(args)?),
        (None, None) => one(args),
    }
}

fn one(args: &Args) -> anyhow::Result<bool> {
    let setup = setup(args)?;
    let row = match args.checkpoint.as_slice() {
        [] => measure::random(&setup)?,
        [path] => {
            let path = path.clone();
            let name = Checkpoint::load(&path, &candle_core::Device::Cpu)?.metadata.name;
            let stores = if args.data.is_empty() { vec![] } else { zarr::open_all(&args.data)? };
            measure::trained(&Setup { name, ..setup }, &path, stores)?
        }
        _ => bail!("--checkpoint: several need --out"),
    };
    args.output.print(&row, || table::rows(std::slice::from_ref(&row)))?;
    Ok(true)
}

/// Returns the one configuration of the lists, and sets up its thread pool.
fn setup(args: &Args) -> anyhow::Result<Setup> {
    fn single<T: Clone>(name: &str, values: &[T]) -> anyhow::Result<Option<T>> {
        ensure!(values.len() <= 1, "{name}: several values need --out");
        Ok(values.first().cloned())
    }
    let name = single("--preset", &args.preset)?.context("--preset: expected a name")?;
    let mut config = Config::preset(&name)?;
    if let Some(horizon) = single("--horizon", &args.horizon)? {
        config.horizon = horizon;
    }
    if let Some(image) = single("--size", &args.size)? {
        config.image = image;
    }
    config.check()?;
    let threads = single("--threads", &args.threads)?.context("--threads: expected a number")?;
    rayon::ThreadPoolBuilder::new().num_threads(threads).build_global()?;
    Ok(Setup {
        name,
        config,
        precision: single("--precision", &args.precision)?.context("--precision: expected a name")?,
        threads,
        runs: args.runs as usize,
        batch: args.batch as usize,
        device: egotac::cli::device(args.cuda)?,
    })
}

fn cost_of_estimates(args: &Args, images: usize) -> anyhow::Result<bool> {
    let setup = setup(args)?;
    let [path] = args.checkpoint.as_slice() else { bail!("--checkpoint: --estimates needs one") };
    let cost = estimates::measure(path, setup.precision, images)?;
    args.output.print(&cost, || {
        format!(
            "{} images: {:.3} ms without estimates, {:.3} ms with them; {:.2} % more, median of pairs",
            cost.images,
            cost.without_ms,
            cost.with_ms,
            100.0 * cost.share
        )
    })?;
    Ok(cost.share <= MAX_SHARE)
}

fn grow(args: &Args, frames: usize) -> anyhow::Result<bool> {
    let setup = setup(args)?;
    let model = EgoTac::new(&setup.config, init::var_builder(&VarMap::new(), 0, &setup.device))?;
    let metadata = Metadata::new(&setup.name, 1.0, 0.04);
    let checkpoint = Checkpoint::new(model.compile(setup.precision)?, metadata);
    let mut predictor = Predictor::new(checkpoint, Options { device: setup.device, ..Options::default() })?;
    let growth = growth::measure(&mut predictor, &setup.name, frames)?;
    if let Some(folder) = args.output.folder() {
        let mut json = serde_json::to_value(&growth)?;
        json["command"] = command(args).into();
        json["machine"] = serde_json::to_value(Machine::this())?;
        file::write(&folder.join(format!("growth-{}.json", growth.preset)), format!("{json:#}\n").as_bytes())?;
    }
    args.output.print(&growth, || {
        format!(
            "{}: {frames} frames in {:.0} s; {:.1} MB after the first tenth, {:.1} MB at the end",
            growth.preset, growth.seconds, growth.warm_mb, growth.end_mb
        )
    })?;
    Ok(growth.mb() <= GROWTH_MB)
}

fn sweep(args: &Args) -> anyhow::Result<sweep::ModelReport> {
    let plan = Plan {
        command: command(args),
        presets: args.preset.clone(),
        vary: args.vary.clone(),
        horizons: args.horizon.clone(),
        images: args.size.clone(),
        precisions: args.precision.clone(),
        threads: args.threads.clone(),
        runs: args.runs as usize,
        checkpoints: args.checkpoint.clone(),
        data: args.data.clone(),
        peer: args.peer.clone().map(|command| (command, args.rounds)),
    };
    let bar = progress::told_bar("measurements");
    let report = sweep::run(&plan, |what, done, all| {
        progress::step(&bar, done, all);
        bar.set_message(what.to_owned());
    })?;
    bar.finish_and_clear();
    Ok(report)
}

fn write(args: &Args, folder: &Path, report: &sweep::ModelReport) -> anyhow::Result<bool> {
    args.output.write("model", report, &table::render(report))?;
    pareto::write(folder, report)?;
    Ok(true)
}

/// Returns the command that measures the same again.
fn command(args: &Args) -> String {
    let mut words = format!("egotac bench model --preset {}", args.preset.join(","));
    fn list<T: ToString>(values: &[T]) -> String {
        values.iter().map(T::to_string).collect::<Vec<_>>().join(",")
    }
    for (name, values) in [
        ("--horizon", list(&args.horizon)),
        ("--size", list(&args.size)),
        ("--precision", list(&args.precision)),
        ("--threads", list(&args.threads)),
    ] {
        if !values.is_empty() {
            words += &format!(" {name} {values}");
        }
    }
    if let Some(preset) = &args.vary {
        words += &format!(" --vary {preset}");
    }
    words += &format!(" --runs {}", args.runs);
    for (name, paths) in [("--checkpoint", &args.checkpoint), ("--data", &args.data)] {
        if !paths.is_empty() {
            // The option has put the path of the shipped network in place of its name.
            let is_shipped = |path: &PathBuf| shipped::path().is_ok_and(|own| own == *path);
            let written = |path: &PathBuf| if is_shipped(path) { "shipped".into() } else { path.display().to_string() };
            words += &format!(" {name} {}", paths.iter().map(written).collect::<Vec<String>>().join(" "));
        }
    }
    if let Some(peer) = &args.peer {
        words += &format!(" --peer \"{peer}\" --rounds {}", args.rounds);
    }
    if let Some(frames) = args.growth {
        words += &format!(" --growth {frames}");
    }
    words + &args.output.words()
}
