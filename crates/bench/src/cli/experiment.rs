//! `egotac experiment`.

use std::path::PathBuf;
use std::process::ExitCode;

use clap::builder::PossibleValuesParser;
use egotac::cli::options::Json;

use crate::names::{MEASURED, TRAINED};

/// Name of the command that writes the page about all experiments.
const RESULTS: &str = "results";

/// The paper's peak learning rate.
const LEARNING_RATE: f64 = 1e-4;

/// Arguments of `egotac experiment`.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Trained: sources (contact by distance beside force: 0 to 3 sources), consistency (loss L_cons), sampling \
    (temperature, quotas), glove (its look), history (EgoTac-i), separation (per-frame crops), scaling (10 to 100 % of the data; \
    1 to 4 sources), ablations (the parts of the method, other loss weights), limits (time, resolution, capacity), motion (forces estimated \
    from motion), recordings (two data sets, written as others record them, imported and mixed), hands (squares around the hands in place \
    of the whole picture).\n\
    Measured on a finished network: transfer (other sensors), decline (worse pictures), attention (where it looks), reuse \
    (encoder work that is skipped: images that hardly change, patches without hands).\n\
    results: the page that sets what was found beside the paper, from the JSON files in --out.\n\
    Data is rendered and runs are trained in the work folder; both stay there, so a stopped experiment resumes."
)]
pub struct Args {
    /// Name of the experiment.
    #[arg(value_parser = PossibleValuesParser::new(TRAINED.into_iter().chain(MEASURED).chain([RESULTS])))]
    name: String,
    /// Runs of each arm.
    #[arg(long, default_value_t = 2, value_parser = clap::value_parser!(u64).range(1..=100))]
    seeds: u64,
    /// Optimisation steps of a run.
    #[arg(long, default_value_t = 1200, value_parser = clap::value_parser!(u64).range(1..=10_000_000))]
    steps: u64,
    /// Peak learning rate of the runs.
    #[arg(long, value_name = "RATE", default_value_t = LEARNING_RATE)]
    learning_rate: f64,
    /// Training episodes of each scene.
    #[arg(long, default_value_t = 25, value_parser = clap::value_parser!(u64).range(1..=900))]
    episodes: u64,
    /// Held-out episodes of each scene [default: 6, or 3 where nothing is trained].
    #[arg(long, value_parser = clap::value_parser!(u64).range(1..=900))]
    held_out: Option<u64>,
    /// Width and height of the pictures, pixels, a multiple of the network's patch [default: 112, or 176 where nothing is trained].
    #[arg(long, value_name = "PIXELS", value_parser = clap::value_parser!(u32).range(28..=1024))]
    size: Option<u32>,
    /// Use only this many scenes of each world.
    #[arg(long, default_value_t = 19, value_parser = clap::value_parser!(u64).range(1..=19))]
    scenes: u64,
    /// Checkpoint whose encoder all arms start from, or which is measured [default: the one shipped with egotac].
    #[arg(long, value_name = "FILE|shipped", value_parser = egotac::cli::options::checkpoint())]
    checkpoint: Option<PathBuf>,
    /// Repeat the experiment with other episodes for training and test, and other seeds of the runs: 1 is the first repetition. What was chosen by
    /// the scores of one is tested by another.
    #[arg(long, value_name = "N", default_value_t = 0, value_parser = clap::value_parser!(u64).range(0..=100))]
    repetition: u64,
    /// Try the command in seconds: one scene, one or two episodes, two steps and, where it trains, a tiny network with random
    /// weights. The numbers mean nothing.
    #[arg(long, conflicts_with_all = ["seeds", "steps", "learning_rate", "episodes", "held_out", "size", "scenes", "repetition", "checkpoint"])]
    quick: bool,
    /// Index of the CUDA device that trains; by default the CPU.
    #[arg(long, value_name = "INDEX")]
    cuda: Option<usize>,
    /// Folder for data and runs.
    #[arg(long, value_name = "FOLDER", default_value = "out/experiments")]
    work: PathBuf,
    /// Folder for NAME.md, NAME.json, NAME.png and NAME.svg.
    #[arg(long, value_name = "FOLDER", default_value = "out/results")]
    out: PathBuf,
}

/// Runs the command.
#[cfg(not(feature = "sim"))]
pub fn run(_: Args, _: &Json) -> anyhow::Result<ExitCode> {
    Err(super::feature_off("experiment"))
}

#[cfg(feature = "sim")]
pub use enabled::run;

#[cfg(feature = "sim")]
mod enabled {
    use egotac::file;
    use egotac::render::figure;
    use egotac::text::tell;
    use indicatif::ProgressBar;
    use serde::Serialize;

    use super::*;
    use crate::cli::output::write_report;
    use crate::experiment::{
        self, Experiment, Network, Progress, Setup, Size, attention, claims, decline, plot, reuse, transfer,
    };

