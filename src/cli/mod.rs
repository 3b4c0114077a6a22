//! The command line: one file per command.

mod completions;
mod data;
mod demo;
mod doctor;
mod doubt;
mod eval;
mod external;
mod hand;
mod hands;
#[doc(hidden)]
pub mod help;
#[doc(hidden)]
pub mod label;
mod label_physics;
mod label_views;
mod labelling;
mod limits;
mod model;
#[doc(hidden)]
pub mod options;
mod predict;
#[doc(hidden)]
pub mod progress;
#[doc(hidden)]
pub mod reference;
#[doc(hidden)]
pub mod renamed;
mod report;
mod retarget;
mod sensor;
#[cfg(any(feature = "ros", feature = "sim"))]
mod sheet;
mod sim;
mod train;
mod verify;
mod view;

use std::ffi::OsString;
use std::io::Write;
use std::process::ExitCode;
use std::time::Instant;

use anyhow::Context;
use clap::{CommandFactory, FromArgMatches, Parser, Subcommand};

use crate::file::input;
use crate::file::limits::check_environment;
use crate::text::{self, tell};

/// Touch from sight: dense force and contact on both hands, from egocentric RGB.
#[derive(Debug, Parser)]
#[command(version, propagate_version = true)]
struct Cli {
    /// Permit symbolic links inside data sets that lead out of them.
    #[arg(long, global = true)]
    follow_links: bool,
    #[command(flatten)]
    say: Say,
    #[command(subcommand)]
    command: Command,
}

/// How much the program says on standard error.
#[doc(hidden)]
#[derive(Debug, clap::Args)]
pub struct Say {
    /// Show no progress; results, warnings and errors stay.
    #[arg(long, short, global = true, conflicts_with = "verbose")]
    quiet: bool,
    /// Also tell what is loaded, and the time taken.
    #[arg(long, short, global = true)]
    verbose: bool,
}

impl Say {
    /// Sets the verbosity of this process.
    pub fn apply(&self) {
        progress::set_verbosity(match (self.quiet, self.verbose) {
            (true, _) => progress::Verbosity::Quiet,
            (_, true) => progress::Verbosity::Verbose,
            _ => progress::Verbosity::Normal,
        });
    }

    /// Returns the options that set the same verbosity in another process.
    fn options(&self) -> Option<&'static str> {
        match (self.quiet, self.verbose) {
            (true, _) => Some("--quiet"),
            (_, true) => Some("--verbose"),
            _ => None,
        }
    }
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Check the installation and print fixes for missing parts.
    Doctor(doctor::Args),
    /// Hand model: forward, show, build, map.
    Hand(hand::Args),
    /// Simulated hand-object scenes: list, show, explain, run, replay, generate.
    Sim(sim::Args),
    /// Train a network on stores.
    Train(train::Args),
    /// Label recordings: bags, LeRobot data sets, OXT stores, videos, images.
    Label(label::Args),
    /// Write an HTML page about labels: frames, forces over time, contact by region.
    Report(report::Args),
    /// Show images and touch on a local page: recordings, cameras, ROS topics.
    View(view::Args),
    /// Predict touch for images or a store.
    Predict(predict::Args),
    /// Score predictions against truth.
    Eval(eval::Args),
    /// Train and compare: ablations, sources, scaling, on rendered data.
    #[command(disable_help_flag = true, disable_version_flag = true)]
    Experiment(external::Args),
    /// Score labels, or a network, against simulated contact forces; a gate for continuous integration.
    Verify(verify::Args),
    /// Transfer a hand's pose and touch to a robot hand: run, inspect, new, list, demo.
    Retarget(retarget::Args),
    /// Tactile gloves: list, show, new, convert.
    Sensor(sensor::Args),
    /// Network: forward, attention, import, get, init, grow, half, familiarity, presence, calibrate, doubt, info.
    Model(model::Args),
    /// Benchmarks of the documentation: model, layers, train, ranks, label, import, retarget, sim, physics, effects, glove, node, hard-cases, guards, faults.
    #[command(disable_help_flag = true, disable_version_flag = true)]
    Bench(external::Args),
    /// Recordings and labels: info, diff, crop, import.
    Data(data::Args),
    /// Run simulator, predictor and verifier end to end on this machine.
    Demo(demo::Args),
    /// Print the limits on files and messages from outside, and the variables that raise them.
    Limits,
    /// Print completions for a shell: bash, zsh, fish, elvish, powershell.
    Completions(completions::Completions),
    /// Write manual pages into a folder.
    Man(completions::Man),
    /// Write the pages of docs/reference; scripts/reference runs this command.
    #[command(hide = true)]
    Reference(reference::Args),
}

/// Runs the command line; docs/reference/exit-status.md lists the exit statuses.
pub fn main() -> ExitCode {
    main_with(std::env::args_os())
}

