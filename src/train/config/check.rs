//! Ranges of the values of a training configuration.

use super::{Config, LossWeights};
use crate::error::{Error, Result};
use crate::model::Precision;

/// Largest number of steps; some counters are 32 bits wide.
const MAX_STEPS: usize = 1 << 30;
/// Largest number of clips, windows per clip or batches of a step.
pub(in crate::train) const MAX_BATCH: usize = 1 << 16;
/// Largest number of windows of an epoch, all of which each loading thread holds: 130 MB.
const MAX_EPOCH: usize = 1 << 24;
/// Largest number of loading threads.
const MAX_THREADS: usize = 256;

impl Config {
    /// Checks that all values are in range and that the input files exist.
    ///
    /// # Errors
    /// If a value does not fit; the error names the first such key and the allowed values.
    pub fn check(&self) -> Result<()> {
        self.check_counts()?;
        self.check_ranges()?;
        self.check_quotas()?;
        let LossWeights { force, contact, active, keypoints, .. } = self.loss;
        if force + contact + active + keypoints == 0.0 {
            return Err(Error::value("loss", "a weight above 0", "force, contact, active and keypoints all 0"));
        }
        if self.precision == Precision::Int8 {
            return Err(Error::value("precision", "f32 or bf16", self.precision));
        }
        if self.init.is_some() && self.encoder.is_some() {
            return Err(Error::value("encoder", "none beside init, which has one", "both"));
        }
        if self.mano_left.is_some() != self.mano_right.is_some() {
            return Err(Error::value("mano_left and mano_right", "both files or neither", "one of them"));
        }
        if !self.data.iter().any(|source| source.labels.has_contact()) {
            let expected = "a source that knows contact and its absence, which train the contact head";
            return Err(Error::value("data, labels", expected, "`labels: force` or `labels: felt` for all sources"));
        }
        self.geometry()?;
        let stores = self.data.iter().flat_map(|source| &source.stores);
        for path in stores
            .chain(&self.validation)
            .chain(&self.init)
            .chain(&self.encoder)
            .chain(&self.mano_left)
            .chain(&self.mano_right)
        {
            path.metadata().map_err(Error::io(path))?;
        }
        Ok(())
    }

    fn check_counts(&self) -> Result<()> {
        let least_stores = self.data.iter().map(|source| source.stores.len()).min().unwrap_or(0);
        let ranges = [
            ("steps", self.steps, MAX_STEPS),
            ("batch.clips", self.batch.clips, MAX_BATCH),
            ("batch.windows", self.batch.windows, MAX_BATCH),
            ("batch.accumulate", self.batch.accumulate, MAX_BATCH),
            ("save_every", self.save_every, usize::MAX),
            ("validate_every", self.validate_every, usize::MAX),
            ("threads", self.threads, MAX_THREADS),
            ("data", self.data.len(), usize::MAX),
            ("data.stores", least_stores, usize::MAX),
            ("sampling.epoch", self.sampling.epoch.unwrap_or(1), MAX_EPOCH),
        ];
        match ranges.iter().find(|(_, value, most)| !(1..=*most).contains(value)) {
            Some((key, value, usize::MAX)) => Err(Error::value(key, "at least 1", value)),
            Some((key, value, most)) => Err(Error::value(key, format!("1 to {most}"), value)),
            None => Ok(()),
        }
    }

    fn check_ranges(&self) -> Result<()> {
        let (o, l, a) = (&self.optimizer, &self.loss, &self.augment);
        let ranges = [
            ("frame_dt", self.frame_dt, 1e-3, 10.0),
            ("ema", self.ema, 0.0, 0.999_999),
            ("optimizer.learning_rate", o.learning_rate, 1e-9, 1.0),
            ("optimizer.final_learning_rate", o.final_learning_rate, 0.0, o.learning_rate),
            ("optimizer.encoder_factor", self.encoder_factor(), 0.0, 10.0),
            ("optimizer.warmup", o.warmup, 0.0, 1.0),
            ("optimizer.weight_decay", o.weight_decay, 0.0, 1.0),
            ("optimizer.max_grad_norm", o.max_grad_norm, 1e-6, 1e6),
            ("loss.force", l.force, 0.0, 1e3),
            ("loss.contact", l.contact, 0.0, 1e3),
            ("loss.active", l.active, 0.0, 1e3),
            ("loss.consistency", l.consistency, 0.0, 1e3),
            ("loss.keypoints", l.keypoints, 0.0, 1e3),
            ("loss.positive_weight", l.positive_weight, 1e-3, 1e3),
            ("augment.brightness", a.brightness, 0.0, 0.9),
            ("augment.contrast", a.contrast, 0.0, 0.9),
            ("augment.saturation", a.saturation, 0.0, 1.0),
            ("augment.hue", a.hue, 0.0, std::f64::consts::PI),
            ("augment.crop", a.crop, 0.0, 0.9),
            ("augment.view_scale", a.view_scale, 0.0, 0.9),
            ("augment.view_scale_probability", a.view_scale_probability, 0.0, 1.0),
            ("augment.mirror", a.mirror, 0.0, 1.0),
            ("sampling.temperature", self.sampling.temperature, 0.0, 10.0),
        ];
        // Negated, so that NaN is out of range.
        match ranges.iter().find(|(_, value, low, high)| !(value >= low && value <= high)) {
            Some((key, value, low, high)) => Err(Error::value(key, format!("a number from {low} to {high}"), value)),
            None => Ok(()),
        }
    }

    fn check_quotas(&self) -> Result<()> {
        for (i, source) in self.data.iter().enumerate() {
            if !(0.0..=1.0).contains(&source.quota) {
                return Err(Error::value(format!("data[{i}].quota"), "a share from 0 to 1", source.quota));
            }
        }
        let quotas: f64 = self.data.iter().map(|source| source.quota).sum();
        match quotas > 1.0 + 1e-9 {
            true => Err(Error::value("data, sum of quotas", "at most 1", quotas)),
            false => Ok(()),
        }
    }
}
