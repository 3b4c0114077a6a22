//! The demo's picture: what the camera saw, the touch on the hand in truth and as predicted, and the force over time.

use std::path::Path;

use image::RgbImage;
use plotters::style::RGBColor;

use crate::cli::sheet::{Bar, PANEL, Series, Sheet};
use crate::error::Result;
use crate::hand::{HandModel, PosedHand};
use crate::render;

const TRUTH: RGBColor = RGBColor(30, 30, 30);
const PREDICTED: RGBColor = RGBColor(214, 96, 24);

/// Total force of both hands at one image, for the trace.
#[derive(Debug, Clone, Copy)]
pub struct TracePoint {
    /// Seconds since the first image.
    pub seconds: f64,
    /// Predicted total force, N.
    pub predicted: f64,
    /// The simulator's total force, N.
    pub truth: f64,
}

/// What the upper row shows: one image of the run and the touch of one hand in it.
#[derive(Debug)]
pub struct Moment<'a> {
    /// Seconds since the first image.
    pub seconds: f64,
    /// The camera image.
    pub image: &'a RgbImage,
    /// (778) predicted force, N.
    pub predicted: &'a [f32],
    /// (778) the simulator's force, N.
    pub truth: &'a [f32],
}

/// Writes the picture to `path` (PNG).
///
/// # Errors
/// If drawing or writing fails.
pub fn write(path: &Path, hand: &HandModel, posed: &PosedHand, moment: &Moment, trace: &[TracePoint]) -> Result<()> {
    let peak = moment.truth.iter().chain(moment.predicted).copied().fold(0.05, f32::max);
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
            (format!("camera, t = {:.1} s", moment.seconds), moment.image.clone()),
            (format!("truth (simulator): {:.1} N in total", total(moment.truth)), view(moment.truth)),
            (format!("predicted from the image: {:.1} N in total", total(moment.predicted)), view(moment.predicted)),
        ],
        bar: Bar { peak, label: "force per vertex, newton", column: 1.5 },
        note: None,
        axis: "total force, N",
        series: [series("truth", TRUTH, |point| point.truth), series("predicted", PREDICTED, |point| point.predicted)],
        shown: moment.seconds,
    };
    sheet.write(path)
}
