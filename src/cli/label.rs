//! `egotac label`.

use std::path::PathBuf;
use std::process::ExitCode;

use anyhow::{Context, bail};
use indicatif::ProgressBar;
use serde_json::json;

use crate::dataset::mcap::TOPIC;
use crate::dataset::{LabelSummary, Provenance};
use crate::file;
use crate::label::{
    FormatOptions, Job, LabelTask, LabelTasks, LabelTiming, Outcome, OutputFormat, Shard, find_tasks, write_manifest,
};
use crate::model::predictor::Options;
use crate::model::{Precision, Predictor, shipped};
use crate::text::{printable, printable_name};

/// Exit status if a part of the input could not be labelled.
const PARTLY: u8 = 3;
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
    /// A Zarr store (folder or zip file), a bag (folder) or an .mcap file, a LeRobot v3 data set, a video, a
    /// folder of images; or a folder of these.
    input: PathBuf,
    /// The labelled data set; of several inputs, a folder for them and a manifest.json.
    #[arg(long)]
    out: PathBuf,
    /// Format of the output.
    #[arg(long, value_name = "KIND", default_value = "same")]
    to: OutputFormat,
    /// Checkpoint to run; by default the one shipped with egotac.
    #[arg(long, value_name = "FILE")]
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
    #[arg(long, default_value = "tactile")]
    prefix: String,
    /// Make the new columns observations of policies: the prefix becomes observation.PREFIX.
    #[arg(long)]
    observation: bool,
    /// Frame rate of a folder of images, 1/s; by default one image per observation step of the network.
    #[arg(long, value_name = "F", value_parser = super::positive)]
    fps: Option<f64>,
    /// Upper limit of the shorter side of images in a store made from another format, pixels; 0 = original size.
    #[arg(long, value_name = "PIXELS", default_value_t = 224)]
    side: u32,
    /// Shard: label only every N-th episode or file from the I-th (from 0) on. The last shard assembles the output.
    #[arg(long, value_name = "I/N", value_parser = shard, default_value = "0/1")]
    shard: Shard,
    /// Number of threads that decode images beside the network.
    #[arg(long, default_value_t = 1, value_parser = decoders)]
    decoders: usize,
    /// JSON file for the closing summary; `-` prints JSON instead of text.
    #[arg(long, value_name = "FILE")]
    json: Option<PathBuf>,
}

/// Runs the command.
pub fn run(args: Args) -> anyhow::Result<ExitCode> {
    let path = args.checkpoint.clone().map_or_else(shipped::path, Ok)?;
    let options = Options { device: super::device(args.cuda)?, precision: args.precision, ..Default::default() };
    let mut predictor = Predictor::load(&path, options)?;
    let options = FormatOptions {
        to: args.to,
        fps: args.fps,
        frame_dt: predictor.metadata().frame_dt,
        side: (args.side > 0).then_some(args.side),
        prefix: Some(if args.observation { format!("observation.{}", args.prefix) } else { args.prefix.clone() }),
        camera: args.camera.clone(),
        time_unit: args.time_unit,
        topic: args.topic.clone(),
        labels_topic: Some(args.labels_topic.clone()),
    };
    let LabelTasks { tasks, unreadable } = find_tasks(&args.input, &args.out, &options)?;
    let several = tasks.len() + unreadable.len() > 1;
    let jobs: Vec<Job> = tasks.iter().map(|task| job(task, &predictor, &args)).collect();
    let bar = bar(&tasks, &jobs)?;
    let (mut timing, mut ends) = (LabelTiming::default(), Ends::default());
    ends.failed.extend(unreadable.iter().map(|(name, error)| (name.clone(), error.to_string())));
    let mut number = 0;
    for (task, job) in tasks.iter().zip(&jobs) {
        let outcome = job.run(&mut predictor, args.shard, number, &mut timing, &mut || bar.inc(1));
        number += task.source.units().len();
        match outcome {
            Ok(Outcome::Done(info)) => ends.done.push((task, info.summary, false)),
            Ok(Outcome::DoneBefore(info)) => ends.done.push((task, info.summary, true)),
            Ok(Outcome::Waiting) => ends.waiting.push(task),
            // An error in one of several recordings does not stop the others.
            Err(error) if several => ends.failed.push((task.name.clone(), error.to_string())),
            Err(error) => return Err(error).with_context(|| task.name.clone()),
        }
    }
    bar.finish_and_clear();
    if several && args.out.is_dir() {
        write_manifest(&args.out, &tasks, &unreadable)?;
    }
    report(&args, &ends, &timing)?;
    for (name, reason) in &ends.failed {
        eprintln!("{}", printable_name(&format!("{name}: {reason}")));
    }
    if ends.done.is_empty() && ends.waiting.is_empty() {
        bail!("{}: none of {} recordings could be labelled", args.input.display(), ends.failed.len());
    }
    let whole = ends.failed.is_empty() && ends.done.iter().all(|(_, summary, _)| summary.is_whole());
    Ok(if whole { ExitCode::SUCCESS } else { ExitCode::from(PARTLY) })
}

