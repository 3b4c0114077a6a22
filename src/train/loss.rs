//! Training objective: masked means over vertices (paper, Training objective).

use candle_core::{DType, Tensor};

use super::config::LossWeights;
use crate::error::Result;
use crate::tactile::CONTACT_FORCE_N;

/// Targets of a batch, `(B, K, 1556)` each.
#[derive(Debug, Clone)]
pub struct Targets {
    /// Force in normalised units (N / `force_scale`); any finite number where masked.
    pub force: Tensor,
    /// Contact, 0 or 1; any finite number where masked.
    pub contact: Tensor,
    /// 1 = the force is supervised.
    pub mask_force: Tensor,
    /// 1 = the contact is supervised.
    pub mask_contact: Tensor,
}

/// Numbers of supervised entries, which the terms of the objective are divided by. An entry with a weight counts as much as it
/// weighs, so that a term is the weighted mean. Those of several ranks add up: each rank
/// divides its sums by the counts of all, and the sum of the ranks' terms is the term of the whole batch.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct SupervisedCounts {
    /// Entries whose force is supervised.
    pub force: f64,
    /// Entries whose contact is supervised.
    pub contact: f64,
    /// Entries whose force is supervised and above 0.05 N.
    pub active: f64,
    /// Keypoints in the image, over all frames.
    pub points: f64,
    /// Keypoints in the image, over the newest frame of each window.
    pub newest_points: f64,
}

impl SupervisedCounts {
    /// Counts the supervised entries of a batch's labels: `force` in normalised units, and masks or weights, 0 to 1.
    pub fn of(force: &[f32], mask_force: &[f32], mask_contact: &[f32], force_scale: f32) -> Self {
        let threshold = CONTACT_FORCE_N / force_scale;
        let supervised = |mask: &[f32]| mask.iter().map(|mask| f64::from(*mask)).sum();
        let active = force.iter().zip(mask_force).filter(|(force, _)| **force > threshold);
        Self {
            force: supervised(mask_force),
            contact: supervised(mask_contact),
            active: active.map(|(_, mask)| f64::from(*mask)).sum(),
            ..Self::default()
        }
    }

    /// Returns the counts as an array.
    pub fn values(&self) -> [f64; 5] {
        let Self { force, contact, active, points, newest_points } = *self;
        [force, contact, active, points, newest_points]
    }

    /// Creates counts from the array of [`SupervisedCounts::values`].
    pub fn from_values([force, contact, active, points, newest_points]: [f64; 5]) -> Self {
        Self { force, contact, active, points, newest_points }
    }
}

/// The objective and its terms.
#[derive(Debug, Clone)]
pub struct Objective {
    /// Weighted sum, a scalar.
    pub total: Tensor,
    /// L_F: squared error of the normalised force.
    pub force: Tensor,
    /// L_C: cross-entropy of contact.
    pub contact: Tensor,
    /// L_A: Smooth-L1 error of the normalised force where the true force is above 0.05 N.
    pub active: Tensor,
    /// L_cons: cross-entropy of (F_raw - 0.05 N) / 0.03 N as a logit against the predicted contact probability.
    pub consistency: Tensor,
}

/// Force that increases the logit of the consistency term by one, N.
const CONSISTENCY_SCALE_N: f32 = 0.03;

/// Computes the objective of predicted `force` (normalised units) and `contact_logits`, `(B, K, 1556)` each.
///
/// # Errors
/// If shapes differ.
pub fn objective(
    force: &Tensor,
    contact_logits: &Tensor,
    truth: &Targets,
    force_scale: f32,
    weights: &LossWeights,
) -> Result<Objective> {
    let [values, mask_force, mask_contact] =
        [&truth.force, &truth.mask_force, &truth.mask_contact].map(|tensor| tensor.flatten_all()?.to_vec1::<f32>());
    let counts = SupervisedCounts::of(&values?, &mask_force?, &mask_contact?, force_scale);
    objective_of_share(force, contact_logits, truth, force_scale, weights, &counts)
}

