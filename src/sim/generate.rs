//! Generation of a data set: episodes recorded side by side, which an interrupted run resumes, then merged to one store.

use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Mutex, PoisonError};

use serde_json::{Value, json};

use super::parts::PartsFolder;
use super::record::{RecordSummary, SUMMARY, attributes, record_part};
use super::rollout::RolloutOptions;
use super::scene::Scene;
use super::stored_scene::{self, EPISODES, SCENES};
use crate::dataset::zarr::{ZarrReader, concatenate};
use crate::error::{Error, Result};

/// Greatest number of episodes of a data set.
const MAX_EPISODES: usize = 1_000_000;
/// Greatest number of episodes simulated at a time.
const MAX_JOBS: usize = 1024;

/// Progress of [`generate`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum GenerateProgress {
    /// Number of simulated episodes, and of all episodes.
    Episodes(usize, usize),
    /// Number of written chunks of the store, and of all chunks.
    Chunks(usize, usize),
}

/// Data set to generate.
#[derive(Debug, Clone)]
pub struct DatasetPlan {
    /// Scenes, used in turn.
    pub scenes: Vec<Scene>,
    /// Number of episodes.
    pub episodes: usize,
    /// Seed of the first episode; episode `i` has seed + i.
    pub seed: u64,
    /// Number of episodes simulated at a time, and of threads that write the store.
    pub jobs: usize,
    /// Options of the rollouts.
    pub options: RolloutOptions,
}

/// Generates a data set as one store at `out`; calls `progress` after each episode, then after each chunk.
///
/// Finished episodes are kept in `OUT.parts` until the end; the same call resumes an interrupted one. Other episodes go
/// on when one fails.
///
/// # Errors
/// If `out` exists, the parts belong to another call, or an episode fails; the error names scenes and seeds of the
/// failed episodes.
pub fn generate(plan: &DatasetPlan, out: &Path, progress: impl Fn(GenerateProgress) + Sync) -> Result<RecordSummary> {
    let recorder = || {
        let record = |scene: usize, seed: u64, out: &Path| record_part(&plan.scenes, scene, seed, &plan.options, out);
        Box::new(record) as Recorder
    };
    generate_with(plan, &recorder, false, out, progress)
}

/// Records an episode, given the index of its scene and its seed, as a store.
pub(super) type Recorder<'a> = Box<dyn FnMut(usize, u64, &Path) -> Result<()> + 'a>;

/// Generates a data set as [`generate`] with one recorder per job; `skip_failed` leaves out failed episodes.
pub(super) fn generate_with<'a>(
    plan: &DatasetPlan,
    recorder: &(dyn Fn() -> Recorder<'a> + Sync),
    skip_failed: bool,
    out: &Path,
    progress: impl Fn(GenerateProgress) + Sync,
) -> Result<RecordSummary> {
    check(plan)?;
    PartsFolder::remove_merged(out)?;
    if out.exists() && !PartsFolder::exists(out) {
        return Err(exists(out));
    }
    let folder = PartsFolder::claim(out, &plan_text(plan))?;
    if out.exists() {
        return remove_merged(plan, folder, out);
    }
    let failed = record_parts(plan, recorder, &folder, &progress);
    if failed.len() == plan.episodes || !(failed.is_empty() || skip_failed) {
        return Err(Error::file(folder.path(), failure_message(&failed, plan.episodes)));
    }
    // Failed episodes left no part.
    let mut total = merge(plan, &folder, progress)?;
    if out.exists() {
        return Err(exists(out));
    }
    folder.publish_whole(out)?;
    total.failed = failed;
    Ok(total)
}

fn exists(out: &Path) -> Error {
    Error::file(out, "exists already; choose another name or remove it")
}

/// Checks numbers of a plan.
fn check(plan: &DatasetPlan) -> Result<()> {
    if plan.scenes.is_empty() {
        return Err(Error::value("scenes", "at least one", "none"));
    }
    for (name, value, most) in [("episodes", plan.episodes, MAX_EPISODES), ("jobs", plan.jobs, MAX_JOBS)] {
        if !(1..=most).contains(&value) {
            return Err(Error::value(name, format!("1 to {most}"), value));
        }
    }
    match plan.seed.checked_add(plan.episodes as u64) {
        Some(_) => Ok(()),
        None => Err(Error::value("seed", format!("at most {}", u64::MAX - plan.episodes as u64), plan.seed)),
    }
}

/// Ends a run that was killed after it had given the data set its name: removes the parts.
fn remove_merged(plan: &DatasetPlan, folder: PartsFolder, out: &Path) -> Result<RecordSummary> {
    let (total, entries) = survey(&parts(plan, &folder))?;
    let reader = ZarrReader::open(out)?;
    if entries.is_empty() || reader.raw_attributes().get(EPISODES) != Some(&Value::Array(entries)) {
        return Err(exists(out));
    }
    folder.remove(out)?;
    Ok(total)
}

