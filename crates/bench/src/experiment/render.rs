//! Rendering of the stores that an experiment needs.

use std::ffi::OsString;
use std::path::Path;

use egotac::error::{Error, Result};
use egotac::file;
use egotac::hand::{HandModel, Side};
use egotac::sim::{DatasetPlan, GenerateProgress, RolloutOptions, Scene, WorkerCommand, generate_in_processes};

use super::Progress;
use super::recipe::Recipe;

/// Renders the stores that are missing. A stopped rendering goes on where it was.
///
/// # Errors
/// If a scene can't be read, no episode of a store can be simulated, or a file can't be written.
pub fn render(recipes: &[Recipe], progress: &mut dyn FnMut(Progress)) -> Result<()> {
    let mut missing: Vec<&Recipe> = Vec::new();
    for recipe in recipes.iter().filter(|recipe| !recipe.path.exists()) {
        if !missing.iter().any(|other| other.path == recipe.path) {
            missing.push(recipe);
        }
    }
    let all: u64 = missing.iter().map(|recipe| recipe.episodes as u64).sum();
    let mut done = 0;
    for recipe in missing {
        write_scene(recipe)?;
        make(recipe)?;
        done += recipe.episodes as u64;
        progress(Progress::Rendered(done, all));
    }
    Ok(())
}

/// Writes the scene file of a store that has one.
///
/// # Errors
/// If it can't be written.
pub(super) fn write_scene(recipe: &Recipe) -> Result<()> {
    match recipe.text.is_empty() {
        true => Ok(()),
        false => file::write(&recipe.scene, recipe.text.as_bytes()),
    }
}

fn make(recipe: &Recipe) -> Result<()> {
    let scene = recipe.scene.display().to_string();
    let mut options = RolloutOptions { picture: Some((recipe.side, recipe.side)), ..RolloutOptions::default() };
    let mut arguments: Vec<OsString> = vec!["--size".into(), recipe.side.to_string().into()];
    if let Some([left, right]) = &recipe.mano {
        options.hands = [HandModel::load(left, Side::Left)?, HandModel::load(right, Side::Right)?];
        arguments.extend(["--mano-left".into(), left.into(), "--mano-right".into(), right.into()]);
    }
    arguments.extend(["--".into(), scene.clone().into()]);
    let plan = DatasetPlan {
        scenes: vec![Scene::load(&scene)?],
        episodes: recipe.episodes,
        seed: recipe.seed,
        jobs: std::thread::available_parallelism().map_or(1, usize::from).min(recipe.episodes),
        options,
    };
    let workers = WorkerCommand::of_this_program(arguments)?;
    let folder = recipe.path.parent().unwrap_or(Path::new("."));
    std::fs::create_dir_all(folder).map_err(Error::io(folder))?;
    // An episode that can't be simulated is left out: always the same one, and the report counts the frames that exist.
    generate_in_processes(&plan, &workers, true, &recipe.path, |_: GenerateProgress| ())?;
    Ok(())
}
