//! One picture of an image and its touch: the image, and both hands beside it, coloured by force.

use ::image::imageops::{FilterType, overlay, resize};
use ::image::{Rgb, RgbImage};

use super::moment::Moment;
use crate::hand::{HandModel, HandParams, Side};
use crate::render::color::{INK, PAPER, force_color};
use crate::render::font::{self, Align};
use crate::render::{View, color_bar, force_colors, hand_picture};
use crate::tactile::{CONTACT_FORCE_N, TactileField};

/// Width of a hand relative to the height of the picture.
const HAND: f64 = 0.55;
/// Height of the colour bar below the hands, pixels.
const BAR: u32 = 60;
/// Height of the line above each hand, pixels.
const TITLE: u32 = 28;
/// Height of the line of text below the image, pixels.
const NOTE: u32 = 26;
/// Largest width of the image, pixels.
const MAX_WIDTH: u32 = 1280;
/// Share of the colour of a touched vertex on the image; the rest is the image.
const OPACITY: f32 = 0.75;

/// Drawer of pictures of one source.
#[derive(Debug, Clone)]
pub struct Picture {
    hands: [HandModel; 2],
    /// Force at the dark end of the colours, N.
    scale: f32,
    /// Height of the picture, pixels.
    height: u32,
}

impl Picture {
    /// Creates the drawer of touch on these hands, left first; `scale` is the force at the dark end of the colours, N, `height` the
    /// height of the pictures, pixels.
    pub fn new(hands: [HandModel; 2], scale: f32, height: u32) -> Self {
        Self { hands, scale, height: height.max(BAR + 2 * TITLE + NOTE + 2) }
    }

    /// Draws the image on the left, then the palms of the left and the right hand with their total forces; those of the truth below
    /// them.
    pub fn draw(&self, moment: &Moment) -> RgbImage {
        let hand_width = (HAND * f64::from(self.height)) as u32;
        let seen = self.image(moment);
        let mut picture = RgbImage::from_pixel(seen.width() + 2 * hand_width, self.height, PAPER);
        overlay(&mut picture, &seen, 0, 0);
        let rows: Vec<(&str, &TactileField)> = match &moment.truth {
            Some(truth) => vec![("", &moment.touch), ("truth, ", truth)],
            None => vec![("", &moment.touch)],
        };
        let height = (self.height - BAR) / rows.len() as u32;
        for (row, (name, field)) in rows.into_iter().enumerate() {
            for side in Side::BOTH {
                let at = (seen.width() + side as u32 * hand_width, row as u32 * height);
                let (model, params) = (&self.hands[side as usize], moment.hands[side as usize].as_ref());
                let posed = model.forward(params.unwrap_or(&HandParams::default()));
                let colors: Vec<Rgb<u8>> = force_colors(&field.force[side.range()], self.scale);
                let size = (hand_width, height.saturating_sub(TITLE).max(1));
                let hand = hand_picture(model, &posed, &colors, View::Palmar, size);
                overlay(&mut picture, &hand, i64::from(at.0), i64::from(at.1 + TITLE));
                let total = field.total_force(side);
                let line = match total.is_nan() {
                    true => format!("{name}{}: unknown", side.name()),
                    false => format!("{name}{}: {total:.1} N", side.name()),
                };
                let at = ((at.0 + hand_width / 2) as i32, (at.1 + 8) as i32);
                font::draw(&mut picture, &line, at, 16.0, INK, Align::Centre);
            }
        }
        let bar = color_bar(self.scale, "force on a vertex", (2 * hand_width, BAR));
        overlay(&mut picture, &bar, i64::from(seen.width()), i64::from(self.height - BAR));
        picture
    }

    /// Draws the image in the height of the picture, with the touched vertices where the camera sees them, and a line on what is
    /// known.
    fn image(&self, moment: &Moment) -> RgbImage {
        let Ok(image) = &moment.image else {
            let mut empty = RgbImage::from_pixel(self.height * 4 / 3, self.height, Rgb([230; 3]));
            let at = ((empty.width() / 2) as i32, (self.height / 2) as i32);
            font::draw(&mut empty, "this image can't be read", at, 16.0, INK, Align::Centre);
            return empty;
        };
        let width = u64::from(image.width()) * u64::from(self.height) / u64::from(image.height().max(1));
        let width = (width.clamp(1, u64::from(MAX_WIDTH))) as u32;
        let mut seen = resize(image, width, self.height, FilterType::Triangle);
        self.dots(&mut seen, moment);
        if !moment.reason.is_empty() {
            let line = format!("unknown: {}", moment.reason);
            for (x, y) in (0..width).flat_map(|x| (self.height - NOTE..self.height).map(move |y| (x, y))) {
                blend(&mut seen, (x, y), PAPER, 0.85);
            }
            font::draw(&mut seen, &line, (8, (self.height - NOTE + 5) as i32), 15.0, INK, Align::Left);
        }
        seen
    }

    /// Marks the touched vertices of hands whose pose and camera are known.
    fn dots(&self, seen: &mut RgbImage, moment: &Moment) {
        let Some(sight) = &moment.sight else { return };
        let (width, height) = seen.dimensions();
        let radius = (self.height as i32 / 160).max(1);
        for side in Side::BOTH {
            let Some(params) = &moment.hands[side as usize] else { continue };
            let posed = self.hands[side as usize].forward(params);
            let force = &moment.touch.force[side.range()];
            for (vertex, force) in posed.vertices.iter().zip(force).filter(|(_, force)| **force > CONTACT_FORCE_N) {
                let [x, y, _] = sight.of(*vertex);
                if x.is_nan() {
                    continue;
                }
                let centre = (0.5 * (x + 1.0) * width as f32, 0.5 * (1.0 - y) * height as f32);
                let around = (-radius..=radius).flat_map(|dx| (-radius..=radius).map(move |dy| (dx, dy)));
                for (dx, dy) in around.filter(|(dx, dy)| dx * dx + dy * dy <= radius * radius) {
                    let at = (centre.0 as i32 + dx, centre.1 as i32 + dy);
                    if let (Ok(x), Ok(y)) = (u32::try_from(at.0), u32::try_from(at.1))
                        && x < width
                        && y < height
                    {
                        blend(seen, (x, y), force_color(*force, self.scale), OPACITY);
                    }
                }
            }
        }
    }
}

/// Mixes a colour into a pixel.
fn blend(picture: &mut RgbImage, (x, y): (u32, u32), Rgb(color): Rgb<u8>, share: f32) {
    let Rgb(below) = *picture.get_pixel(x, y);
    let mixed = std::array::from_fn(|i| (f32::from(below[i]) * (1.0 - share) + f32::from(color[i]) * share) as u8);
    picture.put_pixel(x, y, Rgb(mixed));
}