/// As [`objective`], of a part of a batch whose supervised entries are `counts`.
///
/// # Errors
/// If shapes differ.
pub fn objective_of_share(
    force: &Tensor,
    contact_logits: &Tensor,
    truth: &Targets,
    force_scale: f32,
    weights: &LossWeights,
    counts: &SupervisedCounts,
) -> Result<Objective> {
    let error = (force - &truth.force)?;
    let l_force = masked_mean(&error.sqr()?, &truth.mask_force, counts.force)?;
    let threshold = f64::from(CONTACT_FORCE_N / force_scale);
    let mask_active = (truth.force.gt(threshold)?.to_dtype(DType::F32)? * &truth.mask_force)?;
    let l_active = masked_mean(&smooth_l1(&error)?, &mask_active, counts.active)?;
    let cross_entropy = bce_with_logits(contact_logits, &truth.contact, weights.positive_weight)?;
    let l_contact = masked_mean(&cross_entropy, &truth.mask_contact, counts.contact)?;
    let l_consistency = consistency(force, contact_logits, &truth.mask_contact, force_scale, counts.contact)?;
    let total = ((&l_force * weights.force)? + (&l_contact * weights.contact)?)?;
    let total = (total + (&l_active * weights.active)?)?;
    let total = (total + (&l_consistency * weights.consistency)?)?;
    Ok(Objective { total, force: l_force, contact: l_contact, active: l_active, consistency: l_consistency })
}

/// Computes the disagreement of force and contact where contact is supervised. The contact probability is a constant target:
/// no gradient flows into it.
fn consistency(force: &Tensor, contact_logits: &Tensor, mask: &Tensor, force_scale: f32, count: f64) -> Result<Tensor> {
    let (scale, shift) = (force_scale / CONSISTENCY_SCALE_N, CONTACT_FORCE_N / CONSISTENCY_SCALE_N);
    let logit = force.affine(scale.into(), -f64::from(shift))?;
    // The sigmoid as (1 + tanh(x/2)) / 2, which overflows for no x.
    let probability = (contact_logits.detach() * 0.5)?.tanh()?.affine(0.5, 0.5)?;
    masked_mean(&bce_with_logits(&logit, &probability, 1.0)?, mask, count)
}

/// Returns the sum of `values` times `mask`, divided by `count`: the weighted mean if that is the sum of the mask; 0 if the mask is 0 everywhere
/// (epsilon of the paper in the denominator).
pub fn masked_mean(values: &Tensor, mask: &Tensor, count: f64) -> Result<Tensor> {
    let count = Tensor::new((count + 1e-6) as f32, values.device())?;
    Ok((values * mask)?.sum_all()?.div(&count)?)
}

/// Computes the binary cross-entropy of logits x against y, positives weighted by w:
/// (1 - y) x + (1 + (w - 1) y) softplus(-x), with softplus(-x) = (|x| - x) / 2 + ln(1 + e^-|x|), which overflows for
/// no x. With max(-x, 0) instead of (|x| - x) / 2, the gradient at x = 0 would not be the mean of both sides.
pub fn bce_with_logits(logits: &Tensor, target: &Tensor, positive_weight: f64) -> Result<Tensor> {
    let size = logits.abs()?;
    let softplus = (((&size - logits)? * 0.5)? + (size.neg()?.exp()? + 1.0)?.log()?)?;
    let weight = ((target * (positive_weight - 1.0))? + 1.0)?;
    Ok(((target.neg()? + 1.0)? * logits)?.add(&(weight * softplus)?)?)
}

/// Computes the smooth L1 loss with beta 1: e²/2 up to |e| = 1, |e| - 1/2 beyond; with m = min(|e|, 1) that is
/// m (|e| - m/2).
fn smooth_l1(error: &Tensor) -> Result<Tensor> {
    let size = error.abs()?;
    let small = size.minimum(1.0)?;
    Ok((&small * (&size - (&small * 0.5)?)?)?)
}

#[cfg(test)]
mod tests {
    use candle_core::{Device, Var};

    use super::*;

    fn tensor(values: &[f32]) -> Tensor {
        Tensor::from_slice(values, (1, 1, values.len()), &Device::Cpu).unwrap()
    }

    fn value(tensor: &Tensor) -> f64 {
        f64::from(tensor.to_scalar::<f32>().unwrap())
    }

    fn truth() -> Targets {
        Targets {
            force: tensor(&[0.0, 0.5, 3.0, 9.0]),
            contact: tensor(&[0.0, 1.0, 1.0, 1.0]),
            mask_force: tensor(&[1.0, 1.0, 1.0, 0.0]),
            mask_contact: tensor(&[1.0, 1.0, 0.0, 1.0]),
        }
    }

