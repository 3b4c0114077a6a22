//! Plot of `egotac bench sim`: error against cost, with the recommended preset marked.

use std::path::Path;

use egotac::error::Result;
use egotac::render::figure::{self, Drawn, Figure};
use egotac::render::plot::{self, ACCENT, Named, PALETTE};
use plotters::coord::Shift;
use plotters::prelude::*;

use super::knob::Knob;
use super::table::{Entry, SimReport};
use crate::front::front;

/// Smallest relative error that is drawn. The reference has none: drawn, it would leave the others a corner of the plot.
const FLOOR: f64 = 1e-5;
/// Colour of the names of settings: that of their points is too pale for letters.
const NAME: RGBColor = RGBColor(70, 70, 70);
/// Knobs whose settings are drawn beside the presets. Grids are not: they are compared with another model.
const KNOBS: [Knob; 6] = [Knob::Timestep, Knob::Cone, Knob::Iterations, Knob::Integrator, Knob::Impratio, Knob::Hull];

type ErrorOf = fn(&Entry) -> Option<f64>;

/// A setting in the plot.
struct Point {
    knob: String,
    setting: String,
    /// Computation per simulated second, ms.
    cost: f64,
    /// Relative force error.
    error: f64,
}

/// Titles of the two panels and their errors.
const PANELS: [(&str, ErrorOf); 2] = [
    ("against the same model at 0.1 ms", |entry| entry.same.force),
    ("against elliptic, impratio 100, 0.05 ms", |entry| entry.model.force),
];

/// Writes `sim.png` and `sim.svg` into `folder`; false if no setting has both a cost and an error, because no hand presses
/// in the scenes.
///
/// # Errors
/// If a file can't be written.
pub fn write(folder: &Path, report: &SimReport) -> Result<bool> {
    if PANELS.iter().any(|(_, error)| points(report, *error).is_empty()) {
        return Ok(false);
    }
    figure::write(folder, "sim", report)?;
    Ok(true)
}

impl Figure for SimReport {
    const SIZE: (u32, u32) = (1400, 640);

    fn draw<B: DrawingBackend>(&self, root: &DrawingArea<B, Shift>) -> Drawn<()>
    where
        B::ErrorType: 'static,
    {
        root.fill(&WHITE)?;
        let panels = root.split_evenly((1, 2));
        // More names have no room below a panel.
        let scenes = match self.shared_scenes() {
            few if few.len() <= 3 => few.join(", "),
            many => format!("{} scenes", many.len()),
        };
        for (panel, (title, error)) in panels.iter().zip(PANELS) {
            draw_panel(panel, title, &scenes, &points(self, error), self.recommended.name())?;
        }
        root.present()?;
        Ok(())
    }
}

/// Returns the settings as the worst of the scenes in which all were measured: single knobs have fewer scenes than presets.
fn points(report: &SimReport, error: ErrorOf) -> Vec<Point> {
    let shared = report.shared_scenes();
    let point = |row: &super::table::Row| {
        let worst = row.worst_of(|scene| shared.contains(&scene));
        let (cost, error) = (worst.ms_per_second?, error(&worst).filter(|error| *error > FLOOR)?);
        Some(Point { knob: row.knob.clone(), setting: row.setting.clone(), cost, error })
    };
    let drawn: Vec<&str> = KNOBS.iter().chain([&Knob::Preset]).map(|knob| knob.name()).collect();
    let rows = report.rows.iter().filter(|row| drawn.contains(&row.knob.as_str()));
    let mut points: Vec<Point> = rows.filter_map(point).collect();
    // Settings that equal the recommended preset, or have no effect, would hide its mark.
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
    // A logarithmic axis without bounds would have endless ticks.
    if !(least > 0.0 && least <= most && most.is_finite()) {
        return Err("no setting has both a cost and an error".into());
    }
    let errors = points.iter().map(|point| point.error);
    let (low, high) = (0.5 * errors.clone().fold(2.0, f64::min), 2.0 * errors.fold(FLOOR, f64::max));
    let mut chart = plot::chart(area, &format!("Force error {title}"), [60, 90]).build_cartesian_2d(
        (0.6 * least..2.5 * most).log_scale().with_key_points(plot::log_ticks(0.6 * least, 2.5 * most)),
        (low..high).log_scale().with_key_points(plot::log_ticks(low, high)),
    )?;
    plot::axes(
        &mut chart,
        (&format!("milliseconds per simulated second (worst of {scenes})"), &|x| format!("{x}")),
        ("error of quasi-static forces (worst scene)", &|y| format!("{} %", (100.0 * y * 1e6).round() / 1e6)),
        [8, 8],
    )?;
    let front = front(points.iter().map(|point| (point.cost, point.error)));
    chart.draw_series(LineSeries::new(front.iter().copied(), plot::front_line()))?;
    let mut names: Vec<Named> = Vec::new();
    // The accent is the recommended preset's alone.
    for (knob, color) in KNOBS.into_iter().zip(PALETTE.into_iter().filter(|color| *color != ACCENT)) {
        let own: Vec<&Point> = points.iter().filter(|point| point.knob == knob.name()).collect();
        if own.is_empty() {
            continue;
        }
        chart
            .draw_series(own.iter().map(|p| Circle::new((p.cost, p.error), 4, color.filled())))?
            .label(knob.name())
            .legend(plot::dot_key(color, 4));
        names.extend(own.into_iter().map(|point| {
            let at = (point.cost, point.error);
            Named { text: &point.setting, at, size: 15, color: NAME }
        }));
    }
    let recommended = format!("{marked} (recommended)");
    for point in points.iter().filter(|point| point.knob == Knob::Preset.name()) {
        let is_marked = point.setting == marked;
        let (color, size) = if is_marked { (ACCENT, 9) } else { (BLACK, 6) };
        let at = (point.cost, point.error);
        chart.draw_series([EmptyElement::at(at) + Circle::new((0, 0), size, color.stroke_width(3))])?;
        let text = if is_marked { &recommended } else { &point.setting };
        // Presets choose their places first.
        names.insert(0, Named { text, at, size: 19, color });
    }
    plot::draw_names(area, &chart, &names, points.iter().map(|point| (point.cost, point.error)), &front)?;
    if KNOBS.iter().any(|knob| points.iter().any(|point| point.knob == knob.name())) {
        plot::legend(&mut chart, SeriesLabelPosition::UpperRight)?;
    }
    Ok(())
}
