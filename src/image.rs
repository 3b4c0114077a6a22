//! Preparation of images for the network: decode, resize, normalise.

mod bayer;
mod crop;
#[doc(hidden)]
pub mod procedural;
mod raw;
pub mod rectify;

use std::borrow::Cow;
use std::io::Cursor;

use ::image::codecs::jpeg::JpegEncoder;
use ::image::{DynamicImage, ImageBuffer, ImageDecoder, ImageReader, Limits, Rgb, RgbImage};
use fast_image_resize as fir;
use fir::images::{TypedImage, TypedImageRef};
use fir::pixels::U8x3;
use serde::{Deserialize, Serialize};

use crate::error::{Error, Result};
use crate::file::limits;

pub use crop::{Framing, Square};
pub use raw::{ENCODINGS, RawImage, has_16_bits, is_bayer};

/// Longest accepted side of an image, pixels; bounds the memory that a damaged or hostile file can ask for.
pub(crate) const MAX_SIDE: u32 = 16_384;
/// ImageNet's mean per RGB channel, for values in 0..1.
pub const IMAGENET_MEAN: [f32; 3] = [0.485, 0.456, 0.406];
/// ImageNet's standard deviation per RGB channel, for values in 0..1.
pub const IMAGENET_STD: [f32; 3] = [0.229, 0.224, 0.225];

/// First bytes of a PNG file.
const PNG: &[u8] = b"\x89PNG\r\n\x1a\n";
/// Part of the shorter side that [`Resize::Centre`] keeps: 224 of 256 pixels.
const CENTRE: f64 = 7.0 / 8.0;

/// Share of a picture outside of the network's view above which people are warned.
const HIDDEN_SHARE: f64 = 0.1;

/// Conversion of an image of any size to the square input.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Resize {
    /// Scales the shorter side to the input size, and crops the centre.
    #[default]
    Crop,
    /// Scales the shorter side to 8/7 of the input size (256 for 224), and crops the centre, as published DINOv2 checkpoints
    /// expect.
    Centre,
    /// Scales the longer side to the input size, and adds black bars.
    Letterbox,
    /// Scales both sides to the input size.
    Squash,
}

impl Resize {
    /// Name, as in metadata.
    pub fn name(self) -> &'static str {
        match self {
            Resize::Crop => "crop",
            Resize::Centre => "centre",
            Resize::Letterbox => "letterbox",
            Resize::Squash => "squash",
        }
    }
}

/// Resampling filter; its support grows with the scale when shrinking (antialiasing).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Filter {
    /// Linear.
    #[default]
    Triangle,
    /// Cubic, Keys' kernel with a = -0.5 (Catmull-Rom).
    Bicubic,
}

/// Parameters of the conversion from an image of any size to the network's input.
#[derive(Debug, Clone, PartialEq)]
pub struct Preparation {
    /// Side of the square input, pixels.
    pub side: usize,
    /// Conversion to a square.
    pub resize: Resize,
    /// Resampling filter.
    pub filter: Filter,
    /// Mean per RGB channel, for values in 0..1.
    pub mean: [f32; 3],
    /// Standard deviation per RGB channel, for values in 0..1.
    pub std: [f32; 3],
}

impl Preparation {
    /// Resizes and normalises an image. Returns `(3, side, side)`, row-major, channels red, green, blue.
    ///
    /// # Errors
    /// If the image is empty, or mean or deviation would give values that are not finite.
    pub fn apply(&self, image: &RgbImage) -> Result<Vec<f32>> {
        self.apply_view(&image_view(image)?)
    }

    /// As [`Preparation::apply`], for pixels of another owner: `(height, width, 3)` bytes, row by row, channels red, green, blue.
    ///
    /// # Errors
    /// As [`Preparation::apply`], and if the number of bytes is another one.
    pub fn apply_pixels(&self, pixels: &[u8], width: u32, height: u32) -> Result<Vec<f32>> {
        self.apply_view(&view(pixels, width, height)?)
    }

    fn apply_view(&self, image: &View) -> Result<Vec<f32>> {
        if let Some(mean) = self.mean.iter().find(|mean| !mean.is_finite()) {
            return Err(Error::value("mean", "finite numbers", mean));
        }
        if let Some(std) = self.std.iter().find(|std| !(std.is_normal() && **std > 0.0)) {
            return Err(Error::value("std", "positive numbers", std));
        }
        let square = resize_view(image, self.side, self.resize, self.filter)?;
        Ok(normalise(&square, self.mean, self.std))
    }

