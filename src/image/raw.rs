//! Uncompressed images of cameras and middleware.

use ::image::RgbImage;

use super::{MAX_SIDE, bayer, check_size};
use crate::error::{Error, Result};

/// Encodings that [`RawImage::to_rgb`] converts; `yuv422_yuy2` and `yuv422` are older names of `yuyv` and `uyvy` in ROS. Those
/// without colours in the name are taken as OpenCV takes them: `8UC3` as `bgr8`, `8UC1` and `16UC1` as `mono8` and `mono16`.
pub const ENCODINGS: [&str; 29] = [
    "rgb8",
    "bgr8",
    "rgba8",
    "bgra8",
    "mono8",
    "8UC3",
    "8UC1",
    "rgb16",
    "bgr16",
    "rgba16",
    "bgra16",
    "mono16",
    "16UC1",
    "16UC3",
    "bayer_rggb8",
    "bayer_bggr8",
    "bayer_gbrg8",
    "bayer_grbg8",
    "bayer_rggb16",
    "bayer_bggr16",
    "bayer_gbrg16",
    "bayer_grbg16",
    "yuyv",
    "yuv422_yuy2",
    "uyvy",
    "yuv422",
    "nv12",
    "nv21",
    "nv24",
];

/// An uncompressed image: rows of `step` bytes, pixels first, then padding.
#[derive(Debug, Clone, Copy)]
pub struct RawImage<'a> {
    /// Pixels per row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Encoding of the pixels, one of [`ENCODINGS`].
    pub encoding: &'a str,
    /// Bytes from the start of one row to the next.
    pub step: u32,
    /// `step` x `height` bytes, values of 16 bits in little endian; followed in `nv12` and `nv21` by half as many rows of chroma, in
    /// `nv24` by as many rows of 2 x `step` bytes.
    pub data: &'a [u8],
}

/// Places of the colours among the values of a row or plane.
#[derive(Clone, Copy)]
enum Layout {
    /// Values per pixel; places of red, green and blue.
    Packed(Depth, usize, [usize; 3]),
    /// One colour per pixel; column and row of the first red one.
    Bayer(Depth, [usize; 2]),
    /// Four bytes for two pixels; places of Y0, Y1, U and V.
    Yuv422([usize; 4]),
    /// A plane of Y, then a plane of chroma pairs at half size; places of U and V.
    Yuv420([usize; 2]),
    /// A plane of Y, then a plane of chroma pairs U, V at full size.
    Yuv444,
}

/// Size of a value.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Depth {
    Bits8,
    Bits16,
}

impl Depth {
    fn bytes(self) -> usize {
        match self {
            Self::Bits8 => 1,
            Self::Bits16 => 2,
        }
    }

    /// Returns the value at `index` of a row.
    fn value(self, row: &[u8], index: usize) -> u32 {
        match self {
            Self::Bits8 => row[index].into(),
            Self::Bits16 => u16::from_le_bytes([row[2 * index], row[2 * index + 1]]).into(),
        }
    }

    /// Returns a value as one of 8 bits.
    fn to_u8(self, value: u32) -> u8 {
        match self {
            Self::Bits8 => value as u8,
            // value / 257, rounded, as cv_bridge converts.
            Self::Bits16 => ((value * 255 + 32_767) / 65_535) as u8,
        }
    }
}

/// Returns true if values of this encoding have 16 bits, so that their order of bytes matters.
pub fn has_16_bits(encoding: &str) -> bool {
    matches!(layout(encoding), Some(Layout::Packed(Depth::Bits16, ..) | Layout::Bayer(Depth::Bits16, _)))
}

/// Returns true if each pixel of this encoding has one colour of a Bayer pattern.
pub fn is_bayer(encoding: &str) -> bool {
    matches!(layout(encoding), Some(Layout::Bayer(..)))
}

