//! Draws the demo's picture: camera image, true and predicted touch on the hand, and force over time.

use std::path::Path;

use image::RgbImage;
use plotters::style::RGBColor;

use crate::cli::sheet::{Bar, PANEL, Series, Sheet};
use crate::error::Result;
use crate::hand::{HandModel, PosedHand, Region};
use crate::render;
use crate::render::plot::ACCENT;

const TRUTH: RGBColor = RGBColor(30, 30, 30);
const PREDICTED: RGBColor = ACCENT;

/// Total force of both hands at one image.
#[derive(Debug, Clone, Copy)]
pub struct TracePoint {
    /// Seconds since the first image.
    pub seconds: f64,
    /// Predicted total force, N.
    pub predicted: f64,
    /// True total force, N.
    pub truth: f64,
}

/// One image of the run and the touch of one hand in it.
#[derive(Debug)]
pub struct Snapshot<'a> {
    /// Seconds since the first image.
    pub seconds: f64,
    /// Camera image.
    pub image: &'a RgbImage,
    /// Predicted force, (778), N.
    pub predicted: &'a [f32],
    /// True force, (778), N.
    pub truth: &'a [f32],
}

/// Least difference of a region's force that the picture names, as a share of the hand's true force.
const NAMED: f32 = 0.05;
/// Largest number of regions named on one line.
const MOST_NAMED: usize = 2;

/// Writes the picture to `path` (PNG).
///
/// # Errors
/// If drawing or writing fails.
pub fn write(
    path: &Path,
    hand: &HandModel,
    posed: &PosedHand,
    snapshot: &Snapshot,
    trace: &[TracePoint],
) -> Result<()> {
    let peak = snapshot.truth.iter().chain(snapshot.predicted).copied().fold(0.05, f32::max);
    let view = |force: &[f32]| {
        render::hand_picture(hand, posed, &render::force_colors(force, peak), render::View::Palmar, (PANEL, PANEL))
    };
    let total = |force: &[f32]| force.iter().sum::<f32>();
    let series = |name: String, color, value: fn(&TracePoint) -> f64| Series {
        name,
        color,
        points: trace.iter().map(|point| (point.seconds, value(point))).collect(),
    };
    let found = found(trace)
        .map_or_else(String::new, |share| format!(" ({:.0} % of the true force of the whole run)", 100.0 * share));
    let sheet = Sheet {
        panels: [
            (format!("camera, t = {:.1} s", snapshot.seconds), snapshot.image.clone()),
            (format!("truth (simulator): {:.1} N in total", total(snapshot.truth)), view(snapshot.truth)),
            (
                format!("predicted from the image: {:.1} N in total", total(snapshot.predicted)),
                view(snapshot.predicted),
            ),
        ],
        bar: Bar { peak, label: "force per vertex, N", column: 1.0 },
        note: differences(&hand.regions(), snapshot.predicted, snapshot.truth).into(),
        axis: "total force, N",
        series: [
            series("truth".into(), TRUTH, |point| point.truth),
            series(format!("predicted{found}"), PREDICTED, |point| point.predicted),
        ],
        shown: snapshot.seconds,
    };
    sheet.write(path)
}

/// Returns the share of the true force that was predicted where there was some: over all moments, the smaller of both forces
/// over the true one.
fn found(trace: &[TracePoint]) -> Option<f64> {
    let known = || trace.iter().filter(|point| point.predicted.is_finite() && point.truth.is_finite());
    let truth: f64 = known().map(|point| point.truth).sum();
    (truth > 0.0).then(|| known().map(|point| point.predicted.min(point.truth)).sum::<f64>() / truth)
}

/// Tells the regions where the prediction misses force, and where it has too much.
fn differences(regions: &[Region], predicted: &[f32], truth: &[f32]) -> [String; 2] {
    let sum = |region: Region, force: &[f32]| -> f32 {
        let own = regions.iter().zip(force).filter(|(of, force)| **of == region && force.is_finite());
        own.map(|(_, force)| *force).sum()
    };
    let all: Vec<(Region, f32)> =
        Region::ALL.into_iter().map(|region| (region, sum(region, truth) - sum(region, predicted))).collect();
    let least = NAMED * truth.iter().filter(|force| force.is_finite()).sum::<f32>();
    let told = |title: &str, sign: f32| {
        let mut named: Vec<(Region, f32)> =
            all.iter().map(|(region, more)| (*region, sign * more)).filter(|(_, more)| *more > least).collect();
        named.sort_by(|a, b| b.1.total_cmp(&a.1));
        named.truncate(MOST_NAMED);
        let named: Vec<String> =
            named.iter().map(|(region, more)| format!("{} {more:.1} N", region.name().replace('_', " "))).collect();
        if named.is_empty() { format!("{title}: nothing") } else { format!("{title}: {}", named.join(", ")) }
    };
    [told("missed here", 1.0), told("too much here", -1.0)]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn missed_and_false_force_is_told_by_region() {
        let regions = [Region::ALL[0], Region::ALL[0], Region::ALL[3], Region::Palm];
        let names = [Region::ALL[0], Region::ALL[3]].map(|region| region.name().replace('_', " "));
        let [missed, more] = differences(&regions, &[0.5, 0.2, 1.0, f32::NAN], &[1.0, 1.0, 0.4, 0.0]);
        assert_eq!(missed, format!("missed here: {} 1.3 N", names[0]));
        assert_eq!(more, format!("too much here: {} 0.6 N", names[1]));
        let [missed, more] = differences(&regions, &[1.0, 1.0, 0.4, 0.0], &[1.0, 1.0, 0.4, 0.0]);
        assert_eq!([missed.as_str(), more.as_str()], ["missed here: nothing", "too much here: nothing"]);
    }

    #[test]
    fn force_predicted_at_other_times_finds_nothing() {
        let point = |predicted, truth| TracePoint { seconds: 0.0, predicted, truth };
        assert_eq!(found(&[point(2.0, 0.0), point(1.0, 4.0), point(f64::NAN, 4.0)]), Some(0.25));
        assert_eq!(found(&[point(2.0, 0.0)]), None);
    }
}
