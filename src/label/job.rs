//! One labelling, from an input to its output: goes on where an earlier one was stopped.

use std::fs;
use std::path::{Path, PathBuf};
use std::time::Instant;

use super::inference::{Times, label_unit};
use super::output::Output;
use super::provenance::Provenance;
use super::source::Source;
use super::summary::{About, Summary};
use super::workspace::{Work, folder_of};
use crate::error::{Error, Result};
use crate::model::Predictor;

/// A part of all units: those whose number, divided by `of`, leaves `index`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Shard {
    /// Which part, from 0 on.
    pub index: usize,
    /// Parts.
    pub of: usize,
}

/// What is labelled, and where to.
pub struct Job<'a> {
    /// Where images come from.
    pub source: &'a dyn Source,
    /// What is made of the labels.
    pub output: &'a dyn Output,
    /// Where it goes.
    pub out: PathBuf,
    /// What the output will say about its labels.
    pub provenance: Provenance,
    /// Threads that decode images beside the network.
    pub decoders: usize,
}

/// How a job ended.
#[derive(Debug, Clone)]
pub enum Outcome {
    /// The output is there.
    Done(About),
    /// It was there before, from the same input and settings.
    DoneBefore(About),
    /// This shard's units are labelled; other units are not.
    Waiting,
}

/// Frames that a run labelled, and the time it took.
#[derive(Debug, Clone, Copy, Default)]
pub struct Effort {
    /// Images labelled by this run; earlier ones not counted.
    pub frames: u64,
    /// Wall time of the network's passes, s.
    pub pass_secs: f64,
    /// Wall time of putting the output together, s.
    pub assemble_secs: f64,
    /// Where the passes' time went.
    pub times: Times,
}

impl Job<'_> {
    /// Images that are labelled already, of all units.
    ///
    /// # Errors
    /// If an unfinished labelling of another input, or with other settings, lies there, or a journal can't be read.
    pub fn done(&self) -> Result<u64> {
        if self.out.exists() || !folder_of(&self.out)?.exists() {
            return Ok(0);
        }
        let work = Work::open(&self.out, &self.provenance, self.source.units())?;
        let mut done = 0;
        for unit in 0..self.source.units().len() {
            done += work.progress(unit)?.frames as u64;
        }
        Ok(done)
    }

    /// Labels what is missing of the units whose `numbers` fall into `shard`, and puts the output together once no unit
    /// is missing. `numbers` counts the units of all jobs, so that shards share out several jobs as one.
    ///
    /// # Errors
    /// If `out` is something else than this job's output, another process works on one of the units, the input can't be
    /// opened, or the output can't be written.
    pub fn run(
        &self,
        predictor: &mut Predictor,
        shard: Shard,
        first_number: usize,
        effort: &mut Effort,
        progress: &mut dyn FnMut(),
    ) -> Result<Outcome> {
        if self.out.exists() {
            return self.done_before().map(Outcome::DoneBefore);
        }
        self.output.check(self.provenance.topology)?;
        if let Some(parent) = self.out.parent().filter(|parent| !parent.as_os_str().is_empty()) {
            fs::create_dir_all(parent).map_err(Error::io(parent))?;
        }
        let units = self.source.units();
        let work = Work::open(&self.out, &self.provenance, units)?;
        let started = Instant::now();
        for unit in (0..units.len()).filter(|unit| (first_number + unit) % shard.of == shard.index) {
            let Some(mut journal) = work.journal(unit)? else {
                return Err(Error::file(&self.out, format!("{}: another process is labelling it", units[unit].name)));
            };
            let times = label_unit(self.source, unit, predictor, &mut journal, self.decoders, || {
                effort.frames += 1;
                progress()
            })?;
            effort.times.add(&times);
        }
        effort.pass_secs += started.elapsed().as_secs_f64();
        if !work.is_complete(units.len())? {
            return Ok(Outcome::Waiting);
        }
        let Some(_lock) = work.lock()? else { return Ok(Outcome::Waiting) };
        if self.out.exists() {
            return self.done_before().map(Outcome::DoneBefore);
        }
        let started = Instant::now();
        let mut about = About { provenance: self.provenance.clone(), summary: self.summary(&work)? };
        self.output.assemble(work.journals(), &mut about, &work.unfinished(), &self.out)?;
        work.publish(&self.out)?;
        effort.assemble_secs += started.elapsed().as_secs_f64();
        Ok(Outcome::Done(about))
    }

    fn done_before(&self) -> Result<About> {
        let about = self.output.about(&self.out);
        let same = about.filter(|about| about.provenance == self.provenance);
        same.ok_or_else(|| {
            Error::file(&self.out, "exists, and is not this labelling's output; choose another name or remove it")
        })
    }

    fn summary(&self, work: &Work) -> Result<Summary> {
        let mut summary = Summary::default();
        for (unit, about) in self.source.units().iter().enumerate() {
            let before = summary.counts.frames;
            for head in work.journals().heads(unit)? {
                summary.add_block(&about.name, &head?);
            }
            summary.lost.extend(self.source.damage(unit, (summary.counts.frames - before) as usize)?);
        }
        Ok(summary)
    }
}

impl Times {
    fn add(&mut self, other: &Self) {
        self.network += other.network;
        self.waiting += other.waiting;
        self.journal += other.journal;
    }
}

impl std::fmt::Debug for Job<'_> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Job").field("out", &self.out).finish_non_exhaustive()
    }
}

/// Whether `out` lies in `input` or is it: a labelling never touches its input.
pub fn is_within(out: &Path, input: &Path) -> bool {
    let real = |path: &Path| {
        path.ancestors().find_map(|up| Some((up.canonicalize().ok()?, path.strip_prefix(up).ok()?.to_path_buf())))
    };
    match (real(out), input.canonicalize()) {
        (Some((there, rest)), Ok(input)) => there.join(rest).starts_with(input),
        _ => false,
    }
}
