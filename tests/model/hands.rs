//! A network that sees single hands gives for each hand what the same weights give for the squares around it.

use std::path::{Path, PathBuf};

use candle_core::Device;
use candle_nn::VarMap;
use egotac::hand::{N_VERTICES, Side};
use egotac::image::{Framing, Square};
use egotac::model::predictor::{Options, Prediction, Predictor};
use egotac::model::{Checkpoint, Config, EgoTac, HandEstimate, Metadata, Unknown, init};
use image::{Rgb, RgbImage};

use crate::common::save_network_with_presence;

const DT: f64 = 0.04;
const SIZE: (u32, u32) = (200, 120);

/// Saves a network of this framing with random weights; equal but for the framing.
fn save(path: &Path, framing: Framing) {
    let vars = VarMap::new();
    EgoTac::new(&Config::toy(), init::var_builder(&vars, 11, &Device::Cpu)).unwrap();
    for (name, var) in vars.data().lock().unwrap().iter() {
        if name.contains("ada") || name.contains("head") {
            // Any numbers that are not zero, the same in every file.
            let waves = (0..var.elem_count()).map(|i| (0.3 * (i as f32).sin() + 0.1) * 0.5).collect::<Vec<_>>();
            var.set(&candle_core::Tensor::from_vec(waves, var.shape(), &Device::Cpu).unwrap()).unwrap();
        }
    }
    let metadata = Metadata { framing, ..Metadata::new("toy", 0.7, DT) };
    Checkpoint::save(path, &Config::toy(), &metadata, &vars).unwrap();
}

/// Files of a locator that sees these hands, and of one network as hands and as whole pictures.
struct Files {
    locator: PathBuf,
    hands: PathBuf,
    whole: PathBuf,
    _folder: tempfile::TempDir,
}

fn files(present: [bool; 2]) -> Files {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    let files = Files {
        locator: path("locator.safetensors"),
        hands: path("hands.safetensors"),
        whole: path("whole.safetensors"),
        _folder: folder,
    };
    save_network_with_presence(&files.locator, present);
    save(&files.hands, Framing::Hands);
    save(&files.whole, Framing::Whole);
    files
}

impl Files {
    fn predictor(&self, unknown: Unknown) -> Predictor {
        let options = Options { locator: Some(self.locator.clone()), unknown, ..Options::default() };
        Predictor::load(&self.hands, options).unwrap()
    }
}

fn picture(i: usize) -> RgbImage {
    RgbImage::from_fn(SIZE.0, SIZE.1, |x, y| {
        let v = |k: usize| ((x as usize * (3 + i) + y as usize * (7 + k) + 31 * i * i) % 256) as u8;
        Rgb([v(0), v(5), v(11)])
    })
}

/// The square by the rule that the documentation states: around the keypoints at least half as sure as the surest.
fn square(estimate: &HandEstimate, locator: &Predictor) -> Square {
    let preparation = locator.metadata().preparation(locator.config());
    let surest = estimate.keypoints.iter().map(|keypoint| keypoint.confidence).fold(0.0, f32::max);
    let sure = estimate.keypoints.iter().filter(|keypoint| keypoint.confidence >= 0.5 * surest);
    let pixels = sure.map(|keypoint| keypoint.pixel(&preparation, SIZE.0 as usize, SIZE.1 as usize));
    Square::around_hand(pixels, SIZE.0, SIZE.1).unwrap()
}

#[test]
fn each_hand_is_what_the_weights_say_of_its_square() {
    let files = files([true, true]);
    let mut hands = files.predictor(Unknown::Nan);
    let mut locator = Predictor::load(&files.locator, Options::default()).unwrap();
    let mut singles = Side::BOTH.map(|_| Predictor::load(&files.whole, Options::default()).unwrap());
    for i in 0..5 {
        let (image, stamp) = (picture(i), DT * i as f64);
        let got = hands.push(&image, stamp).unwrap();
        let found = locator.push(&image, stamp).unwrap();
        assert_eq!((got.hands, got.certainty), (found.hands, found.certainty));
        for (side, single) in Side::BOTH.into_iter().zip(&mut singles) {
            let square = square(&found.hands.unwrap()[side as usize], &locator);
            let cut = square.cut(&image, Config::toy().image as u32, side == Side::Left).unwrap();
            let want = single.push(&cut, stamp).unwrap().field;
            assert_eq!(got.field.force[side.range()], want.force[Side::Right.range()]);
            assert_eq!(got.field.contact[side.range()], want.contact[Side::Right.range()]);
            assert!(
                want.contact[Side::Right.range()].iter().any(|contact| *contact != 0.5),
                "the weights say something"
            );
        }
        assert_eq!((got.warming_up, got.restarted), (i < 2, i == 0));
    }
}

