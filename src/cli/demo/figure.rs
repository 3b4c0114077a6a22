//! The demo's picture: what the camera saw, the touch on the hand in truth and as predicted, and the force over time.

use std::path::Path;

use anyhow::{Context, Result};
use image::RgbImage;
use image::imageops::{FilterType, resize};
use plotters::prelude::*;

use crate::file;
use crate::hand::{HandModel, PosedHand};
use crate::render;

/// Size of the picture, pixels.
const SIZE: (u32, u32) = (1500, 900);
/// Height of the upper row (camera image and hands), pixels.
const UPPER: u32 = 560;
/// Edge of one square panel, pixels.
const PANEL: u32 = 460;
const TRUTH: RGBColor = RGBColor(30, 30, 30);
const PREDICTED: RGBColor = RGBColor(214, 96, 24);

/// Total force of both hands at one image, for the trace.
#[derive(Debug, Clone, Copy)]
pub struct TracePoint {
    /// Seconds since the first image.
    pub seconds: f64,
    /// Predicted total force, N.
    pub predicted: f64,
    /// The simulator's total force, N.
    pub truth: f64,
}

/// What the upper row shows: one image of the run and the touch of one hand in it.
#[derive(Debug)]
pub struct Moment<'a> {
    /// Seconds since the first image.
    pub seconds: f64,
    /// The camera image.
    pub image: &'a RgbImage,
    /// (778) predicted force, N.
    pub predicted: &'a [f32],
    /// (778) the simulator's force, N.
    pub truth: &'a [f32],
}

/// Writes the picture to `path` (PNG).
///
/// # Errors
/// If drawing or writing fails.
pub fn write(path: &Path, hand: &HandModel, posed: &PosedHand, moment: &Moment, trace: &[TracePoint]) -> Result<()> {
    render::font::register();
    let mut pixels = vec![255u8; (SIZE.0 * SIZE.1 * 3) as usize];
    {
        let root = BitMapBackend::with_buffer(&mut pixels, SIZE).into_drawing_area();
        root.fill(&WHITE)?;
        let (upper, lower) = root.split_vertically(UPPER);
        draw_moment(&upper, hand, posed, moment).context("camera image and hands")?;
        draw_trace(&lower, trace, moment.seconds).context("force over time")?;
        root.present()?;
    }
    let picture = RgbImage::from_raw(SIZE.0, SIZE.1, pixels).context("picture buffer has another size")?;
    Ok(file::write_png(path, &picture)?)
}

type Area<'a> = DrawingArea<BitMapBackend<'a>, plotters::coord::Shift>;

fn draw_moment(area: &Area, hand: &HandModel, posed: &PosedHand, moment: &Moment) -> Result<()> {
    let peak = moment.truth.iter().chain(moment.predicted).copied().fold(0.0f32, f32::max).max(0.05);
    let view = |force: &[f32]| {
        render::hand_picture(hand, posed, &render::force_colors(force, peak), render::View::Palmar, (PANEL, PANEL))
    };
    let panels = [
        (format!("camera, t = {:.1} s", moment.seconds), resize(moment.image, PANEL, PANEL, FilterType::Triangle)),
        (format!("truth (simulator): {:.1} N in total", total(moment.truth)), view(moment.truth)),
        (format!("predicted from the image: {:.1} N in total", total(moment.predicted)), view(moment.predicted)),
    ];
    for (index, (title, picture)) in panels.into_iter().enumerate() {
        let x = 20 + index as i32 * (PANEL as i32 + 15);
        area.draw(&Text::new(title, (x, 18), ("sans-serif", 22)))?;
        blit(area, picture, (x, 50))?;
    }
    let bar = render::color_bar(peak, "force per vertex, newton", (PANEL, 44));
    blit(area, bar, (20 + (PANEL as i32 + 15) * 3 / 2, UPPER as i32 - 46))
}

fn blit(area: &Area, picture: RgbImage, at: (i32, i32)) -> Result<()> {
    let (width, height) = picture.dimensions();
    let element = BitMapElement::with_owned_buffer(at, (width, height), picture.into_raw());
    area.draw(&element.context("picture buffer has another size")?)?;
    Ok(())
}

fn draw_trace(area: &Area, trace: &[TracePoint], marked_seconds: f64) -> Result<()> {
    let end = trace.last().map_or(1.0, |point| point.seconds).max(1e-3);
    let peak = trace.iter().map(|point| point.predicted.max(point.truth)).fold(0.5, f64::max) * 1.1;
    let mut chart = ChartBuilder::on(area)
        .margin(12)
        .x_label_area_size(44)
        .y_label_area_size(64)
        .build_cartesian_2d(0.0..end, 0.0..peak)?;
    chart
        .configure_mesh()
        .light_line_style(TRANSPARENT)
        .x_desc("time, s")
        .y_desc("total force, N")
        .label_style(("sans-serif", 17))
        .axis_desc_style(("sans-serif", 19))
        .draw()?;
    chart.draw_series(LineSeries::new([(marked_seconds, 0.0), (marked_seconds, peak)], BLACK.mix(0.25)))?;
    type Value = fn(&TracePoint) -> f64;
    let series: [(&str, RGBColor, Value); 2] =
        [("truth", TRUTH, |point| point.truth), ("predicted", PREDICTED, |point| point.predicted)];
    for (label, color, value) in series {
        chart
            .draw_series(LineSeries::new(trace.iter().map(|p| (p.seconds, value(p))), color.stroke_width(2)))?
            .label(label)
            .legend(move |(x, y)| PathElement::new([(x, y), (x + 24, y)], color.stroke_width(3)));
    }
    chart
        .configure_series_labels()
        .position(SeriesLabelPosition::UpperRight)
        .background_style(WHITE.mix(0.8))
        .border_style(BLACK.mix(0.3))
        .label_font(("sans-serif", 18))
        .draw()?;
    Ok(())
}

fn total(force: &[f32]) -> f32 {
    force.iter().sum()
}
