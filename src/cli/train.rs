//! `egotac train`.

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use anyhow::Context;

use super::hands::Hands;
use super::reference;
use crate::error::Error;
use crate::file;
use crate::text;
use crate::train::ranks::{self, Communicator};
use crate::train::{self, Config, Control, Event, Outcome, Started, Step};

/// Arguments of `egotac train`.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "The YAML's keys, with defaults, are those of `egotac::train::Config`; see models/*.yaml for the \
    configuration of the shipped checkpoint. The folder `out` of the configuration receives checkpoint.safetensors \
    (averaged weights), state.safetensors (to resume), config.yaml, log.csv and, at the end, curves.png."
)]
pub struct Args {
    /// Configuration of the run.
    #[arg(long, value_name = "FILE", required_unless_present = "init_config")]
    config: Option<PathBuf>,
    /// Write a configuration with every key at its default, to edit, and train nothing.
    #[arg(long, value_name = "FILE", conflicts_with_all = ["config", "resume"])]
    init_config: Option<PathBuf>,
    /// Value in place of that of the configuration: a key, dotted as in optimizer.learning_rate, and YAML; repeatable.
    #[arg(long, value_name = "KEY=VALUE", value_parser = setting, requires = "config")]
    set: Vec<(String, String)>,
    /// Resume from the state in the run's folder.
    #[arg(long)]
    resume: bool,
    /// Index of the CUDA device to train on; by default the CPU.
    #[arg(long, value_name = "INDEX")]
    cuda: Option<usize>,
    /// MANO files in place of the configuration's: labels and checkpoint are then on MANO's vertices.
    #[command(flatten)]
    hands: Hands,
}

/// Runs the command.
pub fn run(args: Args) -> anyhow::Result<ExitCode> {
    let Some(path) = &args.config else {
        return write_config(args.init_config.as_deref().context("expected --config or --init-config")?);
    };
    let ranks = ranks::launched()?;
    let trained = train_on(&*ranks, path, &args);
    if let (Err(error), true) = (&trained, ranks.size() > 1) {
        // Ends the other ranks, which would wait for this one, and this one with them.
        ranks.abort(&text::error_chain(error.as_ref()));
    }
    trained.map(|()| ExitCode::SUCCESS)
}

fn train_on(ranks: &dyn Communicator, path: &Path, args: &Args) -> anyhow::Result<()> {
    let mut config = Config::read_with(path, &args.set)?;
    config.check().map_err(|error| Error::file(path, error))?;
    let Hands { mano_left, mano_right, .. } = &args.hands;
    config.mano_left = mano_left.clone().or(config.mano_left);
    config.mano_right = mano_right.clone().or(config.mano_right);
    let device = super::device(args.cuda)?;
    if !ranks.is_root() {
        return Ok(train::train_on(ranks, &config, args.resume, &device, &mut |_| Control::Continue).map(drop)?);
    }
    let bar = super::progress::told_bar("steps");
    bar.set_length(config.steps as u64);
    let mut pace = Pace::default();
    let outcome = train::train_on(ranks, &config, args.resume, &device, &mut |event| {
        match event {
            Event::Started(started) => {
                bar.set_position(started.step as u64);
                bar.suspend(|| println!("{}", describe_start(started)));
            }
            Event::Stepped(step) => {
                bar.set_position(step.step as u64);
                bar.set_message(pace.describe(step));
            }
            Event::Validated(step, report) => {
                let show = |score: Option<f64>| score.map_or("undefined".into(), |score| format!("{score:.4}"));
                bar.suspend(|| {
                    println!(
                        "step {step}: MAE {} N, active MAE {} N, temporal Pearson {}, F1 {} (pooled {}), IoU {}, AUROC {}",
                        show(report.mae),
                        show(report.active_mae),
                        show(report.temporal_pearson),
                        show(report.frame_mean.f1),
                        show(report.pooled.f1),
                        show(report.frame_mean.iou),
                        show(report.frame_mean.auroc)
                    );
                });
            }
            Event::Saved(_) => {}
        }
        Control::Continue
    })?;
    bar.finish_and_clear();
    if let Some(outcome) = &outcome {
        println!("{}", describe_end(outcome));
    }
    Ok(())
}

/// Parses KEY=VALUE.
fn setting(text: &str) -> Result<(String, String), String> {
    let pair = text.split_once('=').filter(|(key, _)| !key.is_empty());
    pair.map(|(key, value)| (key.to_owned(), value.to_owned()))
        .ok_or_else(|| "expected KEY=VALUE, such as steps=200".into())
}

/// Writes a configuration to start from; refuses to replace a file.
fn write_config(path: &Path) -> anyhow::Result<ExitCode> {
    anyhow::ensure!(!path.exists(), "{}: exists already; expected the name of a new file", path.display());
    file::write(path, reference::training_config()?.as_bytes())?;
    println!("{}: fill in data, validation and out, then `egotac train --config {0}`", path.display());
    Ok(ExitCode::SUCCESS)
}

fn describe_start(started: &Started) -> String {
    let ranks = if started.ranks > 1 { format!("; {} ranks", started.ranks) } else { String::new() };
    format!(
        "{} parameters; {} training frames, {} held out; one unit of force is {:.4} N; steps {} to {}{ranks}",
        started.parameters, started.frames, started.validation_frames, started.force_scale, started.step, started.steps
    )
}

fn describe_end(outcome: &Outcome) -> String {
    let skipped = match outcome.skipped_steps {
        0 => String::new(),
        n => format!("; {n} steps skipped because their gradient was not finite"),
    };
    format!("{} after {} steps{skipped}\nsha256 {}", outcome.checkpoint.display(), outcome.steps, outcome.sha256)
}

/// Losses and speed, smoothed exponentially over about fifty steps.
#[derive(Debug, Default)]
struct Pace {
    loss: Option<f64>,
    windows: f64,
    secs: f64,
    wait_secs: f64,
    exchange_secs: f64,
}

impl Pace {
    fn describe(&mut self, step: &Step) -> String {
        const KEEP: f64 = 0.98;
        self.loss =
            Some(self.loss.map_or(f64::from(step.losses.total), |loss| {
                KEEP * loss + (1.0 - KEEP) * f64::from(step.losses.total)
            }));
        self.windows = KEEP * self.windows + step.windows as f64;
        self.secs = KEEP * self.secs + step.secs;
        self.wait_secs = KEEP * self.wait_secs + step.wait_secs;
        self.exchange_secs = KEEP * self.exchange_secs + step.exchange_secs;
        let percent = |secs: f64| 100.0 * secs / self.secs.max(1e-9);
        let exchanging = match step.exchange_bytes {
            0 => String::new(),
            _ => format!(", {:.0} % exchanging gradients", percent(self.exchange_secs)),
        };
        format!(
            "loss {:.4} (force {:.4}, contact {:.4}, active {:.4}), {:.0} windows/s, {:.0} % waiting for data{exchanging}",
            self.loss.unwrap_or_default(),
            step.losses.force,
            step.losses.contact,
            step.losses.active,
            self.windows / self.secs.max(1e-9),
            percent(self.wait_secs)
        )
    }
}
