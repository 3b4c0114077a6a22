//! `egotac label`.

use std::path::PathBuf;
use std::process::ExitCode;

use anyhow::{Context, bail};
use indicatif::ProgressBar;
use serde_json::json;

use crate::file;
use crate::label::{
    Choices, Effort, Found, Item, Job, Outcome, Provenance, Shard, Summary, TOPIC, Target, items, write_manifest,
};
use crate::model::predictor::Options;
use crate::model::{Precision, Predictor, shipped};

/// Exit status where the labels are there, but not for all of the input.
const PARTLY: u8 = 3;

/// Arguments of `egotac label`.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "The input is only read. A run that is stopped, however hard, goes on where it was when the same command is \
    given again; what it has so far lies in a hidden folder beside the output. The output appears when it is complete.\n\
    Exit status: 0 = every image is labelled, 3 = all that could be read is labelled and the rest listed, 1 = nothing is."
)]
pub struct Args {
    /// A Zarr store (folder or zip file), a bag (folder) or an .mcap file, a LeRobot v3 data set, a video, a
    /// folder of images; or a folder of these.
    input: PathBuf,
    /// The labelled data set; of several inputs, a folder for them and a manifest.json.
    #[arg(long)]
    out: PathBuf,
    /// Kind of output.
    #[arg(long, value_name = "KIND", default_value = "same")]
    to: Target,
    /// Checkpoint to run; the one that comes with egotac if absent.
    #[arg(long, value_name = "FILE")]
    checkpoint: Option<PathBuf>,
    /// Number format of the network: f32, bf16 or int8.
    #[arg(long, default_value = "f32")]
    precision: Precision,
    /// CUDA device, by index; the CPU without it.
    #[arg(long, value_name = "INDEX")]
    cuda: Option<usize>,
    /// Array of a store's images, such as camera_main_rgb (by default camera_ego_rgb, else camera_main_rgb), or key of a
    /// LeRobot camera (by default the only one).
    #[arg(long, value_name = "NAME")]
    camera: Option<String>,
    /// Unit of a store's time stamps: s, ms, us or ns; by default the size of their steps tells.
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
    /// Images per second of a folder of images; by default one per observation step of the network.
    #[arg(long, value_name = "F", value_parser = super::positive)]
    fps: Option<f64>,
    /// Shorter side of images in a store made from another format at most, pixels; 0 = as they are.
    #[arg(long, value_name = "PIXELS", default_value_t = 224)]
    side: u32,
    /// Label only each N-th episode or file from the I-th (from 0) on. Whoever is done last puts the output together.
    #[arg(long, value_name = "I/N", value_parser = shard, default_value = "0/1")]
    shard: Shard,
    /// Threads that decode images beside the network.
    #[arg(long, default_value_t = 1)]
    decoders: usize,
    /// JSON file with the closing summary; `-` prints it in place of the text.
    #[arg(long, value_name = "FILE")]
    json: Option<PathBuf>,
}