#[test]
fn squares_of_a_tracker_take_the_place_of_the_locators() {
    // The locator misses the left hand, which the tracker has found.
    let files = files([false, true]);
    let mut predictor = files.predictor(Unknown::Nan);
    let square = Square { centre: [70.0, 50.0], half: 30.0 };
    let input = predictor.preparation().apply(&picture(1)).unwrap().with_squares([Some(square), None]);
    let got = predictor.push_prepared(input, 0.0).unwrap();
    let cut = square.cut(&picture(1), Config::toy().image as u32, true).unwrap();
    let want = Predictor::load(&files.whole, Options::default()).unwrap().push(&cut, 0.0).unwrap().field;
    assert_eq!(got.field.contact[..N_VERTICES], want.contact[N_VERTICES..]);
    assert_eq!(got.certainty.doubt, [None; 2]);
    let alone = files.predictor(Unknown::Nan).push(&picture(1), 0.0).unwrap();
    assert_eq!(got.field.contact[N_VERTICES..], alone.field.contact[N_VERTICES..]);
}

#[test]
fn a_hand_that_is_not_there_is_unknown_and_the_other_stays() {
    let files = files([false, true]);
    let mut predictor = files.predictor(Unknown::Nan);
    let got = predictor.push(&picture(1), 0.0).unwrap();
    assert!(got.field.force[..N_VERTICES].iter().chain(&got.field.contact[..N_VERTICES]).all(|value| value.is_nan()));
    assert!(got.field.force[N_VERTICES..].iter().all(|force| force.is_finite()));
    assert_eq!(got.certainty.mask()[N_VERTICES - 1..N_VERTICES + 1], [0, 1]);
    // Who wants a guess gets one of both hands.
    let guess = files.predictor(Unknown::Guess).push(&picture(1), 0.0).unwrap();
    assert!(guess.field.force.iter().chain(&guess.field.contact).all(|value| value.is_finite()));
    assert_eq!(guess.field.force[N_VERTICES..], got.field.force[N_VERTICES..]);
}

#[test]
fn kept_pictures_restore_the_stream() {
    let files = files([true, true]);
    let mut predictor = files.predictor(Unknown::Nan);
    for i in 0..6 {
        predictor.push(&picture(i), DT * i as f64).unwrap();
    }
    let mut restored = predictor.another_stream();
    for i in (0..6).filter(|i| predictor.kept_stamps().any(|stamp| stamp == DT * *i as f64)) {
        restored.push(&picture(i), DT * i as f64).unwrap();
    }
    let next = |predictor: &mut Predictor| -> Prediction { predictor.push(&picture(7), DT * 6.0).unwrap() };
    assert_eq!(next(&mut restored), next(&mut predictor));
    // Several cameras give what each gives alone.
    let mut streams = [predictor.another_stream(), predictor.another_stream()];
    let prepared = [2, 3].map(|i| predictor.preparation().apply(&picture(i)).unwrap());
    let images = streams.iter_mut().zip(prepared).map(|(stream, input)| (stream, input, 0.0));
    for (i, result) in Predictor::push_together(images.collect()).into_iter().enumerate() {
        assert_eq!(result.unwrap(), predictor.another_stream().push(&picture(2 + i), 0.0).unwrap());
    }
}

#[test]
fn a_locator_that_cannot_find_hands_is_refused_by_its_file() {
    let files = files([true, true]);
    for (locator, got) in [(&files.whole, "without presence"), (&files.hands, "of single hands")] {
        let options = Options { locator: Some(locator.clone()), ..Options::default() };
        let error = Predictor::load(&files.hands, options).unwrap_err().to_string();
        assert!(error.contains(&locator.display().to_string()) && error.contains(got), "{error}");
    }
    let reusing = Options { locator: Some(files.locator.clone()), reuse_below: 1.0, ..Options::default() };
    assert!(Predictor::load(&files.hands, reusing).unwrap_err().to_string().contains("reuse_below"));
    // The shipped network finds hands.
    assert!(Predictor::load(&files.hands, Options::default()).unwrap().estimates_presence());
    let numbers = vec![0.0; 3 * Config::toy().image * Config::toy().image];
    let error = files.predictor(Unknown::Nan).push_prepared(numbers, 0.0).unwrap_err().to_string();
    assert!(error.contains("a picture"), "{error}");
}
