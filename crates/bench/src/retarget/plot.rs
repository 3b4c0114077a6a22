//! The bench's plot: how far from the best known objective a cap on the solver's steps leaves it, against time.

use std::path::Path;

use egotac::error::Result;
use egotac::render::figure::{self, Drawn, Figure};
use egotac::render::plot::{self, PALETTE};
use plotters::coord::Shift;
use plotters::prelude::*;

use super::RetargetReport;

/// Smallest relative distance from the best objective that is drawn; smaller ones are drawn at it.
const LEAST: f64 = 1e-7;

/// Writes `retarget.png` and `retarget.svg` into a folder; false where nothing was measured that can be drawn.
///
/// # Errors
/// If a file can't be written.
pub fn write(folder: &Path, report: &RetargetReport) -> Result<bool> {
    if report.costs.iter().all(|cost| cost.ratio_p999.is_nan()) {
        return Ok(false);
    }
    figure::write(folder, "retarget", report)?;
    Ok(true)
}

impl Figure for RetargetReport {
    const SIZE: (u32, u32) = (900, 560);

    fn draw<B: DrawingBackend>(&self, root: &DrawingArea<B, Shift>) -> Drawn<()>
    where
        B::ErrorType: 'static,
    {
        root.fill(&WHITE)?;
        let costs: Vec<_> = self.costs.iter().filter(|cost| !cost.ratio_p999.is_nan()).collect();
        let times = || costs.iter().map(|cost| cost.median_us);
        let (left, right) = (times().fold(f64::INFINITY, f64::min), times().fold(0.0, f64::max));
        let off = |ratio: f64| (ratio - 1.0).max(LEAST);
        let most = costs.iter().map(|cost| off(cost.ratio_p999)).fold(0.0, f64::max);
        let mut chart = plot::chart(root, "5 mm noise, at most 1 to 30 steps", [48, 80])
            .build_cartesian_2d((0.8 * left..1.3 * right).log_scale(), (0.5 * LEAST..2.0 * most).log_scale())?;
        plot::axes(
            &mut chart,
            ("microseconds per frame (median)", &|x| format!("{x}")),
            ("objective over the best known, minus 1 (p99.9)", &|y| format!("{y:.0e}")),
        )?;
        let mut robots: Vec<&str> = costs.iter().map(|cost| cost.robot.as_str()).collect();
        robots.dedup();
        for (robot, color) in robots.iter().zip(PALETTE) {
            let points = || costs.iter().filter(|cost| cost.robot == **robot).map(|c| (c.median_us, off(c.ratio_p999)));
            chart
                .draw_series(LineSeries::new(points(), color.stroke_width(2)))?
                .label(*robot)
                .legend(plot::line_key(color));
            chart.draw_series(points().map(|at| Circle::new(at, 4, color.filled())))?;
        }
        plot::legend(&mut chart, SeriesLabelPosition::LowerLeft)?;
        root.present()?;
        Ok(())
    }
}
