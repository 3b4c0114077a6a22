//! Plot of an experiment: scores arm by arm, one bar per test.

use std::path::Path;

use egotac::error::Result;
use egotac::render::figure::{self, Drawn, Figure};
use egotac::render::font::FAMILY;
use egotac::render::plot::{self, PALETTE};
use plotters::coord::Shift;
use plotters::prelude::*;

use super::report::{ArmReport, Report, TestInfo};
use super::table::{self, Column};

/// Names of the scores in the plot.
const DRAWN: [&str; 6] =
    ["frame_mean.f1", "frame_mean.auroc", "active_mae", "temporal_pearson", "force_cosine", "rise_f1"];

/// Writes `EXPERIMENT.png` and `EXPERIMENT.svg` into `folder`.
///
/// # Errors
/// If a file can't be written.
pub fn write(folder: &Path, report: &Report) -> Result<()> {
    figure::write(folder, &report.experiment, report)
}

impl Figure for Report {
    const SIZE: (u32, u32) = (1500, 900);

    fn draw<B: DrawingBackend>(&self, root: &DrawingArea<B, Shift>) -> Drawn<()>
    where
        B::ErrorType: 'static,
    {
        root.fill(&WHITE)?;
        let panels = root.titled(&self.question, (FAMILY, 24))?.split_evenly((2, 3));
        for (panel, name) in panels.iter().zip(DRAWN) {
            if let Some(column) = table::FORCE.iter().find(|column| column.name == name) {
                draw_score(panel, self, column)?;
            }
        }
        root.present()?;
        Ok(())
    }
}

/// Draws one score: a dot for each seed, a bar for their mean, and for each test bars of one colour.
fn draw_score<B: DrawingBackend>(area: &DrawingArea<B, Shift>, report: &Report, column: &Column) -> Drawn<()>
where
    B::ErrorType: 'static,
{
    let arms: Vec<&ArmReport> = report.arms.iter().filter(|arm| !arm.constant).collect();
    let values = |test: &TestInfo| -> Vec<Vec<f64>> {
        let of = |arm: &&ArmReport| {
            arm.tests.get(&test.name).map_or_else(Vec::new, |scores| column.of(scores).into_iter().flatten().collect())
        };
        arms.iter().map(of).collect()
    };
    let drawn: Vec<(&TestInfo, Vec<Vec<f64>>)> = report
        .tests
        .iter()
        .map(|test| (test, values(test)))
        .filter(|(_, values)| values.iter().any(|seeds| !seeds.is_empty()))
        .collect();
    let all = || drawn.iter().flat_map(|(_, values)| values.iter().flatten().copied());
    let (most, least) = (all().fold(0.0, f64::max), all().fold(0.0, f64::min));
    let top = if most > 0.0 { 1.3 * most } else { 1.0 };
    let title = format!("{}, {} is better", column.title, if column.more { "more" } else { "less" });
    let mut chart =
        plot::chart(area, &title, [124, 56]).build_cartesian_2d(-0.5..arms.len() as f64 - 0.5, 1.15 * least..top)?;
    chart
        .configure_mesh()
        .disable_x_mesh()
        .light_line_style(TRANSPARENT)
        .x_labels(0)
        .label_style((FAMILY, 14))
        .draw()?;
    let width = 0.8 / drawn.len().max(1) as f64;
    for (index, (test, values)) in drawn.iter().enumerate() {
        let (shift, color) = (width * (index as f64 + 0.5) - 0.4, PALETTE[index % PALETTE.len()]);
        let bars = values.iter().enumerate().filter(|(_, seeds)| !seeds.is_empty()).map(|(arm, seeds)| {
            let (x, mean) = (arm as f64 + shift, seeds.iter().sum::<f64>() / seeds.len() as f64);
            Rectangle::new([(x - 0.45 * width, 0.0), (x + 0.45 * width, mean)], color.mix(0.55).filled())
        });
        chart
            .draw_series(bars)?
            .label(&test.name)
            .legend(move |(x, y)| Rectangle::new([(x, y - 5), (x + 14, y + 5)], color.mix(0.55).filled()));
        let dots = values.iter().enumerate().flat_map(|(arm, seeds)| {
            seeds.iter().map(move |value| Circle::new((arm as f64 + shift, *value), 3, color.filled()))
        });
        chart.draw_series(dots)?;
    }
    let style = TextStyle::from((FAMILY, 14)).color(&BLACK).transform(FontTransform::Rotate90).pos(
        plotters::style::text_anchor::Pos::new(
            plotters::style::text_anchor::HPos::Left,
            plotters::style::text_anchor::VPos::Center,
        ),
    );
    for (index, arm) in arms.iter().enumerate() {
        let (x, y) = chart.backend_coord(&(index as f64, 1.15 * least));
        let (left, upper) = area.get_base_pixel();
        area.draw(&Text::new(arm.name.as_str(), (x - left, y - upper + 6), style.clone()))?;
    }
    plot::legend(&mut chart, SeriesLabelPosition::UpperRight)?;
    Ok(())
}
