//! Common look of charts: palette, heading, title, axes, legend, names beside points.

use plotters::chart::{ChartBuilder, ChartContext, SeriesLabelPosition};
use plotters::coord::cartesian::Cartesian2d;
use plotters::coord::ranged1d::{Ranged, ValueFormatter};
use plotters::coord::{CoordTranslate, Shift};
use plotters::prelude::*;
use plotters::style::ShapeStyle;

use super::figure::Drawn;
use super::font::{self, FAMILY};
use super::names::{self, Name};

/// Colours of series, in the order in which series take them: those of Okabe and Ito (2008), which stay apart for readers with a
/// colour vision deficiency. Grey stands for their yellow, which is too pale on white.
pub const PALETTE: [RGBColor; 7] = [
    RGBColor(0, 114, 178),
    ACCENT,
    RGBColor(0, 158, 115),
    RGBColor(204, 121, 167),
    RGBColor(86, 180, 233),
    RGBColor(230, 159, 0),
    RGBColor(90, 90, 90),
];
/// Colour of a single series that stands out: vermilion.
pub const ACCENT: RGBColor = RGBColor(213, 94, 0);

/// Height of a figure's heading, of a chart's title, of the axes' descriptions, and of tick labels and legends, pixels.
const HEADING: u32 = 30;
const TITLE: u32 = 25;
const DESCRIPTION: u32 = 20;
/// Height of tick labels and legends, pixels.
pub const LABEL: u32 = 19;
/// Space around a chart, pixels.
pub const MARGIN: u32 = 14;
/// Length of a line in a legend, pixels.
const KEY_LENGTH: i32 = 18;
/// Height of a row of keys, pixels.
const KEY_ROW: u32 = 32;
/// Radius of the space that names leave around a point, pixels.
const DOT: i32 = 6;

/// Draws a heading and below it the keys for all charts of `area`, both in as many rows as they need; returns the part below them.
///
/// # Errors
/// If the backend fails.
pub fn head<DB>(
    area: &DrawingArea<DB, Shift>,
    heading: &str,
    series: &[(&str, RGBColor)],
) -> Drawn<DrawingArea<DB, Shift>>
where
    DB: DrawingBackend,
    DB::ErrorType: 'static,
{
    let left = MARGIN as i32;
    let room = area.dim_in_pixel().0.saturating_sub(2 * MARGIN);
    let lines = wrapped(heading, room, HEADING);
    let top = if lines.is_empty() { 8 } else { (HEADING * lines.len() as u32) as i32 + 18 };
    let (mut x, mut y) = (left, top);
    let mut keys = Vec::new();
    for (name, color) in series {
        let width = KEY_LENGTH + 6 + font::width(name, f64::from(LABEL)) as i32;
        if x > left && x + width > left + room as i32 {
            (x, y) = (left, y + KEY_ROW as i32);
        }
        keys.push((*name, *color, (x, y)));
        x += width + 24;
    }
    let height = if series.is_empty() { top } else { y + KEY_ROW as i32 };
    let (head, body) = area.split_vertically(height);
    for (row, line) in lines.iter().enumerate() {
        head.draw(&Text::new(line.clone(), (left, 10 + HEADING as i32 * row as i32), (FAMILY, HEADING)))?;
    }
    for (name, color, (x, y)) in keys {
        head.draw(&Rectangle::new([(x, y + 1), (x + KEY_LENGTH, y + 11)], color.filled()))?;
        head.draw(&Text::new(name.to_owned(), (x + KEY_LENGTH + 6, y), (FAMILY, LABEL)))?;
    }
    Ok(body)
}

/// Breaks a text of this size into lines of at most `room` pixels, between words; none for an empty one.
fn wrapped(text: &str, room: u32, size: u32) -> Vec<String> {
    let mut lines: Vec<String> = Vec::new();
    for word in text.split_whitespace() {
        let longer = lines.last().map(|line| format!("{line} {word}"));
        match longer.filter(|line| font::width(line, f64::from(size)) <= room) {
            Some(longer) => {
                lines.pop();
                lines.push(longer);
            }
            None => lines.push(word.to_owned()),
        }
    }
    lines
}

/// Starts a chart with a title, `[below, left]` pixels of which hold tick labels and descriptions of the axes.
pub fn chart<'a, 'b, DB: DrawingBackend>(
    area: &'a DrawingArea<DB, Shift>,
    title: &str,
    [below, left]: [u32; 2],
) -> ChartBuilder<'a, 'b, DB> {
    let mut chart = ChartBuilder::on(area);
    if !title.is_empty() {
        chart.caption(title, (FAMILY, TITLE));
    }
    chart.margin(MARGIN).x_label_area_size(below).y_label_area_size(left);
    chart
}

