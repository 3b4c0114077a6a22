//! The bench's plot: how far from the best known objective a cap on the solver's steps leaves it, against time.

use std::path::Path;

use egotac::error::{Error, Result};
use egotac::render::figure::{self, Drawn, Figure};
use egotac::render::plot::{self, PALETTE};
use plotters::coord::Shift;
use plotters::prelude::*;
use serde::Deserialize;

use super::RetargetReport;

/// Smallest relative distance from the best objective that is drawn; smaller ones are drawn at it.
const LEAST: f64 = 1e-7;

/// Content of the plot, as `retarget.json` holds it.
#[derive(Debug, Clone, Deserialize)]
pub struct Plot {
    costs: Vec<Point>,
}

/// Choice that is drawn; see [`Cost`](super::Cost).
#[derive(Debug, Clone, Deserialize)]
struct Point {
    robot: String,
    median_us: f64,
    /// None if the objective is another one.
    ratio_p999: Option<f64>,
}

/// Writes `retarget.png` and `retarget.svg` into a folder; false where nothing was measured that can be drawn.
///
/// # Errors
/// If a file can't be written.
pub fn write(folder: &Path, report: &RetargetReport) -> Result<bool> {
    if report.costs.iter().all(|cost| cost.ratio_p999.is_nan()) {
        return Ok(false);
    }
    let json = serde_json::to_value(report).map_err(|error| Error::file(folder, error))?;
    let plot = Plot::deserialize(&json).map_err(|error| Error::file(folder, error))?;
    figure::write(folder, "retarget", &plot)?;
    Ok(true)
}

impl Figure for Plot {
    const SIZE: (u32, u32) = (900, 580);

    fn draw<B: DrawingBackend>(&self, root: &DrawingArea<B, Shift>) -> Drawn<()>
    where
        B::ErrorType: 'static,
    {
        root.fill(&WHITE)?;
        let off = |ratio: f64| (ratio - 1.0).max(LEAST);
        let point = |cost: &Point| Some((cost.robot.clone(), (cost.median_us, off(cost.ratio_p999?))));
        let points: Vec<(String, (f64, f64))> = self.costs.iter().filter_map(point).collect();
        let times = || points.iter().map(|(_, (time, _))| *time);
        let (left, right) = (times().fold(f64::INFINITY, f64::min), times().fold(0.0, f64::max));
        let most = points.iter().map(|(_, (_, off))| *off).fold(0.0, f64::max);
        // A logarithmic axis without bounds would have endless ticks.
        if !(left > 0.0 && left <= right && right.is_finite()) {
            return Err("no choice has both a time and an objective".into());
        }
        let mut robots: Vec<&str> = points.iter().map(|(robot, _)| robot.as_str()).collect();
        robots.dedup();
        let keys: Vec<(&str, RGBColor)> = robots.iter().copied().zip(PALETTE).collect();
        let body = plot::head(root, "At most 1 to 30 steps of the solver, keypoints with 5 mm noise", &keys)?;
        let times = (0.8 * left..1.3 * right).log_scale().with_key_points(plot::log_ticks(0.8 * left, 1.3 * right));
        let mut chart =
            plot::chart(&body, "", [60, 104]).build_cartesian_2d(times, (0.5 * LEAST..2.0 * most).log_scale())?;
        let tick = |y: &f64| match *y {
            value if value <= 1.01 * LEAST => format!("\u{2264} {LEAST:.0e}"),
            value if (0.1..100.0).contains(&value) => format!("{value}"),
            value => format!("{value:.0e}"),
        };
        plot::axes(
            &mut chart,
            ("microseconds per frame (median)", &|x| format!("{x}")),
            ("objective / best known - 1 (p99.9)", &tick),
            [12, 10],
        )?;
        for (robot, color) in keys {
            let own = || points.iter().filter(|(of, _)| of == robot).map(|(_, at)| *at);
            chart.draw_series(LineSeries::new(own(), color.stroke_width(2)))?;
            chart.draw_series(own().map(|at| Circle::new(at, 4, color.filled())))?;
        }
        root.present()?;
        Ok(())
    }
}
