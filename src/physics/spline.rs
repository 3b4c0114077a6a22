//! Smoothing spline of degree 5 over irregular samples, with the noise gain of its derivatives.

/// Degree of the spline: accelerations are smooth, and exact for polynomials of degree 5.
const DEGREE: usize = 5;
/// Number of basis functions that are not zero at one time.
const ORDER: usize = DEGREE + 1;
/// Binomials of the third difference, which the penalty squares.
const THIRD: [f64; 4] = [-1.0, 3.0, -3.0, 1.0];
/// Weight of the penalty that keeps the system solvable where samples are missing, relative to one sample.
const RIDGE: f64 = 1e-12;

/// Linear smoother of samples at given times: the least squares spline under a penalty on its third derivative.
///
/// At a frequency of `bandwidth`, 1/s, the smoother halves a sinusoid; slower motion passes, faster motion does not.
#[derive(Debug, Clone)]
pub struct Smoother {
    start: f64,
    interval: f64,
    /// Times and weights of the samples.
    samples: Vec<(f64, f64)>,
    /// Banded Cholesky factor of the normal equations, row by row: entry `k` of a row is in column `row - k`.
    factor: Vec<[f64; ORDER]>,
}

/// Value and first two derivatives of the basis functions at one time; the first index is that of the first function.
type Basis = (usize, [[f64; ORDER]; 3]);

impl Smoother {
    /// Creates the smoother of samples at `times`, s, ascending, with a weight each (0 = missing), for a knot interval of
    /// `interval`, s. `None` without two different times, or if a number is not finite or not positive.
    pub fn new(times: &[f64], weights: &[f64], interval: f64, bandwidth: f64) -> Option<Self> {
        let (start, end) = (*times.first()?, *times.last()?);
        let usable = interval.is_finite() && interval > 0.0 && bandwidth.is_finite() && bandwidth > 0.0;
        if !usable || !(end - start).is_finite() || end <= start || weights.len() != times.len() {
            return None;
        }
        let spans = ((end - start) / interval).ceil().max(1.0) as usize;
        let n = spans + DEGREE;
        let samples: Vec<(f64, f64)> = times.iter().copied().zip(weights.iter().copied()).collect();
        let mut smoother = Self { start, interval, samples, factor: vec![[0.0; ORDER]; n] };
        // The sum over samples approximates an integral divided by the interval: the penalty takes the same factor.
        let cut = (2.0 * std::f64::consts::PI * bandwidth).powi(6);
        let penalty = 1.0 / (cut * interval.powi(6));
        for first in 0..n - 3 {
            for (i, a) in THIRD.iter().enumerate() {
                for (j, b) in THIRD.iter().enumerate().take(i + 1) {
                    smoother.factor[first + i][i - j] += penalty * a * b;
                }
            }
        }
        for row in &mut smoother.factor {
            row[0] += RIDGE;
        }
        for index in 0..smoother.samples.len() {
            let (time, weight) = smoother.samples[index];
            let (first, [values, ..]) = smoother.basis(time);
            for (i, a) in values.iter().enumerate() {
                for (j, b) in values.iter().enumerate().take(i + 1) {
                    smoother.factor[first + i][i - j] += weight * a * b;
                }
            }
        }
        smoother.decompose().then_some(smoother)
    }

    /// Returns the coefficients that fit `values`, one per sample.
    pub fn fit(&self, values: &[f64]) -> Vec<f64> {
        let mut right = vec![0.0; self.factor.len()];
        for ((time, weight), value) in self.samples.iter().zip(values).filter(|((_, weight), _)| *weight > 0.0) {
            let (first, [basis, ..]) = self.basis(*time);
            for (k, b) in basis.iter().enumerate() {
                right[first + k] += weight * b * value;
            }
        }
        self.solve(&mut right);
        right
    }

    /// Returns value, velocity and acceleration at `time` of the spline with these coefficients.
    pub fn at(&self, coefficients: &[f64], time: f64) -> [f64; 3] {
        let (first, basis) = self.basis(time);
        basis.map(|row| row.iter().zip(&coefficients[first..]).map(|(b, c)| b * c).sum())
    }

    /// Returns the factors by which independent noise of standard deviation 1 in every sample appears in value, velocity
    /// and acceleration at `time`.
    pub fn noise_gain(&self, time: f64) -> [f64; 3] {
        let (first, basis) = self.basis(time);
        basis.map(|row| {
            let mut right = vec![0.0; self.factor.len()];
            right[first..first + ORDER].copy_from_slice(&row);
            self.solve(&mut right);
            let square = |(time, weight): &(f64, f64)| (weight * self.at(&right, *time)[0]).powi(2);
            self.samples.iter().map(square).sum::<f64>().sqrt()
        })
    }

    /// Computes basis functions and their derivatives by de Boor's recursion on uniform knots.
    fn basis(&self, time: f64) -> Basis {
        let spans = self.factor.len() - DEGREE;
        let place = ((time - self.start) / self.interval).clamp(0.0, spans as f64);
        let first = (place.floor() as usize).min(spans - 1);
        let u = place - first as f64;
        let raise = |lower: &[f64; ORDER], degree: usize| {
            std::array::from_fn::<f64, ORDER, _>(|k| {
                let left = if (1..=degree).contains(&k) { (u + (degree - k) as f64) * lower[k - 1] } else { 0.0 };
                let right = if k < degree { (1.0 + k as f64 - u) * lower[k] } else { 0.0 };
                (left + right) / degree as f64
            })
        };
        let differ = |lower: &[f64; ORDER], degree: usize| {
            std::array::from_fn::<f64, ORDER, _>(|k| {
                let before = if (1..=degree).contains(&k) { lower[k - 1] } else { 0.0 };
                let after = if k < degree { lower[k] } else { 0.0 };
                (before - after) / self.interval
            })
        };
        let mut of_degree = [[0.0; ORDER]; ORDER];
        of_degree[0][0] = 1.0;
        for degree in 1..ORDER {
            of_degree[degree] = raise(&of_degree[degree - 1], degree);
        }
        let velocity = differ(&of_degree[DEGREE - 1], DEGREE);
        let acceleration = differ(&differ(&of_degree[DEGREE - 2], DEGREE - 1), DEGREE);
        (first, [of_degree[DEGREE], velocity, acceleration])
    }

    /// Factors the normal equations in place; false if they are singular.
    fn decompose(&mut self) -> bool {
        for row in 0..self.factor.len() {
            for k in (0..ORDER.min(row + 1)).rev() {
                let column = row - k;
                let mut sum = self.factor[row][k];
                for m in k + 1..ORDER.min(row + 1) {
                    // Entries of both rows in column `row - m`.
                    if m - k < ORDER {
                        sum -= self.factor[row][m] * self.factor[column][m - k];
                    }
                }
                if k > 0 {
                    self.factor[row][k] = sum / self.factor[column][0];
                } else if sum > 0.0 {
                    self.factor[row][0] = sum.sqrt();
                } else {
                    return false;
                }
            }
        }
        true
    }

    fn solve(&self, right: &mut [f64]) {
        let n = right.len();
        for row in 0..n {
            let known: f64 = (1..ORDER.min(row + 1)).map(|k| self.factor[row][k] * right[row - k]).sum();
            right[row] = (right[row] - known) / self.factor[row][0];
        }
        for row in (0..n).rev() {
            let known: f64 = (1..ORDER.min(n - row)).map(|k| self.factor[row + k][k] * right[row + k]).sum();
            right[row] = (right[row] - known) / self.factor[row][0];
        }
    }
}
