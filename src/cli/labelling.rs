//! Jobs of one command over several recordings: progress, results and exit status.

use std::path::Path;
use std::process::ExitCode;

use anyhow::{Context, bail};
use indicatif::ProgressBar;
use serde_json::{Value, json};

use super::options::Json;
use crate::dataset::LabelSummary;
use crate::error::{Error, Result};
use crate::file;
use crate::label::{Job, LabelTask, LabelTiming, Outcome, Shard, write_manifest};
use crate::text::{printable, printable_name, tell};

/// Exit status if a part of the input could not be labelled.
const PARTLY: u8 = 3;

/// The jobs of one command.
pub(super) struct Work<'a> {
    /// Path of the input.
    pub input: &'a Path,
    /// Path of the output; of several recordings, a folder.
    pub out: &'a Path,
    /// Recordings and their outputs.
    pub tasks: &'a [LabelTask],
    /// Their jobs, in the same order.
    pub jobs: &'a [Job<'a>],
    /// Names of recordings that can't be opened, and the reasons.
    pub unreadable: &'a [(String, Error)],
}

impl Work<'_> {
    /// Runs all jobs by `run`, which gets the job's index, the number of its first unit, the times to add to, and the
    /// function to call after each image; reports the results and returns the exit status.
    pub fn run(
        &self,
        json: &Json,
        run: impl FnMut(usize, usize, &mut LabelTiming, &mut dyn FnMut()) -> Result<Outcome>,
    ) -> anyhow::Result<ExitCode> {
        let Self { input, tasks, jobs, .. } = self;
        let bar = bar(tasks, jobs)?;
        let (ends, timing) = self.results(run, || bar.inc(1))?;
        bar.finish_and_clear();
        report(json, &ends, &timing)?;
        for (name, reason) in &ends.failed {
            tell(format_args!("{}", printable_name(&format!("{name}: {reason}"))));
        }
        if ends.done.is_empty() && ends.waiting.is_empty() {
            bail!("{}: none of {} recordings could be labelled", input.display(), ends.failed.len());
        }
        let whole = ends.failed.is_empty() && ends.done.iter().all(|(_, summary, _)| summary.is_whole());
        Ok(if whole { ExitCode::SUCCESS } else { ExitCode::from(PARTLY) })
    }

    /// Runs all jobs as [`Work::run`] and returns the content of its JSON file; prints nothing.
    ///
    /// # Errors
    /// If the only recording can't be labelled, or none of several.
    pub fn summary(
        &self,
        run: impl FnMut(usize, usize, &mut LabelTiming, &mut dyn FnMut()) -> Result<Outcome>,
    ) -> anyhow::Result<Value> {
        let (ends, timing) = self.results(run, || ())?;
        if ends.done.is_empty() && ends.waiting.is_empty() {
            let reasons: Vec<String> = ends.failed.iter().map(|(name, reason)| format!("{name}: {reason}")).collect();
            bail!("{}: no recording could be labelled: {}", self.input.display(), reasons.join("; "));
        }
        Ok(summary(&ends, &timing))
    }

    /// Runs all jobs; calls `progress` after each image.
    fn results(
        &self,
        mut run: impl FnMut(usize, usize, &mut LabelTiming, &mut dyn FnMut()) -> Result<Outcome>,
        mut progress: impl FnMut(),
    ) -> anyhow::Result<(Ends<'_>, LabelTiming)> {
        let Self { out, tasks, unreadable, .. } = self;
        let several = tasks.len() + unreadable.len() > 1;
        let (mut timing, mut ends) = (LabelTiming::default(), Ends::default());
        ends.failed.extend(unreadable.iter().map(|(name, error)| (name.clone(), error.to_string())));
        let mut number = 0;
        for (index, task) in tasks.iter().enumerate() {
            let outcome = run(index, number, &mut timing, &mut progress);
            number += task.source.units().len();
            match outcome {
                Ok(Outcome::Done(info)) => ends.done.push((task, info.summary, false)),
                Ok(Outcome::DoneBefore(info)) => ends.done.push((task, info.summary, true)),
                Ok(Outcome::Waiting) => ends.waiting.push(task),
                // An error in one of several recordings does not stop the others.
                Err(error) if several => ends.failed.push((task.name.clone(), error.to_string())),
                Err(error) => return Err(error).with_context(|| task.name.clone()),
            }
        }
        ends.forget_moved();
        if several && out.is_dir() {
            write_manifest(out, tasks, unreadable)?;
        }
        Ok((ends, timing))
    }
}

