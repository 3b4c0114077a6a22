//! From the outputs of the two heads to newtons and probabilities.
//!
//! For each vertex, with f the output of the force head and l that of the contact head,
//!
//! ```text
//! force   = max(0, force_scale · f)     newtons; NaN if the force head was never trained
//! contact = σ(l / T)                    probability; σ(x) = 1 / (1 + e^-x), T the checkpoint's temperature
//! ```
//!
//! T is positive, so that a contact above 0.5 is one whose logit is positive, whatever T is.
//!
//! Stream ([`super::Predictor`]) and batch (evaluation) use these functions.

use super::Metadata;
use super::finite::check_finite;
use crate::error::Result;
use crate::tactile::N_FIELD;

/// Outputs of both heads for a batch of windows.
#[derive(Debug, Clone)]
pub(crate) struct HeadOutputs {
    /// Force in normalised units, `(B, K, 1556)`.
    pub force: Vec<f32>,
    /// Contact logits, `(B, K, 1556)`.
    pub contact_logits: Vec<f32>,
    /// K: tactile steps.
    pub steps: usize,
}

impl HeadOutputs {
    /// Returns force in newtons and contact probability of step 0 of each window, `(B, 1556)` each.
    ///
    /// # Errors
    /// If an output or a force is not finite; names the head.
    pub fn first_step(&self, metadata: &Metadata) -> Result<(Vec<f32>, Vec<f32>)> {
        let first = |values: &[f32]| -> Vec<f32> {
            values.chunks_exact(self.steps * N_FIELD).flat_map(|window| &window[..N_FIELD]).copied().collect()
        };
        let (mut force, mut contact) = (first(&self.force), first(&self.contact_logits));
        check_finite("force_head", &force)?;
        check_finite("contact_head", &contact)?;
        match metadata.has_force {
            true => force.iter_mut().for_each(|value| *value = newtons(*value, metadata.force_scale)),
            false => force.fill(f32::NAN),
        }
        if metadata.has_force {
            check_finite("force_head in newtons", &force)?;
        }
        contact.iter_mut().for_each(|value| *value = probability(*value / metadata.contact_temperature));
        Ok((force, contact))
    }
}

/// Force in newtons of an output of the force head, never negative.
pub(crate) fn newtons(output: f32, force_scale: f32) -> f32 {
    (force_scale * output).max(0.0)
}

/// Probability of a logit: the f32 nearest to 1 / (1 + e^-x), but for rounding in f64. In f64, e^-x of an f32 overflows only
/// where the probability is zero in f32 too.
pub(crate) fn probability(logit: f32) -> f32 {
    (1.0 / (1.0 + (-f64::from(logit)).exp())) as f32
}

#[cfg(test)]
mod tests {
    use super::*;

    fn outputs(force: f32, logit: f32, steps: usize) -> HeadOutputs {
        let values = |first: f32| -> Vec<f32> {
            (0..2 * steps * N_FIELD).map(|i| if (i / N_FIELD).is_multiple_of(steps) { first } else { 99.0 }).collect()
        };
        HeadOutputs { force: values(force), contact_logits: values(logit), steps }
    }

    #[test]
    fn a_probability_is_the_nearest_f32_for_every_size_of_logit() {
        let sizes = (-400..=400).map(|i| 10f32.powf(i as f32 / 10.0));
        let fine = (-16_000..=16_000).map(|i| i as f32 * 0.0071);
        for x in sizes.flat_map(|x| [x, -x]).chain(fine).chain([0.0, f32::MAX, f32::MIN, f32::MIN_POSITIVE]) {
            // The other algebraic form, in which nothing cancels for x < 0 and which is exact to 1e-16 for x > 0.
            let x64 = f64::from(x);
            let exact = if x > 0.0 { 1.0 - (-x64).exp() / (1.0 + (-x64).exp()) } else { x64.exp() / (1.0 + x64.exp()) };
            let got = probability(x);
            let spacing = f64::from(f32::from_bits(got.to_bits() + 1)) - f64::from(got);
            assert!((f64::from(got) - exact).abs() <= 0.500_001 * spacing, "σ({x}) = {got}, expected {exact}");
        }
        assert_eq!((probability(0.0), probability(f32::MAX), probability(f32::MIN)), (0.5, 1.0, 0.0));
    }

    #[test]
    fn forces_are_scaled_and_never_negative_and_only_step_0_is_taken() {
        let metadata = Metadata::new("a", 2.5, 0.04);
        for (output, expected) in [(2.0, 5.0), (-1.0, 0.0), (0.0, 0.0)] {
            let (force, contact) = outputs(output, 0.0, 3).first_step(&metadata).unwrap();
            assert_eq!((force, contact), (vec![expected; 2 * N_FIELD], vec![0.5; 2 * N_FIELD]));
        }
        let contact_only = Metadata { has_force: false, ..metadata };
        let (force, _) = outputs(2.0, 0.0, 1).first_step(&contact_only).unwrap();
        assert!(force.len() == 2 * N_FIELD && force.iter().all(|newtons| newtons.is_nan()));
    }

    #[test]
    fn a_temperature_moves_probabilities_and_never_across_one_half() {
        let calibrated = Metadata { contact_temperature: 2.0, ..Metadata::new("a", 1.0, 0.04) };
        for logit in [-7.0f32, -0.3, 0.0, 0.3, 7.0] {
            let (_, contact) = outputs(0.0, logit, 1).first_step(&calibrated).unwrap();
            let expected = 1.0 / (1.0 + (-logit / 2.0).exp());
            assert!((contact[0] - expected).abs() < 1e-6, "{logit}: {}, expected {expected}", contact[0]);
            assert_eq!(contact[0] > 0.5, probability(logit) > 0.5);
        }
    }

    #[test]
    fn an_output_that_is_not_finite_is_a_recoverable_error_that_names_the_head() {
        let metadata = Metadata::new("a", 2.5, 0.04);
        for (force, logit, name) in [
            (f32::NAN, 0.0, "force_head: expected finite numbers, got NaN at 0"),
            (0.0, f32::INFINITY, "contact_head: expected finite numbers, got inf at 0"),
            (f32::MAX, 0.0, "force_head in newtons"),
        ] {
            let error = outputs(force, logit, 1).first_step(&metadata).unwrap_err();
            assert!(error.is_recoverable() && error.to_string().contains(name), "{error}");
        }
    }
}