impl RawImage<'_> {
    /// Converts to RGB. YUV is BT.601 at video range (Y 16 to 235), as in OpenCV and ROS.
    ///
    /// # Errors
    /// If the encoding is unknown, or width, height, step and size of the data contradict each other.
    pub fn to_rgb(&self) -> Result<RgbImage> {
        self.to_rgb_in(Vec::new())
    }

    /// As [`Self::to_rgb`], in the memory of `spare`, whose content is lost: for streams, whose images are then written into memory
    /// that the process has already.
    ///
    /// # Errors
    /// As [`Self::to_rgb`].
    pub fn to_rgb_in(&self, spare: Vec<u8>) -> Result<RgbImage> {
        let layout = self.layout()?;
        self.check(layout)?;
        let (width, height, step) = (self.width as usize, self.height as usize, self.step as usize);
        if let Layout::Bayer(depth, red) = layout {
            let rows: Vec<&[u8]> = self.data.chunks_exact(step).take(height).collect();
            return Ok(bayer::to_rgb(self.width, self.height, red, |x, y| depth.value(rows[y], x), |v| depth.to_u8(v)));
        }
        let size = width * height * 3;
        // One large image of a stream does not hold its memory for good.
        let mut rgb = if spare.capacity() > 2 * size { Vec::new() } else { spare };
        rgb.resize(size, 0);
        let rows = self.data.chunks_exact(step).zip(rgb.chunks_exact_mut(width * 3));
        for (y, (row, out)) in rows.enumerate() {
            let pixels = out.as_chunks_mut::<3>().0;
            match layout {
                Layout::Packed(Depth::Bits8, 3, [0, 1, 2]) => out.copy_from_slice(&row[..width * 3]),
                // Sizes and places that the compiler knows are several times faster.
                Layout::Packed(Depth::Bits8, 3, [2, 1, 0]) => {
                    let bgr = row[..width * 3].as_chunks::<3>().0;
                    pixels.iter_mut().zip(bgr).for_each(|(out, [b, g, r])| *out = [*r, *g, *b]);
                }
                Layout::Packed(Depth::Bits8, size, [r, g, b]) => {
                    let values = row[..width * size].chunks_exact(size);
                    pixels.iter_mut().zip(values).for_each(|(out, p)| *out = [p[r], p[g], p[b]]);
                }
                Layout::Packed(depth @ Depth::Bits16, size, places) => {
                    let value = |pixel: usize, place: usize| depth.to_u8(depth.value(row, pixel * size + place));
                    for (pixel, out) in pixels.iter_mut().enumerate() {
                        *out = places.map(|place| value(pixel, place));
                    }
                }
                Layout::Yuv422([y0, y1, u, v]) => {
                    let pairs = row[..width * 2].as_chunks::<4>().0;
                    for ([left, right], p) in pixels.as_chunks_mut::<2>().0.iter_mut().zip(pairs) {
                        [*left, *right] = [p[y0], p[y1]].map(|y| from_yuv(y, p[u], p[v]));
                    }
                }
                Layout::Yuv420([u, v]) => {
                    let chroma = self.data[step * (height + y / 2)..][..width].as_chunks::<2>().0;
                    let pairs = row[..width].as_chunks::<2>().0.iter().zip(chroma);
                    for ([left, right], (p, c)) in pixels.as_chunks_mut::<2>().0.iter_mut().zip(pairs) {
                        [*left, *right] = p.map(|y| from_yuv(y, c[u], c[v]));
                    }
                }
                Layout::Yuv444 => {
                    let chroma = self.data[step * (height + 2 * y)..][..2 * width].as_chunks::<2>().0;
                    for (out, (y, c)) in pixels.iter_mut().zip(row[..width].iter().zip(chroma)) {
                        *out = from_yuv(*y, c[0], c[1]);
                    }
                }
                Layout::Bayer(..) => {} // converted above
            }
        }
        RgbImage::from_raw(self.width, self.height, rgb)
            .ok_or_else(|| Error::shape("image", format!("[{height}, {width}, 3]"), [size]))
    }

    fn layout(&self) -> Result<Layout> {
        layout(self.encoding).ok_or_else(|| Error::unknown("image encoding", self.encoding, ENCODINGS))
    }

    /// Checks that the numbers agree, so that no row lies outside the data.
    fn check(&self, layout: Layout) -> Result<()> {
        let Self { width, height, encoding, step, data } = *self;
        for (name, length) in [("width", width), ("height", height)] {
            if length == 0 || length > MAX_SIDE {
                return Err(Error::value(format!("image {name}"), format!("1 to {MAX_SIDE} pixels"), length));
            }
        }
        check_size(width.into(), height.into())?;
        let (even_width, even_height) = match layout {
            Layout::Packed(..) | Layout::Bayer(..) | Layout::Yuv444 => (false, false),
            Layout::Yuv422(_) => (true, false),
            Layout::Yuv420(_) => (true, true),
        };
        let least = if matches!(layout, Layout::Bayer(..)) { bayer::MIN_SIDE } else { 1 };
        for (name, length) in [("width", width), ("height", height)] {
            if length < least {
                return Err(Error::value(
                    format!("image {name}"),
                    format!("at least {least} pixels for {encoding}"),
                    length,
                ));
            }
        }
        for (name, length, even) in [("width", width, even_width), ("height", height, even_height)] {
            if even && length % 2 != 0 {
                return Err(Error::value(format!("image {name}"), format!("an even number for {encoding}"), length));
            }
        }
        let row = u64::from(width)
            * match layout {
                Layout::Packed(depth, size, _) => (depth.bytes() * size) as u64,
                Layout::Bayer(depth, _) => depth.bytes() as u64,
                Layout::Yuv422(_) => 2,
                Layout::Yuv420(_) | Layout::Yuv444 => 1,
            };
        if u64::from(step) < row {
            let expected = format!("at least {row} bytes for {width} pixels of {encoding}");
            return Err(Error::value("image step", expected, step));
        }
        let chroma_rows = match layout {
            Layout::Yuv420(_) => u64::from(height) / 2,
            Layout::Yuv444 => 2 * u64::from(height),
            _ => 0,
        };
        let rows = u64::from(height) + chroma_rows;
        let size = u64::from(step) * rows;
        if data.len() as u64 != size {
            let expected = format!("{size} bytes for {rows} rows of {step} bytes ({encoding}, {width} x {height})");
            return Err(Error::value("image data", expected, format!("{} bytes", data.len())));
        }
        Ok(())
    }
}

