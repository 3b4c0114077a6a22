//! The network's view of pictures, and the keypoints that it finds there, in `egotac label` and `egotac predict`.

use std::fs;
use std::path::Path;

use crate::common::{egotac, save_network_with_presence};
use egotac::dataset::Labelled;
use egotac::dataset::zarr::{PREDICTED_KEYPOINTS, ZarrReader};
use egotac::image::Resize;
use egotac::model::View;
use egotac::model::predictor::{Options, Predictor};
use image::{Rgb, RgbImage};

const IMAGES: usize = 3;
const WARNING: &str = "44 % of the picture (320 x 180) lies outside of the network's view (crop)";

fn picture(index: usize) -> RgbImage {
    RgbImage::from_fn(320, 180, |x, y| Rgb([(x * 3) as u8, (y * 5 + 40 * index as u32) as u8, (x * y) as u8]))
}

/// Writes 16:9 pictures and a network that sees the right hand alone.
fn write(folder: &Path) {
    fs::create_dir_all(folder.join("in")).unwrap();
    for index in 0..IMAGES {
        picture(index).save(folder.join(format!("in/frame_{index}.png"))).unwrap();
    }
    save_network_with_presence(&folder.join("model"), [false, true]);
}

/// Runs `egotac` in `folder`'s files; returns what it says on standard error.
fn said(folder: &Path, command: &str) -> String {
    let place = folder.to_str().unwrap();
    let arguments: Vec<String> = command.split(' ').map(|word| word.replace('@', place)).collect();
    let output = egotac(&arguments.iter().map(String::as_str).collect::<Vec<_>>());
    let error = String::from_utf8(output.stderr).unwrap();
    assert!(output.status.success(), "{command}: {error}");
    error
}

#[test]
fn a_crop_that_cuts_pictures_is_told_once_and_another_view_takes_them_in() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    write(folder);
    let label = "label @/in --checkpoint @/model --fps 25 --to store --out @";
    let predict = "predict --data @/in --checkpoint @/model --out @";
    for (command, out) in [(label, "a.zarr"), (predict, "a.safetensors")] {
        let told = said(folder, &format!("{command}/crop_{out}"));
        assert_eq!(told.matches(WARNING).count(), 1, "{told}");
        for view in ["letterbox", "squash"] {
            let told = said(folder, &format!("{command}/{view}_{out} --view {view}"));
            assert!(!told.contains("of the picture"), "{told}");
        }
        let told = said(folder, &format!("{command}/as_it_is_{out} --view crop"));
        assert!(told.contains(WARNING), "{told}");
    }
    let labelled = |name: &str| Labelled::read(&folder.join(name)).unwrap();
    let [crop, same] = ["crop_a.zarr", "as_it_is_a.zarr"].map(|name| labelled(name).labels.force);
    let bits = |values: &[f32]| values.iter().map(|value| value.to_bits()).collect::<Vec<_>>();
    assert!(bits(&crop) == bits(&same));
    // Labels of another view are others: a run with it does not go on where one without it stopped.
    let view = |name: &str| labelled(name).info.unwrap().provenance.view;
    assert_eq!((view("as_it_is_a.zarr"), view("letterbox_a.zarr")), (None, Some(Resize::Letterbox)));
    let other = egotac(&[
        "label",
        folder.join("in").to_str().unwrap(),
        "--checkpoint",
        folder.join("model").to_str().unwrap(),
        "--out",
        folder.join("crop_a.zarr").to_str().unwrap(),
        "--fps",
        "25",
        "--to",
        "store",
        "--view",
        "squash",
    ]);
    assert!(String::from_utf8_lossy(&other.stderr).contains("with other settings"));
}

#[test]
fn keypoints_of_labels_are_those_of_the_predictor_in_pixels_and_unknown_for_an_absent_hand() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    write(folder);
    let label = "label @/in --checkpoint @/model --fps 25 --keypoints --view letterbox";
    said(folder, &format!("{label} --to store --out @/a.zarr"));
    said(folder, &format!("{label} --to store --size 90 --out @/half.zarr"));
    said(folder, &format!("{label} --to tensors --out @/b.safetensors"));

    let options = Options { view: View::Letterbox, ..Options::default() };
    let mut predictor = Predictor::load(&folder.join("model"), options).unwrap();
    let preparation = predictor.metadata().preparation(predictor.config());
    let mut expected = Vec::new();
    for index in 0..IMAGES {
        let prediction = predictor.push(&picture(index), 0.04 * index as f64).unwrap();
        let keypoints = prediction.keypoints(&preparation, 320, 180).unwrap();
        // The letterbox scales 320 pixels to the input's side, and the picture is in the middle.
        let [x, y] = prediction.hands.unwrap()[1].keypoints[4].place;
        assert!((keypoints[21 + 4][0] - 320.0 * x).abs() < 1e-3);
        assert!((keypoints[21 + 4][1] - (90.0 + 320.0 * (y - 0.5))).abs() < 1e-3);
        expected.extend_from_slice(keypoints.as_flattened());
    }
    for row in expected.chunks(2 * 21 * 3) {
        assert!(row[..63].iter().all(|value| value.is_nan()) && row[63..].iter().all(|value| value.is_finite()));
    }
    let same = |got: &[f32], scale: f32| {
        assert_eq!(got.len(), expected.len());
        for (index, (got, expected)) in got.iter().zip(&expected).enumerate() {
            let expected = if index % 3 == 2 { *expected } else { scale * expected };
            assert!((got - expected).abs() < 2e-3 || got.is_nan() && expected.is_nan(), "{index}: {got} {expected}");
        }
    };
    let store = |name: &str| {
        let reader = ZarrReader::open(&folder.join(name)).unwrap();
        let shape = reader.arrays().into_iter().find(|array| array.name == PREDICTED_KEYPOINTS).unwrap().shape;
        assert_eq!(shape, [IMAGES, 2, 21, 3]);
        reader.read_f32(PREDICTED_KEYPOINTS, 0..IMAGES).unwrap()
    };
    same(&store("a.zarr"), 1.0);
    same(&store("half.zarr"), 0.5);
    let bytes = fs::read(folder.join("b.safetensors")).unwrap();
    let tensors = safetensors::SafeTensors::deserialize(&bytes).unwrap();
    let tensor = tensors.tensor("predicted_keypoints").unwrap();
    assert_eq!(tensor.shape(), [IMAGES, 2, 21, 3]);
    let values: Vec<f32> = tensor.data().as_chunks().0.iter().map(|bytes| f32::from_le_bytes(*bytes)).collect();
    same(&values, 1.0);
    // Without the option there are none, and bags hold none.
    said(folder, "label @/in --checkpoint @/model --fps 25 --to store --out @/plain.zarr");
    let plain = ZarrReader::open(&folder.join("plain.zarr")).unwrap();
    assert!(plain.arrays().iter().all(|array| array.name != PREDICTED_KEYPOINTS));
    let place = |name: &str| folder.join(name).to_str().unwrap().to_owned();
    let bag = egotac(&[
        "label",
        &place("in"),
        "--out",
        &place("bag"),
        "--to",
        "bag",
        "--checkpoint",
        &place("model"),
        "--keypoints",
    ]);
    let error = String::from_utf8_lossy(&bag.stderr);
    assert!(!bag.status.success() && error.contains("expected a format that holds them, got a bag"), "{error}");
}
