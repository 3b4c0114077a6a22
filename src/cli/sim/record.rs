//! `egotac sim run` and `egotac sim generate`, and the worker processes of the latter.

use std::ffi::OsString;
use std::path::Path;

use anyhow::Context;

use super::shared::{load, options, with_hands};
use super::{Accuracy, Generate, RolloutArgs, Run, Worker};
use crate::cli::progress;
use crate::mujoco::{PhysicsOptions, Preset};
use crate::sim::budget::{self, Request, Table};
use crate::sim::scene::Split;
use crate::sim::{self, RecordSummary, Scene, WorkerCommand};
use crate::trial;

pub fn run(args: &Run) -> anyhow::Result<()> {
    let factor = factor(&args.accuracy)?;
    let scene = with_hands(load(&args.scene)?, &args.rollout)?;
    let scene = with_printed_accuracy(scene, &args.accuracy, factor)?;
    let bar = progress::bar("frames");
    let options = options(&args.rollout, args.size)?;
    let summary = sim::record(&scene, args.seed, &options, &args.out, |done, all| progress::step(&bar, done, all))?;
    bar.finish_and_clear();
    print(&summary, &args.out);
    Ok(())
}

pub fn generate(args: &Generate) -> anyhow::Result<()> {
    let factor = factor(&args.accuracy)?;
    let names = scene_names(args)?;
    let scenes =
        names.iter().map(|name| with_printed_accuracy(with_hands(load(name)?, &args.rollout)?, &args.accuracy, factor));
    let plan = sim::DatasetPlan {
        scenes: scenes.collect::<anyhow::Result<_>>()?,
        episodes: args.episodes,
        seed: args.seed,
        jobs: args.jobs,
        options: options(&args.rollout, args.size)?,
    };
    let [episodes, chunks] = ["episodes", "chunks of the store"].map(progress::bar);
    let progress = |at| match at {
        sim::GenerateProgress::Episodes(done, all) => progress::step(&episodes, done, all),
        sim::GenerateProgress::Chunks(done, all) => {
            episodes.finish_and_clear();
            progress::step(&chunks, done, all);
        }
    };
    let summary = match args.in_process {
        true => sim::generate(&plan, &args.out, progress)?,
        false => {
            sim::generate_in_processes(&plan, &workers(args, &names, factor)?, args.skip_failed, &args.out, progress)?
        }
    };
    chunks.finish_and_clear();
    print(&summary, &args.out);
    Ok(())
}

/// Returns the names of the scenes to simulate: those given, or those of the split.
fn scene_names(args: &Generate) -> anyhow::Result<Vec<String>> {
    match &args.split {
        Some(name) => Ok(Split::named(name)?.scene_names(name)),
        None => Ok(args.scenes.clone()),
    }
}

/// Returns the command that starts this program as a worker with the same scenes and options.
fn workers(args: &Generate, scenes: &[String], factor: Option<f64>) -> anyhow::Result<WorkerCommand> {
    let mut arguments: Vec<OsString> = vec!["--size".into(), args.size.to_string().into()];
    let RolloutArgs { shadows, look, backgrounds, objects, present, kernel, hands } = &args.rollout;
    arguments.extend(["--sigma".into(), kernel.sigma.to_string().into()]);
    if *shadows {
        arguments.push("--shadows".into());
    }
    if let Some(look) = look {
        arguments.extend(["--look".into(), look.into()]);
    }
    if let Some(present) = present {
        arguments.extend(["--hands".into(), present.into()]);
    }
    let Accuracy { preset, budget, error } = &args.accuracy;
    let preset = preset.clone().map(|name| ("--preset", name));
    let budget = budget.map(|seconds| ("--budget", format!("{seconds}s")));
    let error = error.map(|share| ("--error", format!("{}%", 100.0 * share)));
    // Measured once, so that all workers choose the preset that was printed. Rust prints all digits of a number.
    let factor = factor.map(|factor| ("--budget-factor", factor.to_string()));
    for (flag, value) in [preset, budget, error, factor].into_iter().flatten() {
        arguments.extend([flag.into(), value.into()]);
    }
    let folders = [("--backgrounds", backgrounds), ("--objects", objects)];
    for (flag, path) in
        folders.into_iter().chain([("--mano-left", &hands.mano_left), ("--mano-right", &hands.mano_right)])
    {
        arguments.extend(path.iter().flat_map(|path| [flag.into(), path.clone().into_os_string()]));
    }
    arguments.push("--".into());
    arguments.extend(scenes.iter().map(OsString::from));
    Ok(WorkerCommand::of_this_program(arguments)?)
}

