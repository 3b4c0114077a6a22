//! `egotac train`.

use std::path::PathBuf;
use std::process::ExitCode;

use indicatif::{ProgressBar, ProgressStyle};

use super::hands::Hands;
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
    #[arg(long, value_name = "FILE")]
    config: PathBuf,
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
    let mut config = Config::read(&args.config)?;
    let Hands { mano_left, mano_right, .. } = args.hands;
    config.mano_left = mano_left.or(config.mano_left);
    config.mano_right = mano_right.or(config.mano_right);
    let device = super::device(args.cuda)?;
    let bar = ProgressBar::new(config.steps as u64);
    bar.set_style(ProgressStyle::with_template("{bar:30} {pos}/{len} {elapsed}<{eta} {msg}")?);
    let mut pace = Pace::default();
    let outcome = train::train(&config, args.resume, &device, &mut |event| {
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
    println!("{}", describe_end(&outcome));
    Ok(ExitCode::SUCCESS)
}

fn describe_start(started: &Started) -> String {
    format!(
        "{} parameters; {} training frames, {} held out; one unit of force is {:.4} N; steps {} to {}",
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
        format!(
            "loss {:.4} (force {:.4}, contact {:.4}, active {:.4}), {:.0} windows/s, {:.0} % waiting for data",
            self.loss.unwrap_or_default(),
            step.losses.force,
            step.losses.contact,
            step.losses.active,
            self.windows / self.secs.max(1e-9),
            100.0 * self.wait_secs / self.secs.max(1e-9)
        )
    }
}