/// Description of an axis with its unit, and the text of a value on it.
pub type Axis<'a> = (&'a str, &'a dyn Fn(&f64) -> String);

/// Draws axes with about `ticks` values on each, and the lines at these.
///
/// # Errors
/// If the backend fails.
pub fn axes<DB, X, Y>(
    chart: &mut ChartContext<'_, DB, Cartesian2d<X, Y>>,
    x: Axis<'_>,
    y: Axis<'_>,
    ticks: [usize; 2],
) -> Drawn<()>
where
    DB: DrawingBackend,
    DB::ErrorType: 'static,
    X: Ranged<ValueType = f64> + ValueFormatter<f64>,
    Y: Ranged<ValueType = f64> + ValueFormatter<f64>,
{
    chart
        .configure_mesh()
        .light_line_style(TRANSPARENT)
        .x_labels(ticks[0])
        .y_labels(ticks[1])
        .x_desc(x.0)
        .y_desc(y.0)
        .x_label_formatter(x.1)
        .y_label_formatter(y.1)
        .label_style((FAMILY, LABEL))
        .axis_desc_style((FAMILY, DESCRIPTION))
        .draw()?;
    Ok(())
}

/// Space between a chart and the names of its categories, pixels.
const BELOW: i32 = 8;
/// Height of the names of many categories, pixels.
const SMALL_LABEL: u32 = 16;
/// Most rows of the names of categories.
const MOST_ROWS: usize = 2;

/// Names of categories in rows, and their height, pixels.
type Rows = (Vec<Vec<String>>, u32);

/// Breaks the names of categories, which are `pitch` pixels apart, into rows, smaller ones if need be; None if they have no room there.
fn rows(names: &[&str], pitch: u32) -> Option<Rows> {
    let room = pitch.saturating_sub(BELOW as u32);
    [LABEL, SMALL_LABEL].into_iter().find_map(|size| {
        let rows: Vec<_> = names.iter().map(|name| wrapped(name, room, size)).collect();
        let fits = |rows: &Vec<String>| {
            rows.len() <= MOST_ROWS && rows.iter().all(|row| font::width(row, f64::from(size)) <= room)
        };
        rows.iter().all(fits).then_some((rows, size))
    })
}

/// Returns the height that [`categories`] needs for names that are `pitch` pixels apart.
pub fn names_height(names: &[&str], pitch: u32) -> u32 {
    let below = BELOW as u32;
    match rows(names, pitch) {
        Some((rows, size)) => below + MARGIN + size * rows.iter().map(Vec::len).max().unwrap_or(1).max(1) as u32,
        None => 2 * below + names.iter().map(|name| font::width(name, f64::from(LABEL))).max().unwrap_or(0),
    }
}