    /// Returns the share of a picture of this size that lies outside of the input, 0 to 1.
    pub fn hidden_share(&self, width: usize, height: usize) -> f64 {
        let (from, to) = (self.pixel([0.0; 2], width, height), self.pixel([1.0; 2], width, height));
        let seen = |axis: usize, side: usize| (to[axis].min(side as f64) - from[axis].max(0.0)) / side as f64;
        1.0 - seen(0, width) * seen(1, height)
    }

    /// Returns a warning for people if more than a tenth of a picture of this size lies outside of the input.
    pub fn warning(&self, width: usize, height: usize) -> Option<String> {
        let hidden = self.hidden_share(width, height);
        (hidden > HIDDEN_SHARE).then(|| {
            format!(
                "{:.0} % of the picture ({width} x {height}) lies outside of the network's view ({}), and hands there are not \
                 seen; the view letterbox takes in the whole picture",
                100.0 * hidden,
                self.resize.name()
            )
        })
    }

    /// Returns the position in the input of `pixel` of an image of this size, as a fraction of the input's side, x to the
    /// right, y down; outside of 0..1 if the pixel is cropped.
    pub fn place(&self, pixel: [f64; 2], width: usize, height: usize) -> [f64; 2] {
        let sides = [width as f64, height as f64];
        let (short, long) = (sides[0].min(sides[1]), sides[0].max(sides[1]));
        std::array::from_fn(|axis| match self.resize {
            Resize::Centre => 0.5 + (pixel[axis] - 0.5 * sides[axis]) / (CENTRE * short),
            Resize::Crop => 0.5 + (pixel[axis] - 0.5 * sides[axis]) / short,
            Resize::Letterbox => 0.5 + (pixel[axis] - 0.5 * sides[axis]) / long,
            Resize::Squash => pixel[axis] / sides[axis],
        })
    }

    /// Returns the pixel of an image of this size at a position in the input; the inverse of [`Preparation::place`].
    pub fn pixel(&self, place: [f64; 2], width: usize, height: usize) -> [f64; 2] {
        let sides = [width as f64, height as f64];
        let (short, long) = (sides[0].min(sides[1]), sides[0].max(sides[1]));
        std::array::from_fn(|axis| match self.resize {
            Resize::Centre => 0.5 * sides[axis] + CENTRE * short * (place[axis] - 0.5),
            Resize::Crop => 0.5 * sides[axis] + short * (place[axis] - 0.5),
            Resize::Letterbox => 0.5 * sides[axis] + long * (place[axis] - 0.5),
            Resize::Squash => place[axis] * sides[axis],
        })
    }
}

/// Decodes a PNG or JPEG file to RGB with 8 bits; grey is repeated, transparency is dropped.
///
/// # Errors
/// If the bytes are of neither format or damaged, or the image is larger than [`limits::IMAGE`].
pub fn decode(bytes: &[u8]) -> Result<RgbImage> {
    Ok(decode_any(bytes)?.into_rgb8())
}

/// Decodes a PNG or JPEG file whose pixels have the ROS encoding `encoding`: a grey image with a Bayer pattern gets its colours.
/// Otherwise as [`decode`].
///
/// # Errors
/// As [`decode`].
pub fn decode_as(bytes: &[u8], encoding: &str) -> Result<RgbImage> {
    let image = decode_any(bytes)?;
    if image.color().has_color() || !is_bayer(encoding) {
        return Ok(image.into_rgb8());
    }
    let (width, height) = (image.width(), image.height());
    let (step, data) = match has_16_bits(encoding) {
        true => (2 * width, image.into_luma16().iter().flat_map(|value| value.to_le_bytes()).collect()),
        false => (width, image.into_luma8().into_raw()),
    };
    RawImage { width, height, encoding, step, data: &data }.to_rgb()
}

fn decode_any(bytes: &[u8]) -> Result<DynamicImage> {
    let invalid = |error: &dyn std::fmt::Display| Error::value("image", "an intact PNG or JPEG file", error);
    let bytes = &*without_profiles(bytes);
    let mut reader = ImageReader::new(Cursor::new(bytes)).with_guessed_format().map_err(|e| invalid(&e))?;
    if reader.format().is_none() {
        let start: Vec<String> = bytes.iter().take(8).map(|byte| format!("{byte:02x}")).collect();
        let got = format!("{} bytes that start with [{}]", bytes.len(), start.join(" "));
        return Err(invalid(&got));
    }
    let mut limits = Limits::default();
    limits.max_image_width = Some(MAX_SIDE);
    limits.max_image_height = Some(MAX_SIDE);
    reader.limits(limits);
    let decoder = reader.into_decoder().map_err(|e| invalid(&e))?;
    let (width, height) = decoder.dimensions();
    check_size(width.into(), height.into())?;
    DynamicImage::from_decoder(decoder).map_err(|e| invalid(&e))
}