pub fn work(args: &Worker) -> anyhow::Result<()> {
    trial::end_with_parent(args.parent)?;
    trial::trust_parent();
    let factor = args.budget_factor.map_or_else(|| factor(&args.accuracy), |factor| Ok(Some(factor)))?;
    let scenes = args.scenes.iter().map(|name| {
        let scene = with_hands(Scene::load(name)?, &args.rollout)?;
        Ok(with_accuracy(scene, &args.accuracy, factor)?.0)
    });
    let scenes = scenes.collect::<anyhow::Result<Vec<_>>>()?;
    let options = options(&args.rollout, args.size)?;
    sim::worker_process::serve(&scenes, &options, std::io::stdin().lock(), std::io::stdout().lock())?;
    Ok(())
}

/// Measures this machine against the table's, or reads the cached result; `None` without a budget, as nothing else needs
/// it.
fn factor(accuracy: &Accuracy) -> anyhow::Result<Option<f64>> {
    match accuracy.budget {
        Some(_) => Ok(Some(budget::this_machines_factor(&Table::shipped()?)?)),
        None => Ok(None),
    }
}

/// Applies the accuracy options as [`with_accuracy`], and prints the notes.
fn with_printed_accuracy(scene: Scene, accuracy: &Accuracy, factor: Option<f64>) -> anyhow::Result<Scene> {
    let (scene, notes) = with_accuracy(scene, accuracy, factor)?;
    notes.iter().for_each(|line| println!("{line}"));
    Ok(scene)
}

/// Returns the scene with the selected preset, and notes for the user.
fn with_accuracy(mut scene: Scene, accuracy: &Accuracy, factor: Option<f64>) -> anyhow::Result<(Scene, Vec<String>)> {
    let mut notes = Vec::new();
    let request = Request { budget: accuracy.budget, error: accuracy.error };
    let preset = match &accuracy.preset {
        Some(name) => Preset::from_name(name)?,
        None if request == Request::default() => return Ok((scene, notes)),
        None => {
            let choice = budget::pick(&Table::shipped()?, factor.unwrap_or(1.0), &scene.name, request)?;
            notes.push(format!("{}: preset {choice}: {}, by {}", scene.name, choice.reason, choice.basis));
            choice.preset
        }
    };
    let physics = &scene.spec.physics;
    if *physics != PhysicsOptions::preset(physics.preset) {
        notes.push(format!("{}: the preset replaces the scene's physics values, except gravity", scene.name));
    }
    scene.spec.physics = physics.with_preset(preset);
    let interval = 1.0 / scene.spec.rate;
    scene.spec.physics.steps_in(interval).with_context(|| format!("{} with preset {}", scene.name, preset.name()))?;
    Ok((scene, notes))
}

fn print(summary: &RecordSummary, out: &Path) {
    println!(
        "wrote {}: {} frames, {} with touch; largest force {:.2} N; residuals: sum {:.1e}, moment {:.1e} N m",
        out.display(),
        summary.frames,
        summary.touching,
        summary.max_force,
        summary.sum_residual,
        summary.moment_residual,
    );
    for failed in &summary.failed {
        println!("left out: {failed}");
    }
    for (reason, count) in &summary.invalid {
        println!("{count} invalid frames: {reason}");
    }
}
