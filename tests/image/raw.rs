//! Every raw encoding gives back its colours; contradictory sizes are errors.

use egotac::image::{ENCODINGS, RawImage};
use image::{Rgb, RgbImage};
use proptest::prelude::*;

/// Encodes by the definition: BT.601 luma, chroma differences scaled to video range.
fn yuv(p: Rgb<u8>) -> [u8; 3] {
    let [r, g, b] = p.0.map(|c| f64::from(c) / 255.0);
    let y = 0.299 * r + 0.587 * g + 0.114 * b;
    [16.0 + 219.0 * y, 128.0 + 224.0 * 0.5 * (b - y) / (1.0 - 0.114), 128.0 + 224.0 * 0.5 * (r - y) / (1.0 - 0.299)]
        .map(|v| v.round() as u8)
}

/// Encodes an image whose colour is constant over blocks of 2 x 2, rows padded with `padding` bytes of 0xAA.
fn encode(image: &RgbImage, encoding: &str, padding: usize) -> (Vec<u8>, u32) {
    let (width, height) = image.dimensions();
    let at = |x: u32, y: u32| *image.get_pixel(x, y);
    // A value of 8 bits is 257 times itself in 16.
    let wide = |value: u8| (u16::from(value) * 257).to_le_bytes();
    let row = |y: u32| -> Vec<u8> {
        let pixels = (0..width).map(|x| at(x, y));
        let pairs = (0..width / 2).map(|x| yuv(at(2 * x, y)));
        match encoding {
            "rgb8" => pixels.flat_map(|p| p.0).collect(),
            "bgr8" | "8UC3" => pixels.flat_map(|Rgb([r, g, b])| [b, g, r]).collect(),
            "rgba8" => pixels.flat_map(|Rgb([r, g, b])| [r, g, b, 7]).collect(),
            "bgra8" => pixels.flat_map(|Rgb([r, g, b])| [b, g, r, 7]).collect(),
            "mono8" | "8UC1" => pixels.map(|p| p.0[0]).collect(),
            "rgb16" => pixels.flat_map(|p| p.0).flat_map(wide).collect(),
            "bgr16" | "16UC3" => pixels.flat_map(|Rgb([r, g, b])| [b, g, r]).flat_map(wide).collect(),
            "rgba16" => pixels.flat_map(|Rgb([r, g, b])| [r, g, b, 9]).flat_map(wide).collect(),
            "bgra16" => pixels.flat_map(|Rgb([r, g, b])| [b, g, r, 9]).flat_map(wide).collect(),
            "mono16" | "16UC1" => pixels.map(|p| p.0[0]).flat_map(wide).collect(),
            "yuyv" | "yuv422_yuy2" => pairs.flat_map(|[y, u, v]| [y, u, y, v]).collect(),
            "uyvy" | "yuv422" => pairs.flat_map(|[y, u, v]| [u, y, v, y]).collect(),
            _ => pixels.map(|p| yuv(p)[0]).collect(),
        }
    };
    let chroma = |y: u32| -> Vec<u8> {
        let pairs = (0..width / 2).map(|x| yuv(at(2 * x, 2 * y)));
        pairs.flat_map(|[_, u, v]| if encoding == "nv12" { [u, v] } else { [v, u] }).collect()
    };
    let mut rows: Vec<Vec<u8>> = (0..height).map(row).collect();
    if encoding == "nv12" || encoding == "nv21" {
        rows.extend((0..height / 2).map(chroma));
    }
    rows.iter_mut().for_each(|row| row.extend(std::iter::repeat_n(0xAA, padding)));
    let step = rows[0].len() as u32;
    if encoding == "nv24" {
        // Chroma at full size: twice as many bytes per row.
        rows.extend((0..height).map(|y| {
            let pixels = (0..width).map(|x| yuv(at(x, y))).flat_map(|[_, u, v]| [u, v]);
            pixels.chain(std::iter::repeat_n(0xAA, 2 * padding)).collect()
        }));
    }
    (rows.concat(), step)
}

proptest! {
    #[test]
    fn every_encoding_gives_back_the_colours(
        (half_width, half_height) in (1u32..9, 1u32..9), padding in 0usize..9, colours in prop::collection::vec(any::<[u8; 3]>(), 64),
    ) {
        let image = RgbImage::from_fn(2 * half_width, 2 * half_height, |x, y| {
            Rgb(colours[(x / 2 + 8 * (y / 2)) as usize])
        });
        let (width, height) = image.dimensions();
        // OpenCV checks Bayer patterns, in `opencv.rs`.
        for encoding in ENCODINGS.into_iter().filter(|encoding| !egotac::image::is_bayer(encoding)) {
            let (data, step) = encode(&image, encoding, padding);
            let rgb = RawImage { width, height, encoding, step, data: &data }.to_rgb().unwrap();
            for (got, want) in rgb.pixels().zip(image.pixels()) {
                let (want, tolerance) = match encoding {
                    "mono8" | "mono16" | "8UC1" | "16UC1" => (Rgb([want.0[0]; 3]), 0),
                    _ if encoding.contains("rgb") || encoding.contains("bgr") || encoding.contains("UC3") => (*want, 0),
                    // Eight-bit chroma steps are worth up to two steps of blue, plus rounding.
                    _ => (*want, 3),
                };
                for (a, b) in got.0.iter().zip(want.0) {
                    prop_assert!(a.abs_diff(b) <= tolerance, "{encoding}: {got:?} for {want:?}");
                }
            }
        }
    }

    #[test]
    fn contradictory_sizes_are_refused_and_never_panic(
        width in 0u32..40, height in 0u32..40, step in 0u32..200, size in 0usize..4000, encoding in prop::sample::select(ENCODINGS.to_vec()),
    ) {
        let data = vec![1; size];
        if let Ok(rgb) = (RawImage { width, height, encoding, step, data: &data }).to_rgb() {
            prop_assert_eq!(rgb.dimensions(), (width, height));
            let rows = match encoding {
                "nv12" | "nv21" => height * 3 / 2,
                "nv24" => height * 3,
                _ => height,
            };
            prop_assert_eq!(size, (rows * step) as usize);
        }
    }
}

#[test]
fn errors_name_the_wrong_field() {
    let image = |width, height, encoding, step, size| {
        let data = vec![0; size];
        RawImage { width, height, encoding, step, data: &data }.to_rgb().unwrap_err().to_string()
    };
    for (error, parts) in [
        (image(2, 2, "32FC1", 8, 16), ["32FC1", "rgb8, bgr8"]),
        (image(2, 2, "64FC1", 16, 32), ["64FC1", "known"]),
        (image(2, 3, "bayer_rggb8", 2, 6), ["image width", "at least 3"]),
        (image(2, 2, "mono16", 3, 6), ["image step", "at least 4 bytes"]),
        (image(2, 2, "rgb8", 5, 10), ["image step", "at least 6 bytes"]),
        (image(2, 2, "rgb8", 8, 15), ["image data", "15 bytes"]),
        (image(3, 2, "yuyv", 6, 12), ["image width", "even"]),
        (image(2, 3, "nv12", 2, 9), ["image height", "even"]),
        (image(0, 3, "mono8", 0, 0), ["image width", "got 0"]),
        (image(u32::MAX, u32::MAX, "rgba8", u32::MAX, 9), ["image width", "4294967295"]),
    ] {
        assert!(parts.iter().all(|part| error.contains(part)), "{error}");
    }
}
