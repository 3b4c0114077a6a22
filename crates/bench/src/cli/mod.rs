//! Command line of the program `egotac-bench`: the commands `egotac bench` and `egotac experiment`.

mod bench;
mod experiment;
mod output;
#[cfg(feature = "sim")]
mod policy;

use std::ffi::OsString;
use std::path::PathBuf;
use std::process::ExitCode;

use clap::{CommandFactory, Parser, Subcommand};
use egotac::cli::help;
use egotac::cli::options::Json;

/// Example of each command, without the program's name.
const EXAMPLES: [&str; 19] = [
    "bench model --preset toy --threads 2",
    "bench layers --preset tiny",
    "bench train --preset tiny",
    "bench gpu --preset tiny --out out/gpu",
    "bench ranks --preset tiny --steps 2",
    "bench label --frames 100",
    "bench import --out out/import",
    "bench sim --out out/bench",
    "bench retarget --frames 1000",
    "bench effects --out out/effects",
    "bench hard-cases --out out/hard-cases",
    "bench guards --rounds 500 --json",
    "bench glove poke --out out/glove",
    "bench physics --out out/physics",
    "bench faults --short",
    "bench node --short",
    "bench draw docs/bench/sim.json",
    "experiment policy --quick",
    "experiment transfer --quick",
];

/// Benchmarks and experiments of egotac.
// Its users type `egotac bench`, so help and errors name it so.
#[derive(Debug, Parser)]
#[command(name = "egotac", bin_name = "egotac", version = egotac::VERSION, propagate_version = true)]
struct Cli {
    #[command(flatten)]
    say: egotac::cli::Say,
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Benchmarks of the documentation: model, layers, train, gpu, ranks, label, import, retarget, sim, physics, effects, glove, node, hard-cases, guards, faults.
    Bench(bench::Args),
    /// Test the paper's claims on rendered data: train, measure, compare.
    Experiment(Experiments),
    /// Write the page of docs/reference; scripts/reference runs this command.
    #[command(hide = true)]
    Reference {
        /// Folder for the page.
        folder: PathBuf,
    },
    /// Serve as a worker process of a simulation that this program started.
    #[command(hide = true, disable_help_flag = true, disable_version_flag = true)]
    Sim(Passed),
    /// Serve as a command that this program disturbs.
    #[command(hide = true, disable_help_flag = true, disable_version_flag = true)]
    Label(Passed),
    /// Serve as a command that this program disturbs.
    #[command(hide = true, disable_help_flag = true, disable_version_flag = true)]
    Train(Passed),
    /// Serve as a command that this program disturbs.
    #[command(hide = true, disable_help_flag = true, disable_version_flag = true)]
    Data(Passed),
}

/// Arguments of `egotac experiment`: an experiment in a closed loop, or one of trainings.
#[derive(Debug, clap::Args)]
#[command(args_conflicts_with_subcommands = true, subcommand_negates_reqs = true)]
struct Experiments {
    #[command(subcommand)]
    closed_loop: Option<ClosedLoop>,
    #[command(flatten)]
    trained: Option<experiment::Args>,
    // Not among the arguments before: clap finds none of them if they contain other groups.
    #[command(flatten)]
    json: Json,
}

#[derive(Debug, clap::Subcommand)]
enum ClosedLoop {
    /// Lift a ball of unknown weight: a policy with pictures alone, predicted touch, true touch.
    #[cfg(feature = "sim")]
    Policy(policy::Args),
    #[cfg(not(feature = "sim"))]
    Policy(Passed),
}

/// Arguments that egotac's own command line reads.
#[derive(Debug, clap::Args)]
struct Passed {
    #[arg(trailing_var_arg = true, allow_hyphen_values = true)]
    _arguments: Vec<OsString>,
}

