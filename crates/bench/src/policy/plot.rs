//! Plot of the experiment: success of each arm, and success by the ball's weight.

use std::path::Path;

use egotac::error::Result;
use egotac::render::figure::{self, Drawn, Figure};
use egotac::render::font::FAMILY;
use egotac::render::plot::{self, LABEL, PALETTE};
use plotters::coord::Shift;
use plotters::prelude::*;
use serde::Deserialize;

use super::report::{PolicyReport, Row};
use super::task::{End, MASS};

/// Bins of the ball's mass; equally wide in its logarithm.
const BINS: usize = 4;

/// Content of the plot.
#[derive(Debug, Clone, Deserialize)]
pub struct Plot {
    rows: Vec<Row>,
}

/// Writes `policy.png` and `policy.svg` into `folder`.
///
/// # Errors
/// If a file can't be written.
pub fn write(folder: &Path, report: &PolicyReport) -> Result<()> {
    figure::write(folder, "policy", &Plot { rows: report.rows.clone() })
}

impl Figure for Plot {
    const SIZE: (u32, u32) = (1400, 560);

    fn draw<B: DrawingBackend>(&self, root: &DrawingArea<B, Shift>) -> Drawn<()>
    where
        B::ErrorType: 'static,
    {
        root.fill(&WHITE)?;
        let names: Vec<String> = self.rows.iter().map(|row| row.name.replace('_', " ")).collect();
        let keys: Vec<(&str, RGBColor)> = names.iter().map(String::as_str).zip(PALETTE).collect();
        let (left, right) = plot::head(root, "Does touch help a policy?", &keys)?.split_horizontally(640);
        draw_success(&left, &self.rows, &names)?;
        draw_by_mass(&right, &self.rows)?;
        root.present()?;
        Ok(())
    }
}

/// Draws a bar for each row with its name, its bootstrap interval, and a dot for each training.
fn draw_success<B: DrawingBackend>(area: &DrawingArea<B, Shift>, rows: &[Row], names: &[String]) -> Drawn<()>
where
    B::ErrorType: 'static,
{
    let mut chart = plot::chart(area, "Success (black line: 95 %, dots: trainings)", [48, 236])
        .build_cartesian_2d(0.0..1.05, -0.5..rows.len() as f64 - 0.5)?;
    // The first row stands on top.
    let place = |row: usize| (rows.len() - 1 - row) as f64;
    let label = |y: &f64| {
        let row = rows.len() as f64 - 1.0 - y;
        if row.fract().abs() < 1e-6 && row >= 0.0 {
            names.get(row as usize).cloned().unwrap_or_default()
        } else {
            String::new()
        }
    };
    chart
        .configure_mesh()
        .disable_y_mesh()
        .light_line_style(TRANSPARENT)
        .y_labels(2 * rows.len() + 1)
        .y_label_formatter(&label)
        .label_style((FAMILY, LABEL))
        .draw()?;
    for (index, row) in rows.iter().enumerate() {
        let (y, color) = (place(index), PALETTE[index % PALETTE.len()]);
        chart.draw_series([Rectangle::new([(0.0, y - 0.3), (row.success, y + 0.3)], color.mix(0.5).filled())])?;
        if let Some([low, high]) = row.bootstrap {
            chart.draw_series([PathElement::new([(low, y), (high, y)], BLACK.stroke_width(2))])?;
        }
        chart.draw_series(row.by_seed.iter().map(|rate| Circle::new((*rate, y), 4, color.filled())))?;
    }
    Ok(())
}

/// Draws the success rate of each row over the ball's mass.
fn draw_by_mass<B: DrawingBackend>(area: &DrawingArea<B, Shift>, rows: &[Row]) -> Drawn<()>
where
    B::ErrorType: 'static,
{
    let [low, high] = MASS.map(|mass| 1000.0 * mass);
    let mut chart = plot::chart(area, "Success by weight", [58, 76]).build_cartesian_2d(low..1.03 * high, 0.0..1.05)?;
    plot::axes(
        &mut chart,
        ("mass of the ball, g", &|mass| format!("{mass:.0}")),
        ("share of trials", &|rate| format!("{rate:.1}")),
        [6, 6],
    )?;
    for (index, row) in rows.iter().enumerate() {
        let color = PALETTE[index % PALETTE.len()];
        chart.draw_series(LineSeries::new(by_mass(row), color.stroke_width(2)).point_size(4))?;
    }
    Ok(())
}

/// Returns the middle of each bin, g, with the success rate in it; bins without trials are left out.
fn by_mass(row: &Row) -> Vec<(f64, f64)> {
    let [low, high] = MASS.map(f64::ln);
    let mut counts = [(0.0, 0.0); BINS];
    for outcome in row.outcomes.iter().flatten() {
        let bin = ((outcome.mass.ln() - low) / (high - low) * BINS as f64) as usize;
        let count = &mut counts[bin.min(BINS - 1)];
        *count = (count.0 + f64::from(outcome.end == End::Lifted), count.1 + 1.0);
    }
    let middle = |bin: usize| 1000.0 * (low + (high - low) * (bin as f64 + 0.5) / BINS as f64).exp();
    let filled = counts.into_iter().enumerate().filter(|(_, (_, all))| *all > 0.0);
    filled.map(|(bin, (lifted, all))| (middle(bin), lifted / all)).collect()
}