/// Draws the value axis of a chart whose other axis has the categories 0, 1, 2 ..., and their names below it: side by side, in two rows
/// where one is too narrow, else from top to bottom.
///
/// # Errors
/// If the backend fails.
pub fn categories<DB, X, Y>(
    area: &DrawingArea<DB, Shift>,
    chart: &mut ChartContext<'_, DB, Cartesian2d<X, Y>>,
    names: &[&str],
    y: Axis<'_>,
) -> Drawn<()>
where
    DB: DrawingBackend,
    DB::ErrorType: 'static,
    X: Ranged<ValueType = f64> + ValueFormatter<f64>,
    Y: Ranged<ValueType = f64> + ValueFormatter<f64>,
{
    chart
        .configure_mesh()
        .disable_x_mesh()
        .light_line_style(TRANSPARENT)
        .x_labels(0)
        .y_labels(6)
        .y_desc(y.0)
        .y_label_formatter(y.1)
        .label_style((FAMILY, LABEL))
        .axis_desc_style((FAMILY, DESCRIPTION))
        .draw()?;
    let bottom = chart.plotting_area().get_pixel_range().1.end;
    let (left, upper) = area.get_base_pixel();
    let zero = chart.plotting_area().get_y_range().start;
    let place = |index: usize| chart.plotting_area().map_coordinate(&(index as f64, zero)).0 - left;
    let pitch = if names.len() > 1 { place(1).abs_diff(place(0)) } else { u32::MAX };
    let style = |size: u32| TextStyle::from((FAMILY, size)).color(&BLACK);
    use plotters::style::text_anchor::{HPos, Pos, VPos};
    let top = bottom - upper + BELOW;
    let Some((rows, size)) = rows(names, pitch) else {
        let style = style(LABEL).transform(FontTransform::Rotate90).pos(Pos::new(HPos::Left, VPos::Center));
        for (index, name) in names.iter().enumerate() {
            area.draw(&Text::new((*name).to_owned(), (place(index), top), style.clone()))?;
        }
        return Ok(());
    };
    let style = style(size).pos(Pos::new(HPos::Center, VPos::Top));
    for (index, rows) in rows.into_iter().enumerate() {
        for (row, line) in rows.into_iter().enumerate() {
            area.draw(&Text::new(line, (place(index), top + row as i32 * size as i32), style.clone()))?;
        }
    }
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

/// Returns the values with a tick on a logarithmic axis: 1, 2 and 5 times the powers of ten, or those alone where they are many.
pub fn log_ticks(low: f64, high: f64) -> Vec<f64> {
    let steps: &[f64] = match high / low {
        ..8.0 => &[1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 7.0],
        8.0..1e3 => &[1.0, 2.0, 5.0],
        _ => &[1.0],
    };
    let powers = low.log10().floor() as i32..=high.log10().ceil() as i32;
    powers
        .flat_map(|power| steps.iter().map(move |step| step * 10f64.powi(power)))
        .filter(|tick| (low..=high).contains(tick))
        .collect()
}

/// Returns the range of `values` with room at both ends, at least `span` wide, so that differences smaller than that look small.
pub fn span(values: impl Iterator<Item = f64>, span: f64) -> Option<(f64, f64)> {
    let finite = values.filter(|value| value.is_finite());
    let (low, high) = finite.fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), value| (l.min(value), h.max(value)));
    let room = (0.2 * (high - low)).max(0.5 * (span - (high - low)));
    (low <= high).then_some((low - room, high + room))
}

/// Name of a point in a chart.
pub struct Named<'a> {
    /// The name.
    pub text: &'a str,
    /// The point, in the chart's coordinates.
    pub at: (f64, f64),
    /// Height of the text, pixels.
    pub size: u32,
    /// Colour of the text.
    pub color: RGBColor,
}

