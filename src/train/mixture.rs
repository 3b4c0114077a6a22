//! Number of windows of each source in an epoch (paper, Dataset sampling).

use crate::error::{Error, Result};

/// Returns the windows of each source in an epoch of `epoch` windows: shares p_i ~ n_i^`temperature` of the sources' sizes n_i, but at
/// least `quotas[i]`; the counts sum to `epoch` exactly.
///
/// Temperature 1 samples sources in proportion to their size, 0 samples all equally. An empty source gets no windows.
///
/// # Errors
/// If the quotas together are more than the epoch, or a quota is asked of a source that is empty.
pub fn counts(sizes: &[usize], quotas: &[usize], epoch: usize, temperature: f64) -> Result<Vec<usize>> {
    if let Some(source) = (0..sizes.len()).find(|i| sizes[*i] == 0 && quotas[*i] > 0) {
        return Err(Error::value(
            format!("data[{source}].quota"),
            "0, since it holds no frames",
            format!("{} windows", quotas[source]),
        ));
    }
    let asked: usize = quotas.iter().sum();
    if asked > epoch {
        return Err(Error::value("data, sum of quotas", format!("at most the epoch's {epoch} windows"), asked));
    }
    let weight = |size: usize| if size == 0 { 0.0 } else { (size as f64).powf(temperature) };
    // A source whose share is below its quota gets exactly the quota; the others divide the rest.
    let mut held = vec![false; sizes.len()];
    loop {
        let free = |i: &usize| !held[*i];
        let left = epoch - (0..sizes.len()).filter(|i| held[*i]).map(|i| quotas[i]).sum::<usize>();
        let total: f64 = (0..sizes.len()).filter(free).map(|i| weight(sizes[i])).sum();
        let share = |i: usize| if total > 0.0 { left as f64 * weight(sizes[i]) / total } else { 0.0 };
        let short = (0..sizes.len()).filter(free).find(|i| share(*i) < quotas[*i] as f64);
        match short {
            Some(source) => held[source] = true,
            None => {
                let shares: Vec<f64> =
                    (0..sizes.len()).map(|i| if held[i] { quotas[i] as f64 } else { share(i) }).collect();
                return Ok(round(&shares, epoch));
            }
        }
    }
}

/// Rounds shares to whole numbers that sum to `total` (largest remainder method; ties go to the first).
fn round(shares: &[f64], total: usize) -> Vec<usize> {
    // A share that is a whole number may lie a rounding error below it.
    let mut counts: Vec<usize> = shares.iter().map(|share| (share + 1e-9).floor() as usize).collect();
    let mut order: Vec<usize> = (0..shares.len()).filter(|i| shares[*i] > 0.0).collect();
    order.sort_by(|a, b| (shares[*b] - counts[*b] as f64).total_cmp(&(shares[*a] - counts[*a] as f64)));
    let missing = total.saturating_sub(counts.iter().sum());
    order.iter().cycle().take(if order.is_empty() { 0 } else { missing }).for_each(|i| counts[*i] += 1);
    counts
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn shares_follow_the_root_of_the_sizes() {
        // Roots 10, 20, 30 of 60.
        assert_eq!(counts(&[100, 400, 900], &[0; 3], 600, 0.5).unwrap(), [100, 200, 300]);
        assert_eq!(counts(&[100, 400, 900], &[0; 3], 1400, 1.0).unwrap(), [100, 400, 900]);
        assert_eq!(counts(&[100, 400, 0], &[0; 3], 10, 0.0).unwrap(), [5, 5, 0]);
    }

    #[test]
    fn a_small_source_gets_its_quota_and_the_others_divide_the_rest() {
        assert_eq!(counts(&[1, 400, 400], &[200, 0, 0], 600, 0.5).unwrap(), [200, 200, 200]);
        // Holding one source at its quota leaves another below its own.
        assert_eq!(counts(&[1, 100, 10_000], &[50, 10, 0], 100, 0.5).unwrap(), [50, 10, 40]);
    }

    #[test]
    fn quotas_that_cannot_be_met_are_refused() {
        let error = counts(&[5, 5], &[3, 4], 6, 0.5).unwrap_err().to_string();
        assert!(error.contains("quotas") && error.contains("at most the epoch's 6"), "{error}");
        assert!(counts(&[5, 0], &[0, 1], 6, 0.5).unwrap_err().to_string().contains("data[1].quota"));
    }

    proptest! {
        #[test]
        fn counts_sum_to_the_epoch_and_keep_quotas(
            sources in prop::collection::vec((1usize..100_000, 0usize..50), 1..8),
            more in 0usize..5000,
            temperature in 0.0f64..1.5,
        ) {
            let (sizes, quotas): (Vec<usize>, Vec<usize>) = sources.into_iter().unzip();
            let epoch = quotas.iter().sum::<usize>() + more;
            let counts = counts(&sizes, &quotas, epoch, temperature).unwrap();
            prop_assert_eq!(counts.iter().sum::<usize>(), epoch);
            prop_assert!(counts.iter().zip(&quotas).all(|(count, quota)| count >= quota), "{:?} {:?}", counts, quotas);
        }
    }
}
