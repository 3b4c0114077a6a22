//! Images that are encoded only near the hands.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use candle_core::{DType, Device, Tensor};
use egotac::Predictor;
use egotac::model::predictor::{Focus, Options};
use egotac::model::{Config, Presence, Unknown};
use image::{Rgb, RgbImage};

use crate::common::network;

/// Interval between observation steps, s.
const DT: f64 = 0.04;
/// Sides of the input and of a patch, pixels: 4 x 4 patches.
const SIDES: [u32; 2] = [56, 14];

/// Saves a network that sees both hands, or none, in the upper left patch of every image.
fn save(folder: &Path, present: bool) -> PathBuf {
    let config = Config::toy();
    let tensor = |(name, shape): (String, Vec<usize>)| {
        let zeros = Tensor::zeros(shape.clone(), DType::F32, &Device::Cpu).unwrap();
        let tensor = match name.as_str() {
            "presence.hand.bias" => zeros.affine(0.0, if present { 100.0 } else { -100.0 }).unwrap(),
            "presence.nowhere.bias" => zeros.affine(0.0, -100.0).unwrap(),
            _ => zeros,
        };
        (name, tensor)
    };
    let presence: BTreeMap<String, Tensor> = Presence::shapes(config.vision_width).into_iter().map(tensor).collect();
    let path = folder.join(format!("{present}.safetensors"));
    let tensors = network::save(&path, &config, presence.clone());
    // Any numbers in place of the zeros that training starts from.
    let lively = |(name, tensor): (String, Tensor)| {
        let waves: Vec<f32> = (0..tensor.elem_count()).map(|i| 0.15 * (i as f32).sin() + 0.05).collect();
        (name, Tensor::from_vec(waves, tensor.shape(), &Device::Cpu).unwrap())
    };
    let heads = tensors.into_iter().filter(|(name, _)| name.contains("ada") || name.contains("head")).map(lively);
    network::save(&path, &config, heads.chain(presence).collect());
    path
}

fn load(path: &Path, focus: Option<Focus>) -> Predictor {
    Predictor::load(path, Options { focus, unknown: Unknown::Guess, ..Options::default() }).unwrap()
}

/// Returns an image, with a patch in this column and row brighter.
fn picture(brighter: Option<[u32; 2]>) -> RgbImage {
    RgbImage::from_fn(SIDES[0], SIDES[0], |x, y| {
        let more = if brighter == Some([x / SIDES[1], y / SIDES[1]]) { 60 } else { 0 };
        Rgb([3 * x + more, 2 * y + more, x + y + more].map(|value| value as u8))
    })
}

/// Returns the forces at the second of two images, and the share of its patches that were encoded.
fn second(network: &Predictor, image: &RgbImage) -> (Vec<f32>, f32) {
    let mut stream = network.another_stream();
    assert_eq!(stream.push(&picture(None), 0.0).unwrap().encoded, 1.0, "nothing is known before the first image");
    let prediction = stream.push(image, DT).unwrap();
    (prediction.field.contact, prediction.encoded)
}

#[test]
fn patches_far_from_the_hands_pass_the_first_layers_alone() {
    let folder = tempfile::tempdir().unwrap();
    let path = save(folder.path(), true);
    let depth = Config::toy().vision_depth;
    let whole = load(&path, None);
    let (far, near) = (picture(Some([3, 3])), picture(Some([0, 0])));
    let all = second(&whole, &picture(None)).0;
    assert_ne!(second(&whole, &far).0, all, "the whole encoder sees the change");
    for (reach, patches) in [(0.0, 1.0), (1.0, 4.0)] {
        let of = |after: usize| load(&path, Some(Focus { after, reach, every: 9 }));
        // Where all layers pass all patches, an image that does not change gets its own tokens again.
        assert_eq!(second(&of(depth), &picture(None)), (all.clone(), patches / 16.0));
        // Far patches have no influence if they pass no layer, and some if they pass one.
        let none = of(0);
        let still = second(&none, &picture(None));
        assert_eq!(still.1, patches / 16.0);
        assert_eq!(second(&none, &far).0, still.0);
        assert_ne!(second(&none, &near).0, still.0);
        assert_ne!(second(&of(1), &far).0, second(&of(1), &picture(None)).0);
    }
}

#[test]
fn images_are_whole_from_time_to_time_and_where_nothing_is_known_of_the_one_before() {
    let folder = tempfile::tempdir().unwrap();
    let focus = Some(Focus { after: 1, reach: 1.0, every: 3 });
    let mut stream = load(&save(folder.path(), true), focus);
    let mut shares = |stamps: &[f64]| -> Vec<f32> {
        stamps.iter().map(|stamp| stream.push(&picture(None), *stamp).unwrap().encoded).collect()
    };
    let part = 4.0 / 16.0;
    assert_eq!(shares(&[0.0, 0.04, 0.08, 0.12, 0.16]), [1.0, part, part, 1.0, part]);
    assert_eq!(shares(&[100.0, 100.04]), [1.0, part], "a pause starts a new stream");
    assert_eq!(shares(&[50.0, 50.04]), [1.0, part], "so does a jump back in time");
    stream.reset();
    assert_eq!(stream.push(&picture(None), 50.08).unwrap().encoded, 1.0);
    let mut nobody = load(&save(folder.path(), false), focus);
    assert!((0..5).all(|k| nobody.push(&picture(None), DT * f64::from(k)).unwrap().encoded == 1.0), "no hand is seen");
}

#[test]
fn several_streams_equal_single_ones() {
    let folder = tempfile::tempdir().unwrap();
    let network = load(&save(folder.path(), true), Some(Focus { after: 1, reach: 0.0, every: 9 }));
    let (mut together, mut alone) =
        ([0, 1].map(|_| network.another_stream()), [0, 1].map(|_| network.another_stream()));
    for k in 0..3 {
        let stamp = DT * f64::from(k);
        let images = [picture(Some([k as u32, 0])), picture(None)];
        let prepared = images.each_ref().map(|image| network.preparation().apply(image).unwrap());
        let batch = together.iter_mut().zip(prepared).map(|(stream, input)| (stream, input, stamp));
        let results = Predictor::push_together(batch.collect());
        for ((result, stream), image) in results.into_iter().zip(&mut alone).zip(&images) {
            assert_eq!(result.unwrap(), stream.push(image, stamp).unwrap());
        }
    }
}

#[test]
fn networks_that_know_no_places_of_hands_and_numbers_out_of_range_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = save(folder.path(), true);
    let refused = |path: &Path, focus: Focus| {
        Predictor::load(path, Options { focus: Some(focus), ..Options::default() }).unwrap_err().to_string()
    };
    let good = Focus { after: 1, reach: 1.0, every: 3 };
    let bare = path.with_extension("bare");
    assert!(refused(&bare, good).contains("a network that estimates keypoints"), "{}", refused(&bare, good));
    assert!(refused(&path, Focus { after: 99, ..good }).contains("focus.after"));
    assert!(refused(&path, Focus { every: 0, ..good }).contains("focus.every"));
}
