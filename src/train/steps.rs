//! Steps of a run on one rank: gradient, update, log, validation and saves.

use std::time::Instant;

use candle_core::backprop::GradStore;

use super::config::Config;
use super::gradients::{Gradients, sum_on_device};
use super::loader::Loader;
use super::optimizer::AdamW;
use super::pass::{Accumulated, Pass};
use super::ranks::Communicator;
use super::root::Root;
use super::{Control, Event, Outcome, Step, together};
use crate::error::{Error, Result};

/// Consecutive steps whose gradient may be not finite before the run fails: a single one happens, ten mean divergence.
const MAX_SKIPPED_IN_A_ROW: usize = 10;

/// Steps of a run, and what they change.
pub struct Steps<'a> {
    ranks: &'a dyn Communicator,
    config: &'a Config,
    pass: Pass<'a>,
    optimizer: AdamW,
    /// Log, saves and validation; None on other ranks than the first.
    root: Option<Root<'a>>,
    /// Steps taken.
    step: usize,
    /// Steps that changed nothing because their gradient was not finite.
    skipped: usize,
    skipped_in_a_row: usize,
    stop: bool,
    may_validate: bool,
}

impl<'a> Steps<'a> {
    /// Creates the steps after the first `step` ones; `control`: the observers' answer to the start of the run.
    pub fn new(
        ranks: &'a dyn Communicator,
        config: &'a Config,
        pass: Pass<'a>,
        optimizer: AdamW,
        step: usize,
        root: Option<Root<'a>>,
        control: Control,
    ) -> Self {
        let mut steps = Self {
            ranks,
            config,
            pass,
            optimizer,
            root,
            step,
            skipped: 0,
            skipped_in_a_row: 0,
            stop: false,
            may_validate: true,
        };
        steps.heed(control);
        steps
    }

    /// Takes all steps, or those until an observer stops the run.
    ///
    /// # Errors
    /// If gradients stay not finite, another rank fails, or a file can't be written.
    pub fn run(&mut self, loader: &mut Loader, observe: &mut dyn FnMut(Event) -> Control) -> Result<()> {
        let mut began = Instant::now();
        while self.step < self.config.steps && !self.stop {
            let mut taken = self.take(loader)?;
            taken.secs = began.elapsed().as_secs_f64();
            began = Instant::now();
            self.root.as_mut().map_or(Ok(()), |root| root.log(&taken))?;
            let control = together::agree(self.ranks, observe(Event::Stepped(&taken)))?;
            self.heed(control);
            if control == Control::Stop {
                // Validation may take minutes. A program that is told to end may be killed before that.
                self.save()?;
            }
            self.validate_and_save(observe)?;
        }
        Ok(())
    }

    /// Ends the run; the first rank returns the outcome.
    ///
    /// # Errors
    /// As [`Root::finish`].
    pub fn finish(self) -> Result<Option<Outcome>> {
        let Self { root, optimizer, step, may_validate, skipped, .. } = self;
        let outcome = root.map(|root| root.finish(&optimizer, step, may_validate, skipped)).transpose()?;
        // A rank that ended sooner could not be told of an error.
        self.ranks.barrier()?;
        Ok(outcome)
    }

    /// Takes one step; its time is not known yet.
    fn take(&mut self, loader: &mut Loader) -> Result<Step> {
        let mut sum = self.pass.accumulate(self.ranks, loader, &self.optimizer, self.config)?;
        let learning_rate = self.config.learning_rate(self.step);
        let (exchange_bytes, grad_norm) = match sum.gradients.take() {
            // Gradients stay on the device.
            Some(gradients) if self.ranks.size() == 1 => (0, self.optimizer.step(&gradients, learning_rate)?),
            gradients => self.exchange(&mut sum, gradients, learning_rate)?,
        };
        self.step += 1;

        self.skipped_in_a_row = if grad_norm.is_finite() { 0 } else { self.skipped_in_a_row + 1 };
        self.skipped += usize::from(!grad_norm.is_finite());
        if self.skipped_in_a_row >= MAX_SKIPPED_IN_A_ROW {
            let expected = "a finite number; a lower learning rate may help";
            return Err(Error::value(format!("gradient at step {}", self.step), expected, grad_norm));
        }
        let Accumulated { losses, windows, frames, wait_secs, exchange_secs, .. } = sum;
        Ok(Step {
            step: self.step,
            losses,
            learning_rate,
            grad_norm,
            windows,
            frames,
            secs: 0.0,
            wait_secs,
            exchange_secs,
            exchange_bytes,
        })
    }

    /// Takes a step with the gradients of all ranks, and returns the bytes that this rank gives and the norm.
    fn exchange(
        &mut self,
        share: &mut Accumulated,
        gradients: Option<GradStore>,
        learning_rate: f64,
    ) -> Result<(usize, f64)> {
        let (ranks, params) = (self.ranks, self.optimizer.params());
        if let Some(sums) = ranks.sums_on(self.pass.device) {
            let mut gradients = gradients.unwrap_or_default();
            let bytes = share.add_over(|scalars| sum_on_device(params, &mut gradients, ranks, sums, scalars))?;
            return Ok((bytes, self.optimizer.step(&gradients, learning_rate)?));
        }
        let mut gradients = Gradients::new(params, gradients.as_ref())?;
        let bytes = share.add_over(|scalars| gradients.sum(ranks, scalars))?;
        Ok((bytes, self.optimizer.apply(&gradients, learning_rate)?))
    }

    /// Validates and saves after the steps at which that is due.
    fn validate_and_save(&mut self, observe: &mut dyn FnMut(Event) -> Control) -> Result<()> {
        let last = self.stop || self.step == self.config.steps;
        if self.may_validate && (last || self.step.is_multiple_of(self.config.validate_every)) {
            let validate = |root: &mut Root| root.validate(&self.optimizer, self.step, observe);
            let control = self.root.as_mut().map(validate).transpose()?;
            self.stop |= together::agree(self.ranks, control.unwrap_or(Control::Continue))? != Control::Continue;
        }
        if last || self.step.is_multiple_of(self.config.save_every) {
            together::same_weights(self.ranks, &self.optimizer)?;
            self.save()?;
            let control = if self.root.is_some() { observe(Event::Saved(self.step)) } else { Control::Continue };
            self.stop |= together::agree(self.ranks, control)? != Control::Continue;
        }
        Ok(())
    }

    fn save(&self) -> Result<()> {
        self.root.as_ref().map_or(Ok(()), |root| root.save(&self.optimizer, self.step))
    }

    /// Follows the observers' answer to a step.
    fn heed(&mut self, control: Control) {
        self.stop = control != Control::Continue;
        self.may_validate = control != Control::StopUnvalidated;
    }
}