/// Leaves out the chunks of a PNG file that hold compressed profiles and texts, which do not change the pixels: the decoder
/// would decompress them, and a kilobyte may hold a gigabyte.
fn without_profiles(bytes: &[u8]) -> Cow<'_, [u8]> {
    const NAMES: [&[u8]; 3] = [b"iCCP", b"zTXt", b"iTXt"];
    let Some(body) = bytes.strip_prefix(PNG) else { return Cow::Borrowed(bytes) };
    let is_left_out = |(name, _): &(&[u8], &[u8])| NAMES.contains(name);
    if !png_chunks(body).any(|chunk| is_left_out(&chunk)) {
        return Cow::Borrowed(bytes);
    }
    let kept = png_chunks(body).filter(|chunk| !is_left_out(chunk)).map(|(_, chunk)| chunk);
    Cow::Owned(std::iter::once(PNG).chain(kept).collect::<Vec<_>>().concat())
}

/// Returns name and bytes of each chunk of a PNG file behind its first bytes; the last one may be cut off.
fn png_chunks(mut rest: &[u8]) -> impl Iterator<Item = (&[u8], &[u8])> {
    std::iter::from_fn(move || {
        // A chunk has a length, a name, so many bytes, and a checksum.
        let length = rest.first_chunk().map_or(0, |length| u32::from_be_bytes(*length) as usize);
        let (chunk, behind) = rest.split_at(length.saturating_add(12).min(rest.len()));
        rest = behind;
        (!chunk.is_empty()).then(|| (chunk.get(4..8).unwrap_or_default(), chunk))
    })
}

/// Returns width and height from the header of a PNG or JPEG file, pixels; None if it has none.
pub(crate) fn dimensions(bytes: &[u8]) -> Option<(u32, u32)> {
    if bytes.starts_with(PNG) {
        // The first chunk begins with them. The library would read all chunks before the pixels.
        let side = |at: usize| Some(u32::from_be_bytes(*bytes.get(at..)?.first_chunk()?));
        return side(16).zip(side(20));
    }
    ImageReader::new(Cursor::new(bytes)).with_guessed_format().ok()?.into_dimensions().ok()
}

/// Compresses an image as JPEG; `quality` is 1 to 100.
///
/// # Errors
/// If the image has no pixels or is too large for JPEG.
pub(crate) fn jpeg(image: &RgbImage, quality: u8) -> Result<Vec<u8>> {
    let mut bytes = Vec::new();
    let encoded = JpegEncoder::new_with_quality(&mut bytes, quality).encode_image(image);
    encoded.map_err(|error| Error::value("image", "one that JPEG can hold", error))?;
    Ok(bytes)
}

/// Checks width and height, pixels, before an image of this size is allocated.
///
/// # Errors
/// If a side is 0 or above 16,384, or the image has more pixels than [`limits::IMAGE`].
pub(crate) fn check_size(width: u64, height: u64) -> Result<()> {
    let (most, side) = (limits::IMAGE.value(), u64::from(MAX_SIDE));
    if (1..=side).contains(&width) && (1..=side).contains(&height) && width * height <= most {
        return Ok(());
    }
    let variable = limits::IMAGE.variable();
    let expected = format!("sides of 1 to {MAX_SIDE} and at most {most} pixels, which {variable} changes");
    Err(Error::value("image size", expected, format!("{width} x {height}")))
}

/// Resizes to a square of `side` pixels.
///
/// # Errors
/// If the image is empty.
pub fn resize(image: &RgbImage, side: usize, resize: Resize, filter: Filter) -> Result<RgbImage> {
    resize_view(&image_view(image)?, side, resize, filter)
}

