//! `egotac bench`: measurements whose tables are part of the documentation.

use std::path::PathBuf;
use std::process::ExitCode;

/// Arguments of `egotac bench`.
#[derive(Debug, clap::Args)]
pub struct Args {
    #[command(subcommand)]
    subject: Subject,
}

#[derive(Debug, clap::Subcommand)]
enum Subject {
    /// What accuracy costs in simulation: errors against fine references, times, a Pareto plot.
    Sim(Sim),
}

#[derive(Debug, clap::Args)]
struct Sim {
    /// Names of scenes (`egotac sim list`), or YAML files; without them, presets are compared on all scenes that are
    /// part of the program, and the other knobs on two of them.
    scenes: Vec<String>,
    /// What to turn, comma separated: preset, timestep, cone, iterations, integrator, impratio, hull, label, size,
    /// shadows. Without it all of them, the wrapper's overhead and the speed of `egotac sim generate`.
    #[arg(long, value_delimiter = ',')]
    knobs: Vec<String>,
    /// First seed.
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Seeds over which errors are pooled; times are those of the first.
    #[arg(long, default_value_t = 1, value_parser = clap::value_parser!(u64).range(1..=1000))]
    seeds: u64,
    /// Interleaved repetitions of which the least time counts.
    #[arg(long, default_value_t = 3, value_parser = clap::value_parser!(u64).range(1..=100))]
    repetitions: u64,
    /// Folder for sim.json, sim.md, sim.png and sim.svg.
    #[arg(long)]
    out: PathBuf,
}

/// Runs the command.
#[cfg(not(feature = "sim"))]
pub fn run(args: Args) -> anyhow::Result<ExitCode> {
    let name = match args.subject {
        Subject::Sim(_) => "bench sim",
    };
    Err(super::feature_off(name, "sim"))
}

/// Runs the command.
#[cfg(feature = "sim")]
pub fn run(args: Args) -> anyhow::Result<ExitCode> {
    match args.subject {
        Subject::Sim(args) => with_sim::sim(&args)?,
    }
    Ok(ExitCode::SUCCESS)
}

#[cfg(feature = "sim")]
mod with_sim {
    use indicatif::{ProgressBar, ProgressStyle};

    use super::Sim;
    use crate::bench::sim::knob::Knob;
    use crate::bench::sim::{KNOB_SCENES, Plan, markdown, pareto, run};
    use crate::file;
    use crate::sim::{RolloutOptions, SHIPPED, Scene};

    pub fn sim(args: &Sim) -> anyhow::Result<()> {
        let names: Vec<String> = match args.scenes.is_empty() {
            true => SHIPPED.iter().map(|(name, _)| (*name).to_owned()).collect(),
            false => args.scenes.clone(),
        };
        let scenes = names.iter().map(|name| Scene::load(name)).collect::<crate::Result<Vec<_>>>()?;
        let knob_scenes = match args.scenes.is_empty() {
            true => KNOB_SCENES.map(str::to_owned).into(),
            false => scenes.iter().map(|scene| scene.name.clone()).collect(),
        };
        let knobs = match args.knobs.is_empty() {
            true => Knob::ALL.into(),
            false => args.knobs.iter().map(|name| Knob::from_name(name)).collect::<crate::Result<_>>()?,
        };
        let plan = Plan {
            command: command(args),
            scenes,
            knob_scenes,
            speed: args.knobs.is_empty(),
            knobs,
            seed: args.seed,
            seeds: args.seeds,
            repetitions: args.repetitions as usize,
            options: RolloutOptions { picture: None, ..RolloutOptions::default() },
        };
        let bar = ProgressBar::new(0);
        if let Ok(style) = ProgressStyle::with_template("{bar:30} {pos}/{len} {msg} ({elapsed})") {
            bar.set_style(style);
        }
        let report = run(&plan, |what, done, all| {
            bar.set_length(all as u64);
            bar.set_position(done as u64);
            bar.set_message(what.to_owned());
        })?;
        bar.finish_and_clear();
        let table = markdown::render(&report);
        file::write(&args.out.join("sim.json"), report.to_json()?.as_bytes())?;
        file::write(&args.out.join("sim.md"), table.as_bytes())?;
        pareto::write(&args.out, &report)?;
        print!("{table}");
        println!(
            "\nwrote {}",
            ["sim.json", "sim.md", "sim.png", "sim.svg"].map(|f| args.out.join(f).display().to_string()).join(", ")
        );
        Ok(())
    }

    /// The command that measures the same again.
    fn command(args: &Sim) -> String {
        let mut words = vec!["egotac bench sim".to_owned()];
        words.extend(args.scenes.iter().cloned());
        if !args.knobs.is_empty() {
            words.push(format!("--knobs {}", args.knobs.join(",")));
        }
        let Sim { seed, seeds, repetitions, out, .. } = args;
        words.push(format!("--seed {seed} --seeds {seeds} --repetitions {repetitions} --out {}", out.display()));
        words.join(" ")
    }
}
