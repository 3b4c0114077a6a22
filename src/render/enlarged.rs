//! A backend for plots that enlarges them: edges become smooth when the picture is reduced again.

use plotters::prelude::DrawingBackend;
use plotters::style::{Color as _, FontDesc, RGBAColor, TextStyle};
use plotters_backend::{BackendColor, BackendCoord, BackendStyle, BackendTextStyle, DrawingErrorKind};

/// Factor of all lengths.
pub(super) const SCALE: u32 = 3;

/// Draws on a backend that is [`SCALE`] times as wide and as high.
pub(super) struct Enlarged<B>(pub B);

/// A style whose lines are as many times as thick.
struct Thick<'a, S>(&'a S);

impl<S: BackendStyle> BackendStyle for Thick<'_, S> {
    fn color(&self) -> BackendColor {
        self.0.color()
    }

    fn stroke_width(&self) -> u32 {
        SCALE * self.0.stroke_width()
    }
}

/// Returns the middle of the pixel at a place.
fn middle((x, y): BackendCoord) -> BackendCoord {
    let scale = SCALE as i32;
    (scale * x + scale / 2, scale * y + scale / 2)
}

impl<B: DrawingBackend> DrawingBackend for Enlarged<B> {
    type ErrorType = B::ErrorType;

    fn get_size(&self) -> (u32, u32) {
        let (width, height) = self.0.get_size();
        (width / SCALE, height / SCALE)
    }

    fn ensure_prepared(&mut self) -> Result<(), DrawingErrorKind<B::ErrorType>> {
        self.0.ensure_prepared()
    }

    fn present(&mut self) -> Result<(), DrawingErrorKind<B::ErrorType>> {
        self.0.present()
    }

    fn draw_pixel(&mut self, (x, y): BackendCoord, color: BackendColor) -> Result<(), DrawingErrorKind<B::ErrorType>> {
        let BackendColor { alpha, rgb: (red, green, blue) } = color;
        let style = RGBAColor(red, green, blue, alpha).filled();
        self.draw_rect((x, y), (x + 1, y + 1), &style, true)
    }

    fn draw_line<S: BackendStyle>(
        &mut self,
        from: BackendCoord,
        to: BackendCoord,
        style: &S,
    ) -> Result<(), DrawingErrorKind<B::ErrorType>> {
        self.0.draw_path([middle(from), middle(to)], &Thick(style))
    }

    fn draw_rect<S: BackendStyle>(
        &mut self,
        (left, top): BackendCoord,
        (right, bottom): BackendCoord,
        style: &S,
        fill: bool,
    ) -> Result<(), DrawingErrorKind<B::ErrorType>> {
        if fill {
            // As in the pictures and in SVG, the pixel of the second corner lies outside.
            let scale = SCALE as i32;
            return self.0.draw_rect((scale * left, scale * top), (scale * right, scale * bottom), style, true);
        }
        let corners = [(left, top), (right, top), (right, bottom), (left, bottom), (left, top)];
        corners.windows(2).try_for_each(|ends| self.draw_line(ends[0], ends[1], style))
    }

    fn draw_path<S: BackendStyle, I: IntoIterator<Item = BackendCoord>>(
        &mut self,
        path: I,
        style: &S,
    ) -> Result<(), DrawingErrorKind<B::ErrorType>> {
        self.0.draw_path(path.into_iter().map(middle), &Thick(style))
    }

    fn draw_circle<S: BackendStyle>(
        &mut self,
        center: BackendCoord,
        radius: u32,
        style: &S,
        fill: bool,
    ) -> Result<(), DrawingErrorKind<B::ErrorType>> {
        self.0.draw_circle(middle(center), SCALE * radius + SCALE / 2, &Thick(style), fill)
    }

    fn fill_polygon<S: BackendStyle, I: IntoIterator<Item = BackendCoord>>(
        &mut self,
        corners: I,
        style: &S,
    ) -> Result<(), DrawingErrorKind<B::ErrorType>> {
        self.0.fill_polygon(corners.into_iter().map(middle), style)
    }

    fn draw_text<S: BackendTextStyle>(
        &mut self,
        text: &str,
        style: &S,
        (x, y): BackendCoord,
    ) -> Result<(), DrawingErrorKind<B::ErrorType>> {
        let BackendColor { alpha, rgb: (red, green, blue) } = style.color();
        let family = style.family();
        let font = FontDesc::new(family, f64::from(SCALE) * style.size(), style.style()).transform(style.transform());
        let color = RGBAColor(red, green, blue, alpha);
        let large = TextStyle::from(font).color(&color).pos(style.anchor());
        self.0.draw_text(text, &large, (SCALE as i32 * x, SCALE as i32 * y))
    }
}

#[cfg(test)]
mod tests {
    use image::{Rgb, RgbImage, imageops};
    use plotters::prelude::{BLACK, BitMapBackend, Circle, Color as _, IntoDrawingArea, PathElement, Rectangle, WHITE};

    use super::{Enlarged, SCALE};

    #[test]
    fn shapes_keep_their_places_and_sizes_and_edges_become_smooth() {
        let (width, height) = (60, 40);
        let large = (SCALE * width, SCALE * height);
        let mut picture = RgbImage::new(large.0, large.1);
        {
            let root = Enlarged(BitMapBackend::with_buffer(picture.as_mut(), large)).into_drawing_area();
            assert_eq!(root.dim_in_pixel(), (width, height));
            root.fill(&WHITE).unwrap();
            root.draw(&Rectangle::new([(5, 5), (10, 15)], BLACK.filled())).unwrap();
            root.draw(&Circle::new((40, 20), 6, BLACK.filled())).unwrap();
            root.draw(&PathElement::new([(20, 2), (20, 36)], BLACK.stroke_width(1))).unwrap();
        }
        let picture: RgbImage = imageops::thumbnail(&picture, width, height);
        assert_eq!(picture.get_pixel(width - 1, height - 1), &Rgb([255; 3]), "the ground reaches the last pixel");
        let dark = |x: u32, y: u32| picture.get_pixel(x, y).0[0] < 100;
        for (x, y) in (0..16).flat_map(|x| (0..20).map(move |y| (x, y))) {
            assert_eq!(dark(x, y), (5..=9).contains(&x) && (5..=14).contains(&y), "{x} {y}");
        }
        assert!(dark(20, 20) && !dark(19, 20) && !dark(21, 20), "a line of one pixel");
        let area: f64 = (30..50)
            .flat_map(|x| (10..30).map(move |y| (x, y)))
            .map(|(x, y)| 1.0 - f64::from(picture.get_pixel(x, y).0[0]) / 255.0)
            .sum();
        let want = std::f64::consts::PI * 6.5f64.powi(2);
        assert!((area / want - 1.0).abs() < 0.1, "a disc of {area} for {want} pixels");
        assert!(picture.pixels().any(|&Rgb([value, ..])| (60..200).contains(&value)), "no smooth edge");
    }
}
