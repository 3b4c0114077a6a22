//! Plot of the errors against the noise of the poses.

use egotac::render::figure::{Drawn, Figure};
use egotac::render::plot::{self, PALETTE};
use plotters::coord::Shift;
use plotters::prelude::*;
use serde::Deserialize;

use super::record::{Disturbance, MassKnowledge};

/// Frame rates that have a line.
const KEYS: [&str; 2] = ["30 Hz", "60 Hz"];

/// Content of the plot, as `physics.json` holds it.
#[derive(Debug, Clone, Deserialize)]
pub struct Plot {
    conditions: Vec<Point>,
}

/// Scores of one condition that are drawn; see [`Score`](super::Score).
#[derive(Debug, Clone, Deserialize)]
struct Point {
    condition: Disturbance,
    net_error: [f64; 2],
    link_error: [Option<f64>; 2],
    coverage: [Option<f64>; 3],
}

impl Figure for Plot {
    const SIZE: (u32, u32) = (1200, 480);

    fn draw<B: DrawingBackend>(&self, root: &DrawingArea<B, Shift>) -> Drawn<()>
    where
        B::ErrorType: 'static,
    {
        root.fill(&WHITE)?;
        let keys: Vec<(&str, RGBColor)> = KEYS.into_iter().zip(PALETTE).collect();
        let parts =
            plot::head(root, "Forces from motion against the noise of poses (rings: rotations of 3 degrees)", &keys)?
                .split_evenly((1, 3));
        self.panel(&parts[0], "Net force", "median error, N", |point| Some(point.net_error[0]), None)?;
        let of_links = |point: &Point| Some(point.link_error[0]? / point.link_error[1]?);
        self.panel(&parts[1], "Force of links", "mean error / mean force", of_links, None)?;
        self.panel(
            &parts[2],
            "Truth inside the 90 % interval",
            "share of links",
            |point| point.coverage[0],
            Some(0.9),
        )?;
        root.present()?;
        Ok(())
    }
}

impl Plot {
    /// Draws one quantity over the noise of positions: a line for each frame rate along noises with the smaller rotation, a ring for
    /// the other one, and the goal.
    fn panel<B: DrawingBackend>(
        &self,
        area: &DrawingArea<B, Shift>,
        title: &str,
        what: &str,
        of: fn(&Point) -> Option<f64>,
        goal: Option<f64>,
    ) -> Drawn<()>
    where
        B::ErrorType: 'static,
    {
        let known = || self.conditions.iter().filter(|point| point.condition.mass == MassKnowledge::Known);
        let most = known().filter_map(of).filter(|value| value.is_finite()).fold(0.05, f64::max);
        let mut builder = plot::chart(area, title, [55, 85]);
        let mut chart = builder.build_cartesian_2d(-0.2..5.4, 0.0..1.1 * most)?;
        let whole = |value: &f64| format!("{value:.0}");
        let fine = |value: &f64| format!("{value:.2}");
        plot::axes(&mut chart, ("noise of positions, mm", &whole), (what, &fine), [6, 8])?;
        if let Some(goal) = goal {
            chart.draw_series(LineSeries::new([(-0.2, goal), (5.4, goal)], BLACK.mix(0.5).stroke_width(2)))?;
        }
        for (rate, color) in [30.0, 60.0].into_iter().zip(PALETTE) {
            let of_rate = || known().filter(move |point| point.condition.rate == rate);
            let on_line = |point: &&Point| point.condition.degrees != 3.0 || point.condition.millimetres == 5.0;
            let at = |point: &Point| Some((point.condition.millimetres, of(point)?));
            let line: Vec<(f64, f64)> = of_rate().filter(on_line).filter_map(at).collect();
            chart.draw_series(LineSeries::new(line.iter().copied(), color.stroke_width(2)))?;
            chart.draw_series(line.into_iter().map(|point| Circle::new(point, 4, color.filled())))?;
            let others = of_rate().filter(|point| !on_line(point)).filter_map(at);
            chart.draw_series(others.map(|point| Circle::new(point, 6, color.stroke_width(2))))?;
        }
        Ok(())
    }
}
