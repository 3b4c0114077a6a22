//! `egotac experiment`.

use std::path::PathBuf;
use std::process::ExitCode;

use egotac::file;
use indicatif::{ProgressBar, ProgressStyle};

use crate::experiment::data::{Recipe, Stores};
use crate::experiment::{self, Experiment, Progress, Size, plot};

/// Arguments of `egotac experiment`.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "ablations: everything, and without temporal context, active-region loss, force supervision, consistency loss. \
    sources: force-supervised only, contact-only, mixed. scaling: 10, 20, 50, 100 % of the data; 1, 4, 6 scenes. \
    limits: less and more time, resolution, capacity.\n\
    Data is rendered and runs are trained in the work folder; both stay there, so a stopped experiment resumes."
)]
pub struct Args {
    /// ablations, sources, scaling or limits.
    name: String,
    /// Runs of each arm.
    #[arg(long, default_value_t = 2, value_parser = clap::value_parser!(u64).range(1..=100))]
    seeds: u64,
    /// Optimisation steps of the encoder of all runs, before the runs.
    #[arg(long, default_value_t = 4000, value_parser = clap::value_parser!(u64).range(1..=10_000_000))]
    encoder_steps: u64,
    /// Optimisation steps of a run.
    #[arg(long, default_value_t = 1200, value_parser = clap::value_parser!(u64).range(1..=10_000_000))]
    steps: u64,
    /// Training episodes of each of the eight scenes.
    #[arg(long, default_value_t = 25, value_parser = clap::value_parser!(u64).range(1..=900))]
    episodes: u64,
    /// Held-out episodes of each scene.
    #[arg(long, default_value_t = 6, value_parser = clap::value_parser!(u64).range(1..=900))]
    held_out: u64,
    /// Folder for data and runs.
    #[arg(long, value_name = "FOLDER", default_value = "out/experiments")]
    work: PathBuf,
    /// Folder for NAME.md, NAME.json, NAME.png and NAME.svg.
    #[arg(long, value_name = "FOLDER", default_value = "docs/results")]
    out: PathBuf,
}

/// Runs the command.
pub fn run(args: Args) -> anyhow::Result<ExitCode> {
    let experiment = Experiment::by_name(&args.name)?;
    let size = Size {
        episodes: args.episodes as usize,
        held_out: args.held_out as usize,
        encoder_steps: args.encoder_steps as usize,
        steps: args.steps as usize,
        seeds: args.seeds,
    };
    let stores = Stores::plan(&args.work.join("data"), size.episodes, size.held_out);
    render(stores.recipes())?;
    let bar = ProgressBar::new(0);
    bar.set_style(ProgressStyle::with_template("{bar:30} {pos}/{len} {elapsed}<{eta} {msg}")?);
    let command = format!(
        "egotac experiment {} --seeds {} --encoder-steps {} --steps {} --episodes {} --held-out {}",
        args.name, args.seeds, args.encoder_steps, args.steps, args.episodes, args.held_out
    );
    let report = experiment::run(&experiment, &size, &stores, &args.work, command, &mut |progress| match progress {
        Progress::Budget(budget) => bar.suspend(|| {
            let minutes = budget.windows as f64 / budget.windows_per_s / 60.0;
            println!(
                "{} runs to make, {} windows altogether: about {minutes:.0} min at {:.0} windows/s, measured now",
                budget.runs, budget.windows, budget.windows_per_s
            );
        }),
        Progress::Step(arm, seed, done, all) => {
            bar.set_length(all as u64);
            bar.set_position(done as u64);
            bar.set_message(format!("{arm}, seed {seed}"));
        }
        Progress::Run(arm, seed) => bar.suspend(|| println!("{arm}, seed {seed}: done")),
    })?;
    bar.finish_and_clear();
    let named = |ending: &str| args.out.join(format!("{}.{ending}", args.name));
    file::write(&named("md"), report.markdown().as_bytes())?;
    file::write(&named("json"), format!("{:#}\n", serde_json::to_value(&report)?).as_bytes())?;
    plot::write(&args.out, &report)?;
    print!("{}", report.markdown());
    Ok(ExitCode::SUCCESS)
}

/// Renders the stores that are missing.
fn render(recipes: &[Recipe]) -> anyhow::Result<()> {
    let missing: Vec<&Recipe> = recipes.iter().filter(|recipe| !recipe.path.exists()).collect();
    let bar = ProgressBar::new(missing.iter().map(|recipe| recipe.episodes as u64).sum());
    bar.set_style(ProgressStyle::with_template("{bar:30} {pos}/{len} episodes {elapsed}<{eta}")?);
    for recipe in missing {
        file::write(&recipe.scene, recipe.text.as_bytes())?;
        make(recipe, &bar)?;
    }
    bar.finish_and_clear();
    Ok(())
}

#[cfg(feature = "sim")]
fn make(recipe: &Recipe, bar: &ProgressBar) -> anyhow::Result<()> {
    use crate::experiment::data::SIDE;
    use egotac::sim::{Generate, Progress as Rendered, RolloutOptions, Scene, generate_isolated};
    let options = RolloutOptions { picture: Some((SIDE, SIDE)), ..RolloutOptions::default() };
    let plan = Generate {
        scenes: vec![Scene::load(&recipe.scene.display().to_string())?],
        episodes: recipe.episodes,
        seed: recipe.seed,
        jobs: std::thread::available_parallelism().map_or(1, usize::from).min(recipe.episodes),
        options,
    };
    let workers = crate::cli::sim_workers(SIDE, [recipe.scene.clone().into_os_string()])?;
    let before = bar.position();
    // An episode that can't be simulated is left out: always the same one, and the report counts the frames that exist.
    generate_isolated(&plan, &workers, true, &recipe.path, |at| {
        if let Rendered::Episodes(done, _) = at {
            bar.set_position(before + done as u64);
        }
    })?;
    Ok(())
}

#[cfg(not(feature = "sim"))]
fn make(recipe: &Recipe, _: &ProgressBar) -> anyhow::Result<()> {
    anyhow::bail!("{}: is missing, and rendering it needs the feature `sim`", recipe.path.display())
}