/// Runs the command.
pub fn run(args: Args) -> anyhow::Result<ExitCode> {
    let path = args.checkpoint.clone().map_or_else(shipped::path, Ok)?;
    let options = Options { device: super::device(args.cuda)?, precision: args.precision, ..Default::default() };
    let mut predictor = Predictor::load(&path, options)?;
    let choices = Choices {
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
    let Found { items, unreadable } = items(&args.input, &args.out, &choices)?;
    let several = items.len() + unreadable.len() > 1;
    let jobs: Vec<Job> = items.iter().map(|item| job(item, &predictor, &args)).collect();
    let bar = bar(&items, &jobs)?;
    let (mut effort, mut ends) = (Effort::default(), Ends::default());
    ends.failed.extend(unreadable.iter().map(|(name, error)| (name.clone(), error.to_string())));
    let mut number = 0;
    for (item, job) in items.iter().zip(&jobs) {
        let outcome = job.run(&mut predictor, args.shard, number, &mut effort, &mut || bar.inc(1));
        number += item.source.units().len();
        match outcome {
            Ok(Outcome::Done(about)) => ends.done.push((item, about.summary, false)),
            Ok(Outcome::DoneBefore(about)) => ends.done.push((item, about.summary, true)),
            Ok(Outcome::Waiting) => ends.waiting.push(item),
            // One of several does not stop the others.
            Err(error) if several => ends.failed.push((item.name.clone(), error.to_string())),
            Err(error) => return Err(error).with_context(|| item.name.clone()),
        }
    }
    bar.finish_and_clear();
    if several && args.out.is_dir() {
        write_manifest(&args.out, &items, &unreadable)?;
    }
    report(&args, &ends, &effort)?;
    for (name, reason) in &ends.failed {
        eprintln!("{name}: {reason}");
    }
    if ends.done.is_empty() && ends.waiting.is_empty() {
        bail!("{}: none of {} recordings could be labelled", args.input.display(), ends.failed.len());
    }
    let whole = ends.failed.is_empty() && ends.done.iter().all(|(_, summary, _)| summary.is_whole());
    Ok(if whole { ExitCode::SUCCESS } else { ExitCode::from(PARTLY) })
}

/// How the jobs ended.
#[derive(Default)]
struct Ends<'a> {
    /// Outputs that are there, and whether they were there before.
    done: Vec<(&'a Item, Summary, bool)>,
    /// Other shards have not done their parts yet.
    waiting: Vec<&'a Item>,
    /// Names of inputs without an output, and why.
    failed: Vec<(String, String)>,
}

fn job<'a>(item: &'a Item, predictor: &Predictor, args: &Args) -> Job<'a> {
    Job {
        source: item.source.as_ref(),
        output: item.output.as_ref(),
        out: item.out.clone(),
        provenance: Provenance::of(predictor, args.precision, item.about.clone()),
        decoders: args.decoders,
    }
}

/// A bar over all images, begun where earlier runs stopped.
fn bar(items: &[Item], jobs: &[Job]) -> anyhow::Result<ProgressBar> {
    let bar = super::progress::bar("images");
    let frames: Option<usize> = items.iter().flat_map(|item| item.source.units()).map(|unit| unit.frames).sum();
    bar.set_length(frames.unwrap_or(0) as u64);
    let mut before = 0;
    for job in jobs {
        before += job.done()?;
    }
    bar.set_position(before);
    bar.reset_eta();
    Ok(bar)
}

fn report(args: &Args, Ends { done, waiting, failed }: &Ends, effort: &Effort) -> anyhow::Result<()> {
    let mut total = Summary::default();
    done.iter().for_each(|(_, summary, _)| total.add(summary));
    let fps = effort.frames as f64 / effort.pass_secs.max(f64::MIN_POSITIVE);
    let outputs: Vec<_> = done.iter().map(|(item, ..)| item.out.display().to_string()).collect();
    let json = json!({
        "outputs": outputs,
        "waiting_for_other_shards": waiting.iter().map(|item| item.out.display().to_string()).collect::<Vec<_>>(),
        "failed": failed.iter().map(|(name, reason)| json!({ "input": name, "reason": reason })).collect::<Vec<_>>(),
        "summary": total,
        "images_labelled_now": effort.frames,
        "images_per_sec": (effort.frames > 0).then_some(fps),
        "seconds": {
            "pass": effort.pass_secs,
            "network": effort.times.network,
            "waiting_for_images": effort.times.waiting,
            "journal": effort.times.journal,
            "assembly": effort.assemble_secs,
        },
    });
    if args.json.as_deref().is_some_and(|path| path.as_os_str() == "-") {
        println!("{json:#}");
        return Ok(());
    }
    for (item, _, before) in done {
        println!("{}{}", item.out.display(), if *before { ": done before" } else { "" });
    }
    if !done.is_empty() {
        println!("{}", total.text());
    }
    if effort.frames > 0 {
        println!("{} images in {:.1} s, {fps:.1} per second", effort.frames, effort.pass_secs);
    }
    for item in waiting {
        println!("{}: this shard's part is done; other shards are not", item.out.display());
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
