//! The bench's plot: accuracy against latency where weights are trained, size against latency for all.

use std::error::Error as StdError;
use std::path::Path;

use ::image::RgbImage;
use plotters::coord::Shift;
use plotters::prelude::*;

use super::measure::Row;
use super::sweep::Report;
use crate::error::{Error, Result};
use crate::model::Precision;
use crate::{file, render};

const SIZE: (u32, u32) = (1400, 640);
const COLORS: [RGBColor; 3] = [RGBColor(31, 119, 180), RGBColor(44, 160, 44), RGBColor(214, 96, 24)];

type Drawn<T> = std::result::Result<T, Box<dyn StdError>>;

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
    render::font::register();
    let (png, svg) = (folder.join("model.png"), folder.join("model.svg"));
    let mut pixels = vec![255u8; (SIZE.0 * SIZE.1 * 3) as usize];
    draw(&BitMapBackend::with_buffer(&mut pixels, SIZE).into_drawing_area(), report)
        .map_err(|error| Error::file(&png, error))?;
    file::write_png(&png, &RgbImage::from_raw(SIZE.0, SIZE.1, pixels).unwrap_or_default())?;
    let mut text = String::new();
    draw(&SVGBackend::with_string(&mut text, SIZE).into_drawing_area(), report)
        .map_err(|error| Error::file(&svg, error))?;
    file::write(&svg, text.as_bytes())
}

fn draw<B: DrawingBackend>(root: &DrawingArea<B, Shift>, report: &Report) -> Drawn<()>
where
    B::ErrorType: 'static,
{
    root.fill(&WHITE)?;
    let (left, right) = root.split_horizontally(SIZE.0 / 2);
    let label = |row: &Row| format!("{} T{} {}px x{}", row.preset, row.horizon, row.image, row.threads);
    let points = |value: fn(&Row) -> Option<f64>| -> Vec<Point> {
        let point = |row: &Row| {
            Some(Point { label: label(row), precision: row.precision, at: (row.streaming_ms, value(row)?) })
        };
        report.rows.iter().filter_map(point).collect()
    };
    panel(
        &left,
        "Size against latency",
        "million parameters",
        &points(|row| Some(row.parameters as f64 / 1e6)),
        false,
    )?;
    let scored = points(|row| row.accuracy.as_ref()?.contact_f1);
    panel(&right, "Accuracy against latency: trained weights", "contact F1, held-out frames", &scored, true)?;
    root.present()?;
    Ok(())
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
    let range = |value: fn(&Point) -> f64, below: f64, above: f64| {
        let least = points.iter().map(value).fold(f64::INFINITY, f64::min);
        let most = points.iter().map(value).fold(0.0, f64::max);
        if least > 0.0 && most.is_finite() && !points.is_empty() { below * least..above * most } else { 0.1..1.0 }
    };
    let x = range(|point| point.at.0, 0.7, 2.2);
    let y = if is_accuracy { range(|p| p.at.1, 0.97, 1.02) } else { range(|p| p.at.1, 0.7, 1.5) };
    let mut chart = ChartBuilder::on(area)
        .caption(title, (render::font::FAMILY, 21))
        .margin(14)
        .x_label_area_size(48)
        .y_label_area_size(72)
        .build_cartesian_2d(x.log_scale(), y.log_scale())?;
    chart
        .configure_mesh()
        .light_line_style(TRANSPARENT)
        .x_desc("milliseconds per streamed frame (p50)")
        .y_desc(what)
        .x_label_formatter(&|x| format!("{x}"))
        .y_label_formatter(&|y| format!("{}", (1e3 * y).round() / 1e3))
        .label_style((render::font::FAMILY, 15))
        .axis_desc_style((render::font::FAMILY, 17))
        .draw()?;
    let front = front(points);
    chart.draw_series(LineSeries::new(front, BLACK.mix(0.25).stroke_width(2)))?;
    for (precision, color) in Precision::ALL.into_iter().zip(COLORS) {
        let own: Vec<&Point> = points.iter().filter(|point| point.precision == precision).collect();
        if own.is_empty() {
            continue;
        }
        chart
            .draw_series(own.iter().map(|p| Circle::new(p.at, 5, color.filled())))?
            .label(precision.name())
            .legend(move |(x, y)| Circle::new((x + 10, y), 5, color.filled()));
        chart.draw_series(own.iter().map(|p| {
            let style = TextStyle::from((render::font::FAMILY, 12)).color(&color);
            EmptyElement::at(p.at) + Text::new(p.label.clone(), (8, -6), style)
        }))?;
    }
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

/// Configurations that no other beats in both: less time, and more of what is drawn.
fn front(points: &[Point]) -> Vec<(f64, f64)> {
    let mut all: Vec<(f64, f64)> = points.iter().map(|point| point.at).collect();
    all.sort_by(|a, b| a.0.total_cmp(&b.0).then(b.1.total_cmp(&a.1)));
    let mut best = f64::NEG_INFINITY;
    all.retain(|(_, value)| {
        let better = *value > best;
        best = best.max(*value);
        better
    });
    all
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_front_holds_what_no_other_beats() {
        let point = |at: (f64, f64)| Point { label: String::new(), precision: Precision::F32, at };
        let points: Vec<Point> = [(4.0, 0.9), (1.0, 0.5), (2.0, 0.4), (3.0, 0.8), (3.0, 0.7)].map(point).into();
        assert_eq!(front(&points), [(1.0, 0.5), (3.0, 0.8), (4.0, 0.9)]);
    }
}