fn resize_view(image: &View, side: usize, resize: Resize, filter: Filter) -> Result<RgbImage> {
    let (width, height) = image.dimensions();
    if width == 0 || height == 0 || side == 0 || side > MAX_SIDE as usize {
        let expected = format!("at least one pixel, and an input side of 1 to {MAX_SIDE}");
        return Err(Error::value("image", expected, format!("{width} x {height} pixels, input side {side}")));
    }
    let side = side as u32;
    // Crop and centre read a square of the source, to a fraction of a pixel. Letterbox fills a part of the output.
    let short = f64::from(width.min(height));
    let box_side = if resize == Resize::Centre { CENTRE * short } else { short };
    let (crop_x, crop_y) = ((f64::from(width) - box_side) / 2.0, (f64::from(height) - box_side) / 2.0);
    let shrunk = |length: u32| (f64::from(side * length) / f64::from(width.max(height))).round().max(1.0) as u32;
    let (out_width, out_height) = match resize {
        Resize::Letterbox => (shrunk(width), shrunk(height)),
        Resize::Crop | Resize::Centre | Resize::Squash => (side, side),
    };
    let cropped = matches!(resize, Resize::Crop | Resize::Centre).then_some([crop_x, crop_y, box_side, box_side]);
    let out = convolved(image, (out_width, out_height), cropped, filter)?;
    if (out_width, out_height) == (side, side) {
        return Ok(out);
    }
    let mut square = RgbImage::new(side, side);
    let (left, top) = ((side - out_width) / 2, (side - out_height) / 2);
    ::image::imageops::replace(&mut square, &out, i64::from(left), i64::from(top));
    Ok(square)
}

/// Scales to width and height `size`, pixels.
///
/// # Errors
/// If the image or `size` is empty.
pub(crate) fn scaled(image: &RgbImage, size: (u32, u32)) -> Result<RgbImage> {
    convolved(&image_view(image)?, size, None, Filter::Triangle)
}

/// Pixels of an image that somebody else owns.
type View<'a> = ImageBuffer<Rgb<u8>, &'a [u8]>;

fn image_view(image: &RgbImage) -> Result<View<'_>> {
    view(image.as_raw(), image.width(), image.height())
}

fn view(pixels: &[u8], width: u32, height: u32) -> Result<View<'_>> {
    let bytes = 3 * width as usize * height as usize;
    let wrong = || Error::shape("image", format!("({height}, {width}, 3), {bytes} bytes"), [pixels.len()]);
    let image = Some(pixels).filter(|pixels| pixels.len() == bytes);
    image.and_then(|pixels| ImageBuffer::from_raw(width, height, pixels)).ok_or_else(wrong)
}

/// Scales an image, or the part of it at left, top, width and height `cropped`, to width and height `size`, pixels.
fn convolved(image: &View, size: (u32, u32), cropped: Option<[f64; 4]>, filter: Filter) -> Result<RgbImage> {
    let algorithm = fir::ResizeAlg::Convolution(match filter {
        Filter::Triangle => fir::FilterType::Bilinear,
        Filter::Bicubic => fir::FilterType::CatmullRom,
    });
    let mut options = fir::ResizeOptions::new().resize_alg(algorithm);
    if let Some([left, top, width, height]) = cropped {
        options = options.crop(left, top, width, height);
    }
    let failed = |error: &dyn std::fmt::Display| Error::value("image", "an image that can be resized", error);
    // The untyped call would compile the filters for all thirteen types of pixels.
    let source = TypedImageRef::<U8x3>::from_buffer(image.width(), image.height(), image.as_raw());
    let mut out = RgbImage::new(size.0, size.1);
    let mut target = TypedImage::<U8x3>::from_buffer(size.0, size.1, &mut out).map_err(|e| failed(&e))?;
    fir::Resizer::new()
        .resize_typed(&source.map_err(|e| failed(&e))?, &mut target, &options)
        .map_err(|e| failed(&e))?;
    Ok(out)
}

