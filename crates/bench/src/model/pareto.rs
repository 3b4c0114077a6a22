//! Plot of `egotac bench model`: size against latency, and accuracy against latency of trained weights.

use std::path::Path;

use egotac::error::Result;
use egotac::model::Precision;
use egotac::render::figure::{self, Drawn, Figure};
use egotac::render::font::FAMILY;
use egotac::render::plot::{self, Named, PALETTE};
use plotters::coord::Shift;
use plotters::coord::ranged1d::Ranged;
use plotters::prelude::*;

use super::measure::Row;
use super::sweep::ModelReport;
use crate::front::front;

/// Height of the networks' names, pixels.
const NAME: u32 = 15;
/// Least height of the axis of accuracy: runs differ by about 0.01, which is to look small.
const LEAST_SPAN: f64 = 0.1;
/// Description of the axis of time.
const LATENCY: &str = "milliseconds per streamed frame (p50)";

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
        // Measurements of before frame means have pooled scores alone.
        let (scored, what) = match scored.is_empty() {
            false => (scored, "contact F1 (frame mean), held-out frames"),
            true => (points(|row| row.accuracy.as_ref()?.contact_f1), "contact F1 (pooled), held-out frames"),
        };
        match scored.is_empty() {
            false => panel(&right, "Accuracy against latency: trained weights", what, &scored, true)?,
            true => right.draw(&Text::new("no trained weights were measured", (180, 290), (FAMILY, NAME + 2)))?,
        }
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
    let x = points.iter().map(|point| point.at.0).filter(|ms| *ms > 0.0);
    let (least, most) = x.fold((f64::INFINITY, 0.0), |(low, high): (f64, f64), ms| (low.min(ms), high.max(ms)));
    let (left, right) = if least <= most { (0.7 * least, 1.6 * most) } else { (0.1, 1.0) };
    let mut builder = plot::chart(area, title, [60, 90]);
    let y = points.iter().map(|point| point.at.1);
    match is_accuracy {
        true => {
            let (bottom, top) = plot::span(y, LEAST_SPAN).unwrap_or((0.0, 1.0));
            // Ticks of a logarithmic axis stand at powers of ten: a narrow range would have none.
            if most < 10.0 * least {
                // A time below the end of the axis is wider than the usual margin.
                builder.margin_right(2 * plot::MARGIN);
                let mut chart = builder.build_cartesian_2d(0.0..right, bottom..top)?;
                plot::axes(&mut chart, (LATENCY, &|x| format!("{x:.1}")), (what, &|y| format!("{y:.2}")), [8, 6])?;
                return draw_points(area, &mut chart, points);
            }
            let times = (left..right).log_scale().with_key_points(plot::log_ticks(left, right));
            let mut chart = builder.build_cartesian_2d(times, bottom..top)?;
            plot::axes(&mut chart, (LATENCY, &|x| format!("{x}")), (what, &|y| format!("{y:.2}")), [12, 6])?;
            draw_points(area, &mut chart, points)
        }
        false => {
            let (low, high) = plot::span(y.map(f64::log10), 1.0).unwrap_or((0.0, 1.0));
            let (low, high) = (10f64.powf(low), 10f64.powf(high));
            let times = (left..right).log_scale().with_key_points(plot::log_ticks(left, right));
            let sizes = (low..high).log_scale().with_key_points(plot::log_ticks(low, high));
            let mut chart = builder.build_cartesian_2d(times, sizes)?;
            plot::axes(&mut chart, (LATENCY, &|x| format!("{x}")), (what, &|y| format!("{y}")), [8, 6])?;
            draw_points(area, &mut chart, points)
        }
    }
}

fn draw_points<'a, B, X, Y>(
    area: &DrawingArea<B, Shift>,
    chart: &mut ChartContext<'a, B, Cartesian2d<X, Y>>,
    points: &[Point],
) -> Drawn<()>
where
    B: DrawingBackend + 'a,
    B::ErrorType: 'static,
    X: Ranged<ValueType = f64>,
    Y: Ranged<ValueType = f64>,
{
    // More is better, so the front takes the negated value as the error.
    let front = front(points.iter().map(|point| (point.at.0, -point.at.1)));
    let front: Vec<(f64, f64)> = front.into_iter().map(|(x, y)| (x, -y)).collect();
    chart.draw_series(LineSeries::new(front.iter().copied(), plot::front_line()))?;
    for (precision, color) in Precision::ALL.into_iter().zip(PALETTE) {
        let own: Vec<&Point> = points.iter().filter(|point| point.precision == precision).collect();
        if own.is_empty() {
            continue;
        }
        chart
            .draw_series(own.iter().map(|point| Circle::new(point.at, 5, color.filled())))?
            .label(precision.name())
            .legend(plot::dot_key(color, 5));
    }
    // All precisions of a network share one name, drawn at the fastest.
    let fastest = |point: &&Point| points.iter().all(|other| other.label != point.label || other.at.0 >= point.at.0);
    let named: Vec<Named> = points
        .iter()
        .filter(fastest)
        .map(|point| Named { text: &point.label, at: point.at, size: NAME, color: BLACK })
        .collect();
    plot::draw_names(area, chart, &named, points.iter().map(|point| point.at), &front)?;
    if !points.is_empty() {
        plot::legend(chart, SeriesLabelPosition::LowerRight)?;
    }
    Ok(())
}
