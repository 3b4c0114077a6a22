//! A checkpoint with weights for presence tells absent hands and places keypoints; one without says nothing of them.

use std::collections::BTreeMap;

use candle_core::{Device, Tensor};
use candle_nn::VarMap;
use egotac::hand::{N_KEYPOINTS, Side};
use egotac::image::{Preparation, Resize};
use egotac::model::checkpoint::{self, Stored};
use egotac::model::grow::{self, Growth};
use egotac::model::predictor::{Options, Predictor};
use egotac::model::presence::{FEATURES, N_POINTS, PREFIX};
use egotac::model::{Checkpoint, Config, EgoTac, Presence, init};
use egotac::tactile::Doubt;
use image::{Rgb, RgbImage};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::common::network::save;

/// Random weights; `hand_bias`: bias of the presence of the left and the right hand.
fn weights(config: &Config, hand_bias: [f32; 2]) -> BTreeMap<String, Tensor> {
    let mut rng = ChaCha8Rng::seed_from_u64(11);
    let mut tensor = |(name, shape): (String, Vec<usize>)| {
        let n = shape.iter().product();
        let values: Vec<f32> = match name.ends_with("hand.bias") {
            true => hand_bias.to_vec(),
            false => (0..n).map(|_| rng.random_range(-0.5..0.5)).collect(),
        };
        (name, Tensor::from_vec(values, shape, &Device::Cpu).unwrap())
    };
    Presence::shapes(config.vision_width).into_iter().map(&mut tensor).collect()
}

fn picture() -> RgbImage {
    RgbImage::from_fn(90, 70, |x, y| Rgb([(x * 2) as u8, (y * 3) as u8, ((x * y) % 251) as u8]))
}

#[test]
fn presence_and_keypoints_are_those_of_the_formula() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a");
    let config = Config::toy();
    let weights = weights(&config, [0.3, -0.2]);
    save(&path, &config, weights.clone());
    let mut predictor = Predictor::load(&path, Options::default()).unwrap();
    assert!(predictor.estimates_presence());
    let hands = predictor.push(&picture(), 0.0).unwrap().hands.unwrap();

    // The same in f64 from the tokens of the stage.
    let input = predictor.metadata().preparation(&config).apply(&picture()).unwrap();
    let frame = Tensor::from_vec(input, (1, 3, config.image, config.image), &Device::Cpu).unwrap();
    let tokens: Vec<Vec<f32>> = predictor.model().encode(&frame).unwrap().get(0).unwrap().to_vec2().unwrap();
    let (cls, patches) = (&tokens[0], &tokens[1..]);
    let grid = patches.len().isqrt();
    let layer = |name: &str, row: usize, x: &[f32]| -> f64 {
        let weight: Vec<Vec<f32>> = weights[&format!("{PREFIX}{name}.weight")].to_vec2().unwrap();
        let bias: Vec<f32> = weights[&format!("{PREFIX}{name}.bias")].to_vec1().unwrap();
        f64::from(bias[row]) + weight[row].iter().zip(x).map(|(w, x)| f64::from(*w) * f64::from(*x)).sum::<f64>()
    };
    let features: Vec<Vec<f64>> =
        patches.iter().map(|x| (0..FEATURES).map(|row| layer("features", row, x).max(0.0)).collect()).collect();
    let column = |row: usize| features.iter().map(move |patch| patch[row]);
    let pooled: Vec<f32> = (0..FEATURES)
        .map(|row| column(row).fold(0.0, f64::max) as f32)
        .chain((0..FEATURES).map(|row| (column(row).sum::<f64>() / patches.len() as f64) as f32))
        .collect();
    for (hand, estimate) in hands.iter().enumerate() {
        let presence = 1.0 / (1.0 + (-layer("hand", hand, &pooled)).exp());
        assert!((f64::from(estimate.presence) - presence).abs() < 1e-4, "{} {presence}", estimate.presence);
        for (index, keypoint) in estimate.keypoints.iter().enumerate() {
            let point = hand * N_KEYPOINTS + index;
            let mut logits: Vec<f64> = patches.iter().map(|x| layer("keypoints", point, x)).collect();
            let best = (0..patches.len()).max_by(|a, b| logits[*a].total_cmp(&logits[*b])).unwrap();
            logits.push(layer("nowhere", point, cls));
            let sum: f64 = logits.iter().map(|logit| logit.exp()).sum();
            let (row, column) = (best / grid, best % grid);
            let near = |patch: &usize| (patch / grid).abs_diff(row) <= 1 && (patch % grid).abs_diff(column) <= 1;
            let share: f64 = (0..patches.len()).filter(near).map(|patch| logits[patch].exp() / sum).sum();
            assert!((f64::from(keypoint.confidence) - presence * share).abs() < 1e-4, "{point}");
            for (axis, cell) in [column, row].into_iter().enumerate() {
                let place = (cell as f64 + 0.5 + layer("offset", 2 * point + axis, &patches[best])) / grid as f64;
                assert!((f64::from(keypoint.place[axis]) - place).abs() < 1e-4, "{point}: {:?}", keypoint.place);
            }
        }
    }
}

