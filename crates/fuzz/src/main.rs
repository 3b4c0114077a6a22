//! Reads hostile files with every reader of egotac, in child processes with limits of memory and time.
//!
//! A child makes inputs from files of the tests by changes that keep the structure of the format. A crash, a hang, or memory
//! above the limit ends the child; the parent keeps the input and starts the next child. Inputs depend on the seed and their
//! number alone.

mod case;
mod child;
mod limits;
mod mutate;
mod parent;
mod targets;

use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::Mutex;
use std::time::Duration;

use anyhow::bail;
use clap::{Parser, Subcommand};

use targets::{TARGETS, Target};

/// Longest time of a target in the short form, where the number of inputs ends it.
const LONGEST: Duration = Duration::from_secs(600);

/// Hostile files for every reader of egotac.
#[derive(Debug, Parser)]
struct Args {
    #[command(subcommand)]
    child: Option<Child>,
    /// Time of each target, s.
    #[arg(long, default_value_t = 15.0)]
    seconds: f64,
    /// Read as many inputs of each target as continuous integration does, whatever the time: some seconds' worth.
    #[arg(long, conflicts_with = "seconds")]
    short: bool,
    /// Target; several are given one by one. Without one, all.
    #[arg(long)]
    target: Vec<String>,
    /// Seed of the inputs.
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Number of targets that run at a time; 0 = number of processors.
    #[arg(long, default_value_t = 0)]
    jobs: usize,
    /// Folder for inputs that are findings.
    #[arg(long, default_value = "out/fuzz")]
    out: PathBuf,
    /// Input to read with the only target given, and nothing else.
    #[arg(long)]
    replay: Option<PathBuf>,
    /// List the targets.
    #[arg(long)]
    list: bool,
}

#[derive(Debug, Subcommand)]
enum Child {
    /// Read inputs in this process.
    #[command(hide = true)]
    Child {
        target: String,
        #[arg(long)]
        folder: PathBuf,
        #[arg(long, default_value_t = 0)]
        seed: u64,
        #[arg(long, default_value_t = 0)]
        first: u64,
        #[arg(long, default_value_t = u64::MAX)]
        end: u64,
        #[arg(long, default_value_t = 0.0)]
        seconds: f64,
        #[arg(long)]
        replay: Option<PathBuf>,
    },
}

fn main() -> anyhow::Result<ExitCode> {
    // Robots and objects are tried in a child process, which is this same program.
    #[cfg(feature = "sim")]
    {
        if std::env::args().nth(1).is_some_and(|command| command == "sim") {
            return Ok(egotac::cli::main());
        }
        egotac::trial::serve_by_this_program()?;
    }
    let args = Args::parse();
    if let Some(Child::Child { target, folder, seed, first, end, seconds, replay }) = args.child {
        let target = find(&target)?;
        match replay {
            Some(case) => child::replay(target, &folder, &case)?,
            None => {
                let span = child::Span { seed, first, end, time: Duration::from_secs_f64(seconds) };
                child::run(target, &folder, &span)?
            }
        }
        return Ok(ExitCode::SUCCESS);
    }
    if args.list {
        TARGETS.iter().for_each(|target| println!("{}", target.name));
        return Ok(ExitCode::SUCCESS);
    }
    let chosen: Vec<&Target> = match args.target.is_empty() {
        true => TARGETS.iter().collect(),
        false => args.target.iter().map(|name| find(name)).collect::<anyhow::Result<_>>()?,
    };
    match (&args.replay, &chosen[..]) {
        (Some(case), [target]) => replay(target, case),
        (Some(_), _) => bail!("--replay: expected one --target"),
        (None, chosen) => fuzz(&args, chosen),
    }
}

fn find(name: &str) -> anyhow::Result<&'static Target> {
    let names = || TARGETS.iter().map(|target| target.name).collect::<Vec<_>>().join(", ");
    TARGETS
        .iter()
        .find(|target| target.name == name)
        .ok_or_else(|| anyhow::anyhow!("target {name}: expected one of {}", names()))
}

/// Reads one input; fails if it is a finding.
fn replay(target: &Target, case: &Path) -> anyhow::Result<ExitCode> {
    Ok(match parent::replay(target, case)? {
        None => ExitCode::SUCCESS,
        Some(reason) => {
            println!("{}: {}: {reason}", target.name, case.display());
            ExitCode::FAILURE
        }
    })
}

/// Runs the targets, several at a time, and prints a line for each; fails on a finding.
fn fuzz(args: &Args, chosen: &[&Target]) -> anyhow::Result<ExitCode> {
    let jobs = match args.jobs {
        0 => std::thread::available_parallelism()?.get(),
        jobs => jobs,
    };
    let time = if args.short { LONGEST } else { Duration::from_secs_f64(args.seconds) };
    let (waiting, failed) = (Mutex::new(chosen.iter()), Mutex::new(Vec::new()));
    let work = || -> anyhow::Result<()> {
        loop {
            let next = waiting.lock().map(|mut waiting| waiting.next()).unwrap_or(None);
            let Some(target) = next else { return Ok(()) };
            let inputs = if args.short { target.short } else { u64::MAX };
            let report = parent::run(target, args.seed, inputs, time, &args.out)?;
            println!(
                "{:12} {:>8} inputs, {:>7} accepted, {} findings",
                target.name,
                report.inputs,
                report.accepted,
                report.findings.len()
            );
            if let Ok(mut failed) = failed.lock() {
                failed.extend(report.findings.into_iter().map(|(reason, found)| (target.name, reason, found)));
            }
        }
    };
    std::thread::scope(|scope| {
        let threads: Vec<_> = (0..jobs).map(|_| scope.spawn(work)).collect();
        threads.into_iter().try_for_each(|thread| thread.join().unwrap_or_else(|_| bail!("a thread panicked")))
    })?;
    let failed = failed.into_inner().unwrap_or_default();
    for (name, reason, (path, times)) in &failed {
        println!("{name}: {reason}, {times} times: {}", path.display());
    }
    Ok(if failed.is_empty() { ExitCode::SUCCESS } else { ExitCode::FAILURE })
}
