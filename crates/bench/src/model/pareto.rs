//! Plot of `egotac bench model`: size against latency, and accuracy against latency of trained weights.

use std::path::Path;

use egotac::error::Result;
use egotac::model::Precision;
use egotac::render::figure::{self, Drawn, Figure};
use egotac::render::font::FAMILY;
use egotac::render::plot::{self, PALETTE};
use plotters::coord::Shift;
use plotters::prelude::*;

use super::measure::Row;
use super::sweep::ModelReport;
use crate::front::front;

/// Height of the networks' names, pixels.
const NAME: u32 = 15;

/// A configuration in the plot.
struct Point {
    label: String,
    precision: Precision,
    /// Latency in ms, and the value on the other axis.
    at: (f64, f64),
}

/// Writes `model.png` and `model.svg` into `folder`.
///
/// # Errors
/// If a file can't be written.
pub fn write(folder: &Path, report: &ModelReport) -> Result<()> {
    figure::write(folder, "model", report)
}

impl Figure for ModelReport {
    const SIZE: (u32, u32) = (1400, 640);

    fn draw<B: DrawingBackend>(&self, root: &DrawingArea<B, Shift>) -> Drawn<()>
    where
        B::ErrorType: 'static,
    {
        root.fill(&WHITE)?;
        let (left, right) = root.split_horizontally(Self::SIZE.0 / 2);
        let points = |value: fn(&Row) -> Option<f64>| -> Vec<Point> {
            let point = |row: &Row| {
                let at = (row.streaming_ms, value(row)?);
                Some(Point { label: label(row, &self.rows), precision: row.precision, at })
            };
            self.rows.iter().filter_map(point).collect()
        };
        panel(
            &left,
            "Size against latency",
            "million parameters",
            // Trained weights are in the right panel.
            &points(|row| row.accuracy.is_none().then_some(row.parameters as f64 / 1e6)),
            false,
        )?;
        let scored = points(|row| row.accuracy.as_ref()?.frame_mean_f1);
        panel(
            &right,
            "Accuracy against latency: trained weights",
            "contact F1 (frame mean), held-out frames",
            &scored,
            true,
        )?;
        root.present()?;
        Ok(())
    }
}

/// Returns the network's name with horizon, input and threads where these differ between rows of that name.
fn label(row: &Row, rows: &[Row]) -> String {
    let differs = |of: fn(&Row) -> usize| rows.iter().any(|other| other.preset == row.preset && of(other) != of(row));
    let mut label = row.preset.clone();
    if differs(|row| row.horizon) {
        label += &format!(", T {}", row.horizon);
    }
    if differs(|row| row.image) {
        label += &format!(", {} px", row.image);
    }
    if differs(|row| row.threads) {
        label += &format!(", {} threads", row.threads);
    }
    label
}

fn panel<B: DrawingBackend>(
    area: &DrawingArea<B, Shift>,
    title: &str,
    what: &str,
    points: &[Point],
    is_accuracy: bool,
) -> Drawn<()>
where
    B::ErrorType: 'static,
{
    // Sizes span decades, scores do not: sizes are drawn by their logarithm on a linear axis.
    let height = |value: f64| if is_accuracy { value } else { value.log10() };
    let name =
        |y: &f64| if is_accuracy { format!("{y:.3}") } else { format!("{}", (10.0 * 10f64.powf(*y)).round() / 10.0) };
    let span = |values: Vec<f64>| {
        let low = values.iter().copied().fold(f64::INFINITY, f64::min);
        let high = values.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        (low <= high).then_some((low, high))
    };
    let x = span(points.iter().map(|p| p.at.0).filter(|ms| *ms > 0.0).collect());
    let (left, right) = x.map_or((0.1, 1.0), |(low, high)| (0.7 * low, 2.2 * high));
    let y = span(points.iter().map(|p| height(p.at.1)).filter(|y| y.is_finite()).collect());
    let (bottom, top) = y.map_or((0.0, 1.0), |(low, high)| {
        let room = (0.2 * (high - low)).max(0.01);
        (low - room, high + room)
    });
    let mut chart = plot::chart(area, title, [48, 72]).build_cartesian_2d((left..right).log_scale(), bottom..top)?;
    plot::axes(&mut chart, ("milliseconds per streamed frame (p50)", &|x| format!("{x}")), (what, &name))?;
    // More is better, so the front takes the negated value as the error.
    let front = front(points.iter().map(|point| (point.at.0, -point.at.1)));
    let front = front.into_iter().map(|(x, y)| (x, height(-y)));
    chart.draw_series(LineSeries::new(front, plot::front_line()))?;
    for (precision, color) in Precision::ALL.into_iter().zip(PALETTE) {
        let own: Vec<&Point> = points.iter().filter(|point| point.precision == precision).collect();
        if own.is_empty() {
            continue;
        }
        chart
            .draw_series(own.iter().map(|p| Circle::new((p.at.0, height(p.at.1)), 5, color.filled())))?
            .label(precision.name())
            .legend(plot::dot_key(color, 5));
    }
    // All precisions of a network share one name, drawn at the fastest.
    let fastest = |point: &&Point| points.iter().all(|other| other.label != point.label || other.at.0 >= point.at.0);
    let named: Vec<&Point> = points.iter().filter(fastest).collect();
    let pixels: Vec<(i32, i32)> =
        points.iter().map(|point| chart.backend_coord(&(point.at.0, height(point.at.1)))).collect();
    let names: Vec<(&str, (i32, i32))> = named
        .iter()
        .map(|point| (point.label.as_str(), chart.backend_coord(&(point.at.0, height(point.at.1)))))
        .collect();
    let offsets = plot::name_offsets(&names, &pixels, NAME);
    chart.draw_series(named.iter().zip(offsets).map(|(point, offset)| {
        let style = TextStyle::from((FAMILY, NAME)).color(&BLACK);
        EmptyElement::at((point.at.0, height(point.at.1))) + Text::new(point.label.clone(), offset, style)
    }))?;
    if !points.is_empty() {
        plot::legend(&mut chart, SeriesLabelPosition::LowerRight)?;
    }
    Ok(())
}