#[test]
fn touch_of_an_absent_hand_is_unknown_and_that_of_the_other_is_not() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a");
    let config = Config::toy();
    save(&path, &config, weights(&config, [-100.0, 100.0]));
    let mut predictor = Predictor::load(&path, Options::default()).unwrap();
    let prediction = predictor.push(&picture(), 0.0).unwrap();
    assert_eq!(prediction.certainty.doubt, [Some(Doubt::Absent), None]);
    assert_eq!(prediction.certainty.presence, [Some(0.0), Some(1.0)]);
    assert!(prediction.field.is_unknown(Side::Left) && !prediction.field.is_unknown(Side::Right));
    assert!(prediction.certainty.reason().starts_with("left: no such hand in the image"));
    // The other hand's touch is bit for bit that of the network without these weights.
    let bare = path.with_extension("bare");
    let mut before = Predictor::load(&bare, Options::default()).unwrap();
    assert!(!before.estimates_presence() && before.warning().is_some());
    let plain = before.push(&picture(), 0.0).unwrap();
    assert_eq!((plain.hands, plain.certainty.presence, plain.certainty.doubt), (None, [None; 2], [None; 2]));
    let right = Side::Right.range();
    assert_eq!(plain.field.force[right.clone()], prediction.field.force[right.clone()]);
    assert_eq!(plain.field.contact[right.clone()], prediction.field.contact[right]);
}

#[test]
fn weights_survive_saving_halving_and_growing_and_training_starts_without_them() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    let config = Config::toy();
    let weights = weights(&config, [0.5, 0.5]);
    save(&path("a"), &config, weights.clone());
    let (_, metadata, read) = checkpoint::load_tensors(&path("a")).unwrap();
    Checkpoint::save_as(&path("half"), &config, &metadata, &read, Stored::F16).unwrap();
    let growth = Growth { width: 2 * config.width, vision_depth: config.vision_depth, depth: config.depth, seed: 1 };
    let (grown_config, grown) = grow::grow(&path("a"), &config, &read, &growth).unwrap();
    Checkpoint::save_tensors(&path("grown"), &grown_config, &metadata, &grown).unwrap();
    let expected = Predictor::load(&path("a"), Options::default()).unwrap().push(&picture(), 0.0).unwrap().hands;
    let got = Predictor::load(&path("grown"), Options::default()).unwrap().push(&picture(), 0.0).unwrap().hands;
    assert!(expected.is_some());
    assert_eq!(got, expected, "the encoder is the same");
    for (name, tensor) in &weights {
        let (_, _, half) = checkpoint::load_tensors(&path("half")).unwrap();
        let [got, want] = [&half[name], tensor].map(|tensor| tensor.flatten_all().unwrap().to_vec1::<f32>().unwrap());
        assert_eq!(got, want, "{name}");
    }
    let vars = VarMap::new();
    EgoTac::new(&config, init::var_builder(&vars, 0, &Device::Cpu)).unwrap();
    checkpoint::load_variables(&path("a"), &vars).unwrap();
}

#[test]
fn weights_that_lack_a_tensor_or_do_not_fit_the_network_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a");
    let config = Config::toy();
    let weights = weights(&config, [0.0; 2]);
    save(&path, &config, weights.clone());
    let (_, metadata, tensors) = checkpoint::load_tensors(&path).unwrap();
    let zeros = |shape: &[usize]| Tensor::zeros(shape, candle_core::DType::F32, &Device::Cpu).unwrap();
    let name = format!("{PREFIX}offset.weight");
    for change in [None, Some(zeros(&[2 * N_POINTS, config.vision_width + 1]))] {
        let mut changed = tensors.clone();
        match change {
            None => drop(changed.remove(&name)),
            Some(tensor) => drop(changed.insert(name.clone(), tensor)),
        }
        let error = Checkpoint::save_tensors(&path, &config, &metadata, &changed).unwrap_err().to_string();
        assert!(error.contains("presence.offset.weight: expected ["), "{error}");
    }
}

#[test]
fn a_pixel_of_a_place_has_that_place() {
    for resize in [Resize::Crop, Resize::Centre, Resize::Letterbox, Resize::Squash] {
        let preparation = Preparation { side: 56, resize, filter: Default::default(), mean: [0.5; 3], std: [0.2; 3] };
        for (width, height) in [(640, 480), (90, 320)] {
            let place = [0.25, 0.875];
            let back = preparation.place(preparation.pixel(place, width, height), width, height);
            assert!((0..2).all(|axis| (back[axis] - place[axis]).abs() < 1e-12), "{resize:?}: {back:?}");
        }
    }
}