    #[test]
    fn each_part_has_its_analytic_value() {
        let weights = LossWeights {
            force: 2.0,
            contact: 3.0,
            active: 5.0,
            consistency: 7.0,
            keypoints: 0.0,
            positive_weight: 2.0,
        };
        let (force, logits) = (tensor(&[0.5, 0.0, 0.0, 0.0]), tensor(&[0.0, 2.0, 7.0, -60.0]));
        let o = objective(&force, &logits, &truth(), 1.0, &weights).unwrap();
        let l_force = (0.25 + 0.25 + 9.0) / 3.0;
        let l_active = (0.125 + 2.5) / 2.0;
        let l_contact = (2f64.ln() + 2.0 * (1.0 + (-2f64).exp()).ln() + 2.0 * 60.0) / 3.0;
        assert!((value(&o.force) - l_force).abs() < 1e-5);
        assert!((value(&o.active) - l_active).abs() < 1e-5);
        assert!((value(&o.contact) - l_contact).abs() < 1e-4);
        // Logits of the forces 0.5, 0, 0 N; the third vertex is not supervised. Probabilities of the logits 0, 2, -60.
        let entropy = |x: f64, p: f64| (1.0 + (-x).exp()).ln() * p + (1.0 + x.exp()).ln() * (1.0 - p);
        let p = |x: f64| 1.0 / (1.0 + (-x).exp());
        let l_consistency = (entropy(15.0, p(0.0)) + entropy(-5.0 / 3.0, p(2.0)) + entropy(-5.0 / 3.0, p(-60.0))) / 3.0;
        assert!((value(&o.consistency) - l_consistency).abs() < 1e-4, "{} {l_consistency}", value(&o.consistency));
        let total = 2.0 * l_force + 3.0 * l_contact + 5.0 * l_active + 7.0 * l_consistency;
        assert!((value(&o.total) - total).abs() < 1e-3);
    }

    #[test]
    fn weighted_forces_give_weighted_means() {
        let weighted = |weights: [f32; 4]| Targets { mask_force: tensor(&weights), ..truth() };
        let (force, logits) = (tensor(&[0.5, 0.0, 0.0, 0.0]), tensor(&[0.0, 2.0, 7.0, -60.0]));
        let of = |truth: &Targets| objective(&force, &logits, truth, 1.0, &LossWeights::default()).unwrap();
        let o = of(&weighted([0.5, 0.25, 0.125, 0.0]));
        assert!((value(&o.force) - (0.5 * 0.25 + 0.25 * 0.25 + 0.125 * 9.0) / 0.875).abs() < 1e-5);
        assert!((value(&o.active) - (0.25 * 0.125 + 0.125 * 2.5) / 0.375).abs() < 1e-5);
        // Equal weights, of any size, change nothing.
        let [plain, small] = [1.0, 0.001].map(|w| of(&weighted([w, w, w, 0.0])));
        for (a, b) in [(&plain.force, &small.force), (&plain.active, &small.active), (&plain.total, &small.total)] {
            assert!((value(a) - value(b)).abs() < 1e-2 * value(a), "{} {}", value(a), value(b));
        }
    }

    #[test]
    fn the_active_threshold_is_in_newtons() {
        // 0.5 units at 0.05 N per unit are 0.025 N: not active.
        let zeros = tensor(&[0.0; 4]);
        let o = objective(&zeros, &zeros, &truth(), 0.05, &LossWeights::default()).unwrap();
        assert!((value(&o.active) - 2.5).abs() < 1e-5);
    }

    #[test]
    fn gradients_agree_with_finite_differences_and_stop_at_masks() {
        // Consistency has a test of its own: its target moves with the logits, but has no gradient.
        let weights = LossWeights {
            force: 1.0,
            contact: 1.0,
            active: 0.2,
            consistency: 0.0,
            keypoints: 0.0,
            positive_weight: 2.0,
        };
        let start = [[0.4f32, 0.1, 1.2, 0.3], [-0.7, 0.6, 0.2, 1.1]];
        let total = |values: [[f32; 4]; 2]| {
            value(&objective(&tensor(&values[0]), &tensor(&values[1]), &truth(), 1.0, &weights).unwrap().total)
        };
        let vars = start.map(|values| Var::from_tensor(&tensor(&values)).unwrap());
        let o = objective(vars[0].as_tensor(), vars[1].as_tensor(), &truth(), 1.0, &weights).unwrap();
        let grads = o.total.backward().unwrap();
        for (side, var) in vars.iter().enumerate() {
            let grad = grads.get(var).unwrap().flatten_all().unwrap().to_vec1::<f32>().unwrap();
            for entry in 0..4 {
                let mut moved = [start; 2];
                moved[0][side][entry] += 1e-2;
                moved[1][side][entry] -= 1e-2;
                let difference = (total(moved[0]) - total(moved[1])) / 2e-2;
                assert!((f64::from(grad[entry]) - difference).abs() < 2e-4, "{side} {entry}: {grad:?} {difference}");
            }
            let masked = if side == 0 { 3 } else { 2 };
            assert_eq!(grad[masked], 0.0);
        }
    }