/// Computes `(value / 255 - mean) / std` per channel. Returns `(3, H, W)`, row-major, channels red, green, blue.
pub fn normalise(image: &RgbImage, mean: [f32; 3], std: [f32; 3]) -> Vec<f32> {
    let pixels = image.as_raw();
    let mut out = Vec::with_capacity(pixels.len());
    for channel in 0..3 {
        let table: [f32; 256] = std::array::from_fn(|v| (v as f32 / 255.0 - mean[channel]) / std[channel]);
        out.extend(pixels.iter().skip(channel).step_by(3).map(|v| table[usize::from(*v)]));
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_crop_that_hides_more_than_a_tenth_of_the_picture_is_told() {
        let of = |resize| {
            let (mean, std) = (IMAGENET_MEAN, IMAGENET_STD);
            Preparation { side: 8, resize, filter: Filter::Triangle, mean, std }
        };
        let share = |resize, width, height| of(resize).hidden_share(width, height);
        // The centre of 16:9 is 9 of 16 columns; of a square, 224 of 256 pixels in both directions.
        assert!((share(Resize::Crop, 1920, 1080) - 7.0 / 16.0).abs() < 1e-9);
        assert!((share(Resize::Crop, 1080, 1920) - 7.0 / 16.0).abs() < 1e-9);
        assert!((share(Resize::Centre, 512, 512) - (1.0 - 0.875 * 0.875)).abs() < 1e-9);
        for resize in [Resize::Letterbox, Resize::Squash] {
            assert!(share(resize, 1920, 1080).abs() < 1e-9 && of(resize).warning(1920, 1080).is_none());
        }
        let warning = of(Resize::Crop).warning(1920, 1080).unwrap();
        assert!(warning.starts_with("44 % of the picture (1920 x 1080) ") && warning.contains("(crop)"), "{warning}");
        assert_eq!(of(Resize::Crop).warning(110, 100), None);
    }

    #[test]
    fn scaled_images_are_those_of_another_implementation() {
        let picture = RgbImage::from_fn(300, 170, |x, y| ::image::Rgb([x as u8, (3 * y) as u8, (x * y / 97) as u8]));
        for size in [(224, 127), (31, 170), (300, 20), (400, 200)] {
            let theirs = ::image::imageops::resize(&picture, size.0, size.1, ::image::imageops::FilterType::Triangle);
            let ours = scaled(&picture, size).unwrap();
            let most = ours.iter().zip(theirs.iter()).map(|(a, b)| a.abs_diff(*b)).max();
            assert!(ours.dimensions() == size && most <= Some(1), "{size:?}: {most:?}");
        }
    }

    #[test]
    fn profiles_and_texts_of_a_png_are_left_out_and_its_pixels_stay() {
        let picture = RgbImage::from_fn(5, 3, |x, y| ::image::Rgb([x as u8, y as u8, 7]));
        let mut png = Cursor::new(Vec::new());
        picture.write_to(&mut png, ::image::ImageFormat::Png).unwrap();
        let png = png.into_inner();
        assert!(matches!(without_profiles(&png), Cow::Borrowed(_)));
        assert_eq!(dimensions(&png), Some((5, 3)));
        let chunk = |name: &[u8], content: &[u8]| {
            let named = [name, content].concat();
            let (length, crc) = (content.len() as u32, crc32fast::hash(&named));
            [&length.to_be_bytes()[..], &named, &crc.to_be_bytes()].concat()
        };
        // Behind the header of 13 bytes, and before the end.
        let (header, end) = (PNG.len() + 25, png.len() - 12);
        let parts = [
            &png[..header],
            &chunk(b"iCCP", b"a\0\0x"),
            &chunk(b"zTXt", b"b\0\0y"),
            &png[header..end],
            &chunk(b"iTXt", b"c"),
            &png[end..],
        ];
        let full = parts.concat();
        assert_eq!(without_profiles(&full), png);
        assert_eq!(decode(&full).unwrap(), picture);
        for cut in 0..full.len() {
            // No cut makes it panic, and none gives another picture.
            assert!(decode(&full[..cut]).map_or(true, |other| other == picture));
        }
    }

    #[test]
    fn an_image_above_the_limit_is_refused_by_its_header() {
        let mut png = b"\x89PNG\r\n\x1a\n".to_vec();
        let mut header = [16_000u32.to_be_bytes(), 16_000u32.to_be_bytes()].concat();
        header.extend_from_slice(&[8, 2, 0, 0, 0]);
        for (name, data) in [(b"IHDR", header.as_slice()), (b"IDAT", &[])] {
            let chunk = [name.as_slice(), data].concat();
            png.extend_from_slice(&(data.len() as u32).to_be_bytes());
            png.extend_from_slice(&chunk);
            png.extend_from_slice(&crc32fast::hash(&chunk).to_be_bytes());
        }
        let error = decode(&png).unwrap_err().to_string();
        assert!(error.contains("16000 x 16000") && error.contains("EGOTAC_LIMIT_IMAGE_PIXELS"), "{error}");
        let data = vec![0; 256_000_000];
        let raw = RawImage { width: 16_000, height: 16_000, encoding: "mono8", step: 16_000, data: &data };
        assert!(raw.to_rgb().unwrap_err().to_string().contains("16000 x 16000"));
    }
}
