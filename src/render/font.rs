//! Text in pictures.

use std::sync::Once;

use image::{Rgb, RgbImage};
use plotters::prelude::{BitMapBackend, DrawingBackend, RGBColor, TextStyle};
use plotters::style::text_anchor::{HPos, Pos, VPos};
use plotters::style::{FontStyle, IntoFont, register_font};

/// Font family that is registered with plotters.
pub const FAMILY: &str = "sans-serif";

/// Horizontal alignment of a text at a position.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Align {
    /// The text starts at the position.
    Left,
    /// The text is centred at the position.
    Centre,
    /// The text ends at the position.
    Right,
}

/// Registers DejaVu Sans with plotters as [`FAMILY`]. Required before drawing charts; repeated calls do nothing.
pub fn register() {
    static ONCE: Once = Once::new();
    ONCE.call_once(|| {
        for (style, bytes) in [(FontStyle::Normal, dejavu::sans::regular()), (FontStyle::Bold, dejavu::sans::bold())] {
            // The font is embedded in the program, and a test draws text, so this cannot fail at run time.
            let _ = register_font(FAMILY, style, bytes);
        }
    });
}

/// Draws a line of text with its upper edge at `at` (pixels to the right and down); `size` is its height in pixels.
///
/// Text beyond the picture is clipped.
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
    // Drawing into memory fails only if the font is missing, and it is registered above.
    let _ = backend.draw_text(text, &style, at);
}

/// Draws a line of text as [`draw`] does, in the first colour with a rim of the second one, which keeps it legible on any picture.
pub fn draw_on(
    picture: &mut RgbImage,
    text: &str,
    at: (i32, i32),
    size: f64,
    [color, rim]: [Rgb<u8>; 2],
    align: Align,
) {
    const RIM: [(i32, i32); 8] = [(-2, 0), (2, 0), (0, -2), (0, 2), (-1, -1), (1, -1), (-1, 1), (1, 1)];
    for (dx, dy) in RIM {
        draw(picture, text, (at.0 + dx, at.1 + dy), size, rim, align);
    }
    draw(picture, text, at, size, color, align);
}

/// Returns the width of a line of text, pixels.
pub fn width(text: &str, size: f64) -> u32 {
    register();
    (FAMILY, size).into_font().box_size(text).map_or(0, |(width, _)| width)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn text_starts_at_its_position() {
        let mut picture = RgbImage::from_pixel(120, 40, Rgb([255; 3]));
        draw(&mut picture, "force", (60, 10), 16.0, Rgb([0; 3]), Align::Left);
        let dark = |x: std::ops::Range<u32>| {
            x.flat_map(|x| (0..40).map(move |y| (x, y))).filter(|&(x, y)| picture.get_pixel(x, y).0[0] < 100).count()
        };
        assert_eq!(dark(0..58), 0);
        assert!(dark(60..60 + width("force", 16.0)) > 40);
    }

    #[test]
    fn text_on_a_dark_picture_has_a_light_rim() {
        let red = Rgb([255, 0, 0]);
        let [mut plain, mut ringed] = [Rgb([255; 3]), Rgb([0; 3])].map(|ground| RgbImage::from_pixel(120, 40, ground));
        draw(&mut plain, "force", (20, 10), 16.0, red, Align::Left);
        draw_on(&mut ringed, "force", (20, 10), 16.0, [red, Rgb([255; 3])], Align::Left);
        let letters =
            |picture: &RgbImage| picture.pixels().filter(|pixel| pixel.0[0] > 127 && pixel.0[1] < 128).count();
        assert!(letters(&plain) > 20 && letters(&ringed) >= letters(&plain));
        assert!(ringed.pixels().filter(|pixel| pixel.0[1] > 180).count() > 60);
    }

    #[test]
    fn text_beyond_the_picture_is_clipped() {
        let mut picture = RgbImage::new(10, 10);
        draw(&mut picture, "a long line of text", (-40, -3), 16.0, Rgb([255; 3]), Align::Left);
    }
}
