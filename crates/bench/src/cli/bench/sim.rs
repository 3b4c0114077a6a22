//! `egotac bench sim`.

#[cfg(feature = "sim")]
use egotac::sim::{RolloutOptions, WorkerCommand};
#[cfg(feature = "sim")]
use egotac::text::tell;

#[cfg(feature = "sim")]
use super::{load_scenes, show};
use crate::cli::output::Output;
#[cfg(feature = "sim")]
use crate::sim::{self, KNOB_SCENES, Plan, knob::Knob, markdown, pareto, throughput};

/// Arguments of `egotac bench sim`.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Names of scenes (`egotac sim list`), or YAML files; without them, presets are compared on all scenes that are
    /// part of the program, and the other knobs on two of them.
    scenes: Vec<String>,
    /// Knobs to compare, comma separated: preset, timestep, cone, iterations, integrator, impratio, hull, grid, label, size,
    /// shadows. Without it all of them, the wrapper's overhead and the speed of `egotac sim generate`.
    #[arg(long, value_delimiter = ',')]
    knobs: Vec<String>,
    /// First seed.
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Seeds over which errors are pooled; times are those of the first.
    #[arg(long, default_value_t = 1, value_parser = clap::value_parser!(u64).range(1..=1000))]
    seeds: u64,
    /// Interleaved repetitions; the least time counts.
    #[arg(long, default_value_t = 3, value_parser = clap::value_parser!(u64).range(1..=100))]
    repetitions: u64,
    #[command(flatten)]
    output: Output,
}

/// Runs the subject.
#[cfg(feature = "sim")]
pub fn run(args: &Args) -> anyhow::Result<()> {
    let plan = plan(args)?;
    let bar = egotac::cli::progress::told_bar("measurements");
    let report = sim::run(&plan, |what, done, all| show(&bar, what, done, all))?;
    bar.finish_and_clear();
    args.output.write("sim", &report, &markdown::render(&report))?;
    if let Some(folder) = args.output.folder()
        && !pareto::write(folder, &report)?
    {
        tell(format_args!("no plot: no hand presses in these scenes, so there are no forces to compare"));
    }
    Ok(())
}

#[cfg(feature = "sim")]
fn plan(args: &Args) -> anyhow::Result<Plan> {
    let scenes = load_scenes(&args.scenes)?;
    let knob_scenes: Vec<String> = match args.scenes.is_empty() {
        true => KNOB_SCENES.map(str::to_owned).into(),
        false => scenes.iter().map(|scene| scene.name.clone()).collect(),
    };
    let all_knobs = args.knobs.is_empty();
    let knobs = match all_knobs {
        true => Knob::ALL.into(),
        false => args.knobs.iter().map(|name| Knob::from_name(name)).collect::<egotac::Result<_>>()?,
    };
    Ok(Plan {
        command: command(args),
        scenes,
        knob_scenes,
        workers: if all_knobs { Some(workers(args)?) } else { None },
        knobs,
        seed: args.seed,
        seeds: args.seeds,
        repetitions: args.repetitions as usize,
        options: RolloutOptions { picture: None, ..RolloutOptions::default() },
    })
}

/// Returns the worker processes that time `generate`: this program with the scenes as they were named.
#[cfg(feature = "sim")]
fn workers(args: &Args) -> anyhow::Result<WorkerCommand> {
    let shipped = egotac::sim::SHIPPED.iter().map(|(name, _)| *name).filter(|name| KNOB_SCENES.contains(name));
    let names: Vec<String> = match args.scenes.as_slice() {
        [] => shipped.map(Into::into).collect(),
        names => names.to_vec(),
    };
    crate::cli::sim_workers(throughput::SIZE, names.into_iter().map(Into::into))
}

/// Returns the command that measures the same again.
#[cfg(feature = "sim")]
fn command(args: &Args) -> String {
    let mut words = vec!["egotac bench sim".to_owned()];
    words.extend(args.scenes.iter().cloned());
    if !args.knobs.is_empty() {
        words.push(format!("--knobs {}", args.knobs.join(",")));
    }
    let Args { seed, seeds, repetitions, output, .. } = args;
    words.push(format!("--seed {seed} --seeds {seeds} --repetitions {repetitions}{}", output.words()));
    words.join(" ")
}
