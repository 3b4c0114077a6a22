//! Text in pictures: one font, registered in one place.

use std::sync::Once;

use image::{Rgb, RgbImage};
use plotters::prelude::{BitMapBackend, DrawingBackend, RGBColor, TextStyle};
use plotters::style::text_anchor::{HPos, Pos, VPos};
use plotters::style::{FontStyle, IntoFont, register_font};

/// Family under which the font is known to plotters.
pub const FAMILY: &str = "sans-serif";

/// Which end of the text lies at the given place.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Align {
    /// Text starts there.
    Left,
    /// Text is centred there.
    Centre,
    /// Text ends there.
    Right,
}

/// Makes DejaVu Sans known to plotters as [`FAMILY`]; call it before drawing charts. Only the first call does anything.
pub fn register() {
    static ONCE: Once = Once::new();
    ONCE.call_once(|| {
        for (style, bytes) in [(FontStyle::Normal, dejavu::sans::regular()), (FontStyle::Bold, dejavu::sans::bold())] {
            // The bytes are part of this program; a test draws text.
            let _ = register_font(FAMILY, style, bytes);
        }
    });
}

/// Draws one line of text with its upper edge at `at` (pixels right, down); `size` is its height in pixels.
///
/// Text beyond the picture is cut off.
pub fn draw(picture: &mut RgbImage, text: &str, at: (i32, i32), size: f64, color: Rgb<u8>, align: Align) {
    register();
    let dimensions = picture.dimensions();
    let horizontal = match align {
        Align::Left => HPos::Left,
        Align::Centre => HPos::Center,
        Align::Right => HPos::Right,
    };
    let Rgb([red, green, blue]) = color;
    let color = RGBColor(red, green, blue);
    let style = TextStyle::from((FAMILY, size).into_font()).pos(Pos::new(horizontal, VPos::Top)).color(&color);
    let mut backend = BitMapBackend::with_buffer(picture.as_mut(), dimensions);
    // Drawing into memory can't fail but for a font that isn't there, and it is.
    let _ = backend.draw_text(text, &style, at);
}

/// Width of a line of text in pixels.
pub fn width(text: &str, size: f64) -> u32 {
    register();
    (FAMILY, size).into_font().box_size(text).map_or(0, |(width, _)| width)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn text_leaves_ink_where_it_is_put() {
        let mut picture = RgbImage::from_pixel(120, 40, Rgb([255; 3]));
        draw(&mut picture, "force", (60, 10), 16.0, Rgb([0; 3]), Align::Left);
        let dark = |x: std::ops::Range<u32>| {
            x.flat_map(|x| (0..40).map(move |y| (x, y))).filter(|&(x, y)| picture.get_pixel(x, y).0[0] < 100).count()
        };
        assert_eq!(dark(0..58), 0);
        assert!(dark(60..60 + width("force", 16.0)) > 40);
    }

    #[test]
    fn text_beyond_the_picture_is_cut_off() {
        let mut picture = RgbImage::new(10, 10);
        draw(&mut picture, "a long line of text", (-40, -3), 16.0, Rgb([255; 3]), Align::Left);
    }
}
