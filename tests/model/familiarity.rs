//! A checkpoint with statistics of its features tells images unlike its training's, and one without hides nothing.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use candle_core::{Device, Tensor};
use candle_nn::VarMap;
use egotac::hand::{N_FIELD, Side};
use egotac::model::checkpoint::{self, Stored};
use egotac::model::grow::{self, Growth};
use egotac::model::predictor::{Options, Prediction, Predictor};
use egotac::model::{Checkpoint, Config, EgoTac, Familiarity, Metadata, Precision, Unknown, init, shipped};
use egotac::tactile::Doubt;
use image::{Rgb, RgbImage};

use crate::common::network;

/// Statistics by made-up features of the toy network's width.
fn statistics(config: &Config) -> Familiarity {
    let width = config.vision_width;
    let features = |frames: usize, seed: usize| -> Vec<f32> {
        (0..frames * width).map(|i| ((i * 7919 + seed * 104_729) % 1000) as f32 / 500.0 - 1.0).collect()
    };
    Familiarity::fit(width, &features(400, 1), &features(100, 2)).unwrap()
}

/// Saves a toy network with statistics; returns its tensors.
fn save(path: &Path, config: &Config) -> BTreeMap<String, Tensor> {
    network::save(path, config, statistics(config).tensors().unwrap().into_iter().collect())
}

fn shipped_with(unknown: Unknown, precision: Precision) -> Predictor {
    Predictor::load(&shipped::path().unwrap(), Options { unknown, precision, ..Options::default() }).unwrap()
}

/// Pictures without any hand: black, grey, gradients, noise.
fn pictures() -> Vec<(&'static str, RgbImage)> {
    let of = |pixel: &dyn Fn(u32, u32) -> [u8; 3]| RgbImage::from_fn(320, 240, |x, y| Rgb(pixel(x, y)));
    let hash =
        |x: u32, y: u32, c: u32| ((x * 7919 + y * 104_729 + c * 15_485_863).wrapping_mul(2_654_435_761) >> 24) as u8;
    vec![
        ("black", of(&|_, _| [0; 3])),
        ("grey", of(&|_, _| [128; 3])),
        ("gradient along x", of(&|x, _| [(x * 255 / 319) as u8; 3])),
        ("gradient along y", of(&|_, y| [(y * 255 / 239) as u8, 90, 200])),
        ("noise", of(&|x, y| [hash(x, y, 1), hash(x, y, 2), hash(x, y, 3)])),
    ]
}

fn run(predictor: &mut Predictor, image: &RgbImage) -> Prediction {
    predictor.reset();
    predictor.push(image, 0.0).unwrap()
}

#[test]
fn statistics_survive_saving_halving_and_growing() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| -> PathBuf { folder.path().join(name) };
    let config = Config::toy();
    let tensors = save(&path("a"), &config);
    let expected = Some(statistics(&config));
    assert_eq!(Checkpoint::load(&path("a"), &Device::Cpu).unwrap().familiarity, expected);

    let (_, metadata, read) = checkpoint::load_tensors(&path("a")).unwrap();
    assert_eq!(read.keys().collect::<Vec<_>>(), tensors.keys().collect::<Vec<_>>());
    Checkpoint::save_as(&path("half"), &config, &metadata, &read, Stored::F16).unwrap();
    assert_eq!(checkpoint::stored(&path("half")).unwrap(), Stored::F16);
    assert_eq!(checkpoint::stored(&path("a")).unwrap(), Stored::F32);
    assert_eq!(Checkpoint::load(&path("half"), &Device::Cpu).unwrap().familiarity, expected);

    let growth =
        Growth { width: 2 * config.width, vision_depth: config.vision_depth + 1, depth: config.depth, seed: 1 };
    let (grown_config, grown) = grow::grow(&path("a"), &config, &read, &growth).unwrap();
    Checkpoint::save_tensors(&path("grown"), &grown_config, &metadata, &grown).unwrap();
    assert_eq!(Checkpoint::load(&path("grown"), &Device::Cpu).unwrap().familiarity, expected);
    // Training begins from the network alone.
    let vars = VarMap::new();
    EgoTac::new(&config, init::var_builder(&vars, 0, &Device::Cpu)).unwrap();
    checkpoint::load_variables(&path("a"), &vars).unwrap();
}

