//! The bench's plot: error against cost, presets by name, the recommended one marked.

use std::path::Path;

use egotac::error::Result;
use egotac::render::figure::{self, Drawn, Figure};
use plotters::coord::Shift;
use plotters::prelude::*;

use super::knob::Knob;
use super::table::{Entry, Report};
use crate::front::front;

/// Errors below are drawn here: a share.
const FLOOR: f64 = 1e-5;
const MARK: RGBColor = RGBColor(214, 96, 24);
const COLORS: [RGBColor; 6] = [
    RGBColor(31, 119, 180),
    RGBColor(44, 160, 44),
    RGBColor(148, 103, 189),
    RGBColor(140, 86, 75),
    RGBColor(23, 150, 170),
    RGBColor(190, 150, 20),
];
const KNOBS: [Knob; 6] = [Knob::Timestep, Knob::Cone, Knob::Iterations, Knob::Integrator, Knob::Impratio, Knob::Hull];

type ErrorOf = fn(&Entry) -> Option<f64>;

/// One setting in the plot.
struct Point {
    knob: String,
    setting: String,
    /// Milliseconds per simulated second.
    cost: f64,
    /// Relative force error.
    error: f64,
}

/// The two panels: what the error is against.
const PANELS: [(&str, ErrorOf); 2] = [
    ("against the same model at 0.1 ms", |entry| entry.same.force),
    ("against elliptic, impratio 100, 0.05 ms", |entry| entry.model.force),
];

/// Writes `sim.png` and `sim.svg` into `folder`; `false` = there is nothing to plot: no setting has both a cost and an
/// error, since no hand presses.
///
/// # Errors
/// If a file can't be written.
pub fn write(folder: &Path, report: &Report) -> Result<bool> {
    if PANELS.iter().any(|(_, error)| points(report, *error).is_empty()) {
        return Ok(false);
    }
    figure::write(folder, "sim", report)?;
    Ok(true)
}

impl Figure for Report {
    const SIZE: (u32, u32) = (1400, 640);

    fn draw<B: DrawingBackend>(&self, root: &DrawingArea<B, Shift>) -> Drawn<()>
    where
        B::ErrorType: 'static,
    {
        root.fill(&WHITE)?;
        let panels = root.split_evenly((1, 2));
        for (panel, (title, error)) in panels.iter().zip(PANELS) {
            draw_panel(panel, title, &self.shared_scenes().join(", "), &points(self, error), self.recommended.name())?;
        }
        root.present()?;
        Ok(())
    }
}

/// Presets are measured in more scenes than single knobs; in the plot stand those in which all were.
fn points(report: &Report, error: ErrorOf) -> Vec<Point> {
    let shared = report.shared_scenes();
    let point = |row: &super::table::Row| {
        let worst = row.worst_of(|scene| shared.contains(&scene));
        let (cost, error) = (worst.ms_per_second?, error(&worst)?);
        Some(Point { knob: row.knob.clone(), setting: row.setting.clone(), cost, error: error.max(FLOOR) })
    };
    let physics = report.rows.iter().filter(|row| row.knob != Knob::Label.name());
    let mut points: Vec<Point> = physics.filter_map(point).collect();
    // Knobs left at the recommended preset's value, or without effect, would hide its mark.
    let same = |a: &Point, b: &Point| a.error == b.error && (a.cost / b.cost - 1.0).abs() < 0.05;
    let is_preset = |point: &Point| point.knob == Knob::Preset.name();
    if let Some(at) = points.iter().position(|p| is_preset(p) && p.setting == report.recommended.name()) {
        let recommended = points.swap_remove(at);
        points.retain(|point| is_preset(point) || !same(point, &recommended));
        points.push(recommended);
    }
    points
}

fn draw_panel<B: DrawingBackend>(
    area: &DrawingArea<B, Shift>,
    title: &str,
    scenes: &str,
    points: &[Point],
    marked: &str,
) -> Drawn<()>
where
    B::ErrorType: 'static,
{
    let (least, most) =
        points.iter().fold((f64::INFINITY, 0.0f64), |(low, high), p| (low.min(p.cost), high.max(p.cost)));
    // The axis is logarithmic, and without end its ticks would be, too.
    if !(least > 0.0 && least <= most && most.is_finite()) {
        return Err("no setting has both a cost and an error".into());
    }
    let mut chart = ChartBuilder::on(area)
        .caption(format!("Force error {title}"), ("sans-serif", 21))
        .margin(14)
        .x_label_area_size(48)
        .y_label_area_size(72)
        .build_cartesian_2d((0.6 * least..2.5 * most).log_scale(), (0.7 * FLOOR..2.0).log_scale())?;
    chart
        .configure_mesh()
        .light_line_style(TRANSPARENT)
        .x_desc(format!("milliseconds per simulated second (worst of {scenes})"))
        .y_desc("error of quasi-static forces (worst scene)")
        .x_label_formatter(&|x| format!("{x}"))
        .y_label_formatter(&|y| format!("{} %", (100.0 * y * 1e6).round() / 1e6))
        .label_style(("sans-serif", 15))
        .axis_desc_style(("sans-serif", 17))
        .draw()?;
    let front = front(points.iter().map(|point| (point.cost, point.error)));
    chart.draw_series(LineSeries::new(front, BLACK.mix(0.25).stroke_width(2)))?;
    for (knob, color) in KNOBS.into_iter().zip(COLORS) {
        let own: Vec<&Point> = points.iter().filter(|point| point.knob == knob.name()).collect();
        if own.is_empty() {
            continue;
        }
        chart
            .draw_series(own.iter().map(|p| Circle::new((p.cost, p.error), 4, color.filled())))?
            .label(knob.name())
            .legend(move |(x, y)| Circle::new((x + 10, y), 4, color.filled()));
        let label = |p: &&Point| {
            EmptyElement::at((p.cost, p.error))
                + Text::new(p.setting.clone(), (7, -12), TextStyle::from(("sans-serif", 12)).color(&color))
        };
        chart.draw_series(own.iter().map(label))?;
    }
    for point in points.iter().filter(|point| point.knob == Knob::Preset.name()) {
        let is_marked = point.setting == marked;
        let (color, size) = if is_marked { (MARK, 9) } else { (BLACK, 6) };
        let name = if is_marked { format!("{} (recommended)", point.setting) } else { point.setting.clone() };
        chart.draw_series([EmptyElement::at((point.cost, point.error))
            + Circle::new((0, 0), size, color.stroke_width(3))
            + Text::new(name, (9, 6), TextStyle::from(("sans-serif", 17)).color(&color))])?;
    }
    if KNOBS.iter().any(|knob| points.iter().any(|point| point.knob == knob.name())) {
        chart
            .configure_series_labels()
            .position(SeriesLabelPosition::UpperRight)
            .background_style(WHITE.mix(0.8))
            .border_style(BLACK.mix(0.3))
            .label_font(("sans-serif", 15))
            .draw()?;
    }
    Ok(())
}