/// Runs the command line; the exit status is 0 for success, 1 for a failed check or an error, 2 for bad usage.
pub fn main() -> ExitCode {
    let arguments: Vec<OsString> = std::env::args_os().collect();
    let Cli { say, command } = egotac::cli::parse(Cli::command(), "egotac", &EXAMPLES, arguments);
    say.apply();
    if let Command::Sim(_) | Command::Label(_) | Command::Train(_) | Command::Data(_) = command {
        // Workers, and commands that `bench faults` disturbs, are started as this same program (`sim_workers`), so both ends are of one build.
        return egotac::cli::main();
    }
    egotac::cli::execute(|| match command {
        Command::Bench(args) => bench::run(args),
        Command::Experiment(args) => run_experiment(args),
        Command::Reference { folder } => {
            let command = help::arrange(Cli::command(), "egotac", &EXAMPLES);
            let page = egotac::cli::reference::commands_page("Benchmarks and experiments", command);
            egotac::file::write(&folder.join("bench.md"), page.as_bytes())?;
            Ok(ExitCode::SUCCESS)
        }
        Command::Sim(_) | Command::Label(_) | Command::Train(_) | Command::Data(_) => Ok(ExitCode::SUCCESS),
    })
}

fn run_experiment(args: Experiments) -> anyhow::Result<ExitCode> {
    let Experiments { closed_loop, trained, json } = args;
    match (closed_loop, trained) {
        #[cfg(feature = "sim")]
        (Some(ClosedLoop::Policy(args)), _) => policy::run(args),
        #[cfg(not(feature = "sim"))]
        (Some(ClosedLoop::Policy(_)), _) => Err(feature_off("experiment policy")),
        (None, Some(args)) => experiment::run(args, &json),
        // The name of an experiment is required.
        (None, None) => Ok(ExitCode::FAILURE),
    }
}

/// Returns worker processes that simulate `scenes` (names or files) with pictures of `size` x `size` pixels.
#[cfg(feature = "sim")]
fn sim_workers(size: u32, scenes: impl IntoIterator<Item = OsString>) -> anyhow::Result<egotac::sim::WorkerCommand> {
    let arguments = ["--size", &size.to_string(), "--"].map(OsString::from);
    Ok(egotac::sim::WorkerCommand::of_this_program(arguments.into_iter().chain(scenes))?)
}

/// Returns the error of a command that needs the feature `sim`.
#[cfg(not(feature = "sim"))]
fn feature_off(command: &str) -> anyhow::Error {
    anyhow::anyhow!(
        "`egotac {command}` needs the feature `sim`: `make setup`, `. ./env.sh`, \
         `cargo build --release --features ros,sim -p egotac-bench`"
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_example_parses() {
        for example in EXAMPLES {
            // A subject or experiment whose feature is not compiled in has other arguments.
            if cfg!(all(feature = "ros", feature = "sim")) {
                let words = std::iter::once("egotac").chain(example.split(' '));
                Cli::command().try_get_matches_from(words).unwrap_or_else(|error| panic!("{example}: {error}"));
            }
        }
    }

    #[test]
    fn the_help_of_each_command_is_short_and_ends_with_an_example() {
        let mut command = help::arrange(Cli::command(), "egotac", &EXAMPLES).disable_help_subcommand(true);
        command.build();
        let commands = help::runnable(&command);
        assert!(commands.iter().any(|(path, _)| path == "experiment"));
        for (path, command) in commands {
            let (short, long) =
                (command.clone().render_help().to_string(), command.clone().render_long_help().to_string());
            assert!(short.len() < 2500, "{path} -h has {} bytes:\n{short}", short.len());
            for help in [&short, &long] {
                let end = help.trim_end().lines().next_back().unwrap();
                assert!(end.starts_with(&format!("Example: egotac {path} ")), "{path}:\n{help}");
            }
        }
    }

    #[test]
    #[cfg(all(feature = "ros", feature = "sim"))]
    fn the_reference_in_the_docs_is_up_to_date() {
        let command = help::arrange(Cli::command(), "egotac", &EXAMPLES);
        let page = egotac::cli::reference::commands_page("Benchmarks and experiments", command);
        assert!(page == include_str!("../../../../docs/reference/bench.md"), "run scripts/reference");
    }

    #[test]
    fn old_spellings_name_the_new_ones() {
        for line in ["experiment transfer --image 56", "experiment transfer --init a", "bench model --image 56"] {
            let words: Vec<OsString> = std::iter::once("egotac").chain(line.split(' ')).map(OsString::from).collect();
            let error = Cli::command().try_get_matches_from(&words).unwrap_err();
            let told = egotac::cli::renamed::explain(error, &words).to_string();
            assert!(told.contains("is now --size") || told.contains("is now --checkpoint"), "{line}: {told}");
        }
    }
}