    /// A loss of consistency alone and its gradients on forces and logits.
    fn consistency_alone(force: &[f32], logits: &[f32], truth: &Targets) -> (f64, Vec<f32>, Option<Vec<f32>>) {
        let weights = LossWeights {
            force: 0.0,
            contact: 0.0,
            active: 0.0,
            consistency: 1.0,
            keypoints: 0.0,
            positive_weight: 2.0,
        };
        let [force, logits] = [force, logits].map(|values| Var::from_tensor(&tensor(values)).unwrap());
        let o = objective(force.as_tensor(), logits.as_tensor(), truth, 0.1, &weights).unwrap();
        let grads = o.consistency.backward().unwrap();
        let of = |var: &Var| grads.get(var).map(|grad| grad.flatten_all().unwrap().to_vec1::<f32>().unwrap());
        (value(&o.total), of(&force).unwrap(), of(&logits))
    }

    #[test]
    fn consistency_has_a_gradient_on_forces_only_where_contact_is_known() {
        let (force, logits) = ([0.4f32, 0.1, 1.2, 0.3], [-0.7, 0.6, 0.2, 1.1]);
        let (_, grad, on_logits) = consistency_alone(&force, &logits, &truth());
        for entry in 0..4 {
            let moved = [1e-2, -1e-2].map(|by| {
                let mut force = force;
                force[entry] += by;
                consistency_alone(&force, &logits, &truth()).0
            });
            let difference = (moved[0] - moved[1]) / 2e-2;
            assert!((f64::from(grad[entry]) - difference).abs() < 1e-3, "{entry}: {grad:?} {difference}");
        }
        assert_eq!(grad[2], 0.0, "its contact is masked");
        assert!(on_logits.is_none_or(|grad| grad.iter().all(|g| *g == 0.0)), "the probability is a target");
    }

    #[test]
    fn without_force_labels_only_consistency_reaches_the_force_head() {
        let truth = Targets { mask_force: tensor(&[0.0; 4]), ..truth() };
        let (force, logits) = ([0.4f32, 0.1, 1.2, 0.3], [-0.7, 0.6, 0.2, 1.1]);
        let grad = |weights: &LossWeights| {
            let var = Var::from_tensor(&tensor(&force)).unwrap();
            let o = objective(var.as_tensor(), &tensor(&logits), &truth, 0.1, weights).unwrap();
            o.total.backward().unwrap().get(&var).unwrap().flatten_all().unwrap().to_vec1::<f32>().unwrap()
        };
        assert_eq!(grad(&LossWeights { consistency: 0.0, ..LossWeights::default() }), [0.0; 4]);
        let alone = consistency_alone(&force, &logits, &truth).1;
        let scaled: Vec<f32> = alone.iter().map(|g| 0.05 * g).collect();
        for (all, alone) in grad(&LossWeights::default()).iter().zip(scaled) {
            assert!((all - alone).abs() < 1e-7, "{all} {alone}");
        }
    }

    #[test]
    fn consistency_of_huge_numbers_is_finite() {
        let (total, grad, _) = consistency_alone(&[1e6, -1e6, 0.0, 1e6], &[-200.0, 200.0, 0.0, 1e30], &truth());
        assert!(total.is_finite() && grad.iter().all(|g| g.is_finite()), "{total} {grad:?}");
    }

    #[test]
    fn the_objective_is_zero_without_supervision() {
        let zeros = tensor(&[0.0; 4]);
        let truth = Targets { mask_force: zeros.clone(), mask_contact: zeros.clone(), ..truth() };
        let o = objective(&tensor(&[1.0; 4]), &tensor(&[1.0; 4]), &truth, 1.0, &LossWeights::default()).unwrap();
        assert_eq!(value(&o.total), 0.0);
    }
}
