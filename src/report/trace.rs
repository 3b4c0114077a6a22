//! Plot of the total force over an episode, in SVG.

use std::fmt::Write;
use std::ops::Range;

use crate::dataset::Labelled;
use crate::hand::Side;
use crate::tactile::N_FIELD;

/// Largest number of points of a curve; in longer episodes each point is the maximum of several frames.
const MAX_POINTS: usize = 600;
/// Width and height of a plot, pixels.
const SIZE: (f64, f64) = (760.0, 150.0);
/// Margins of a plot: left, top, right, bottom, pixels.
const MARGIN: (f64, f64, f64, f64) = (46.0, 10.0, 10.0, 24.0);
/// Colours of left and right hand.
const COLORS: [&str; 2] = ["#1b5fae", "#c2410c"];

/// Total force over one episode.
#[derive(Debug, Clone, PartialEq)]
pub struct Trace {
    /// Index of the episode.
    pub episode: usize,
    /// Time of the first frame, s.
    pub start: f64,
    /// Time from the first frame to the last, s.
    pub seconds: f64,
    /// Total force of left and right hand, N; NaN = unknown.
    pub force: [Vec<f64>; 2],
    /// True total force of left and right hand, N, if there is truth.
    pub truth: Option<[Vec<f64>; 2]>,
}

/// Returns the traces of the first `episodes` episodes.
pub fn traces(labelled: &Labelled, episodes: usize) -> Vec<Trace> {
    let labels = &labelled.labels;
    let trace = |(episode, Range { start, end }): (usize, Range<usize>)| {
        let forces =
            |force: &[f32]| Side::BOTH.map(|side| thinned(&totals(&force[start * N_FIELD..end * N_FIELD], side)));
        Trace {
            episode,
            start: labels.stamp_or_index(start),
            seconds: labels.stamp_or_index(end - 1) - labels.stamp_or_index(start),
            force: forces(&labels.force),
            truth: labelled.truth.as_ref().map(|truth| forces(&truth.force)),
        }
    };
    let ranges = labels.episodes().into_iter().filter(|range| !range.is_empty()).take(episodes);
    ranges.enumerate().map(trace).collect()
}

/// Returns the total force of one hand in each frame, N.
pub(crate) fn totals(force: &[f32], side: Side) -> Vec<f64> {
    force.chunks_exact(N_FIELD).map(|frame| frame[side.range()].iter().map(|f| f64::from(*f)).sum()).collect()
}

/// Reduces a curve to the maximum of each group of neighbours; unknown only where the whole group is.
fn thinned(values: &[f64]) -> Vec<f64> {
    values
        .chunks(values.len().div_ceil(MAX_POINTS).max(1))
        .map(|group| group.iter().copied().fold(f64::NAN, f64::max))
        .collect()
}

impl Trace {
    /// Returns the plot; `max_force` is the force at the upper end of the axis, N.
    pub fn svg(&self, max_force: f64) -> String {
        let (left, top, right, bottom) = MARGIN;
        let (width, height) = (SIZE.0 - left - right, SIZE.1 - top - bottom);
        let max_force = if max_force > 0.0 { max_force } else { 1.0 };
        let mut svg =
            format!(r#"<svg viewBox="0 0 {} {}" role="img" aria-label="Total force over time">"#, SIZE.0, SIZE.1);
        for share in [0.0, 0.5, 1.0] {
            let y = top + height * (1.0 - share);
            // Writing to a String cannot fail.
            let _ = write!(
                svg,
                r##"<line x1="{left}" x2="{}" y1="{y}" y2="{y}" stroke="#ddd"/><text x="{}" y="{}" text-anchor="end">{:.1} N</text>"##,
                left + width,
                left - 5.0,
                y + 4.0,
                share * max_force
            );
            let x = left + width * share;
            let anchor = if share == 0.0 {
                "start"
            } else if share == 1.0 {
                "end"
            } else {
                "middle"
            };
            let (y, time) = (SIZE.1 - 7.0, share * self.seconds);
            let _ = write!(svg, r#"<text x="{x}" y="{y}" text-anchor="{anchor}">{time:.2} s</text>"#);
        }
        let mut curve = |values: &[f64], color: &str, style: &str| {
            let last = values.len().saturating_sub(1).max(1) as f64;
            let (mut path, mut pen) = (String::new(), "M");
            for (index, value) in values.iter().enumerate() {
                if value.is_nan() {
                    // An unknown value interrupts the curve.
                    pen = "M";
                    continue;
                }
                let (x, y) = (left + width * index as f64 / last, top + height * (1.0 - (value / max_force).min(1.0)));
                let _ = write!(path, "{pen}{x:.1} {y:.1}");
                pen = "L";
            }
            let _ = write!(svg, r#"<path d="{path}" fill="none" stroke="{color}" {style}/>"#);
        };
        for side in Side::BOTH {
            if let Some(truth) = &self.truth {
                curve(
                    &truth[side as usize],
                    COLORS[side as usize],
                    r#"stroke-width="1" stroke-dasharray="4 3" class="truth""#,
                );
            }
            curve(&self.force[side as usize], COLORS[side as usize], r#"stroke-width="1.8""#);
        }
        svg + "</svg>"
    }

    /// Returns the largest total force of the trace, N.
    pub fn max_force(&self) -> f64 {
        let truth = self.truth.iter().flatten();
        self.force.iter().chain(truth).flatten().copied().fold(0.0, f64::max)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn peaks_survive_thinning_and_gaps_stay_gaps() {
        let mut values = vec![0.0; 10_000];
        values[7_777] = 3.0;
        let thin = thinned(&values);
        assert!(thin.len() <= MAX_POINTS && thin.contains(&3.0));
        let trace =
            Trace { episode: 0, start: 0.0, seconds: 1.0, force: [vec![0.0, f64::NAN, 2.0], vec![]], truth: None };
        let svg = trace.svg(2.0);
        assert!(svg.contains(r#"d="M46.0 126.0M750.0 10.0""#), "{svg}");
        assert_eq!(trace.max_force(), 2.0);
    }
}
