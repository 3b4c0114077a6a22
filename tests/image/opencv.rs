//! Bayer patterns and rectification agree with OpenCV (`tests/data/image/make_golden.py`).

use std::path::Path;

use egotac::image::rectify::{Calibration, Rectifier};
use egotac::image::{RawImage, decode_as};
use image::{GrayImage, ImageFormat, RgbImage};
use safetensors::SafeTensors;

fn golden() -> Vec<u8> {
    std::fs::read(Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/image/golden.safetensors")).unwrap()
}

fn bytes(golden: &[u8], name: &str) -> Vec<u8> {
    SafeTensors::deserialize(golden).unwrap().tensor(name).unwrap().data().to_vec()
}

fn numbers(golden: &[u8], name: &str) -> Vec<f64> {
    bytes(golden, name).chunks_exact(8).map(|x| f64::from_le_bytes(x.try_into().unwrap())).collect()
}

fn image(golden: &[u8], name: &str) -> RgbImage {
    RgbImage::from_raw(80, 60, bytes(golden, name)).unwrap()
}

#[test]
fn bayer_patterns_have_the_colours_of_opencv() {
    let golden = golden();
    let (width, height) = (14, 11);
    for bits in [8, 16] {
        let mosaic = bytes(&golden, &format!("mosaic{bits}"));
        for pattern in ["rggb", "bggr", "gbrg", "grbg"] {
            let encoding = format!("bayer_{pattern}{bits}");
            // Rows may be padded.
            let row = width as usize * bits / 8;
            let data: Vec<u8> = mosaic.chunks_exact(row).flat_map(|row| [row, &[0xAA; 6]].concat()).collect();
            let raw = RawImage { width, height, encoding: &encoding, step: row as u32 + 6, data: &data };
            let got = raw.to_rgb().unwrap().into_raw();
            assert_eq!(got, bytes(&golden, &format!("{pattern}{bits}")), "{encoding}");
        }
    }
}

#[test]
fn a_compressed_mosaic_gets_its_colours() {
    let golden = golden();
    let mosaic = GrayImage::from_raw(14, 11, bytes(&golden, "mosaic8")).unwrap();
    let mut png = Vec::new();
    mosaic.write_to(&mut std::io::Cursor::new(&mut png), ImageFormat::Png).unwrap();
    assert_eq!(decode_as(&png, "bayer_grbg8").unwrap().into_raw(), bytes(&golden, "grbg8"));
    // Another encoding leaves it grey.
    let grey = decode_as(&png, "mono8").unwrap();
    assert!(grey.pixels().zip(mosaic.pixels()).all(|(rgb, luma)| rgb.0 == [luma.0[0]; 3]));
}

#[test]
fn rectified_images_agree_with_opencv() {
    let golden = golden();
    let matrix = |name: &str| numbers(&golden, name);
    let (k, r, p) = (matrix("k"), matrix("r"), matrix("p"));
    for model in ["plumb_bob", "rational_polynomial", "equidistant"] {
        let d = numbers(&golden, &format!("{model}_d"));
        let rectifier = Rectifier::new(&Calibration {
            width: 80,
            height: 60,
            model,
            d: &d,
            k: k[..].try_into().unwrap(),
            r: r[..].try_into().unwrap(),
            p: p[..].try_into().unwrap(),
        });
        let rectifier = rectifier.unwrap();
        let map = bytes(&golden, &format!("{model}_map"));
        let map: Vec<f32> = map.chunks_exact(4).map(|x| f32::from_le_bytes(x.try_into().unwrap())).collect();
        let apart = rectifier.places().as_flattened().iter().zip(&map).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
        assert!(apart < 1e-3, "{model}: {apart} pixels");
        let got = rectifier.apply(&image(&golden, "image")).unwrap();
        let want = image(&golden, &format!("{model}_image"));
        // OpenCV rounds the shares of neighbours to 1/32; beside the black border neighbours differ by up to 255.
        let differences: Vec<u8> = got.as_raw().iter().zip(want.as_raw()).map(|(a, b)| a.abs_diff(*b)).collect();
        let large = differences.iter().filter(|difference| **difference > 1).count();
        assert!(large * 100 < differences.len(), "{model}: {large} of {} values differ", differences.len());
        assert!(differences.iter().all(|difference| *difference <= 8), "{model}: {:?}", differences.iter().max());
    }
}

#[test]
fn a_calibration_that_is_none_is_refused() {
    let (k, zero) = ([50.0, 0.0, 4.0, 0.0, 50.0, 3.0, 0.0, 0.0, 1.0], [0.0; 9]);
    let base = Calibration { width: 8, height: 6, model: "plumb_bob", d: &[], k: &k, r: &zero, p: &[0.0; 12] };
    let refused = |calibration: Calibration, said: &str| {
        let error = Rectifier::new(&calibration).unwrap_err().to_string();
        assert!(error.contains(said), "{error}");
    };
    refused(Calibration { k: &zero, ..base }, "focal lengths");
    refused(Calibration { model: "orthographic", ..base }, "plumb_bob");
    refused(Calibration { model: "equidistant", d: &[0.0, 0.0, 0.0, 0.0, 1.0], ..base }, "at most 4");
    refused(Calibration { d: &[f64::NAN], ..base }, "distortion");
    refused(Calibration { r: &[f64::INFINITY; 9], ..base }, "finite");
    refused(Calibration { width: 0, ..base }, "sides");
    // Without distortion, rotation and projection nothing changes.
    let rectifier = Rectifier::new(&base).unwrap();
    let image = RgbImage::from_fn(8, 6, |x, y| image::Rgb([x as u8 * 30, y as u8 * 40, 7]));
    assert_eq!(rectifier.apply(&image).unwrap(), image);
    assert!(rectifier.apply(&RgbImage::new(6, 8)).unwrap_err().to_string().contains("8 x 6"));
}