/// Results of the jobs.
#[derive(Default)]
struct Ends<'a> {
    /// Complete outputs; true if an earlier run completed them.
    done: Vec<(&'a LabelTask, LabelSummary, bool)>,
    /// Outputs that wait for other shards.
    waiting: Vec<&'a LabelTask>,
    /// Names of inputs without an output, and the reasons.
    failed: Vec<(String, String)>,
}

fn job<'a>(task: &'a LabelTask, predictor: &Predictor, args: &Args) -> Job<'a> {
    Job {
        source: task.source.as_ref(),
        output: task.output.as_ref(),
        out: task.out.clone(),
        provenance: Provenance::of(predictor, args.precision, task.description.clone()),
        decoders: args.decoders,
    }
}

/// Creates a bar over all images that starts where earlier runs stopped.
fn bar(tasks: &[LabelTask], jobs: &[Job]) -> anyhow::Result<ProgressBar> {
    let bar = super::progress::bar("images");
    let frames: Option<usize> = tasks.iter().flat_map(|task| task.source.units()).map(|unit| unit.frames).sum();
    bar.set_length(frames.unwrap_or(0) as u64);
    let mut before = 0;
    for job in jobs {
        before += job.done()?;
    }
    bar.set_position(before);
    bar.reset_eta();
    Ok(bar)
}

fn report(args: &Args, Ends { done, waiting, failed }: &Ends, timing: &LabelTiming) -> anyhow::Result<()> {
    let mut total = LabelSummary::default();
    done.iter().for_each(|(_, summary, _)| total.add(summary));
    let fps = timing.frames as f64 / timing.inference_secs.max(f64::MIN_POSITIVE);
    let outputs: Vec<_> = done.iter().map(|(task, ..)| task.out.display().to_string()).collect();
    let json = json!({
        "outputs": outputs,
        "waiting_for_other_shards": waiting.iter().map(|task| task.out.display().to_string()).collect::<Vec<_>>(),
        "failed": failed.iter().map(|(name, reason)| json!({ "input": name, "reason": reason })).collect::<Vec<_>>(),
        "summary": total,
        "images_labelled_now": timing.frames,
        "images_per_sec": (timing.frames > 0).then_some(fps),
        "seconds": {
            "pass": timing.inference_secs,
            "network": timing.inference.network_secs,
            "waiting_for_images": timing.inference.waiting_secs,
            "journal": timing.inference.journal_secs,
            "assembly": timing.assembly_secs,
        },
    });
    if args.json.as_deref().is_some_and(|path| path.as_os_str() == "-") {
        println!("{}", printable(&format!("{json:#}")));
        return Ok(());
    }
    for (task, _, before) in done {
        println!("{}{}", printable_name(&task.out.to_string_lossy()), if *before { ": done before" } else { "" });
    }
    if !done.is_empty() {
        println!("{}", printable(&total.text()));
    }
    if timing.frames > 0 {
        println!("{} images in {:.1} s, {fps:.1} per second", timing.frames, timing.inference_secs);
    }
    for task in waiting {
        let out = task.out.to_string_lossy();
        println!("{}: this shard's part is done; other shards are not", printable_name(&out));
    }
    if let Some(path) = &args.json {
        file::write(path, format!("{json:#}\n").as_bytes())?;
    }
    Ok(())
}

fn time_unit(text: &str) -> Result<f64, String> {
    match text {
        "s" => Ok(1.0),
        "ms" => Ok(1e-3),
        "us" => Ok(1e-6),
        "ns" => Ok(1e-9),
        _ => Err("expected s, ms, us or ns".into()),
    }
}

fn decoders(text: &str) -> Result<usize, String> {
    match text.parse() {
        Ok(number) if (1..=MAX_DECODERS).contains(&number) => Ok(number),
        _ => Err(format!("expected 1 to {MAX_DECODERS}")),
    }
}

fn shard(text: &str) -> Result<Shard, String> {
    let parse = || -> anyhow::Result<Shard> {
        let (index, of) = text.split_once('/').context("no slash")?;
        let shard = Shard { index: index.parse()?, of: of.parse()? };
        if shard.index >= shard.of {
            bail!("out of range");
        }
        Ok(shard)
    };
    parse().map_err(|_| "expected I/N with I from 0 to N-1, such as 0/4".into())
}