    /// Runs the command.
    pub fn run(args: Args, json: &Json) -> anyhow::Result<ExitCode> {
        if args.name == RESULTS {
            anyhow::ensure!(!json.is_printed() && json.file().is_none(), "--json: the page of results is text only");
            let page = claims::page(&args.out)?;
            file::write(&args.out.join("README.md"), page.as_bytes())?;
            print!("{page}");
            return Ok(ExitCode::SUCCESS);
        }
        let setup = setup(&args)?;
        let command = command(&args, &setup.size);
        let bar = egotac::cli::progress::told_bar("parts");
        let mut show = |progress: Progress| show(&bar, progress);
        let (report, markdown) = match args.name.as_str() {
            "attention" => {
                let report = attention::run(&setup, command, &args.out, &mut show)?;
                write(&args, &report, report.markdown())?
            }
            "reuse" => {
                let report = reuse::run(&setup, command, &mut show)?;
                figure::write(&args.out, "reuse", &reuse::Plot::of(&report, &args.out)?)?;
                write(&args, &report, report.markdown())?
            }
            "transfer" => {
                let report = transfer::run(&setup, command, &mut show)?;
                plot::write(&args.out, &report)?;
                write(&args, &report, report.markdown())?
            }
            "decline" => {
                let report = decline::run(&setup, command, &mut show)?;
                decline::write_plot(&args.out, &report)?;
                write(&args, &report, report.markdown())?
            }
            name => {
                let device = egotac::cli::device(args.cuda)?;
                let report = experiment::run(&Experiment::by_name(name)?, &setup, &device, command, &mut show)?;
                plot::write(&args.out, &report)?;
                write(&args, &report, report.markdown())?
            }
        };
        bar.finish_and_clear();
        json.show(&report, || markdown)?;
        Ok(ExitCode::SUCCESS)
    }

    /// Returns size and network of an experiment.
    fn setup(args: &Args) -> anyhow::Result<Setup> {
        let measures = MEASURED.contains(&args.name.as_str());
        let size = match args.quick {
            true => Size {
                episodes: usize::from(!measures),
                // `decline` predicts each episode seven times; of those of `transfer`, one calibrates.
                held_out: if args.name == "decline" { 1 } else { 2 },
                steps: if measures { 0 } else { 2 },
                learning_rate: args.learning_rate,
                seeds: if measures { 1 } else { 2 },
                image: 56,
                scenes: 1,
                repetition: 0,
            },
            false => Size {
                episodes: if measures { 0 } else { args.episodes as usize },
                held_out: args.held_out.unwrap_or(if measures { 3 } else { 6 }) as usize,
                steps: if measures { 0 } else { args.steps as usize },
                learning_rate: args.learning_rate,
                seeds: if measures { 1 } else { args.seeds },
                image: args.size.unwrap_or(if measures { 176 } else { 112 }),
                scenes: args.scenes as usize,
                repetition: args.repetition,
            },
        };
        let network = if args.quick && !measures { Network::toy() } else { Network::load(args.checkpoint.as_deref())? };
        Ok(Setup { size, network, work: args.work.clone(), quick: args.quick })
    }

    /// Returns the command line that measures the same again.
    fn command(args: &Args, size: &Size) -> String {
        let init = args.checkpoint.as_ref().map(|path| format!(" --checkpoint {}", path.display())).unwrap_or_default();
        let Size { episodes, held_out, steps, learning_rate, seeds, image, .. } = size;
        if args.quick {
            return format!("egotac experiment {} --quick", args.name);
        }
        let training = match steps {
            0 => String::new(),
            steps => {
                let rate = match *learning_rate == LEARNING_RATE {
                    true => String::new(),
                    false => format!(" --learning-rate {learning_rate}"),
                };
                format!(" --seeds {seeds} --steps {steps}{rate} --episodes {episodes}")
            }
        };
        let scenes = if args.scenes < 19 { format!(" --scenes {}", args.scenes) } else { String::new() };
        let again = if args.repetition > 0 { format!(" --repetition {}", args.repetition) } else { String::new() };
        format!("egotac experiment {}{training} --held-out {held_out} --size {image}{scenes}{again}{init}", args.name)
    }

    /// Writes the report; returns its JSON and its Markdown.
    fn write(args: &Args, report: &impl Serialize, markdown: String) -> anyhow::Result<(serde_json::Value, String)> {
        write_report(&args.out, &args.name, report, &markdown)?;
        Ok((serde_json::to_value(report)?, markdown))
    }

    fn show(bar: &ProgressBar, progress: Progress) {
        let at = |done: usize, all: usize, message: String| {
            bar.set_length(all as u64);
            bar.set_position(done as u64);
            bar.set_message(message);
        };
        match progress {
            Progress::Rendered(done, all) => at(done as usize, all as usize, "episodes rendered".into()),
            Progress::Budget(budget) => bar.suspend(|| {
                let minutes = budget.windows as f64 / budget.windows_per_s / 60.0;
                tell(format_args!(
                    "{} runs to make, {} windows altogether: about {minutes:.0} min at {:.0} windows/s, measured now",
                    budget.runs, budget.windows, budget.windows_per_s
                ));
            }),
            Progress::Step(arm, seed, done, all) => at(done, all, format!("{arm}, seed {seed}")),
            Progress::Run(arm, seed) => bar.suspend(|| tell(format_args!("{arm}, seed {seed}: done"))),
            Progress::Measured(done, all) => at(done, all, "conditions".into()),
        }
    }
}