/// Writes names beside their points, so that they cover neither each other, nor a point of `dots`, nor the line through `front`; a
/// name that stands apart from its point is joined to it.
///
/// # Errors
/// If the backend fails.
pub fn draw_names<DB, X, Y>(
    area: &DrawingArea<DB, Shift>,
    chart: &ChartContext<'_, DB, Cartesian2d<X, Y>>,
    named: &[Named],
    dots: impl Iterator<Item = (f64, f64)>,
    front: &[(f64, f64)],
) -> Drawn<()>
where
    DB: DrawingBackend,
    DB::ErrorType: 'static,
    X: Ranged<ValueType = f64>,
    Y: Ranged<ValueType = f64>,
{
    let pixel = |at: (f64, f64)| chart.backend_coord(&at);
    let mut taken: Vec<[i32; 4]> = dots.map(pixel).map(|(x, y)| [x - DOT, y - DOT, x + DOT, y + DOT]).collect();
    for ends in front.windows(2) {
        let ((x0, y0), (x1, y1)) = (pixel(ends[0]), pixel(ends[1]));
        let steps = ((x1 - x0).abs().max((y1 - y0).abs()) / 4).max(1);
        taken.extend(
            (0..=steps)
                .map(|step| [x0 + (x1 - x0) * step / steps, y0 + (y1 - y0) * step / steps])
                .map(|[x, y]| [x, y, x, y]),
        );
    }
    let (columns, rows) = chart.plotting_area().get_pixel_range();
    let texts: Vec<Name> =
        named.iter().map(|name| Name { text: name.text, at: pixel(name.at), size: name.size }).collect();
    let frame = [columns.start, rows.start, columns.end, rows.end];
    let (left, upper) = area.get_base_pixel();
    for (name, spot) in named.iter().zip(names::place(&texts, taken, frame)) {
        let own = |(x, y): (i32, i32)| (x - left, y - upper);
        if let Some(end) = spot.leader {
            area.draw(&PathElement::new([own(pixel(name.at)), own(end)], BLACK.mix(0.35)))?;
        }
        let style = TextStyle::from((FAMILY, name.size)).color(&name.color);
        area.draw(&Text::new(name.text.to_owned(), own(spot.corner), style))?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns a colour as seen without the cones of red or of green (Machado et al. 2009, severity 1), in linear light.
    fn seen(color: RGBColor, matrix: [[f64; 3]; 3]) -> [f64; 3] {
        let linear = [color.0, color.1, color.2].map(|byte| (f64::from(byte) / 255.0).powf(2.2));
        matrix.map(|row| row.iter().zip(linear).map(|(factor, value)| factor * value).sum())
    }

    /// Returns lightness and the two opponent colours of CIE L*a*b*.
    fn lab([red, green, blue]: [f64; 3]) -> [f64; 3] {
        let x = (0.4124 * red + 0.3576 * green + 0.1805 * blue) / 0.9505;
        let y = 0.2126 * red + 0.7152 * green + 0.0722 * blue;
        let z = (0.0193 * red + 0.1192 * green + 0.9505 * blue) / 1.089;
        let [x, y, z] = [x, y, z].map(|value| value.max(0.0).cbrt());
        [116.0 * y - 16.0, 500.0 * (x - y), 200.0 * (y - z)]
    }

    #[test]
    fn colours_stay_apart_without_the_cones_of_red_or_green() {
        let all = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
        let no_red =
            [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998]];
        let no_green =
            [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.011820, 0.042940, 0.968881]];
        for eye in [all, no_red, no_green] {
            for (index, a) in PALETTE.iter().enumerate() {
                for b in &PALETTE[..index] {
                    let (first, second) = (lab(seen(*a, eye)), lab(seen(*b, eye)));
                    let distance: f64 = first.iter().zip(second).map(|(a, b)| (a - b).powi(2)).sum::<f64>().sqrt();
                    assert!(distance > 12.0, "{a:?} and {b:?}: {distance:.1}");
                }
            }
        }
    }

    #[test]
    fn colours_stand_out_from_white() {
        for color in PALETTE {
            let [lightness, ..] = lab(seen(color, [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]));
            assert!(lightness < 75.0, "{color:?}: {lightness:.1}");
        }
    }

    #[test]
    fn long_headings_take_several_lines() {
        let text = "Does training on two imported data sets beat either alone?";
        let lines = wrapped(text, 500, HEADING);
        assert!(lines.len() > 1 && lines.iter().all(|line| font::width(line, f64::from(HEADING)) <= 500));
        assert_eq!(lines.join(" "), text);
        assert_eq!(wrapped("", 500, HEADING).len(), 0);
    }

    #[test]
    fn a_narrow_logarithmic_axis_has_ticks_too() {
        assert_eq!(log_ticks(70.0, 300.0), [70.0, 100.0, 150.0, 200.0, 300.0]);
        assert_eq!(log_ticks(4.0, 60.0), [5.0, 10.0, 20.0, 50.0]);
        assert_eq!(log_ticks(0.5, 2000.0), [1.0, 10.0, 100.0, 1000.0]);
    }

    #[test]
    fn a_small_difference_looks_small() {
        let (low, high) = span([0.719, 0.728].into_iter(), 0.1).unwrap();
        assert!((high - low - 0.1).abs() < 1e-9 && (0.5 * (low + high) - 0.7235).abs() < 1e-9);
        let (low, high) = span([1.0, 3.0, f64::NAN].into_iter(), 0.1).unwrap();
        assert!((low - 0.6).abs() < 1e-9 && (high - 3.4).abs() < 1e-9);
        assert_eq!(span([].into_iter(), 0.1), None);
    }

    #[test]
    fn names_of_categories_take_one_row_two_or_turn() {
        let names = ["by size", "by root of size"];
        let height = |names: &[&str], pitch| names_height(names, pitch);
        let [one, two] =
            [vec![vec!["by size"], vec!["by root of size"]], vec![vec!["by size"], vec!["by root of", "size"]]]
                .map(|rows| rows.into_iter().map(|row| row.into_iter().map(String::from).collect()).collect());
        assert_eq!(rows(&names, 400), Some((one, LABEL)));
        assert_eq!(rows(&names, 120), Some((two, LABEL)));
        let long = ["decoder more", "decoder half"];
        let (small, size) = rows(&long, font::width("decoder", f64::from(SMALL_LABEL)) + BELOW as u32).unwrap();
        assert!(size == SMALL_LABEL && small.iter().all(|rows| rows.len() == 2), "{small:?}");
        assert_eq!(rows(&names, 30), None);
        assert!(height(&names, 400) < height(&names, 120) && height(&names, 120) < height(&names, 30));
    }
}
