//! Plot of the errors against the noise of the poses.

use egotac::render::figure::{Drawn, Figure};
use egotac::render::plot::{self, PALETTE};
use plotters::coord::Shift;
use plotters::prelude::*;

use super::record::MassKnowledge;
use super::{Report, Score};

impl Figure for Report {
    const SIZE: (u32, u32) = (1200, 460);

    fn draw<B: DrawingBackend>(&self, root: &DrawingArea<B, Shift>) -> Drawn<()>
    where
        B::ErrorType: 'static,
    {
        root.fill(&WHITE)?;
        let parts = root.split_evenly((1, 3));
        panel(&parts[0], "Net force: median error", "N", self, |score| score.net_error[0])?;
        panel(&parts[1], "Links: mean error / mean force", "", self, |score| {
            score.link_error[0] / score.link_error[1]
        })?;
        panel(&parts[2], "Truth inside the 90 % interval", "", self, |score| score.coverage[0])?;
        root.present()?;
        Ok(())
    }
}

/// Draws one quantity over the noise of positions, a line for each frame rate, along noises with the larger rotation.
fn panel<B: DrawingBackend>(
    area: &DrawingArea<B, Shift>,
    title: &str,
    unit: &str,
    report: &Report,
    of: fn(&Score) -> f64,
) -> Drawn<()>
where
    B::ErrorType: 'static,
{
    let known = || report.conditions.iter().filter(|score| score.condition.mass == MassKnowledge::Known);
    let most = known().map(of).filter(|value| value.is_finite()).fold(0.05, f64::max);
    let mut builder = plot::chart(area, title, [44, 64]);
    let mut chart = builder.build_cartesian_2d(-0.2..5.4, 0.0..1.1 * most)?;
    let millimetres = |value: &f64| format!("{value:.1}");
    let fine = |value: &f64| format!("{value:.2}");
    plot::axes(&mut chart, ("noise of positions (mm)", &millimetres), (unit, &fine))?;
    for (rate, color) in [30.0, 60.0].into_iter().zip(PALETTE) {
        let of_rate = || known().filter(move |score| score.condition.rate == rate);
        let points = of_rate().filter(|score| score.condition.degrees != 3.0 || score.condition.millimetres == 5.0);
        let points: Vec<(f64, f64)> = points.map(|score| (score.condition.millimetres, of(score))).collect();
        chart
            .draw_series(LineSeries::new(points.clone(), color.stroke_width(2)))?
            .label(format!("{rate:.0} Hz"))
            .legend(plot::line_key(color));
        chart.draw_series(
            of_rate().map(|score| Circle::new((score.condition.millimetres, of(score)), 4, color.filled())),
        )?;
    }
    plot::legend(&mut chart, SeriesLabelPosition::LowerRight)?;
    Ok(())
}
