//! Spectrum of the total force, with the mean removed and a symmetric Hann window.

use std::f64::consts::PI;

use realfft::RealFftPlanner;

use super::statistics::{finite, is_constant, pearson};

/// Returns the magnitudes of the single-sided spectrum, `n / 2 + 1` bins; None for fewer than three frames (the window is
/// zero at both ends) or a constant trace.
pub fn magnitudes(trace: &[f64]) -> Option<Vec<f64>> {
    let n = trace.len();
    if n < 3 || is_constant(trace) {
        return None;
    }
    let mean = trace.iter().sum::<f64>() / n as f64;
    let hann = |t: usize| 0.5 - 0.5 * (2.0 * PI * t as f64 / (n - 1) as f64).cos();
    let mut windowed: Vec<f64> = trace.iter().enumerate().map(|(t, s)| hann(t) * (s - mean)).collect();
    let transform = RealFftPlanner::new().plan_fft_forward(n);
    let mut spectrum = transform.make_output_vec();
    transform.process(&mut windowed, &mut spectrum).ok()?;
    Some(spectrum.iter().map(|bin| bin.norm()).collect())
}

/// Returns the Pearson correlation of log(1 + magnitude) across the bins; 0 for a constant prediction.
pub fn dft_pearson(pred: &[f64], target: &[f64]) -> Option<f64> {
    let log = |spectrum: Vec<f64>| spectrum.into_iter().map(f64::ln_1p).collect::<Vec<_>>();
    let target = log(magnitudes(target)?);
    match is_constant(pred) {
        true => Some(0.0),
        false => pearson(&log(magnitudes(pred)?), &target),
    }
}

/// Returns the distance of the magnitudes relative to the norm of the target's; a constant prediction has magnitude zero.
pub fn spectral_convergence(pred: &[f64], target: &[f64]) -> Option<f64> {
    let target = magnitudes(target)?;
    let pred = match is_constant(pred) {
        true => vec![0.0; target.len()],
        false => magnitudes(pred)?,
    };
    let norm = |values: &mut dyn Iterator<Item = f64>| values.map(|x| x * x).sum::<f64>().sqrt();
    finite(norm(&mut pred.iter().zip(&target).map(|(p, t)| p - t)) / norm(&mut target.iter().copied()))
}

/// Returns the distance of the strongest frequencies above zero, Hz; of equally strong ones the lowest counts. The strongest
/// frequency of a constant prediction is 0.
pub fn dominant_frequency_error(pred: &[f64], target: &[f64], fps: f64) -> Option<f64> {
    let dominant = |trace: &[f64]| {
        let magnitudes = magnitudes(trace)?;
        let (mut best, mut at) = (f64::NEG_INFINITY, 0);
        for (bin, magnitude) in magnitudes.into_iter().enumerate().skip(1) {
            if magnitude > best {
                (best, at) = (magnitude, bin);
            }
        }
        Some(at as f64 * fps / trace.len() as f64)
    };
    let target = dominant(target)?;
    let pred = if is_constant(pred) { 0.0 } else { dominant(pred)? };
    finite((pred - target).abs())
}
