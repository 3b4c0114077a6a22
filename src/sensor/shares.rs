//! Shares of the taxels' forces that vertices take, from the weights of the readings.

/// Largest number of rounds of the iteration.
const ROUNDS: usize = 1000;
/// Least factor, as a share of the start: a vertex that took no force at all could not be converted back.
const LEAST: f64 = 0.05;
/// Error of the sums at which the iteration ends.
const ENOUGH: f64 = 1e-7;

/// Least area of a vertex, m²: one without an area takes part as well.
pub const LEAST_AREA: f32 = 1e-8;

/// Finds factors (778), 0 where no taxel is, that turn readings into shares of force: c with Σ_v c_v w_vk = 1 for every taxel k, nearest to the start, the vertices' areas (multiplicative algebraic
/// reconstruction): then Σ_v c_v reading_v is the sum of the taxels, whatever they read. Where taxels are
/// finer than the vertices, or lie between them, no such factors may exist.
///
/// `weights`: (778) lists of (taxel, weight), that sum to 1 or are empty. `areas`: (778) m².
pub fn factors(weights: &[Vec<(u32, f32)>], areas: &[f32], n_taxels: usize) -> Vec<f64> {
    let mut factor: Vec<f64> = weights
        .iter()
        .zip(areas)
        .map(|(list, area)| if list.is_empty() { 0.0 } else { f64::from(area.max(LEAST_AREA)) })
        .collect();
    let sums = |factor: &[f64]| {
        let mut sums = vec![0.0; n_taxels];
        for (list, factor) in weights.iter().zip(factor) {
            list.iter().for_each(|&(taxel, weight)| sums[taxel as usize] += factor * f64::from(weight));
        }
        sums
    };
    let mut now = sums(&factor);
    let (total, placed) = (now.iter().sum::<f64>(), now.iter().filter(|sum| **sum > 0.0).count());
    factor.iter_mut().for_each(|factor| *factor *= placed as f64 / total);
    let least: Vec<f64> = factor.iter().map(|start| LEAST * start).collect();
    now = sums(&factor);
    for _ in 0..ROUNDS {
        let far = now.iter().filter(|sum| **sum > 0.0).map(|sum| (sum - 1.0).abs()).fold(0.0, f64::max);
        if far < ENOUGH {
            break;
        }
        for ((list, factor), least) in weights.iter().zip(&mut factor).zip(&least) {
            let step: f64 = list.iter().map(|&(taxel, weight)| -f64::from(weight) * now[taxel as usize].ln()).sum();
            *factor = (*factor * step.exp()).max(*least);
        }
        now = sums(&factor);
    }
    factor
}
