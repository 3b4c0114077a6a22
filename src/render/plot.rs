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

/// Returns where each name is written, as pixels from its point to the text's upper left corner, so that no name covers another one
/// or a dot: above its point if there is room, else further up or below.
///
/// `names`: texts and the pixels of their points; `dots`: pixels of all points; `size`: height of the texts, pixels.
pub fn name_offsets(names: &[(&str, (i32, i32))], dots: &[(i32, i32)], size: u32) -> Vec<(i32, i32)> {
    /// Half the side of the square that a dot takes, pixels.
    const DOT: i32 = 7;
    let mut taken: Vec<[i32; 4]> = dots.iter().map(|(x, y)| [x - DOT, y - DOT, x + DOT, y + DOT]).collect();
    let line = size as i32 + 3;
    let mut place = |(name, (x, y)): &(&str, (i32, i32))| {
        let width = super::font::width(name, f64::from(size)) as i32;
        let corners = (1..8).flat_map(|step| [-(9 + step * line), 9 + (step - 1) * line]);
        let boxed = |dy: i32| (dy, [x - 4, y + dy, x - 4 + width, y + dy + size as i32]);
        let is_free = |spot: &[i32; 4]| {
            taken
                .iter()
                .all(|other| spot[2] < other[0] || other[2] < spot[0] || spot[3] < other[1] || other[3] < spot[1])
        };
        let (dy, spot) = corners.map(boxed).find(|(_, spot)| is_free(spot)).unwrap_or_else(|| boxed(-(9 + line)));
        taken.push(spot);
        (-4, dy)
    };
    names.iter().map(&mut place).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_of_near_points_cover_neither_each_other_nor_a_dot() {
        let points = [(100, 200), (110, 203), (120, 198), (128, 201)];
        let names: Vec<(&str, (i32, i32))> = points.iter().map(|at| ("egotac-pocket-8", *at)).collect();
        let offsets = name_offsets(&names, &points, 15);
        let spots: Vec<[i32; 4]> = names
            .iter()
            .zip(&offsets)
            .map(|((name, (x, y)), (dx, dy))| {
                let width = super::super::font::width(name, 15.0) as i32;
                [x + dx, y + dy, x + dx + width, y + dy + 15]
            })
            .collect();
        let apart = |a: &[i32; 4], b: &[i32; 4]| a[2] < b[0] || b[2] < a[0] || a[3] < b[1] || b[3] < a[1];
        for (index, spot) in spots.iter().enumerate() {
            assert!(spots[..index].iter().all(|other| apart(spot, other)), "{spots:?}");
            assert!(points.iter().all(|(x, y)| apart(spot, &[*x, *y, *x, *y])), "{spots:?}");
        }
    }
}
