//! Errors of a trace against a reference: quasi-static forces, impulses and contact sets.

use egotac::score::metrics::contact::Confusion;
use egotac::tactile::N_FIELD;
use serde::{Deserialize, Serialize};

use super::trace::{N_SITES, Trace};

/// Errors against a reference; `None` if the reference has nothing to compare with.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
pub struct Errors {
    /// Sum over fingers and palms of |mean force over the quiet bins - reference|, relative to the reference's sum.
    pub force: Option<f64>,
    /// Sum of the differences of impulses over the whole run, relative to the sum of the reference.
    pub impulse: Option<f64>,
    /// F1 of the vertices in contact (label c) at the frames.
    pub f1: Option<f64>,
    /// Share of vertices and frames with the same contact.
    pub agreement: Option<f64>,
}

/// Sums for the errors, pooled over seeds.
#[derive(Debug, Clone, Copy, Default)]
pub struct Pool {
    force: [f64; 2],
    impulse: [f64; 2],
    counts: Confusion,
}

impl Pool {
    /// Adds a trace and its reference; forces are compared over `bins`.
    pub fn add(&mut self, trace: &Trace, reference: &Trace, bins: &[usize]) {
        let time = bins.len() as f64;
        add(&mut self.force, trace.mean_forces(bins), reference.mean_forces(bins), time);
        add(&mut self.impulse, trace.total_impulses(), reference.total_impulses(), 1.0);
        self.add_sets(&trace.touched, &reference.touched);
    }

    /// Adds contact sets alone: per frame the vertices in contact, ascending. A missing frame counts as one without contact.
    pub fn add_sets(&mut self, touched: &[Vec<u32>], reference: &[Vec<u32>]) {
        for (index, truth) in reference.iter().enumerate() {
            let got = touched.get(index).map_or(&[][..], Vec::as_slice);
            let both = got.iter().filter(|vertex| truth.binary_search(vertex).is_ok()).count();
            let (tp, fp, fn_) = (both as u64, (got.len() - both) as u64, (truth.len() - both) as u64);
            self.counts = self.counts + Confusion { tp, fp, fn_, tn: N_FIELD as u64 - tp - fp - fn_, unknown: 0 };
        }
    }

    /// Returns the errors of all traces added.
    pub fn errors(&self) -> Errors {
        let ratio = |[difference, size]: [f64; 2]| (size > 0.0).then(|| difference / size);
        let total = self.counts.total();
        Errors {
            force: ratio(self.force),
            impulse: ratio(self.impulse),
            f1: self.counts.scores().f1,
            agreement: (total > 0).then(|| (self.counts.tp + self.counts.tn) as f64 / total as f64),
        }
    }
}

fn add(sums: &mut [f64; 2], values: [f64; N_SITES], reference: [f64; N_SITES], weight: f64) {
    for (value, reference) in values.into_iter().zip(reference) {
        sums[0] += weight * (value - reference).abs();
        sums[1] += weight * reference;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn trace(force: f64, touched: &[u32]) -> Trace {
        let mut sites = [0.0; N_SITES];
        (sites[6], sites[7]) = (0.04 * force, 0.04 * 2.0);
        Trace {
            interval: 0.04,
            impulses: vec![sites; 5],
            lifts: vec![0.04 * 3.0; 5],
            accelerations: vec![0.0; 5],
            weights: vec![0.04 * 3.0; 5],
            touched: vec![touched.to_vec(); 6],
            ..Trace::default()
        }
    }

    #[test]
    fn a_trace_has_no_error_against_itself() {
        let reference = trace(2.0, &[3, 900]);
        let bins = reference.quiet();
        assert_eq!(bins, [1, 2, 3]);
        let mut pool = Pool::default();
        pool.add(&reference, &reference, &bins);
        let same = Errors { force: Some(0.0), impulse: Some(0.0), f1: Some(1.0), agreement: Some(1.0) };
        assert_eq!(pool.errors(), same);
        assert!((reference.lift(&bins).unwrap() - 1.0).abs() < 1e-12);
    }

    #[test]
    fn errors_are_relative_to_the_reference() {
        let (reference, other) = (trace(2.0, &[3, 900]), trace(1.6, &[3, 5, 7]));
        let mut pool = Pool::default();
        pool.add(&other, &reference, &reference.quiet());
        let errors = pool.errors();
        // 0.4 N of 2 + 2 N; one vertex right, two too many, one missed.
        assert!((errors.force.unwrap() - 0.1).abs() < 1e-12 && (errors.impulse.unwrap() - 0.1).abs() < 1e-12);
        assert!((errors.f1.unwrap() - 0.4).abs() < 1e-12);
        assert!((errors.agreement.unwrap() - (1.0 - 3.0 / 1556.0)).abs() < 1e-12);
    }

    #[test]
    fn without_touch_there_is_nothing_to_compare() {
        let none = Trace { touched: vec![Vec::new(); 6], ..Trace::default() };
        let mut pool = Pool::default();
        pool.add(&none, &none, &none.quiet());
        assert_eq!(pool.errors(), Errors { agreement: Some(1.0), ..Errors::default() });
    }

    #[test]
    fn a_run_that_ended_early_misses_the_rest() {
        let reference = trace(2.0, &[3]);
        let mut lost = reference.clone();
        lost.impulses.truncate(1);
        lost.touched.truncate(2);
        let mut pool = Pool::default();
        pool.add(&lost, &reference, &reference.quiet());
        let errors = pool.errors();
        assert_eq!((errors.force, errors.f1), (Some(1.0), Some(0.5)));
        assert!((errors.impulse.unwrap() - 0.8).abs() < 1e-12);
    }
}
