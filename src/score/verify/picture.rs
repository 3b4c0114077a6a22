//! Plot of a report: scores above, errors below, one column per candidate.

use ::image::RgbImage;
use plotters::coord::Shift;
use plotters::prelude::*;

use super::report::{CandidateReport, VerifyReport};
use crate::error::{Error, Result};
use crate::render;

/// Width and height of the picture, pixels.
const SIZE: (u32, u32) = (1200, 900);
/// Height of the title above the charts, pixels.
const TITLE_HEIGHT: u32 = 40;

/// A curve: label, name of the score, colour.
type Curve = (&'static str, &'static str, RGBColor);

const SCORES: [Curve; 4] = [
    ("F1", "frame_mean.f1", RGBColor(20, 80, 160)),
    ("precision", "frame_mean.precision", RGBColor(90, 160, 60)),
    ("recall", "frame_mean.recall", RGBColor(214, 96, 24)),
    ("IoU", "frame_mean.iou", RGBColor(120, 120, 120)),
];
const ERRORS: [Curve; 4] = [
    ("missed force", "missed_force", RGBColor(170, 30, 60)),
    ("false-contact mass", "false_contact_mass", RGBColor(120, 60, 160)),
    ("missed touches", "missed_touches", RGBColor(214, 140, 24)),
    ("link force error", "link_force_error", RGBColor(40, 140, 140)),
];

/// Draws the report; error bars are 95 % intervals over episodes.
///
/// # Errors
/// If drawing fails.
pub fn draw(report: &VerifyReport) -> Result<RgbImage> {
    render::font::register();
    let mut pixels = vec![255u8; (SIZE.0 * SIZE.1 * 3) as usize];
    chart(report, &mut pixels).map_err(|error| Error::value("picture", "one that can be drawn", error))?;
    RgbImage::from_raw(SIZE.0, SIZE.1, pixels).ok_or_else(|| Error::shape("picture", format!("{SIZE:?}"), SIZE))
}

type Drawn = std::result::Result<(), Box<dyn std::error::Error>>;
type Area<'a> = DrawingArea<BitMapBackend<'a>, Shift>;

fn chart(report: &VerifyReport, pixels: &mut [u8]) -> Drawn {
    let root = BitMapBackend::with_buffer(pixels, SIZE).into_drawing_area();
    root.fill(&WHITE)?;
    let (head, body) = root.split_vertically(TITLE_HEIGHT);
    let counts = &report.counts;
    let title = format!(
        "against contact forces (label c): {} episodes, {} frames, {} with touch (means over these); bars: 95 % over episodes",
        counts.episodes, counts.frames, counts.touching_frames
    );
    head.draw(&Text::new(title, (16, 12), (render::font::FAMILY, 19)))?;
    let (upper, lower) = body.split_vertically((SIZE.1 - TITLE_HEIGHT) / 2);
    panel(&upper, "better high", &report.candidates, &SCORES)?;
    panel(&lower, "better low", &report.candidates, &ERRORS)?;
    root.present()?;
    Ok(())
}

fn panel(area: &Area, title: &str, candidates: &[CandidateReport], curves: &[Curve]) -> Drawn {
    let value = |candidate: &CandidateReport, name: &str| candidate.scores.get(name).and_then(|v| v.value);
    let all = candidates.iter().flat_map(|c| curves.iter().filter_map(|(_, name, _)| value(c, name)));
    let top = all.fold(1.0, f64::max) * 1.05;
    // Leaves room for the legend on the right.
    let end = candidates.len() as f64 * 1.18 + 0.3;
    let mut chart = ChartBuilder::on(area)
        .margin(10)
        .x_label_area_size(34)
        .y_label_area_size(60)
        .build_cartesian_2d(-0.5..end, 0.0..top)?;
    let names: Vec<&str> = candidates.iter().map(|candidate| candidate.name.as_str()).collect();
    let name_at = |x: &f64| match (x - x.round()).abs() < 1e-6 && *x > -0.5 {
        true => names.get(x.round() as usize).copied().unwrap_or_default().replace('_', " "),
        false => String::new(),
    };
    chart
        .configure_mesh()
        .disable_x_mesh()
        .light_line_style(TRANSPARENT)
        .x_labels(2 * names.len() + 1)
        .x_label_formatter(&name_at)
        .y_desc(title)
        .label_style((render::font::FAMILY, 17))
        .axis_desc_style((render::font::FAMILY, 19))
        .draw()?;
    for (index, (label, name, color)) in curves.iter().enumerate() {
        // Side by side, so that intervals do not hide each other.
        let shift = (index as f64 - 1.5) * 0.12;
        let points = candidates.iter().enumerate().filter_map(|(i, c)| {
            let scored = c.scores.get(name)?;
            Some((i as f64 + shift, scored.value?, scored.interval))
        });
        let points: Vec<(f64, f64, Option<[f64; 2]>)> = points.collect();
        if points.is_empty() {
            continue;
        }
        for (x, _, interval) in &points {
            if let Some([low, high]) = interval {
                let ends = [(*x, *low), (*x, high.min(top))];
                chart.draw_series(LineSeries::new(ends, color.mix(0.5).stroke_width(5)))?;
            }
        }
        let color = *color;
        chart
            .draw_series(points.iter().map(|(x, y, _)| Circle::new((*x, *y), 5, color.filled())))?
            .label(*label)
            .legend(move |(x, y)| Circle::new((x + 10, y), 5, color.filled()));
    }
    chart
        .configure_series_labels()
        .position(SeriesLabelPosition::UpperRight)
        .background_style(WHITE.mix(0.85))
        .border_style(BLACK.mix(0.3))
        .label_font((render::font::FAMILY, 17))
        .draw()?;
    Ok(())
}
