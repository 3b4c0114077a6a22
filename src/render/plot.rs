//! Common look of charts: palette, title, axes, legend.

use plotters::chart::{ChartBuilder, ChartContext, SeriesLabelPosition};
use plotters::coord::cartesian::Cartesian2d;
use plotters::coord::ranged1d::{Ranged, ValueFormatter};
use plotters::coord::{CoordTranslate, Shift};
use plotters::prelude::{BLACK, Circle, Color, DrawingArea, DrawingBackend, PathElement, RGBColor, TRANSPARENT, WHITE};
use plotters::style::ShapeStyle;

use super::figure::Drawn;
use super::font::FAMILY;

/// Colours of series, in the order in which series take them.
pub const PALETTE: [RGBColor; 7] = [
    RGBColor(31, 119, 180),
    ACCENT,
    RGBColor(44, 160, 44),
    RGBColor(148, 103, 189),
    RGBColor(140, 86, 75),
    RGBColor(23, 150, 170),
    RGBColor(190, 150, 20),
];
/// Colour of a single series that stands out: orange.
pub const ACCENT: RGBColor = RGBColor(214, 96, 24);

/// Height of a chart's title, of the axes' descriptions, and of tick labels and legends, pixels.
const TITLE: u32 = 21;
const DESCRIPTION: u32 = 17;
const LABEL: u32 = 15;
/// Space around a chart, pixels.
const MARGIN: u32 = 14;
/// Length of a line in a legend, pixels.
const KEY_LENGTH: i32 = 18;

/// Starts a chart with a title, `[below, left]` pixels of which hold tick labels and descriptions of the axes.
pub fn chart<'a, 'b, DB: DrawingBackend>(
    area: &'a DrawingArea<DB, Shift>,
    title: &str,
    [below, left]: [u32; 2],
) -> ChartBuilder<'a, 'b, DB> {
    let mut chart = ChartBuilder::on(area);
    chart.caption(title, (FAMILY, TITLE)).margin(MARGIN).x_label_area_size(below).y_label_area_size(left);
    chart
}

/// Description of an axis, and the text of a value on it.
pub type Axis<'a> = (&'a str, &'a dyn Fn(&f64) -> String);

/// Draws axes and the lines at their ticks.
///
/// # Errors
/// If the backend fails.
pub fn axes<DB, X, Y>(chart: &mut ChartContext<'_, DB, Cartesian2d<X, Y>>, x: Axis<'_>, y: Axis<'_>) -> Drawn<()>
where
    DB: DrawingBackend,
    DB::ErrorType: 'static,
    X: Ranged<ValueType = f64> + ValueFormatter<f64>,
    Y: Ranged<ValueType = f64> + ValueFormatter<f64>,
{
    chart
        .configure_mesh()
        .light_line_style(TRANSPARENT)
        .x_desc(x.0)
        .y_desc(y.0)
        .x_label_formatter(x.1)
        .y_label_formatter(y.1)
        .label_style((FAMILY, LABEL))
        .axis_desc_style((FAMILY, DESCRIPTION))
        .draw()?;
    Ok(())
}

/// Draws the legend of the series that have a label.
///
/// # Errors
/// If the backend fails.
pub fn legend<'a, DB, CT>(chart: &mut ChartContext<'a, DB, CT>, corner: SeriesLabelPosition) -> Drawn<()>
where
    DB: DrawingBackend + 'a,
    DB::ErrorType: 'static,
    CT: CoordTranslate,
{
    chart
        .configure_series_labels()
        .position(corner)
        .background_style(WHITE.mix(0.8))
        .border_style(BLACK.mix(0.3))
        .label_font((FAMILY, LABEL))
        .draw()?;
    Ok(())
}

/// Returns a legend's picture of a line.
pub fn line_key(color: RGBColor) -> impl Fn((i32, i32)) -> PathElement<(i32, i32)> {
    move |(x, y)| PathElement::new([(x, y), (x + KEY_LENGTH, y)], color.stroke_width(2))
}

/// Returns a legend's picture of dots of `radius` pixels.
pub fn dot_key(color: RGBColor, radius: i32) -> impl Fn((i32, i32)) -> Circle<(i32, i32), i32> {
    move |(x, y)| Circle::new((x + KEY_LENGTH / 2, y), radius, color.filled())
}

/// Returns the style of the line that joins the points of a Pareto front.
pub fn front_line() -> ShapeStyle {
    BLACK.mix(0.25).stroke_width(2)
}
