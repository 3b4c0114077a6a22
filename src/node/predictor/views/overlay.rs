//! Topic `~/overlay/compressed`: the image with both hands beside it, coloured by force.

use ::image::imageops::{FilterType, overlay, resize};
use ::image::{Rgb, RgbImage};

use crate::hand::{HandModel, HandParams, PosedHand};
use crate::message::{CompressedImage, Header};
use crate::node::images::jpeg;
use crate::node::publisher::Publisher;
use crate::node::qos;
use crate::node::runtime::Runtime;
use crate::render::color::{INK, PAPER};
use crate::render::font::{self, Align};
use crate::render::{View, color_bar, force_colors, hand_picture};
use crate::tactile::TactileField;

use crate::render::color::MAX_COLOR_FORCE;

/// Height of the picture, pixels.
const HEIGHT: u32 = 360;
/// Width of a hand, pixels.
const HAND: u32 = 200;
/// Height of the colour bar below the hands, pixels.
const BAR: u32 = 60;
/// Height of the line above each hand, pixels.
const TITLE: u32 = 28;

/// Publishes the picture.
pub(super) struct Overlay {
    publisher: Publisher<CompressedImage>,
    /// Both hands at rest, left first.
    posed: [PosedHand; 2],
}

impl Overlay {
    /// Creates the publisher of pictures of `models`, left first, on `topic`.
    ///
    /// # Errors
    /// If ROS refuses the topic.
    pub(super) fn create(runtime: &mut Runtime, topic: &str, models: &[HandModel; 2]) -> anyhow::Result<Self> {
        let posed = models.each_ref().map(|model| model.forward(&HandParams::default()));
        Ok(Self { publisher: runtime.publisher(topic, qos::output())?, posed })
    }

    /// Publishes the picture of `image` and its touch if the topic has a subscriber.
    ///
    /// # Errors
    /// If the node is gone or the middleware refuses the message.
    pub(super) fn publish(
        &self,
        header: &Header,
        field: &TactileField,
        image: &RgbImage,
        models: &[HandModel; 2],
    ) -> anyhow::Result<()> {
        match self.publisher.subscriber_count() {
            0 => Ok(()),
            _ => self.publisher.publish(&jpeg(header.clone(), &self.picture(field, image, models))?),
        }
    }

    /// Draws the image on the left, then the palms of the left and the right hand with their total forces.
    fn picture(&self, field: &TactileField, image: &RgbImage, models: &[HandModel; 2]) -> RgbImage {
        let width = (u64::from(image.width()) * u64::from(HEIGHT) / u64::from(image.height().max(1))).clamp(1, 1280);
        let seen = resize(image, width as u32, HEIGHT, FilterType::Triangle);
        let mut picture = RgbImage::from_pixel(seen.width() + 2 * HAND, HEIGHT, PAPER);
        overlay(&mut picture, &seen, 0, 0);
        for (side, (model, posed)) in models.iter().zip(&self.posed).enumerate() {
            let left = seen.width() + side as u32 * HAND;
            let colors: Vec<Rgb<u8>> = force_colors(&field.force[model.side.range()], MAX_COLOR_FORCE);
            let hand = hand_picture(model, posed, &colors, View::Palmar, (HAND, HEIGHT - BAR - TITLE));
            overlay(&mut picture, &hand, i64::from(left), i64::from(TITLE));
            let total = field.total_force(model.side);
            let line = match total.is_nan() {
                true => format!("{}: unknown", model.side.name()),
                false => format!("{}: {total:.1} N", model.side.name()),
            };
            let at = ((left + HAND / 2) as i32, 8);
            font::draw(&mut picture, &line, at, 16.0, INK, Align::Centre);
        }
        let bar = color_bar(MAX_COLOR_FORCE, "force on a vertex", (2 * HAND, BAR));
        overlay(&mut picture, &bar, i64::from(seen.width()), i64::from(HEIGHT - BAR));
        picture
    }
}
