//! The bench's plot: accuracy against latency where weights are trained, size against latency for all.

use std::path::Path;

use egotac::error::Result;
use egotac::model::Precision;
use egotac::render;
use egotac::render::figure::{self, Drawn, Figure};
use plotters::coord::Shift;
use plotters::prelude::*;

use super::measure::Row;
use super::sweep::Report;
use crate::front::front;

const COLORS: [RGBColor; 3] = [RGBColor(31, 119, 180), RGBColor(44, 160, 44), RGBColor(214, 96, 24)];

/// A configuration: latency in ms, and what it is drawn against.
struct Point {
    label: String,
    precision: Precision,
    at: (f64, f64),
}

/// Writes `model.png` and `model.svg` into `folder`.
///
/// # Errors
/// If a file can't be written.
pub fn write(folder: &Path, report: &Report) -> Result<()> {
    figure::write(folder, "model", report)
}

impl Figure for Report {
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
            // Trained weights stand on the right.
            &points(|row| row.accuracy.is_none().then_some(row.parameters as f64 / 1e6)),
            false,
        )?;
        let scored = points(|row| row.accuracy.as_ref()?.contact_f1);
        panel(&right, "Accuracy against latency: trained weights", "contact F1, held-out frames", &scored, true)?;
        root.present()?;
        Ok(())
    }
}

/// The network's name, and of horizon, input and threads what tells it from others of that name.
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
    // Sizes span decades, scores do not: the axis is linear in what is returned here.
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
    let mut chart = ChartBuilder::on(area)
        .caption(title, (render::font::FAMILY, 21))
        .margin(14)
        .x_label_area_size(48)
        .y_label_area_size(72)
        .build_cartesian_2d((left..right).log_scale(), bottom..top)?;
    chart
        .configure_mesh()
        .light_line_style(TRANSPARENT)
        .x_desc("milliseconds per streamed frame (p50)")
        .y_desc(what)
        .x_label_formatter(&|x| format!("{x}"))
        .y_label_formatter(&name)
        .label_style((render::font::FAMILY, 15))
        .axis_desc_style((render::font::FAMILY, 17))
        .draw()?;
    // More is better: what is missing is the error.
    let front = front(points.iter().map(|point| (point.at.0, -point.at.1)));
    let front = front.into_iter().map(|(x, y)| (x, height(-y)));
    chart.draw_series(LineSeries::new(front, BLACK.mix(0.25).stroke_width(2)))?;
    for (precision, color) in Precision::ALL.into_iter().zip(COLORS) {
        let own: Vec<&Point> = points.iter().filter(|point| point.precision == precision).collect();
        if own.is_empty() {
            continue;
        }
        chart
            .draw_series(own.iter().map(|p| Circle::new((p.at.0, height(p.at.1)), 5, color.filled())))?
            .label(precision.name())
            .legend(move |(x, y)| Circle::new((x + 10, y), 5, color.filled()));
    }
    // One name for all precisions of a network, at the fastest.
    let fastest = |point: &&Point| points.iter().all(|other| other.label != point.label || other.at.0 >= point.at.0);
    chart.draw_series(points.iter().filter(fastest).map(|point| {
        let style = TextStyle::from((render::font::FAMILY, 15)).color(&BLACK);
        EmptyElement::at((point.at.0, height(point.at.1))) + Text::new(point.label.clone(), (-4, -24), style)
    }))?;
    if !points.is_empty() {
        chart
            .configure_series_labels()
            .position(SeriesLabelPosition::LowerRight)
            .background_style(WHITE.mix(0.8))
            .border_style(BLACK.mix(0.3))
            .label_font((render::font::FAMILY, 15))
            .draw()?;
    }
    Ok(())
}
