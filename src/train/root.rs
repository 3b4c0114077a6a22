//! Work of rank 0 beside the steps: log, validation, saves.

use super::log::Log;
use super::optimizer::AdamW;
use super::run::Run;
use super::{Control, Event, Outcome, Step, curves};
use crate::error::Result;
use crate::score::metrics::Metrics;

/// The rank that writes the files of a run.
pub struct Root<'a> {
    run: Run<'a>,
    log: Log,
    /// Last scores, with the step of their weights.
    validated: Option<(usize, Metrics)>,
    /// Scores that the observer was told, for the plot.
    scores: Vec<(usize, Metrics)>,
}

impl<'a> Root<'a> {
    /// Writes the configuration and opens the log of a run.
    ///
    /// # Errors
    /// If a file can't be read or written.
    pub fn new(run: Run<'a>) -> Result<Self> {
        run.files.write_config()?;
        let log = Log::open(&run.files.log, run.started.step)?;
        Ok(Self { run, log, validated: None, scores: Vec::new() })
    }

    /// Logs a step.
    ///
    /// # Errors
    /// If the log can't be written.
    pub fn log(&mut self, step: &Step) -> Result<()> {
        self.log.push(step)
    }

    /// Scores the averaged weights, and returns the observer's answer.
    ///
    /// # Errors
    /// As [`Run::validate`].
    pub fn validate(
        &mut self,
        optimizer: &AdamW,
        step: usize,
        observe: &mut dyn FnMut(Event) -> Control,
    ) -> Result<Control> {
        self.validated = self.run.validate(optimizer)?.map(|metrics| (step, metrics));
        let Some((_, metrics)) = &self.validated else { return Ok(Control::Continue) };
        self.scores.push((step, metrics.clone()));
        Ok(observe(Event::Validated(step, metrics)))
    }

    /// Saves state and checkpoint, and before them the log.
    ///
    /// # Errors
    /// If a file can't be written.
    pub fn save(&self, optimizer: &AdamW, step: usize) -> Result<()> {
        self.log.sync()?;
        self.run.save(optimizer, step, self.validated.as_ref()).map(drop)
    }

    /// Ends the run: with `measured`, scores the last weights if that was not done, and adds statistics to the checkpoint.
    ///
    /// # Errors
    /// As [`Run::validate`] and [`Run::finish`].
    pub fn finish(mut self, optimizer: &AdamW, step: usize, measured: bool, skipped_steps: usize) -> Result<Outcome> {
        // The observer may have stopped the run after a step without validation.
        if measured && self.validated.as_ref().is_none_or(|(at, _)| *at != step) {
            self.validated = self.run.validate(optimizer)?.map(|metrics| (step, metrics));
        }
        self.log.sync()?;
        let sha256 = self.run.finish(optimizer, step, self.validated.as_ref(), measured)?;
        curves::write(&self.run.files.log, &self.scores)?;
        let checkpoint = self.run.files.checkpoint.clone();
        let validation = self.validated.map(|(_, metrics)| metrics);
        Ok(Outcome { checkpoint, sha256, steps: step, validation, skipped_steps })
    }
}
