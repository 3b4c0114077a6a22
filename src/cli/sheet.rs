//! Draws the picture of a demo: three panels side by side, a colour bar below them, and two forces over time.

use std::path::Path;

use image::RgbImage;
use image::imageops::{FilterType, resize};
use plotters::coord::Shift;
use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};

use crate::error::Result;
use crate::render;
use crate::render::figure::{self, Drawn, Figure};
use crate::render::font::FAMILY;
use crate::render::plot::{self, LABEL};

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
    /// Lines below the last panel, at most two.
    pub note: Vec<String>,
    /// Label of the force axis.
    pub axis: &'a str,
    pub series: [Series; 2],
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
pub struct Series {
    pub name: String,
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
        for (index, line) in self.note.iter().enumerate() {
            let at = (LEFT + 2 * PITCH, UPPER as i32 - 46 + 22 * index as i32);
            upper.draw(&Text::new(line.as_str(), at, (FAMILY, 16)))?;
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
        let keys: Vec<(&str, RGBColor)> =
            self.series.iter().map(|series| (series.name.as_str(), series.color)).collect();
        let body = plot::head(area, "", &keys)?;
        let points = || self.series.iter().flat_map(|series| &series.points);
        let end = points().map(|point| point.0).fold(1e-3, f64::max);
        // Forces far below a newton look small.
        let peak = 1.1 * points().map(|point| point.1).fold(0.5, f64::max);
        let mut chart = plot::chart(&body, "", [60, 80]).build_cartesian_2d(0.0..end, 0.0..peak)?;
        let [seconds, newtons] = [end, peak].map(|most| usize::from(most < 8.0));
        plot::axes(
            &mut chart,
            ("time, s", &|x| format!("{x:.seconds$}")),
            (self.axis, &|y| format!("{y:.newtons$}")),
            [10, 6],
        )?;
        chart.draw_series(LineSeries::new([(self.shown, 0.0), (self.shown, peak)], BLACK.mix(0.5)))?;
        let (side, away) = if self.shown > 0.8 * end { (HPos::Right, -6) } else { (HPos::Left, 6) };
        let grey = BLACK.mix(0.7);
        let style = TextStyle::from((FAMILY, LABEL)).color(&grey).pos(Pos::new(side, VPos::Top));
        chart.draw_series([EmptyElement::at((self.shown, peak)) + Text::new("shown above", (away, 2), style)])?;
        for series in &self.series {
            chart.draw_series(LineSeries::new(series.points.iter().copied(), series.color.stroke_width(2)))?;
        }
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
