//! Faults while a command writes its output: kills, errors of the disk, two runs at once, inputs that change.
//!
//! A later command is one more [`subject::Subject`], a later fault one more [`fault::Fault`].

mod alter;
pub mod case;
pub mod check;
pub mod content;
pub mod fault;
pub mod inject;
pub mod input;
mod judge;
pub mod process;
mod small_disk;
pub mod subject;
pub mod table;

use std::fs;
use std::path::{Path, PathBuf};

use egotac::error::{Error, Result};
use egotac::machine::Machine;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

use case::{Bench, Draw, undisturbed};
use check::{Harm, Reference};
use fault::Fault;
use inject::Library;
use small_disk::SmallDisk;
use subject::{Kind, Subject};
pub use table::{FaultsReport, Row};

/// Choice of cases.
#[derive(Debug, Clone, Default)]
pub struct Options {
    /// A few cases of each command.
    pub short: bool,
    /// Runs of each command with a fault that may hit any moment; of the other faults there are a quarter, of the experiment
    /// an eighth.
    pub runs: usize,
    /// Seed of the times at which faults happen.
    pub seed: u64,
    /// Parts of the names of commands to run; empty = all.
    pub only: Vec<String>,
    /// The program under test, which takes egotac's commands.
    pub program: PathBuf,
    /// Empty folder for inputs and outputs.
    pub folder: PathBuf,
}

/// Runs all cases; calls `progress` with the row after its last case.
///
/// # Errors
/// If there is no C compiler, an input can't be made, or a command fails without a fault.
pub fn run(options: &Options, command: String, mut progress: impl FnMut(&Row)) -> Result<FaultsReport> {
    let folder = options.folder.canonicalize().map_err(Error::io(&options.folder))?;
    let library = Library::compile(&folder)?;
    let subjects = Subject::all(&folder.join("inputs"), &options.only, options.seed)?;
    let mut rows = Vec::new();
    let has_cases = |subject: &&Subject| Fault::ALL.iter().any(|fault| fault.runs(subject, options.short, 1) > 0);
    let small_disk = SmallDisk::is_possible();
    let faults: Vec<_> = Fault::ALL.into_iter().filter(|fault| *fault != Fault::SmallDisk || small_disk).collect();
    for subject in subjects.iter().filter(has_cases) {
        let work = folder.join("work").join(subject.name.replace(", ", "-").replace(' ', "-"));
        rows.extend(rows_of(subject, &faults, options, &library, &work, &mut progress)?);
        fs::remove_dir_all(&work).map_err(Error::io(&work))?;
    }
    let machine = Machine::this();
    Ok(FaultsReport { command, version: egotac::VERSION, machine, seed: options.seed, small_disk, rows })
}

fn rows_of(
    subject: &Subject,
    faults: &[Fault],
    options: &Options,
    library: &Library,
    work: &Path,
    progress: &mut impl FnMut(&Row),
) -> Result<Vec<Row>> {
    let Options { short, runs, seed, program, .. } = options;
    let [first, second] = ["first", "second"].map(|name| work.join(name));
    // The first run of the experiment renders its data, which all others use.
    let rendered = match subject.kind {
        Kind::Experiment => first.join(subject.out).join("work/data"),
        _ => PathBuf::new(),
    };
    let run = |input: &Option<PathBuf>, folder: &Path, rendered: &Path| {
        undisturbed(program, subject, input.as_deref(), folder, rendered)
    };
    run(&subject.input, &first, Path::new(""))?;
    let secs = run(&subject.input, &second, &rendered)?;
    let [outs_first, outs_second] = [&first, &second].map(|run| run.join(subject.out));
    let reference = Reference::read(&outs_first, &outs_second, subject.sets)?;
    let mut other = None;
    if subject.other.is_some() {
        let folder = work.join("other");
        run(&subject.other, &folder, Path::new(""))?;
        other = Some(Reference::read(&folder.join(subject.out), &folder.join(subject.out), subject.sets)?);
    }
    let (calls, reference, other) = (Default::default(), &reference, other.as_ref());
    let mut bench = Bench { program, library, subject, reference, other, secs, calls, rendered };
    bench.calls[0] = bench.count(&work.join("counted"), None)?;
    if let Some(input) = &subject.input {
        bench.calls[1] = bench.count(&work.join("counted-input"), Some(input))?;
    }
    let mut rng = ChaCha8Rng::seed_from_u64(*seed);
    let mut rows = Vec::new();
    for &fault in faults {
        let runs = fault.runs(subject, *short, *runs);
        let mut cases: Vec<(Harm, f64)> = Vec::new();
        for run in 0..runs {
            let draw = Draw { run, runs, share: rng.random_range(0.05..1.0) };
            let place = work.join("case");
            let outcome = bench.case(fault, draw, &place)?;
            fs::remove_dir_all(&place).map_err(Error::io(&place))?;
            cases.push((outcome.harm, outcome.recovery_secs));
        }
        if runs > 0 {
            let row = Row::of(subject.name, fault.name(), &cases);
            progress(&row);
            rows.push(row);
        }
    }
    Ok(rows)
}
