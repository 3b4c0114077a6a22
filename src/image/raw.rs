//! Uncompressed images of cameras and middleware.

use ::image::RgbImage;

use super::{MAX_SIDE, check_size};
use crate::error::{Error, Result};

/// Encodings that [`RawImage::to_rgb`] converts; `yuv422_yuy2` and `yuv422` are older names of `yuyv` and `uyvy` in ROS.
pub const ENCODINGS: [&str; 11] =
    ["rgb8", "bgr8", "rgba8", "bgra8", "mono8", "yuyv", "yuv422_yuy2", "uyvy", "yuv422", "nv12", "nv21"];

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
    /// `step` x `height` bytes, followed in `nv12` and `nv21` by half as many rows of chroma.
    pub data: &'a [u8],
}

/// Places of the colours among the bytes of a row or plane.
#[derive(Clone, Copy)]
enum Layout {
    /// Bytes per pixel; places of red, green and blue.
    Packed(usize, [usize; 3]),
    /// Four bytes for two pixels; places of Y0, Y1, U and V.
    Yuv422([usize; 4]),
    /// A plane of Y, then a plane of chroma pairs at half size; places of U and V.
    Yuv420([usize; 2]),
}

impl RawImage<'_> {
    /// Converts to RGB. YUV is BT.601 at video range (Y 16 to 235), as in OpenCV and ROS.
    ///
    /// # Errors
    /// If the encoding is unknown, or width, height, step and size of the data contradict each other.
    pub fn to_rgb(&self) -> Result<RgbImage> {
        let layout = self.layout()?;
        self.check(layout)?;
        let (width, height, step) = (self.width as usize, self.height as usize, self.step as usize);
        let mut rgb = Vec::with_capacity(width * height * 3);
        for (y, row) in self.data.chunks_exact(step).take(height).enumerate() {
            match layout {
                Layout::Packed(size, [r, g, b]) => {
                    rgb.extend(row[..width * size].chunks_exact(size).flat_map(|p| [p[r], p[g], p[b]]));
                }
                Layout::Yuv422([y0, y1, u, v]) => {
                    let pairs = row[..width * 2].chunks_exact(4);
                    rgb.extend(pairs.flat_map(|p| [p[y0], p[y1]].map(|y| from_yuv(y, p[u], p[v]))).flatten());
                }
                Layout::Yuv420([u, v]) => {
                    let chroma = &self.data[step * (height + y / 2)..][..width];
                    let pairs = row[..width].chunks_exact(2).zip(chroma.chunks_exact(2));
                    rgb.extend(pairs.flat_map(|(p, c)| [p[0], p[1]].map(|y| from_yuv(y, c[u], c[v]))).flatten());
                }
            }
        }
        let size = rgb.len();
        RgbImage::from_raw(self.width, self.height, rgb)
            .ok_or_else(|| Error::shape("image", format!("[{height}, {width}, 3]"), [size]))
    }

    fn layout(&self) -> Result<Layout> {
        Ok(match self.encoding {
            "rgb8" => Layout::Packed(3, [0, 1, 2]),
            "bgr8" => Layout::Packed(3, [2, 1, 0]),
            "rgba8" => Layout::Packed(4, [0, 1, 2]),
            "bgra8" => Layout::Packed(4, [2, 1, 0]),
            "mono8" => Layout::Packed(1, [0, 0, 0]),
            "yuyv" | "yuv422_yuy2" => Layout::Yuv422([0, 2, 1, 3]),
            "uyvy" | "yuv422" => Layout::Yuv422([1, 3, 0, 2]),
            "nv12" => Layout::Yuv420([0, 1]),
            "nv21" => Layout::Yuv420([1, 0]),
            other => return Err(Error::unknown("image encoding", other, ENCODINGS)),
        })
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
            Layout::Packed(..) => (false, false),
            Layout::Yuv422(_) => (true, false),
            Layout::Yuv420(_) => (true, true),
        };
        for (name, length, even) in [("width", width, even_width), ("height", height, even_height)] {
            if even && length % 2 != 0 {
                return Err(Error::value(format!("image {name}"), format!("an even number for {encoding}"), length));
            }
        }
        let row = u64::from(width)
            * match layout {
                Layout::Packed(size, _) => size as u64,
                Layout::Yuv422(_) => 2,
                Layout::Yuv420(_) => 1,
            };
        if u64::from(step) < row {
            let expected = format!("at least {row} bytes for {width} pixels of {encoding}");
            return Err(Error::value("image step", expected, step));
        }
        let rows = u64::from(height) + if even_height { u64::from(height) / 2 } else { 0 };
        let size = u64::from(step) * rows;
        if data.len() as u64 != size {
            let expected = format!("{size} bytes for {rows} rows of {step} bytes ({encoding}, {width} x {height})");
            return Err(Error::value("image data", expected, format!("{} bytes", data.len())));
        }
        Ok(())
    }
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
