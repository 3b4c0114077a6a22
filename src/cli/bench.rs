//! `egotac bench`: what accuracy costs and what breaks, measured on this machine.

mod label;
mod model;
mod train;

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
    /// What the network costs: latency and memory by preset, precision and threads, beside accuracy.
    Model(Box<model::Args>),
    /// What a training step costs, beside another program's.
    Train(train::Args),
    /// What labelling costs beside the network: reading, writing, geometry.
    Label(label::Args),
    /// What accuracy costs in simulation: errors against fine references, times, a Pareto plot.
    Sim(Sim),
    /// What retargeting costs and how exact it is, beside other programs.
    Retarget(Retarget),
    /// What each scene simulates, and what each effect costs in it.
    Effects(Effects),
    /// What goes wrong, what the guards say, and what helps: every hard case in three runs.
    HardCases(HardCases),
    /// What the guards cost: a step with and without them.
    Guards(Guards),
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

#[derive(Debug, clap::Args)]
struct Retarget {
    /// Robots (a name of `egotac retarget list`, a YAML file or a model); without them, those of the program whose models
    /// are part of it.
    robots: Vec<String>,
    /// Frames of the trajectory.
    #[arg(long, default_value_t = 10_000, value_parser = clap::value_parser!(u64).range(100..=1_000_000))]
    frames: u64,
    /// Seed of the trajectory and its noise.
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Command that runs a peer on the same vectors, such as `python benches/retarget_peer.py --peer dexi-rs`; repeatable.
    #[arg(long, value_name = "COMMAND")]
    peer: Vec<String>,
    /// What else the machine did, for the table.
    #[arg(long, value_name = "TEXT")]
    load: Option<String>,
    /// Print JSON in place of the tables.
    #[arg(long)]
    json: bool,
    /// Folder for retarget.md, retarget.json, retarget.png and retarget.svg.
    #[arg(long, value_name = "FOLDER")]
    out: Option<PathBuf>,
}

#[derive(Debug, clap::Args)]
struct Effects {
    /// Names of scenes (`egotac sim list`), or YAML files; without them, all that are part of the program.
    scenes: Vec<String>,
    /// Seed of the episodes.
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Width and height of the picture, pixels.
    #[arg(long, default_value_t = 224, value_parser = clap::value_parser!(u32).range(8..=1024))]
    size: u32,
    /// Folder for `effects.md` and `effects.json`.
    #[arg(long, value_name = "FOLDER")]
    out: PathBuf,
}

#[derive(Debug, clap::Args)]
struct HardCases {
    /// Folder for `hard-cases.md` and `hard-cases.json`; without it, only the verdicts are printed.
    #[arg(long, value_name = "FOLDER")]
    out: Option<PathBuf>,
    /// Only cases whose name contains this.
    #[arg(long, conflicts_with = "out")]
    only: Option<String>,
}

#[derive(Debug, clap::Args)]
struct Guards {
    /// Scenes to measure in.
    #[arg(default_values = ["pinch_cube", "lift_mug", "hover"])]
    scenes: Vec<String>,
    /// Measurements of each kind; the least counts.
    #[arg(long, default_value_t = 2000)]
    rounds: usize,
    /// JSON file to write.
    #[arg(long)]
    out: Option<PathBuf>,
}

/// Runs the command.
#[cfg(not(feature = "sim"))]
pub fn run(args: Args) -> anyhow::Result<ExitCode> {
    let name = match args.subject {
        Subject::Model(args) => return status(model::run(&args)?),
        Subject::Train(args) => return train::run(&args).map(|()| ExitCode::SUCCESS),
        Subject::Label(args) => return status(label::run(&args)?),
        Subject::Sim(_) => "bench sim",
        Subject::Retarget(_) => "bench retarget",
        Subject::Effects(_) => "bench effects",
        Subject::HardCases(_) => "bench hard-cases",
        Subject::Guards(_) => "bench guards",
    };
    Err(super::feature_off(name, "sim"))
}

/// Runs the command; the exit status is 1 if a case fails silently, the guards cost more than they
/// may, or a stream's memory grows.
#[cfg(feature = "sim")]
pub fn run(args: Args) -> anyhow::Result<ExitCode> {
    status(match args.subject {
        Subject::Model(args) => model::run(&args)?,
        Subject::Train(args) => train::run(&args).map(|()| true)?,
        Subject::Label(args) => label::run(&args)?,
        Subject::Sim(args) => with_sim::sim(&args)?,
        Subject::Retarget(args) => with_sim::retarget(&args)?,
        Subject::Effects(args) => with_sim::effects(&args)?,
        Subject::HardCases(args) => with_sim::hard_cases(&args)?,
        Subject::Guards(args) => with_sim::guards(&args)?,
    })
}

