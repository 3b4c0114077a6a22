//! Rendering of the stores that an experiment needs.

use std::path::Path;

use egotac::error::{Error, Result};
use egotac::file;
use egotac::sim::{DatasetPlan, GenerateProgress, RolloutOptions, Scene, WorkerCommand, generate_in_processes};

use super::Progress;
use super::data::Recipe;

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
        if !recipe.text.is_empty() {
            file::write(&recipe.scene, recipe.text.as_bytes())?;
        }
        make(recipe)?;
        done += recipe.episodes as u64;
        progress(Progress::Rendered(done, all));
    }
    Ok(())
}

fn make(recipe: &Recipe) -> Result<()> {
    let scene = recipe.scene.display().to_string();
    let options = RolloutOptions { picture: Some((recipe.side, recipe.side)), ..RolloutOptions::default() };
    let plan = DatasetPlan {
        scenes: vec![Scene::load(&scene)?],
        episodes: recipe.episodes,
        seed: recipe.seed,
        jobs: std::thread::available_parallelism().map_or(1, usize::from).min(recipe.episodes),
        options,
    };
    let arguments = ["--size", &recipe.side.to_string(), "--", &scene].map(Into::into);
    let workers = WorkerCommand::of_this_program(arguments)?;
    let folder = recipe.path.parent().unwrap_or(Path::new("."));
    std::fs::create_dir_all(folder).map_err(Error::io(folder))?;
    // An episode that can't be simulated is left out: always the same one, and the report counts the frames that exist.
    generate_in_processes(&plan, &workers, true, &recipe.path, |_: GenerateProgress| ())?;
    Ok(())
}
