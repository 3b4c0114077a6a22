//! Image subscription of a node, raw or compressed.

use std::borrow::Cow;

use ::image::RgbImage;
use anyhow::Context as _;

use super::input_topics::InputTopic;
use super::params::{Allowed, Parameter, Parameters};
use super::runtime::Runtime;
use crate::error::Result;
use crate::image::{self, RawImage};
use crate::message::{CompressedImage, Header, Image, Message as _, Reader};

/// JPEG quality of compressed images, 0 to 100; high, so that compression changes the image little.
const JPEG_QUALITY: u8 = 90;

/// Message type of the images, set by the parameter `image_transport`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum ImageTransport {
    /// `sensor_msgs/Image` on `image`.
    Raw,
    /// `sensor_msgs/CompressedImage` on the resolved topic `image` followed by `/compressed`.
    Compressed,
}

impl ImageTransport {
    /// Declares the parameter `image_transport`.
    pub(crate) fn parameter() -> Parameter {
        Parameter::fixed(
            "image_transport",
            "raw",
            Allowed::OneOf(&["raw", "compressed"]),
            "raw: take sensor_msgs/Image on image; compressed: take sensor_msgs/CompressedImage (JPEG or PNG) on \
             image/compressed.",
        )
    }

    /// Reads the parameter `image_transport`.
    pub(crate) fn of(parameters: &Parameters) -> Self {
        match parameters.get::<String>("image_transport").as_str() {
            "compressed" => Self::Compressed,
            _ => Self::Raw,
        }
    }

    /// Returns the full name of the topic that images on `name` (relative, private or absolute; remappable) come on.
    pub(crate) fn topic(self, runtime: &Runtime, name: &str) -> String {
        let image = runtime.resolve(name);
        match self {
            Self::Raw => image,
            Self::Compressed => runtime.resolve(&format!("{image}/compressed")),
        }
    }

    /// Subscribes to the images of the topic that `input` names, and calls `call` with the bytes of each message, for
    /// [`Self::decode`].
    ///
    /// # Errors
    /// If ROS refuses the topic name or the quality of service.
    pub(crate) fn subscribe(
        self,
        runtime: &mut Runtime,
        input: InputTopic,
        call: impl FnMut(Vec<u8>) + 'static,
    ) -> anyhow::Result<()> {
        match self {
            Self::Raw => runtime.input_bytes::<Image>(input, call),
            Self::Compressed => {
                let name = self.topic(runtime, &input.name);
                runtime.input_bytes::<CompressedImage>(InputTopic { name, ..input }, call)
            }
        }
    }

    /// Reads only the header of a message.
    ///
    /// # Errors
    /// If the bytes are not a message of this type.
    pub(crate) fn header(self, payload: &[u8]) -> Result<Header> {
        match self {
            Self::Raw => Reader::leading(Image::TYPE, payload),
            Self::Compressed => Reader::leading(CompressedImage::TYPE, payload),
        }
    }

    /// Decodes the header and the pixels of a message.
    ///
    /// # Errors
    /// If the bytes are not this message, or its image has an unknown encoding or contradicts itself.
    pub(crate) fn decode(self, payload: &[u8]) -> Result<(Header, RgbImage)> {
        self.decode_in(payload, Vec::new())
    }

    /// As [`Self::decode`]; raw images in the memory of `spare`, whose content is lost.
    ///
    /// # Errors
    /// As [`Self::decode`].
    pub(crate) fn decode_in(self, payload: &[u8], spare: Vec<u8>) -> Result<(Header, RgbImage)> {
        match self {
            Self::Raw => decode_raw(payload, spare),
            Self::Compressed => {
                let CompressedImage { header, format, data } = CompressedImage::from_cdr(payload)?;
                // For instance `bayer_rggb8; jpeg compressed`: the first part is the encoding before compression.
                let encoding = format.split(';').next().unwrap_or_default().trim();
                Ok((header, image::decode_as(&data, encoding)?))
            }
        }
    }
}

/// Decodes a `sensor_msgs/Image`, whose pixels are read where they are in the payload.
fn decode_raw(payload: &[u8], spare: Vec<u8>) -> Result<(Header, RgbImage)> {
    Reader::whole(Image::TYPE, payload, |message| {
        let header = message.field("header")?;
        let (height, width) = (message.field("height")?, message.field("width")?);
        let encoding: String = message.field("encoding")?;
        let (is_bigendian, step) = (message.field::<u8>("is_bigendian")?, message.field("step")?);
        let mut data = Cow::Borrowed(message.bytes("data")?);
        if is_bigendian != 0 && image::has_16_bits(&encoding) {
            data.to_mut().chunks_exact_mut(2).for_each(|value| value.swap(0, 1));
        }
        let raw = RawImage { width, height, encoding: &encoding, step, data: &data };
        Ok((header, raw.to_rgb_in(spare)?))
    })
}

/// Compresses an image.
///
/// # Errors
/// If the image has no pixels or is too large for JPEG.
pub(crate) fn jpeg(header: Header, picture: &RgbImage) -> anyhow::Result<CompressedImage> {
    let data = image::jpeg(picture, JPEG_QUALITY).context("cannot compress the image")?;
    Ok(CompressedImage { header, format: "rgb8; jpeg compressed bgr8".to_owned(), data })
}