fn status(good: bool) -> anyhow::Result<ExitCode> {
    Ok(if good { ExitCode::SUCCESS } else { ExitCode::FAILURE })
}

#[cfg(feature = "sim")]
mod with_sim {
    use anyhow::{Context, ensure};
    use indicatif::ProgressBar;

    use super::{Effects, Guards, HardCases, Retarget, Sim};
    use crate::bench::hard_cases::{registry, report, run};
    use crate::bench::sim::knob::Knob;
    use crate::bench::sim::{self, KNOB_SCENES, Plan, markdown, pareto, throughput};
    use crate::bench::{Machine, effects, guards, retarget as retargeting};
    use crate::cli::progress;
    use crate::file;
    use crate::sim::{RolloutOptions, SHIPPED, Scene, WorkerCommand};

    pub fn sim(args: &Sim) -> anyhow::Result<bool> {
        let scenes = scenes(&args.scenes)?;
        let knob_scenes = match args.scenes.is_empty() {
            true => KNOB_SCENES.map(str::to_owned).into(),
            false => scenes.iter().map(|scene| scene.name.clone()).collect(),
        };
        let workers = match args.knobs.is_empty() {
            true => Some(workers(args)?),
            false => None,
        };
        let knobs = match args.knobs.is_empty() {
            true => Knob::ALL.into(),
            false => args.knobs.iter().map(|name| Knob::from_name(name)).collect::<crate::Result<_>>()?,
        };
        let plan = Plan {
            command: command(args),
            scenes,
            knob_scenes,
            workers,
            knobs,
            seed: args.seed,
            seeds: args.seeds,
            repetitions: args.repetitions as usize,
            options: RolloutOptions { picture: None, ..RolloutOptions::default() },
        };
        let bar = progress::told_bar();
        let report = sim::run(&plan, |what, done, all| say(&bar, what, done, all))?;
        bar.finish_and_clear();
        let table = markdown::render(&report);
        file::write(&args.out.join("sim.json"), report.to_json()?.as_bytes())?;
        file::write(&args.out.join("sim.md"), table.as_bytes())?;
        let mut written = vec!["sim.json", "sim.md"];
        match pareto::write(&args.out, &report)? {
            true => written.extend(["sim.png", "sim.svg"]),
            false => println!("no plot: no hand presses in these scenes, so there are no forces to compare"),
        }
        print!("{table}");
        let written: Vec<String> = written.iter().map(|file| args.out.join(file).display().to_string()).collect();
        println!("\nwrote {}", written.join(", "));
        Ok(true)
    }

    /// This program with the scenes on which `generate` is timed.
    fn workers(args: &Sim) -> anyhow::Result<WorkerCommand> {
        let names = match args.scenes.as_slice() {
            [] => SHIPPED
                .iter()
                .map(|(name, _)| *name)
                .filter(|name| KNOB_SCENES.contains(name))
                .map(Into::into)
                .collect(),
            names => names.to_vec(),
        };
        let program = std::env::current_exe().context("where this program lies")?;
        let size = throughput::SIZE.to_string();
        let arguments = ["sim", "worker", "--size", &size, "--"].map(Into::into);
        Ok(WorkerCommand {
            program,
            arguments: arguments.into_iter().chain(names.into_iter().map(Into::into)).collect(),
        })
    }

    /// Those named, or all that are part of the program.
    fn scenes(names: &[String]) -> crate::Result<Vec<Scene>> {
        match names {
            [] => SHIPPED.iter().map(|(name, _)| Scene::load(name)).collect(),
            names => names.iter().map(|name| Scene::load(name)).collect(),
        }
    }

    fn say(bar: &ProgressBar, what: &str, done: usize, all: usize) {
        progress::step(bar, done, all);
        bar.set_message(what.to_owned());
    }

    pub fn effects(args: &Effects) -> anyhow::Result<bool> {
        let mut words = vec!["egotac bench effects".to_owned()];
        words.extend(args.scenes.iter().cloned());
        words.push(format!("--seed {} --size {} --out {}", args.seed, args.size, args.out.display()));
        let bar = progress::told_bar();
        let scenes = scenes(&args.scenes)?;
        let report = effects::measure(words.join(" "), &scenes, args.seed, args.size, |what, done, all| {
            say(&bar, what, done, all);
        })?;
        bar.finish_and_clear();
        let table = effects::markdown(&report);
        file::write(&args.out.join("effects.md"), table.as_bytes())?;
        file::write(&args.out.join("effects.json"), serde_json::to_string_pretty(&report)?.as_bytes())?;
        print!("{table}");
        println!("wrote {0}/effects.md and {0}/effects.json", args.out.display());
        Ok(true)
    }