/// Returns the finished parts in order.
fn parts(plan: &DatasetPlan, folder: &PartsFolder) -> Vec<PathBuf> {
    (0..plan.episodes).map(|index| folder.part(index)).filter(|part| part.exists()).collect()
}

/// Records the missing parts with one thread per job; returns a sorted line for each episode that failed.
fn record_parts<'a>(
    plan: &DatasetPlan,
    recorder: &(dyn Fn() -> Recorder<'a> + Sync),
    folder: &PartsFolder,
    progress: &(impl Fn(GenerateProgress) + Sync),
) -> Vec<String> {
    let next = AtomicUsize::new(0);
    let done = AtomicUsize::new(0);
    let failed: Mutex<Vec<String>> = Mutex::new(Vec::new());
    let work = || {
        let mut record = recorder();
        loop {
            let index = next.fetch_add(1, Ordering::Relaxed);
            if index >= plan.episodes {
                return;
            }
            let (scene, seed) = (index % plan.scenes.len(), plan.seed + index as u64);
            let mut record = || {
                record(scene, seed, &folder.unfinished_part(index))?;
                folder.publish_part(index)
            };
            if !folder.part(index).exists()
                && let Err(error) = record()
            {
                let line = format!("{} with seed {seed}: {error}", plan.scenes[scene].name);
                failed.lock().unwrap_or_else(PoisonError::into_inner).push(line);
            }
            progress(GenerateProgress::Episodes(done.fetch_add(1, Ordering::Relaxed) + 1, plan.episodes));
        }
    };
    std::thread::scope(|scope| (0..plan.jobs).for_each(|_| drop(scope.spawn(work))));
    let mut failed = failed.into_inner().unwrap_or_else(PoisonError::into_inner);
    failed.sort();
    failed
}

/// Formats the error for failed episodes; names the first few.
fn failure_message(failed: &[String], episodes: usize) -> String {
    const MAX_NAMED: usize = 5;
    let named = failed.iter().take(MAX_NAMED).map(String::as_str).collect::<Vec<_>>().join("; ");
    let more =
        if failed.len() > MAX_NAMED { format!("; and {} more", failed.len() - MAX_NAMED) } else { String::new() };
    let others = match failed.len() < episodes {
        true => "; the others are kept here, and --skip-failed writes a store of them",
        false => "",
    };
    format!("{} of {episodes} episodes failed: {named}{more}{others}", failed.len())
}

/// Returns a text that differs between plans whose episodes differ.
fn plan_text(plan: &DatasetPlan) -> String {
    let scenes: Vec<String> = plan.scenes.iter().map(|s| format!("{} {:?}", s.name, s.spec)).collect();
    format!(
        "{} {} {:?} {:?} {} {:?} {}\n{}\n",
        plan.seed,
        plan.options.hands[0].topology.id(),
        plan.options.betas,
        plan.options.picture,
        plan.options.shadows,
        plan.options.style,
        plan.options.sigma,
        scenes.join("\n")
    )
}

/// Concatenates the parts and their summaries to one unfinished store.
fn merge(
    plan: &DatasetPlan,
    folder: &PartsFolder,
    progress: impl Fn(GenerateProgress) + Sync,
) -> Result<RecordSummary> {
    let parts = parts(plan, folder);
    let (total, entries) = survey(&parts)?;
    let attributes = attributes(&plan.scenes, plan.seed, &plan.options);
    let more = [
        (EPISODES.to_string(), Value::Array(entries)),
        (SCENES.to_string(), stored_scene::attribute(&plan.scenes)?),
        (SUMMARY.to_string(), json!(total)),
    ];
    let chunks = |done, all| progress(GenerateProgress::Chunks(done, all));
    concatenate(&parts, &folder.unfinished_whole(), &attributes, more.into_iter().collect(), plan.jobs, chunks)?;
    Ok(total)
}

/// Returns the sum of the parts' summaries, and the descriptions of their episodes.
fn survey(parts: &[PathBuf]) -> Result<(RecordSummary, Vec<Value>)> {
    let mut total = RecordSummary::default();
    let mut entries: Vec<Value> = Vec::new();
    for part in parts {
        let reader = ZarrReader::open(part)?;
        let attributes = reader.raw_attributes();
        entries.extend(attributes.get(EPISODES).and_then(Value::as_array).cloned().unwrap_or_default());
        let summary = attributes.get(SUMMARY).cloned().unwrap_or_default();
        total.add(serde_json::from_value(summary).map_err(|e| Error::file(part, format!("{SUMMARY}: {e}")))?);
    }
    Ok((total, entries))
}
