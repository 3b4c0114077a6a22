//! Decoding, resizing and normalising of images.

use std::io::Cursor;

use egotac::image::{Filter, IMAGENET_MEAN, IMAGENET_STD, Preparation, Resize, decode, normalise, resize};
use image::{DynamicImage, ImageFormat, Rgb, RgbImage};

fn picture(width: u32, height: u32) -> RgbImage {
    RgbImage::from_fn(width, height, |x, y| {
        let wave = |f: f64| (127.5 + 120.0 * (f * (f64::from(x) + 0.7 * f64::from(y))).sin()) as u8;
        Rgb([wave(0.11), wave(0.23), wave(0.05)])
    })
}

fn file(image: &DynamicImage, format: ImageFormat) -> Vec<u8> {
    let mut bytes = Cursor::new(Vec::new());
    image.write_to(&mut bytes, format).unwrap();
    bytes.into_inner()
}

#[test]
fn png_and_jpeg_of_any_colour_type_decode_to_rgb() {
    let rgb = picture(37, 23);
    let image = DynamicImage::from(rgb.clone());
    assert_eq!(decode(&file(&image, ImageFormat::Png)).unwrap(), rgb);
    for other in [image.to_rgba8().into(), image.to_rgb16().into(), DynamicImage::from(image.to_rgba16())] {
        assert_eq!(decode(&file(&other, ImageFormat::Png)).unwrap(), rgb);
    }
    let grey = DynamicImage::from(image.to_luma8());
    assert_eq!(decode(&file(&grey, ImageFormat::Png)).unwrap(), grey.to_rgb8());
    let jpeg = decode(&file(&image, ImageFormat::Jpeg)).unwrap();
    let error = jpeg.iter().zip(rgb.iter()).map(|(a, b)| f64::from(a.abs_diff(*b))).sum::<f64>() / rgb.len() as f64;
    assert!(error < 8.0, "mean difference {error}");
    assert_eq!(decode(&file(&grey, ImageFormat::Jpeg)).unwrap().dimensions(), (37, 23));
}

#[test]
fn damaged_and_foreign_files_are_refused_with_a_reason() {
    let png = file(&picture(64, 64).into(), ImageFormat::Png);
    for bytes in [&[][..], b"GIF89a....", b"hello", &png[..png.len() / 2], &png[..20]] {
        let error = decode(bytes).unwrap_err().to_string();
        assert!(error.contains("PNG or JPEG"), "{error}");
    }
}

#[test]
fn a_square_of_the_input_size_passes_unchanged() {
    let image = picture(56, 56);
    for mode in [Resize::Crop, Resize::Letterbox, Resize::Squash] {
        for filter in [Filter::Triangle, Filter::Bicubic] {
            assert_eq!(resize(&image, 56, mode, filter).unwrap(), image);
        }
    }
}

/// Antialiased resampling by its definition: normalised weights of a triangle as wide as the scale.
fn triangle(values: &[f64], crop: (f64, f64), to: usize) -> Vec<f64> {
    let scale = (crop.1 - crop.0) / to as f64;
    let radius = scale.max(1.0);
    let at = |i: usize| {
        let centre = crop.0 + (i as f64 + 0.5) * scale;
        let weight = |x: usize| (1.0 - ((x as f64 + 0.5 - centre) / radius).abs()).max(0.0);
        let total: f64 = (0..values.len()).map(weight).sum();
        values.iter().enumerate().map(|(x, v)| v * weight(x)).sum::<f64>() / total
    };
    (0..to).map(at).collect()
}

#[test]
fn shrinking_and_enlarging_agree_with_the_definition() {
    // Constant along each column, so that only one dimension is resampled.
    for (width, side, mode) in [(200, 56, Resize::Squash), (20, 56, Resize::Squash), (151, 56, Resize::Crop)] {
        let row = picture(width, 1);
        let image = RgbImage::from_fn(width, 101, |x, _| *row.get_pixel(x, 0));
        let crop = match mode {
            Resize::Crop => (25.0, 126.0),
            _ => (0.0, f64::from(width)),
        };
        let got = resize(&image, side, mode, Filter::Triangle).unwrap();
        for channel in 0..3 {
            let values: Vec<f64> = row.pixels().map(|p| f64::from(p.0[channel])).collect();
            let want = triangle(&values, crop, side);
            for (x, want) in want.iter().enumerate().take(side - 2).skip(2) {
                let got = f64::from(got.get_pixel(x as u32, 30).0[channel]);
                assert!((got - want).abs() <= 1.5, "{mode:?} {width} -> {side}, {x}: {got} for {want}");
            }
        }
    }
}

