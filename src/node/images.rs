//! The images that a node takes, raw or compressed.

use ::image::RgbImage;
use r2r::QosProfile;

use super::params::{Allowed, Parameter, Parameters};
use super::runtime::Runtime;
use crate::error::Result;
use crate::image::{self, RawImage};
use crate::message::{CompressedImage, Header, Image, Message as _};

/// The parameter that says in which of the two forms they come.
pub fn transport() -> Parameter {
    Parameter::fixed(
        "image_transport",
        "raw",
        Allowed::OneOf(&["raw", "compressed"]),
        "Take sensor_msgs/Image on image, or sensor_msgs/CompressedImage (JPEG, PNG) on image/compressed.",
    )
}

/// The resolved topic that they come on.
pub fn topic(runtime: &Runtime) -> String {
    let image = runtime.resolve("image");
    match is_compressed(runtime.parameters()) {
        true => runtime.resolve(&format!("{image}/compressed")),
        false => image,
    }
}

/// Calls `call` with the bytes of each, for [`decode`].
///
/// # Errors
/// If ROS refuses the name or the quality of service.
pub fn subscribe(runtime: &mut Runtime, qos: QosProfile, call: impl FnMut(Vec<u8>) + 'static) -> anyhow::Result<()> {
    match is_compressed(runtime.parameters()) {
        true => runtime.subscribe_bytes::<CompressedImage>(&topic(runtime), qos, call),
        false => runtime.subscribe_bytes::<Image>("image", qos, call),
    }
}

/// The picture in a message's bytes.
///
/// # Errors
/// If they are no such message, or hold no picture in a known encoding.
pub fn decode(payload: &[u8], parameters: &Parameters) -> Result<(Header, RgbImage)> {
    if is_compressed(parameters) {
        let CompressedImage { header, data, .. } = CompressedImage::from_cdr(payload)?;
        return Ok((header, image::decode(&data)?));
    }
    let Image { header, height, width, encoding, step, data, .. } = Image::from_cdr(payload)?;
    let raw = RawImage { width, height, encoding: &encoding, step, data: &data };
    let image = raw.to_rgb()?;
    Ok((header, image))
}

fn is_compressed(parameters: &Parameters) -> bool {
    parameters.get::<String>("image_transport") == "compressed"
}