/// Runs the command line `arguments`, whose first one is the program's name, as [`main`]. Bad usage ends the process.
pub fn main_with(arguments: impl IntoIterator<Item = OsString>) -> ExitCode {
    run(parse(help::group(Cli::command()), "egotac", &help::EXAMPLES, arguments))
}

/// Returns the command line with its examples.
fn own_command() -> clap::Command {
    help::arrange(help::group(Cli::command()), "egotac", &help::EXAMPLES)
}

/// Parses a command line; ends the process with help, version or an error that names the new spelling of an old option.
#[doc(hidden)]
pub fn parse<T: FromArgMatches>(
    command: clap::Command,
    program: &str,
    examples: &[&str],
    arguments: impl IntoIterator<Item = OsString>,
) -> T {
    let arguments: Vec<OsString> = arguments.into_iter().collect();
    let mut command = help::arrange(command, program, examples);
    let parsed = command.try_get_matches_from_mut(&arguments).and_then(|matches| T::from_arg_matches(&matches));
    parsed.unwrap_or_else(|error| renamed::explain(error.format(&mut command), &arguments).exit())
}

fn run(Cli { follow_links, say, command }: Cli) -> ExitCode {
    say.apply();
    if follow_links {
        input::follow_links();
    }
    execute(|| match command {
        Command::Doctor(args) => doctor::run(args),
        Command::Hand(args) => hand::run(args),
        Command::Sim(args) => sim::run(args),
        Command::Train(args) => train::run(args),
        Command::Label(args) => label::run(args),
        Command::Report(args) => report::run(args),
        Command::View(args) => view::run(args),
        Command::Predict(args) => predict::run(args),
        Command::Eval(args) => eval::run(args),
        Command::Experiment(args) => external::run("experiment", say.options(), args),
        Command::Verify(args) => verify::run(args),
        Command::Retarget(args) => retarget::run(args),
        Command::Sensor(args) => sensor::run(args),
        Command::Model(args) => model::run(args),
        Command::Bench(args) => external::run("bench", say.options(), args),
        Command::Data(args) => data::run(args),
        Command::Demo(args) => demo::run(args),
        Command::Limits => limits::run(),
        Command::Completions(args) => completions::completions(&args, own_command()),
        Command::Reference(args) => reference::run(&args, own_command()),
        Command::Man(args) => completions::man(&args, own_command()),
    })
}

/// Runs a program's command and prints its error once; the exit status is 1 for an error.
#[doc(hidden)]
pub fn execute(command: impl FnOnce() -> anyhow::Result<ExitCode>) -> ExitCode {
    exit_where_printing_fails();
    let started = Instant::now();
    let done = check_environment().map_err(Into::into).and_then(|()| command()).and_then(|code| {
        std::io::stdout().flush().context("standard output")?;
        progress::detail(format_args!("done in {:.1} s", started.elapsed().as_secs_f64()));
        Ok(code)
    });
    match done {
        Ok(code) => code,
        Err(error) => {
            tell(format_args!("egotac: {}", text::error_chain(error.as_ref())));
            ExitCode::FAILURE
        }
    }
}

/// Creates the error of a command whose feature is not compiled in.
#[doc(hidden)]
pub fn feature_off(command: &str, feature: &str) -> anyhow::Error {
    anyhow::anyhow!(
        "`egotac {command}` needs the feature `{feature}`: `make setup`, `. ./env.sh`, `cargo build --release --features {feature}`"
    )
}

/// Returns the CPU, or a CUDA device by index.
#[doc(hidden)]
pub fn device(cuda: Option<usize>) -> anyhow::Result<candle_core::Device> {
    match cuda {
        None => Ok(candle_core::Device::Cpu),
        Some(_) if !cfg!(feature = "cuda") => {
            anyhow::bail!("--cuda needs the feature `cuda`: build with `cargo build --features cuda`")
        }
        Some(index) => Ok(egotac_kernels::gpu::open(index)?),
    }
}

/// Parses a number above 0.
fn positive(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(value) if value.is_finite() && value > 0.0 => Ok(value),
        _ => Err("expected a number above 0".into()),
    }
}

/// Exits where `print!` would panic: without a message if standard output is closed, as in `egotac ... | head`, and otherwise
/// with the error, as of a full disk. A crate that can't print to standard error ends the program as an error does.
fn exit_where_printing_fails() {
    /// Exit status that a shell reports for a program ended by SIGPIPE.
    const CLOSED_PIPE: i32 = 128 + 13;
    let default_hook = std::panic::take_hook();
    std::panic::set_hook(Box::new(move |panic| {
        let message = panic.payload_as_str().unwrap_or_default();
        if let Some(error) = message.strip_prefix("failed printing to stdout: ") {
            if error.contains("Broken pipe") {
                std::process::exit(CLOSED_PIPE);
            }
            tell(format_args!("egotac: standard output: {error}"));
            std::process::exit(1);
        }
        if message.starts_with("failed printing to stderr: ") {
            std::process::exit(1);
        }
        default_hook(panic);
    }));
}