#[test]
fn letterbox_keeps_the_whole_image_between_black_bars() {
    let image = RgbImage::from_pixel(160, 40, Rgb([200, 100, 50]));
    let out = resize(&image, 64, Resize::Letterbox, Filter::Bicubic).unwrap();
    for (_, y, pixel) in out.enumerate_pixels() {
        let want = if (24..40).contains(&y) { [200, 100, 50] } else { [0, 0, 0] };
        assert_eq!(pixel.0, want, "row {y}");
    }
    // At least one row remains of an image of any aspect.
    let thin = resize(&RgbImage::from_pixel(2000, 1, Rgb([255; 3])), 64, Resize::Letterbox, Filter::Triangle).unwrap();
    assert_eq!(thin.pixels().filter(|p| p.0 == [255; 3]).count(), 64);
}

#[test]
fn crop_takes_the_centre() {
    let image =
        RgbImage::from_fn(90, 30, |x, _| if (30..60).contains(&x) { Rgb([0, 255, 0]) } else { Rgb([255, 0, 0]) });
    let out = resize(&image, 30, Resize::Crop, Filter::Triangle).unwrap();
    assert!(out.pixels().all(|p| p.0 == [0, 255, 0]));
}

#[test]
fn channels_are_normalised_into_planes() {
    let image = RgbImage::from_fn(2, 2, |x, y| Rgb([255, 0, (100 * x + 50 * y) as u8]));
    let out = normalise(&image, IMAGENET_MEAN, IMAGENET_STD);
    let want = |v: f32, c: usize| (v / 255.0 - IMAGENET_MEAN[c]) / IMAGENET_STD[c];
    let blue = [0.0, 100.0, 50.0, 150.0].map(|v| want(v, 2));
    assert_eq!(out, [[want(255.0, 0); 4], [want(0.0, 1); 4], blue].concat());

    let whole =
        Preparation { side: 4, resize: Resize::Squash, filter: Filter::Triangle, mean: [0.5; 3], std: [0.5; 3] };
    assert_eq!(whole.apply(&RgbImage::from_pixel(9, 5, Rgb([255; 3]))).unwrap(), [1.0; 48]);
    let error = whole.apply(&RgbImage::new(0, 5)).unwrap_err().to_string();
    assert!(error.contains("0 x 5"), "{error}");
}

#[test]
fn place_predicts_the_position_of_a_pixel() {
    // A bright block on black: its centroid before and after.
    let (width, height) = (180, 120);
    let image = RgbImage::from_fn(width, height, |x, y| {
        let inside = (90..102).contains(&x) && (30..42).contains(&y);
        Rgb([if inside { 255 } else { 0 }; 3])
    });
    for how in [Resize::Crop, Resize::Letterbox, Resize::Squash] {
        let preparation =
            Preparation { side: 60, resize: how, filter: Filter::Triangle, mean: IMAGENET_MEAN, std: IMAGENET_STD };
        let small = resize(&image, 60, how, Filter::Triangle).unwrap();
        let mut sums = [0.0; 3];
        for (x, y, pixel) in small.enumerate_pixels() {
            let light = f64::from(pixel[0]);
            let at = [f64::from(x) + 0.5, f64::from(y) + 0.5, 1.0];
            sums.iter_mut().zip(at).for_each(|(sum, at)| *sum += light * at);
        }
        let seen = [sums[0], sums[1]].map(|sum| sum / sums[2] / 60.0);
        let place = preparation.place([96.0, 36.0], width as usize, height as usize);
        assert!((0..2).all(|axis| (seen[axis] - place[axis]).abs() < 5e-3), "{how:?}: {seen:?} {place:?}");
    }
}