    pub fn retarget(args: &Retarget) -> anyhow::Result<bool> {
        use crate::retarget::robot::source;
        let robots = match args.robots.is_empty() {
            true => source::names().filter(|name| source::has_own_model(name)).map(str::to_owned).collect(),
            false => args.robots.clone(),
        };
        let mut words = vec!["egotac bench retarget".to_owned()];
        words.extend(args.robots.iter().cloned());
        words.push(format!("--frames {} --seed {}", args.frames, args.seed));
        words.extend(args.peer.iter().map(|peer| format!("--peer {peer:?}")));
        let plan = retargeting::Plan {
            command: words.join(" "),
            robots,
            frames: args.frames as usize,
            seed: args.seed,
            peers: args.peer.clone(),
            load: args.load.clone(),
        };
        let bar = progress::told_bar();
        let report = retargeting::run(&plan, |what| bar.set_message(what.to_owned()))?;
        bar.finish_and_clear();
        let (table, json) = (retargeting::table::markdown(&report), serde_json::to_string_pretty(&report)?);
        match args.json {
            true => println!("{json}"),
            false => print!("{table}"),
        }
        if let Some(folder) = &args.out {
            file::write(&folder.join("retarget.md"), table.as_bytes())?;
            file::write(&folder.join("retarget.json"), json.as_bytes())?;
            retargeting::plot::write(folder, &report)?;
            eprintln!("wrote {0}/retarget.md and {0}/retarget.json", folder.display());
        }
        Ok(true)
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

    pub fn hard_cases(args: &HardCases) -> anyhow::Result<bool> {
        let wanted = |name: &str| args.only.as_ref().is_none_or(|part| name.contains(part.as_str()));
        let mut rows = Vec::new();
        let mut good = true;
        for case in registry().iter().filter(|case| wanted(case.name)) {
            let row = run(case).with_context(|| format!("case {}", case.name))?;
            let outcome = &row.outcome;
            let verdict = outcome.verdict();
            let before = outcome.unguarded.map_or("refused".into(), |error| format!("{error:.2e}"));
            println!("{:32} {before:>9} -> {:.2e}  {}", row.name, outcome.remedied, outcome.guard);
            if let Err(why) = verdict {
                good = false;
                println!("{:32} FAILED: {why}", "");
            }
            rows.push(row);
        }
        ensure!(!rows.is_empty(), "--only: no case has that in its name");
        if let Some(folder) = &args.out {
            let machine = Machine::this();
            file::write(&folder.join("hard-cases.md"), report::markdown(&rows, &machine).as_bytes())?;
            let json = serde_json::to_string_pretty(&report::json(&rows, &machine))?;
            file::write(&folder.join("hard-cases.json"), json.as_bytes())?;
            println!("wrote {0}/hard-cases.md and {0}/hard-cases.json", folder.display());
        }
        Ok(good)
    }

    pub fn guards(args: &Guards) -> anyhow::Result<bool> {
        ensure!(args.rounds > 0, "--rounds: expected at least 1, got 0");
        let scenes: Vec<&str> = args.scenes.iter().map(String::as_str).collect();
        let prices = guards::measure(&scenes, args.rounds)?;
        println!(
            "{:16} {:>8} {:>9} {:>9} {:>9} {:>7}",
            "scene", "contacts", "step us", "guard us", "frame us", "share"
        );
        for price in &prices.scenes {
            let (step, guard, frame) = (price.step_us, price.guard_us, price.frame_us);
            let percent = 100.0 * price.share;
            println!("{:16} {:8} {step:9.2} {guard:9.2} {frame:9.2} {percent:6.2}%", price.scene, price.contacts);
        }
        if let Some(out) = &args.out {
            file::write(out, serde_json::to_string_pretty(&prices)?.as_bytes())?;
            println!("wrote {}", out.display());
        }
        let most = prices.scenes.iter().map(|price| price.share).fold(0.0, f64::max);
        if most > guards::BUDGET {
            println!("guards cost {:.1} %, allowed are {:.0} %", 100.0 * most, 100.0 * guards::BUDGET);
        }
        Ok(most <= guards::BUDGET)
    }
}