/// Results of the jobs.
#[derive(Default)]
struct Ends<'a> {
    /// Complete outputs; true if an earlier run completed them.
    done: Vec<(&'a LabelTask, LabelSummary, bool)>,
    /// Outputs that wait for other shards.
    waiting: Vec<&'a LabelTask>,
    /// Names of inputs without an output, and the reasons.
    failed: Vec<(String, String)>,
}

impl Ends<'_> {
    /// Counts outputs as failed that somebody moved or removed while others were written.
    fn forget_moved(&mut self) {
        for (task, ..) in self.done.extract_if(.., |(task, ..)| !task.out.exists()) {
            let reason = "was moved or removed after it was written; run the command again";
            self.failed.push((task.name.clone(), Error::file(&task.out, reason).to_string()));
        }
    }
}

/// Creates a bar over all images that starts where earlier runs stopped.
fn bar(tasks: &[LabelTask], jobs: &[Job]) -> anyhow::Result<ProgressBar> {
    let bar = super::progress::bar("images");
    let frames: Option<usize> = tasks.iter().flat_map(|task| task.source.units()).map(|unit| unit.frames).sum();
    bar.set_length(frames.unwrap_or(0) as u64);
    let mut before = 0;
    for job in jobs {
        before += job.done()?;
    }
    bar.set_position(before);
    bar.reset_eta();
    Ok(bar)
}

/// Returns the sum of the summaries.
fn total(ends: &Ends) -> LabelSummary {
    let mut total = LabelSummary::default();
    ends.done.iter().for_each(|(_, summary, _)| total.add(summary));
    total
}

/// Returns the images labelled per second.
fn fps(timing: &LabelTiming) -> f64 {
    timing.frames as f64 / timing.inference_secs.max(f64::MIN_POSITIVE)
}

/// Returns the content of the JSON file.
fn summary(ends: &Ends, timing: &LabelTiming) -> Value {
    let Ends { done, waiting, failed } = ends;
    let outputs: Vec<_> = done.iter().map(|(task, ..)| task.out.display().to_string()).collect();
    json!({
        "outputs": outputs,
        "waiting_for_other_shards": waiting.iter().map(|task| task.out.display().to_string()).collect::<Vec<_>>(),
        "failed": failed.iter().map(|(name, reason)| json!({ "input": name, "reason": reason })).collect::<Vec<_>>(),
        "summary": total(ends),
        "images_labelled_now": timing.frames,
        "images_per_sec": (timing.frames > 0).then_some(fps(timing)),
        "seconds": {
            "pass": timing.inference_secs,
            "network": timing.inference.network_secs,
            "waiting_for_images": timing.inference.waiting_secs,
            "journal": timing.inference.journal_secs,
            "assembly": timing.assembly_secs,
        },
    })
}

fn report(json: &Json, ends: &Ends, timing: &LabelTiming) -> anyhow::Result<()> {
    let Ends { done, waiting, .. } = ends;
    if json.is_printed() {
        println!("{}", printable(&format!("{:#}", summary(ends, timing))));
        return Ok(());
    }
    for (task, _, before) in done {
        println!("{}{}", printable_name(&task.out.to_string_lossy()), if *before { ": done before" } else { "" });
    }
    if !done.is_empty() {
        println!("{}", printable(&total(ends).text()));
    }
    if timing.frames > 0 {
        println!("{} images in {:.1} s, {:.1} per second", timing.frames, timing.inference_secs, fps(timing));
    }
    for task in waiting {
        let out = task.out.to_string_lossy();
        println!("{}: this shard's part is done; other shards are not", printable_name(&out));
    }
    if let Some(path) = json.file() {
        file::write(path, format!("{:#}\n", summary(ends, timing)).as_bytes())?;
    }
    Ok(())
}

/// Parses a shard, I/N.
pub(super) fn shard(text: &str) -> std::result::Result<Shard, String> {
    let parse = || -> anyhow::Result<Shard> {
        let (index, of) = text.split_once('/').context("no slash")?;
        let shard = Shard { index: index.parse()?, of: of.parse()? };
        if shard.index >= shard.of {
            bail!("out of range");
        }
        Ok(shard)
    };
    parse().map_err(|_| "expected I/N with I from 0 to N-1, such as 0/4".into())
}
