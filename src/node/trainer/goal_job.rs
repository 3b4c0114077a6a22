//! Training job of a goal.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use anyhow::{Context as _, ensure};
use r2r::egotac_msgs::action::Train;

use crate::node::allowed_folder::AllowedFolder;
use crate::node::episode_recorder::SharedRing;
use crate::node::lock::lock;
use crate::node::params::Parameters;
use crate::train::Config;
use crate::train::job::{Job, LiveRecordings};
use crate::train::source::TrainingSource;

/// Builds and checks the training job that a goal asks for.
///
/// # Errors
/// If the configuration cannot be read, a value is out of range, or a file it names does not exist.
pub(super) fn job(
    goal: &Train::Goal,
    parameters: &Parameters,
    folder: &Path,
    ring: &SharedRing,
) -> anyhow::Result<Job> {
    check_paths(goal, &AllowedFolder::of(parameters)?)?;
    let file = match goal.config.is_empty() {
        true => parameters.get::<String>("config"),
        false => goal.config.clone(),
    };
    ensure!(!file.is_empty(), "config: expected a YAML file in the goal or in the parameter config, got none");
    ensure!(!(goal.live && goal.resume), "resume: expected false with live, got true");
    let config = config(goal, Path::new(&file), folder)?;
    if goal.live && config.data.is_empty() {
        // The recorded episodes do not exist yet; an existing folder stands in for them in the check.
        let checked = Config { data: vec![TrainingSource::path(folder)], ..config.clone() };
        checked.check().with_context(|| file.clone())?;
    } else {
        config.check().with_context(|| file.clone())?;
    }
    let live = goal.live.then(|| live(parameters, ring));
    Ok(Job { config, resume: goal.resume, live })
}

/// Checks that the files that a goal names lie in the allowed folder.
fn check_paths(goal: &Train::Goal, allowed: &AllowedFolder) -> anyhow::Result<()> {
    let single = [("config", &goal.config), ("base_checkpoint", &goal.base_checkpoint), ("out", &goal.out)];
    let stores = goal.data.iter().map(|store| ("data", store));
    for (what, path) in single.into_iter().chain(stores).filter(|(_, path)| !path.is_empty()) {
        allowed.check(what, Path::new(path))?;
    }
    Ok(())
}

/// Reads the configuration `file` and overwrites it with the fields of the goal that are set.
fn config(goal: &Train::Goal, file: &Path, folder: &Path) -> anyhow::Result<Config> {
    let mut config = Config::read_unchecked(file)?;
    if !goal.data.is_empty() {
        config.data = goal.data.iter().map(TrainingSource::path).collect();
    } else if goal.live && config.data.iter().all(|source| source.stores.iter().all(|store| !store.exists())) {
        // Stores that do not exist belong to runs without topics; a live goal does without them.
        config.data.clear();
    }
    if !goal.base_checkpoint.is_empty() {
        config.init = Some(PathBuf::from(&goal.base_checkpoint));
    }
    if !goal.out.is_empty() {
        config.out = PathBuf::from(&goal.out);
    } else if config.out.is_relative() {
        config.out = folder.join("runs").join(&config.out);
    }
    if goal.steps > 0 {
        config.steps = goal.steps as usize;
    }
    Ok(config)
}

/// Returns the source of recorded episodes for a live goal.
fn live(parameters: &Parameters, ring: &SharedRing) -> LiveRecordings {
    let ring = Arc::clone(ring);
    LiveRecordings {
        stores: Box::new(move || lock(&ring).stores()),
        least_frames: parameters.get::<i64>("min_live_frames") as usize,
        round_steps: parameters.get::<i64>("round_steps") as usize,
    }
}
