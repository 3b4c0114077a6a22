//! Plot of a run's losses and scores.

use std::path::Path;

use plotters::coord::Shift;
use plotters::prelude::*;

use crate::error::Result;
use crate::file::{input, limits};
use crate::render::figure::{self, Drawn, Figure};
use crate::render::plot::{self, PALETTE};
use crate::score::metrics::Metrics;

/// Columns of the log that are drawn.
const LOSSES: [&str; 5] = ["loss", "force", "contact", "active", "consistency"];
/// Share of all steps that one point of a loss curve averages over.
const SMOOTHING: f64 = 0.02;

/// Content of the plot.
struct Curves {
    losses: Vec<Curve>,
    scores: Vec<Curve>,
}

/// A named curve: steps and values.
struct Curve {
    name: &'static str,
    points: Vec<(f64, f64)>,
}

/// Plots the losses of the log, and the scores at their steps, to `curves.png` beside the log. Writes nothing for a log
/// without steps.
///
/// # Errors
/// If the log can't be read or the plot can't be written.
pub fn write(log: &Path, scores: &[(usize, Metrics)]) -> Result<()> {
    let text = input::read_text(log, limits::FILE)?;
    let losses = losses(&text);
    if losses.iter().all(|curve| curve.points.is_empty()) {
        return Ok(());
    }
    let score = |name, of: fn(&Metrics) -> Option<f64>| Curve {
        name,
        points: scores.iter().filter_map(|(step, report)| Some((*step as f64, of(report)?))).collect(),
    };
    let scores = [
        score("contact F1, frame mean", |r| r.frame_mean.f1),
        score("AUROC, frame mean", |r| r.frame_mean.auroc),
        score("temporal Pearson", |r| r.temporal_pearson),
        score("force cosine", |r| r.force_cosine),
    ];
    figure::write_png(&log.with_file_name("curves.png"), &Curves { losses, scores: scores.into() })
}

/// Returns the smoothed losses of a log, without those that are always 0.
fn losses(text: &str) -> Vec<Curve> {
    let mut lines = text.lines();
    let columns: Vec<&str> = lines.next().unwrap_or_default().split(',').collect();
    let rows: Vec<Vec<f64>> =
        lines.map(|line| line.split(',').map(|value| value.parse().unwrap_or(f64::NAN)).collect()).collect();
    let width = ((rows.len() as f64 * SMOOTHING).round() as usize).max(1);
    let curve = |name: &'static str| {
        let column = columns.iter().position(|column| *column == name)?;
        let values: Vec<(f64, f64)> = rows
            .iter()
            .filter_map(|row| Some((*row.first()?, *row.get(column)?)))
            .filter(|(_, y)| y.is_finite())
            .collect();
        let mean = |piece: &[(f64, f64)]| {
            let n = piece.len() as f64;
            (piece.iter().map(|p| p.0).sum::<f64>() / n, piece.iter().map(|p| p.1).sum::<f64>() / n)
        };
        let points: Vec<_> = values.chunks(width).map(mean).collect();
        points.iter().any(|(_, y)| *y > 0.0).then_some(Curve { name, points })
    };
    LOSSES.into_iter().filter_map(curve).collect()
}

impl Figure for Curves {
    const SIZE: (u32, u32) = (1400, 560);

    fn draw<B: DrawingBackend>(&self, root: &DrawingArea<B, Shift>) -> Drawn<()>
    where
        B::ErrorType: 'static,
    {
        root.fill(&WHITE)?;
        let (left, right) = root.split_horizontally(Self::SIZE.0 / 2);
        panel(&left, ["Losses", "loss"], &self.losses, true)?;
        panel(&right, ["Scores on held-out data", "score"], &self.scores, false)?;
        root.present()?;
        Ok(())
    }
}

/// Draws curves; `title`, `what`: title and description of the vertical axis.
fn panel<B: DrawingBackend>(
    area: &DrawingArea<B, Shift>,
    [title, what]: [&str; 2],
    curves: &[Curve],
    decades: bool,
) -> Drawn<()>
where
    B::ErrorType: 'static,
{
    let height = |y: f64| if decades { y.max(1e-6).log10() } else { y };
    let all = || curves.iter().flat_map(|curve| &curve.points);
    let last = all().map(|p| p.0).fold(1.0, f64::max);
    let [low, high] = match decades {
        true => [
            all().map(|p| height(p.1)).fold(f64::INFINITY, f64::min).clamp(-6.0, 0.0),
            all().map(|p| height(p.1)).fold(f64::NEG_INFINITY, f64::max).max(-5.0) + 0.1,
        ],
        false => [all().map(|p| p.1).fold(0.0, f64::min), 1.0],
    };
    let mut chart = plot::chart(area, title, [60, 90]).build_cartesian_2d(0.0..last, low..high)?;
    let name = |y: &f64| if decades { format!("{:.0e}", 10f64.powf(*y)) } else { format!("{y:.1}") };
    plot::axes(&mut chart, ("step", &|x| format!("{x:.0}")), (what, &name), [6, 8])?;
    for (curve, color) in curves.iter().zip(PALETTE).filter(|(curve, _)| !curve.points.is_empty()) {
        let points: Vec<_> = curve.points.iter().map(|(x, y)| (*x, height(*y))).collect();
        chart
            .draw_series(LineSeries::new(points.clone(), color.stroke_width(2)))?
            .label(curve.name)
            .legend(plot::line_key(color));
        if points.len() < 40 {
            chart.draw_series(points.into_iter().map(|point| Circle::new(point, 3, color.filled())))?;
        }
    }
    if curves.iter().any(|curve| !curve.points.is_empty()) {
        plot::legend(&mut chart, SeriesLabelPosition::UpperRight)?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn curves_follow_the_log_and_leave_out_losses_that_are_zero() {
        let mut text = String::from("step,loss,force,contact,active,consistency,secs\n");
        (1..=200).for_each(|step| text += &format!("{step},{},{},{},0,0,1\n", 2.0 / step as f64, 1.0, 0.5));
        let curves = losses(&text);
        assert_eq!(curves.iter().map(|curve| curve.name).collect::<Vec<_>>(), ["loss", "force", "contact"]);
        // 2 % of 200 steps are 4: the first point is the mean of 2, 1, 2/3 and 1/2 at 2.5.
        let (step, value) = curves[0].points[0];
        assert!((step - 2.5).abs() < 1e-12 && (value - (2.0 + 1.0 + 2.0 / 3.0 + 0.5) / 4.0).abs() < 1e-12);
        assert_eq!(curves[0].points.len(), 50);
        let folder = tempfile::tempdir().unwrap();
        let log = folder.path().join("log.csv");
        std::fs::write(&log, text).unwrap();
        write(&log, &[]).unwrap();
        assert_eq!(::image::open(folder.path().join("curves.png")).unwrap().width(), Curves::SIZE.0);
    }
}