fn layout(encoding: &str) -> Option<Layout> {
    use Depth::{Bits8, Bits16};
    Some(match encoding {
        "rgb8" => Layout::Packed(Bits8, 3, [0, 1, 2]),
        "bgr8" | "8UC3" => Layout::Packed(Bits8, 3, [2, 1, 0]),
        "rgba8" => Layout::Packed(Bits8, 4, [0, 1, 2]),
        "bgra8" => Layout::Packed(Bits8, 4, [2, 1, 0]),
        "mono8" | "8UC1" => Layout::Packed(Bits8, 1, [0, 0, 0]),
        "rgb16" => Layout::Packed(Bits16, 3, [0, 1, 2]),
        "bgr16" | "16UC3" => Layout::Packed(Bits16, 3, [2, 1, 0]),
        "rgba16" => Layout::Packed(Bits16, 4, [0, 1, 2]),
        "bgra16" => Layout::Packed(Bits16, 4, [2, 1, 0]),
        "mono16" | "16UC1" => Layout::Packed(Bits16, 1, [0, 0, 0]),
        "bayer_rggb8" => Layout::Bayer(Bits8, [0, 0]),
        "bayer_grbg8" => Layout::Bayer(Bits8, [1, 0]),
        "bayer_gbrg8" => Layout::Bayer(Bits8, [0, 1]),
        "bayer_bggr8" => Layout::Bayer(Bits8, [1, 1]),
        "bayer_rggb16" => Layout::Bayer(Bits16, [0, 0]),
        "bayer_grbg16" => Layout::Bayer(Bits16, [1, 0]),
        "bayer_gbrg16" => Layout::Bayer(Bits16, [0, 1]),
        "bayer_bggr16" => Layout::Bayer(Bits16, [1, 1]),
        "yuyv" | "yuv422_yuy2" => Layout::Yuv422([0, 2, 1, 3]),
        "uyvy" | "yuv422" => Layout::Yuv422([1, 3, 0, 2]),
        "nv12" => Layout::Yuv420([0, 1]),
        "nv21" => Layout::Yuv420([1, 0]),
        "nv24" => Layout::Yuv444,
        _ => return None,
    })
}

/// Converts BT.601 at video range to RGB.
fn from_yuv(y: u8, u: u8, v: u8) -> [u8; 3] {
    let y = 255.0 / 219.0 * (f32::from(y) - 16.0);
    // 255/224 of the chroma times 2(1 - Kr), 2(1 - Kb) and their shares of green; Kr = 0.299, Kb = 0.114.
    let (u, v) = (255.0 / 224.0 * (f32::from(u) - 128.0), 255.0 / 224.0 * (f32::from(v) - 128.0));
    let (red, blue) = (1.402 * v, 1.772 * u);
    let green = -(0.299 * red + 0.114 * blue) / 0.587;
    [red, green, blue].map(|colour| (y + colour).round().clamp(0.0, 255.0) as u8)
}