#[test]
fn statistics_that_do_not_fit_the_network_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a");
    let config = Config::toy();
    let tensors = save(&path, &config);
    let (_, metadata, _) = checkpoint::load_tensors(&path).unwrap();
    let refused = |change: &dyn Fn(&mut BTreeMap<String, Tensor>), word: &str| {
        let mut changed = tensors.clone();
        change(&mut changed);
        // By the library, which checks nothing.
        let bad = folder.path().join("bad");
        let mut map: std::collections::HashMap<String, String> = metadata.to_map().into_iter().collect();
        map.insert("config".into(), config.to_json());
        safetensors::serialize_to_file(changed.iter(), Some(map), &bad).unwrap();
        let error = Checkpoint::load(&bad, &Device::Cpu).unwrap_err().to_string();
        assert!(error.contains(word), "{word} is not in: {error}");
    };
    let zeros = |shape: &[usize]| Tensor::zeros(shape, candle_core::DType::F32, &Device::Cpu).unwrap();
    refused(&|t| drop(t.remove("familiarity.mean")), "familiarity.mean: expected [");
    refused(&|t| drop(t.insert("familiarity.mean".into(), zeros(&[3]))), "familiarity.mean: expected [");
    refused(&|t| drop(t.insert("familiarity.more".into(), zeros(&[3]))), "familiarity.more: expected no such tensor");
    refused(&|t| drop(t.insert("familiarity.quantiles".into(), zeros(&[257]))), "familiarity.quantiles");
    let falling: Vec<f32> = (0..257).rev().map(|i| i as f32).collect();
    let falling = Tensor::new(falling, &Device::Cpu).unwrap();
    refused(&|t| drop(t.insert("familiarity.quantiles".into(), falling.clone())), "familiarity.quantiles");
    let nan = (zeros(&[257]) + f64::NAN).unwrap();
    refused(&|t| drop(t.insert("familiarity.quantiles".into(), nan.clone())), "expected finite numbers");
}

#[test]
fn thresholds_of_a_checkpoint_are_read_checked_and_replaced_by_options() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a");
    let config = Config::toy();
    let tensors = save(&path, &config);
    let mut metadata = Metadata::new("toy", 1.0, 0.04);
    metadata.doubt.familiarity = 0.25;
    Checkpoint::save_tensors(&path, &config, &metadata, &tensors).unwrap();
    assert_eq!(Checkpoint::load(&path, &Device::Cpu).unwrap().metadata.doubt, metadata.doubt);
    let options = Options { familiarity_threshold: Some(0.5), ..Options::default() };
    let predictor = Predictor::load(&path, options.clone()).unwrap();
    assert_eq!((predictor.metadata().doubt.familiarity, predictor.metadata().doubt.presence), (0.5, 0.5));
    let options = Options { presence_threshold: Some(1.5), ..options };
    let error = Predictor::load(&path, options).unwrap_err().to_string();
    assert!(error.contains("presence_threshold: expected a number from 0 to 1, got 1.5"), "{error}");
    metadata.doubt.familiarity = -0.1;
    let error = Checkpoint::save_tensors(&path, &config, &metadata, &tensors).unwrap_err().to_string();
    assert!(error.contains("familiarity_threshold"), "{error}");
}

#[test]
fn a_checkpoint_without_statistics_hides_nothing_and_warns() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a");
    save(&path, &Config::toy());
    let mut predictor = Predictor::load(&path.with_extension("bare"), Options::default()).unwrap();
    assert!(predictor.warning().unwrap().contains("egotac model familiarity"));
    for (name, image) in pictures() {
        let prediction = run(&mut predictor, &image);
        assert_eq!((prediction.certainty.familiarity, prediction.certainty.presence), (None, [None; 2]), "{name}");
        assert_eq!(prediction.certainty.doubt, [None; 2], "{name}");
        assert!(prediction.field.force.iter().chain(&prediction.field.contact).all(|value| value.is_finite()));
    }
}

#[test]
fn the_shipped_network_does_not_know_touch_in_pictures_without_hands() {
    for precision in Precision::ALL {
        let mut predictor = shipped_with(Unknown::Nan, precision);
        for (name, image) in pictures() {
            let Prediction { field, certainty, .. } = run(&mut predictor, &image);
            assert_eq!(certainty.doubt, [Some(Doubt::Unfamiliar); 2], "{name}, {precision}: {certainty:?}");
            assert!(field.force.iter().chain(&field.contact).all(|value| value.is_nan()), "{name}, {precision}");
            assert!(Side::BOTH.iter().all(|side| field.is_unknown(*side) && !certainty.counts(*side)));
        }
    }
}

#[test]
fn unknown_touch_is_zero_or_the_guess_on_request() {
    let (_, image) = &pictures()[4];
    let mut guessing = shipped_with(Unknown::Guess, Precision::F32);
    let guess = run(&mut guessing, image);
    assert!(guess.certainty.is_unfamiliar() && guess.certainty.counts(Side::Left));
    assert!(guess.field.contact.iter().all(|contact| contact.is_finite()));
    // The guess is what the network gave before it knew of unfamiliar images.
    let tensors = |image: &RgbImage| {
        let input = guessing.metadata().preparation(guessing.config()).apply(image).unwrap();
        let side = guessing.config().image;
        let frame = Tensor::from_vec(input, (1, 3, side, side), &Device::Cpu).unwrap();
        let clip = Tensor::stack(&vec![frame; guessing.config().horizon], 1).unwrap();
        guessing.model().forward(&clip).unwrap().1.flatten_all().unwrap().to_vec1::<f32>().unwrap()
    };
    let temperature = guessing.metadata().contact_temperature;
    for (contact, logit) in guess.field.contact.iter().zip(tensors(image)) {
        assert!((contact - 1.0 / (1.0 + (-logit / temperature).exp())).abs() < 1e-5);
    }
    let zero = run(&mut shipped_with(Unknown::Zero, Precision::F32), image);
    assert_eq!((zero.field.force, zero.field.contact), (vec![0.0; N_FIELD], vec![0.0; N_FIELD]));
    assert_eq!(zero.certainty.mask(), vec![0; N_FIELD]);
}
