//! Squares around hands, for networks that see one hand at a time.

use ::image::{RgbImage, imageops};
use serde::{Deserialize, Serialize};

use super::{Filter, convolved, image_view};
use crate::error::Result;

/// Side of the square relative to the extent of the keypoints: room for the flesh around them and for the touched object.
const MARGIN: f64 = 1.6;
/// Least side of the square, as a share of the picture's longer side.
const MIN_SIDE: f64 = 0.1;

/// Part of the world that the pictures of a network show.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Framing {
    /// Whole pictures, with both hands.
    #[default]
    #[serde(rename = "frame")]
    Whole,
    /// Squares around one hand each, a left hand mirrored. Touch is that of a right hand.
    Hands,
}

impl Framing {
    /// Name of the attribute of stores and of the key of checkpoints; absent = [`Framing::Whole`].
    pub const KEY: &'static str = "input";

    /// Name: `frame` or `hands`.
    pub fn name(self) -> &'static str {
        match self {
            Self::Whole => "frame",
            Self::Hands => "hands",
        }
    }

    /// True for whole pictures.
    pub fn is_whole(&self) -> bool {
        *self == Self::Whole
    }
}

/// A square of a picture, pixels; it may reach beyond the edges.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Square {
    /// Centre: x to the right, y down.
    pub centre: [f64; 2],
    /// Half of the side.
    pub half: f64,
}

impl Square {
    /// Returns the square around the `keypoints` of a hand in a picture of this size, with room around them; None without a point
    /// whose position is known, or if all lie beyond one edge.
    pub fn around_hand(keypoints: impl IntoIterator<Item = [f64; 2]>, width: u32, height: u32) -> Option<Self> {
        let (mut low, mut high) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
        for point in keypoints.into_iter().filter(|point| point.iter().all(|x| x.is_finite())) {
            for axis in 0..2 {
                low[axis] = low[axis].min(point[axis]);
                high[axis] = high[axis].max(point[axis]);
            }
        }
        let sides = [f64::from(width), f64::from(height)];
        let long = sides[0].max(sides[1]);
        let extent = (high[0] - low[0]).max(high[1] - low[1]);
        let outside = (0..2).any(|axis| low[axis] > sides[axis] || high[axis] < 0.0);
        let side = (MARGIN * extent).clamp(MIN_SIDE * long, long);
        let centre = [0, 1].map(|axis| 0.5 * (low[axis] + high[axis]));
        (extent.is_finite() && !outside).then_some(Self { centre, half: 0.5 * side })
    }

    /// Cuts the square out of a picture and scales it to `side` x `side` pixels, black beyond the picture's edges; `mirrored` swaps
    /// left and right.
    ///
    /// # Errors
    /// If the picture or `side` is empty.
    pub fn cut(&self, image: &RgbImage, side: u32, mirrored: bool) -> Result<RgbImage> {
        let view = image_view(image)?;
        let scale = f64::from(side) / (2.0 * self.half);
        // Along each axis: begin and length of the part within the picture, pixels, and where it comes to lie in the output.
        let part = |size: u32, centre: f64| {
            let corner = centre - self.half;
            let (begin, end) = (corner.max(0.0), (corner + 2.0 * self.half).min(size.into()));
            let [from, to] = [begin, end].map(|at| ((at - corner) * scale).round() as u32);
            (begin, end - begin, from, to.min(side).saturating_sub(from))
        };
        let ((left, width, column, columns), (top, height, row, rows)) =
            (part(image.width(), self.centre[0]), part(image.height(), self.centre[1]));
        let mut out = RgbImage::new(side, side);
        if width > 0.0 && height > 0.0 && columns > 0 && rows > 0 {
            let seen = convolved(&view, (columns, rows), Some([left, top, width, height]), Filter::Triangle)?;
            imageops::replace(&mut out, &seen, column.into(), row.into());
        }
        if mirrored {
            imageops::flip_horizontal_in_place(&mut out);
        }
        Ok(out)
    }
}

#[cfg(test)]
mod tests {
    use ::image::Rgb;

    use super::*;

    #[test]
    fn the_square_of_a_whole_picture_is_the_picture() {
        let image = RgbImage::from_fn(8, 8, |x, y| Rgb([30 * x as u8, 30 * y as u8, 7]));
        let whole = Square { centre: [4.0; 2], half: 4.0 };
        assert_eq!(whole.cut(&image, 8, false).unwrap(), image);
        let mirrored = whole.cut(&image, 8, true).unwrap();
        assert!((0..8).all(|x| mirrored.get_pixel(x, 3) == image.get_pixel(7 - x, 3)));
        // A quarter of the picture, at the upper left, and black beyond its edge.
        let corner = Square { centre: [2.0; 2], half: 2.0 }.cut(&image, 4, false).unwrap();
        assert!((0..4).all(|x| corner.get_pixel(x, 2) == image.get_pixel(x, 2)));
        let beyond = Square { centre: [-4.0, 4.0], half: 2.0 };
        assert_eq!(beyond.cut(&image, 4, false).unwrap(), RgbImage::new(4, 4));
        let half = Square { centre: [0.0, 4.0], half: 2.0 }.cut(&image, 4, false).unwrap();
        assert!(
            (0..4).all(|y| half.get_pixel(1, y) == &Rgb([0; 3]) && half.get_pixel(2, y) == image.get_pixel(0, y + 2))
        );
    }

    #[test]
    fn the_square_surrounds_the_hand_with_room() {
        let points = [[400.0, 100.0], [f64::NAN; 2], [600.0, 150.0]];
        let square = Square::around_hand(points, 1000, 500).unwrap();
        assert_eq!((square.centre, square.half), ([500.0, 125.0], 160.0));
        // A hand far away still has a square of some size, and one beyond the edge has none.
        assert_eq!(Square::around_hand([[500.0, 250.0]], 1000, 500).unwrap().half, 50.0);
        assert_eq!(Square::around_hand([[1001.0, 250.0]], 1000, 500), None);
        assert_eq!(Square::around_hand([[f64::NAN; 2]], 1000, 500), None);
    }
}
