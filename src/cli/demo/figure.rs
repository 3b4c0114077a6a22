//! Draws the demo's picture: camera image, true and predicted touch on the hand, and force over time.

use std::path::Path;

use image::RgbImage;
use plotters::style::RGBColor;

use crate::cli::sheet::{Bar, PANEL, Series, Sheet};
use crate::error::Result;
use crate::hand::{HandModel, PosedHand};
use crate::render;

const TRUTH: RGBColor = RGBColor(30, 30, 30);
const PREDICTED: RGBColor = RGBColor(214, 96, 24);

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
    let series = |name, color, value: fn(&TracePoint) -> f64| Series {
        name,
        color,
        points: trace.iter().map(|point| (point.seconds, value(point))).collect(),
    };
    let sheet = Sheet {
        panels: [
            (format!("camera, t = {:.1} s", snapshot.seconds), snapshot.image.clone()),
            (format!("truth (simulator): {:.1} N in total", total(snapshot.truth)), view(snapshot.truth)),
            (
                format!("predicted from the image: {:.1} N in total", total(snapshot.predicted)),
                view(snapshot.predicted),
            ),
        ],
        bar: Bar { peak, label: "force per vertex, newton", column: 1.5 },
        note: None,
        axis: "total force, N",
        series: [series("truth", TRUTH, |point| point.truth), series("predicted", PREDICTED, |point| point.predicted)],
        shown: snapshot.seconds,
    };
    sheet.write(path)
}
