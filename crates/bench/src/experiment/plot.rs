//! Plot of an experiment: every score, arm by arm, in both domains.

use std::path::Path;

use egotac::error::Result;
use egotac::render::figure::{self, Drawn, Figure};
use egotac::render::font::FAMILY;
use egotac::render::plot::{self, PALETTE};
use plotters::coord::Shift;
use plotters::prelude::*;

use super::data::Domain;
use super::report::{ExperimentReport, SHOWN};

/// Writes `EXPERIMENT.png` and `EXPERIMENT.svg` into `folder`.
///
/// # Errors
/// If a file can't be written.
pub fn write(folder: &Path, report: &ExperimentReport) -> Result<()> {
    figure::write(folder, report.experiment, report)
}

impl Figure for ExperimentReport {
    const SIZE: (u32, u32) = (1500, 900);

    fn draw<B: DrawingBackend>(&self, root: &DrawingArea<B, Shift>) -> Drawn<()>
    where
        B::ErrorType: 'static,
    {
        root.fill(&WHITE)?;
        let panels = root.titled(self.question, (FAMILY, 24))?.split_evenly((2, 3));
        for (panel, (name, title, more)) in panels.iter().zip(SHOWN) {
            draw_score(panel, self, name, &format!("{title}, {} is better", if more { "more" } else { "less" }))?;
        }
        root.present()?;
        Ok(())
    }
}

/// Draws one score: a dot for each seed, a bar for their mean.
fn draw_score<B: DrawingBackend>(
    area: &DrawingArea<B, Shift>,
    report: &ExperimentReport,
    name: &str,
    title: &str,
) -> Drawn<()>
where
    B::ErrorType: 'static,
{
    let values = |domain: Domain| -> Vec<Vec<f64>> {
        report.arms.iter().map(|arm| arm.domain(domain).score(name).into_iter().flatten().collect()).collect()
    };
    let most = Domain::ALL.into_iter().flat_map(values).flatten().fold(0.0, f64::max);
    let least = Domain::ALL.into_iter().flat_map(values).flatten().fold(0.0, f64::min);
    let top = if most > 0.0 { 1.3 * most } else { 1.0 };
    let arms = report.arms.len() as f64;
    let mut chart = plot::chart(area, title, [124, 56]).build_cartesian_2d(-0.5..arms - 0.5, 1.15 * least..top)?;
    chart
        .configure_mesh()
        .disable_x_mesh()
        .light_line_style(TRANSPARENT)
        .x_labels(0)
        .label_style((FAMILY, 14))
        .draw()?;
    for (domain, (shift, color)) in Domain::ALL.into_iter().zip([(-0.19, PALETTE[0]), (0.19, PALETTE[1])]) {
        let values = values(domain);
        let bars = values.iter().enumerate().filter(|(_, seeds)| !seeds.is_empty()).map(|(arm, seeds)| {
            let (x, mean) = (arm as f64 + shift, seeds.iter().sum::<f64>() / seeds.len() as f64);
            Rectangle::new([(x - 0.17, 0.0), (x + 0.17, mean)], color.mix(0.55).filled())
        });
        let label = match domain {
            Domain::InDomain => "in domain",
            Domain::OutOfDomain => "out of domain",
        };
        chart
            .draw_series(bars)?
            .label(label)
            .legend(move |(x, y)| Rectangle::new([(x, y - 5), (x + 14, y + 5)], color.mix(0.55).filled()));
        let dots = values.iter().enumerate().flat_map(|(arm, seeds)| {
            seeds.iter().map(move |value| Circle::new((arm as f64 + shift, *value), 4, color.filled()))
        });
        chart.draw_series(dots)?;
    }
    let style = TextStyle::from((FAMILY, 14)).color(&BLACK).transform(FontTransform::Rotate90).pos(
        plotters::style::text_anchor::Pos::new(
            plotters::style::text_anchor::HPos::Left,
            plotters::style::text_anchor::VPos::Center,
        ),
    );
    for (arm, of) in report.arms.iter().enumerate() {
        let (x, y) = chart.backend_coord(&(arm as f64, 1.15 * least));
        let (left, upper) = area.get_base_pixel();
        area.draw(&Text::new(of.name, (x - left, y - upper + 6), style.clone()))?;
    }
    plot::legend(&mut chart, SeriesLabelPosition::UpperRight)?;
    Ok(())
}
