//! Plot of a report: scores above, errors below, one column per candidate.

use std::collections::BTreeMap;

use ::image::RgbImage;
use plotters::coord::Shift;
use plotters::prelude::*;
use serde::Deserialize;

use super::report::VerifyReport;
use crate::error::{Error, Result};
use crate::render::figure::{self, Drawn, Figure};
use crate::render::plot::{self, PALETTE};

/// Distance between the curves of one candidate, in columns: intervals do not hide each other.
const SHIFT: f64 = 0.14;

/// A curve: label and name of the score.
type Curve = (&'static str, &'static str);

const SCORES: [Curve; 4] = [
    ("F1", "frame_mean.f1"),
    ("precision", "frame_mean.precision"),
    ("recall", "frame_mean.recall"),
    ("IoU", "frame_mean.iou"),
];
const ERRORS: [Curve; 4] = [
    ("missed force", "missed_force"),
    ("false-contact mass", "false_contact_mass"),
    ("missed touches", "missed_touches"),
    ("link force error", "link_force_error"),
];

/// Content of the plot, as the JSON of a [`VerifyReport`] holds it.
#[derive(Debug, Clone, Deserialize)]
pub struct Plot {
    counts: DataCounts,
    candidates: Vec<Column>,
}

#[derive(Debug, Clone, Deserialize)]
struct DataCounts {
    episodes: u64,
    frames: u64,
    touching_frames: u64,
}

/// A candidate.
#[derive(Debug, Clone, Deserialize)]
struct Column {
    name: String,
    scores: BTreeMap<String, Score>,
}

#[derive(Debug, Clone, Copy, Deserialize)]
struct Score {
    value: Option<f64>,
    interval: Option<[f64; 2]>,
}

/// Draws the report; error bars are 95 % intervals over episodes.
///
/// # Errors
/// If drawing fails.
pub fn draw(report: &VerifyReport) -> Result<RgbImage> {
    let told = |error: &dyn std::fmt::Display| Error::value("picture", "one that can be drawn", error);
    let json = serde_json::to_value(report).map_err(|error| told(&error))?;
    let plot = Plot::deserialize(&json).map_err(|error| told(&error))?;
    figure::picture(&plot).map_err(|error| told(&error))
}

impl Figure for Plot {
    const SIZE: (u32, u32) = (1200, 900);

    fn draw<B: DrawingBackend>(&self, root: &DrawingArea<B, Shift>) -> Drawn<()>
    where
        B::ErrorType: 'static,
    {
        root.fill(&WHITE)?;
        let DataCounts { episodes, frames, touching_frames } = self.counts;
        let heading = format!(
            "Against contact forces (label c): {episodes} episodes, {frames} frames, {touching_frames} with touch; bars: 95 %"
        );
        let body = plot::head(root, &heading, &[])?;
        let (upper, lower) = body.split_vertically(body.dim_in_pixel().1 / 2);
        self.panel(&upper, "more is better", &SCORES)?;
        self.panel(&lower, "less is better", &ERRORS)?;
        root.present()?;
        Ok(())
    }
}

impl Plot {
    fn panel<B: DrawingBackend>(&self, area: &DrawingArea<B, Shift>, better: &str, curves: &[Curve]) -> Drawn<()>
    where
        B::ErrorType: 'static,
    {
        let scores = |name: &str| -> Vec<(usize, Score)> {
            let of = |(index, column): (usize, &Column)| Some((index, *column.scores.get(name)?));
            self.candidates.iter().enumerate().filter_map(of).collect()
        };
        let all = curves.iter().flat_map(|(_, name)| scores(name)).filter_map(|(_, score)| score.value);
        let top = all.fold(1.0, f64::max) * 1.03;
        let keys: Vec<(&str, RGBColor)> = curves.iter().map(|(label, _)| *label).zip(PALETTE).collect();
        let body = plot::head(area, "", &keys)?;
        let names: Vec<String> = self.candidates.iter().map(|column| column.name.replace('_', " ")).collect();
        let names: Vec<&str> = names.iter().map(String::as_str).collect();
        let mut chart =
            plot::chart(&body, "", [40, 76]).build_cartesian_2d(-0.5..names.len() as f64 - 0.5, -0.02..top)?;
        plot::categories(&body, &mut chart, &names, (better, &|y| format!("{y:.1}")))?;
        for (index, ((_, name), color)) in curves.iter().zip(PALETTE).enumerate() {
            let shift = (index as f64 - 0.5 * (curves.len() - 1) as f64) * SHIFT;
            for (column, score) in scores(name) {
                let x = column as f64 + shift;
                if let Some([low, high]) = score.interval {
                    let ends = [(x, low), (x, high.min(top))];
                    chart.draw_series(LineSeries::new(ends, color.mix(0.5).stroke_width(5)))?;
                }
                chart.draw_series(score.value.map(|value| Circle::new((x, value), 5, color.filled())))?;
            }
        }
        Ok(())
    }
}
