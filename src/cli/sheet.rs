//! Draws the picture of a demo: three panels side by side, a colour bar below them, and two forces over time.

use std::path::Path;

use image::RgbImage;
use image::imageops::{FilterType, resize};
use plotters::coord::Shift;
use plotters::prelude::*;

use crate::error::Result;
use crate::render;
use crate::render::figure::{self, Drawn, Figure};
use crate::render::font::FAMILY;

/// Edge of a panel, pixels.
pub const PANEL: u32 = 460;
/// Distance between the left edges of neighbouring panels, pixels.
const PITCH: i32 = PANEL as i32 + 15;
/// Left edge of the first panel, pixels.
const LEFT: i32 = 20;
/// Height of the upper part: titles, panels and colour bar, pixels.
const UPPER: u32 = 560;

/// Content of the picture.
pub struct Sheet<'a> {
    /// Titles and pictures, which are scaled to [`PANEL`] squared.
    pub panels: [(String, RgbImage); 3],
    pub bar: Bar<'a>,
    /// A line below the last panel.
    pub note: Option<String>,
    /// Label of the force axis.
    pub axis: &'a str,
    pub series: [Series<'a>; 2],
    /// Time of the panels, s.
    pub shown: f64,
}

/// A colour bar.
pub struct Bar<'a> {
    /// Force at its right end, N.
    pub peak: f32,
    pub label: &'a str,
    /// Panel above the bar, counted from 0; 0.5 is halfway between the first two.
    pub column: f64,
}

/// A force over time.
pub struct Series<'a> {
    pub name: &'a str,
    pub color: RGBColor,
    /// Seconds and newtons, in time order.
    pub points: Vec<(f64, f64)>,
}

impl Sheet<'_> {
    /// Writes the picture to `path` (PNG).
    ///
    /// # Errors
    /// If drawing or writing fails.
    pub fn write(&self, path: &Path) -> Result<()> {
        figure::write_png(path, self)
    }
}

impl Figure for Sheet<'_> {
    const SIZE: (u32, u32) = (1500, 900);

    fn draw<B: DrawingBackend>(&self, root: &DrawingArea<B, Shift>) -> Drawn<()>
    where
        B::ErrorType: 'static,
    {
        root.fill(&WHITE)?;
        let (upper, lower) = root.split_vertically(UPPER);
        for (index, (title, picture)) in self.panels.iter().enumerate() {
            let x = LEFT + index as i32 * PITCH;
            upper.draw(&Text::new(title.as_str(), (x, 18), (FAMILY, 22)))?;
            blit(&upper, resize(picture, PANEL, PANEL, FilterType::Triangle), (x, 50))?;
        }
        let bar = render::color_bar(self.bar.peak, self.bar.label, (PANEL, 44));
        blit(&upper, bar, (LEFT + (self.bar.column * f64::from(PITCH)) as i32, UPPER as i32 - 46))?;
        if let Some(note) = &self.note {
            upper.draw(&Text::new(note.as_str(), (LEFT + 2 * PITCH + 10, UPPER as i32 - 40), (FAMILY, 17)))?;
        }
        self.draw_forces(&lower)?;
        root.present()?;
        Ok(())
    }
}

impl Sheet<'_> {
    fn draw_forces<B: DrawingBackend>(&self, area: &DrawingArea<B, Shift>) -> Drawn<()>
    where
        B::ErrorType: 'static,
    {
        let points = || self.series.iter().flat_map(|series| &series.points);
        let end = points().map(|point| point.0).fold(1e-3, f64::max);
        let peak = 1.1 * points().map(|point| point.1).fold(0.5, f64::max);
        let mut chart = ChartBuilder::on(area)
            .margin(12)
            .x_label_area_size(44)
            .y_label_area_size(64)
            .build_cartesian_2d(0.0..end, 0.0..peak)?;
        chart
            .configure_mesh()
            .light_line_style(TRANSPARENT)
            .x_desc("time, s")
            .y_desc(self.axis)
            .label_style((FAMILY, 17))
            .axis_desc_style((FAMILY, 19))
            .draw()?;
        chart.draw_series(LineSeries::new([(self.shown, 0.0), (self.shown, peak)], BLACK.mix(0.25)))?;
        for series in &self.series {
            let color = series.color;
            chart
                .draw_series(LineSeries::new(series.points.iter().copied(), color.stroke_width(2)))?
                .label(series.name)
                .legend(move |(x, y)| PathElement::new([(x, y), (x + 24, y)], color.stroke_width(3)));
        }
        chart
            .configure_series_labels()
            .position(SeriesLabelPosition::UpperRight)
            .background_style(WHITE.mix(0.8))
            .border_style(BLACK.mix(0.3))
            .label_font((FAMILY, 18))
            .draw()?;
        Ok(())
    }
}

fn blit<B: DrawingBackend>(area: &DrawingArea<B, Shift>, picture: RgbImage, at: (i32, i32)) -> Drawn<()>
where
    B::ErrorType: 'static,
{
    let size = picture.dimensions();
    let element = BitMapElement::with_owned_buffer(at, size, picture.into_raw());
    area.draw(&element.ok_or("picture buffer has another size")?)?;
    Ok(())
}
