//! Plot of the total force over an episode, in SVG.

use std::fmt::Write;
use std::ops::Range;

use crate::dataset::Labelled;
use crate::hand::Side;
use crate::tactile::N_FIELD;
use crate::text::significant;

/// Largest number of points of a curve; in longer episodes each point is the maximum of several frames.
const MAX_POINTS: usize = 600;
/// Width and height of a plot, pixels.
const SIZE: (f64, f64) = (760.0, 150.0);
/// Margins of a plot: left, top, right, bottom, pixels.
const MARGIN: (f64, f64, f64, f64) = (46.0, 10.0, 10.0, 24.0);
/// Least force at the upper end of an axis, N: that of a light touch, so that noise of a few millinewtons stays flat.
const LEAST_TOP: f64 = 0.5;
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
        let max_force = rounded_up(max_force.max(LEAST_TOP));
        let mut svg = format!(
            r#"<svg viewBox="0 0 {} {}" role="img" aria-label="Total force over time" data-episode="{}" data-start="{}" data-seconds="{}">"#,
            SIZE.0, SIZE.1, self.episode, self.start, self.seconds
        );
        for share in [0.0, 0.5, 1.0] {
            let y = top + height * (1.0 - share);
            // Writing to a String cannot fail.
            let _ = write!(
                svg,
                r##"<line x1="{left}" x2="{}" y1="{y}" y2="{y}" stroke="#ddd"/><text x="{}" y="{}" text-anchor="end">{} N</text>"##,
                left + width,
                left - 5.0,
                y + 4.0,
                significant(share * max_force)
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
        let (low, high) = (top + height, top);
        // The page moves this line to the frame that it shows.
        let _ = write!(
            svg,
            r##"<line class="now" x1="{left}" x2="{left}" y1="{low}" y2="{high}" stroke="#1e1e24" visibility="hidden"/>"##
        );
        svg + "</svg>"
    }

    /// Returns the largest total force of the trace, N.
    pub fn max_force(&self) -> f64 {
        let truth = self.truth.iter().flatten();
        self.force.iter().chain(truth).flatten().copied().fold(0.0, f64::max)
    }
}

/// Returns the next of the numbers 1, 2, 2.5, 5 and 10, times a power of ten, at or above `value`, which is above 0.
fn rounded_up(value: f64) -> f64 {
    let power = 10f64.powf(value.log10().floor());
    [1.0, 2.0, 2.5, 5.0, 10.0].map(|step| step * power).into_iter().find(|top| *top >= value).unwrap_or(value)
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

    #[test]
    fn an_axis_ends_at_a_round_number_and_does_not_inflate_millinewtons() {
        assert_eq!([0.5, 0.51, 2.0, 2.1, 7.0, 43.0].map(rounded_up), [0.5, 1.0, 2.0, 2.5, 10.0, 50.0]);
        let trace = Trace { episode: 0, start: 0.0, seconds: 1.0, force: [vec![0.0, 0.009], vec![]], truth: None };
        // 0.009 of 0.5 N over 116 pixels is two pixels.
        assert!(trace.svg(0.009).contains(r#"d="M46.0 126.0L750.0 123.9""#), "{}", trace.svg(0.009));
    }
}
