//! A stream of images gives the output of whole clips, also after restarts, gaps, and errors.

use candle_core::{Device, Tensor};
use candle_nn::VarMap;
use egotac::model::predictor::{Options, Predictor, Prepared};
use egotac::model::{Checkpoint, Config, EgoTac, Metadata, Precision, init};
use egotac::tactile::N_FIELD;
use image::{Rgb, RgbImage};

const DT: f64 = 0.04;

/// A toy network with random weights; none has its initial value of zero.
fn predictor(has_force: bool, config: &Config) -> Predictor {
    predictor_with(has_force, config, Options::default())
}

fn predictor_with(has_force: bool, config: &Config, options: Options) -> Predictor {
    let vars = VarMap::new();
    EgoTac::new(config, init::var_builder(&vars, 11, &Device::Cpu)).unwrap();
    for (name, var) in vars.data().lock().unwrap().iter() {
        if name.contains("ada") || name.starts_with("encoder") {
            let noise = (var.as_tensor().randn_like(0.0, 0.2)).unwrap();
            var.set(&(var.as_tensor() + noise).unwrap()).unwrap();
        }
    }
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("toy.safetensors");
    let metadata = Metadata { has_force, ..Metadata::new("toy", 0.7, DT) };
    Checkpoint::save(&path, config, &metadata, &vars).unwrap();
    Predictor::load(&path, options).unwrap()
}

fn frame(i: usize) -> RgbImage {
    RgbImage::from_fn(80, 60, |x, y| {
        let v = |k: usize| ((x as usize * (3 + i) + y as usize * (7 + k) + 31 * i * i) % 256) as u8;
        Rgb([v(0), v(5), v(11)])
    })
}

/// Output of the whole network for a clip of frames, in newtons and probabilities.
fn whole_clip(predictor: &Predictor, frames: &[usize]) -> (Vec<f32>, Vec<f32>) {
    let preparation = predictor.metadata().preparation(predictor.config());
    let side = predictor.config().image;
    let pixels: Vec<f32> = frames.iter().flat_map(|i| preparation.apply(&frame(*i)).unwrap()).collect();
    let images = Tensor::from_vec(pixels, (1, frames.len(), 3, side, side), &Device::Cpu).unwrap();
    let (force, logits) = predictor.model().forward(&images).unwrap();
    let step = |t: Tensor| t.get(0).unwrap().get(0).unwrap().to_vec1::<f32>().unwrap();
    let scale = predictor.metadata().force_scale;
    (
        step(force).iter().map(|f| (f * scale).max(0.0)).collect(),
        step(logits).iter().map(|l| 1.0 / (1.0 + (-l).exp())).collect(),
    )
}

fn assert_close(got: &[f32], want: &[f32]) {
    assert_eq!(got.len(), want.len());
    let worst = got.iter().zip(want).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
    assert!(worst < 1e-5, "largest difference {worst}");
}

#[test]
fn a_stream_gives_the_output_of_whole_clips() {
    let mut predictor = predictor(true, &Config::toy());
    for i in 0..6 {
        // Seconds since 1970, with jitter, as in real stamps.
        let stamp = 1.7e9 + i as f64 * DT + if i % 2 == 0 { 0.004 } else { -0.004 };
        let prediction = predictor.push(&frame(i), stamp).unwrap();
        let window = [i.saturating_sub(2), i.saturating_sub(1), i];
        let (force, contact) = whole_clip(&predictor, &window);
        assert_close(&prediction.field.force, &force);
        assert_close(&prediction.field.contact, &contact);
        assert_eq!((prediction.stamp_secs, prediction.warming_up, prediction.restarted), (stamp, i < 2, i == 0));
        assert!(prediction.field.force.iter().any(|f| *f > 0.0) && prediction.field.force.iter().all(|f| *f >= 0.0));
    }
    assert!(predictor.cached_frames() <= 3);
}

#[test]
fn a_horizon_of_one_is_never_warming_up() {
    let mut predictor = predictor(true, &Config { horizon: 1, ..Config::toy() });
    for i in 0..3 {
        let prediction = predictor.push(&frame(i), i as f64).unwrap();
        assert_close(&prediction.field.force, &whole_clip(&predictor, &[i]).0);
        assert!(!prediction.warming_up);
        assert_eq!(predictor.cached_frames(), 1);
    }
}

#[test]
fn the_window_takes_the_frames_nearest_in_time() {
    let config = Config::toy();
    let mut fast = predictor(true, &config);
    // Five frames per step: every fifth frame is in the window.
    for i in 0..=14 {
        let prediction = fast.push(&frame(i), i as f64 * DT / 5.0).unwrap();
        assert_eq!(prediction.warming_up, i < 8, "{i}");
        if i >= 10 {
            assert_close(&prediction.field.contact, &whole_clip(&fast, &[i - 10, i - 5, i]).1);
        }
    }
    // One dropped frame: a neighbour takes its place, and the stream continues.
    let mut dropped = predictor(true, &config);
    for i in [0, 1, 2, 4] {
        dropped.push(&frame(i), i as f64 * DT).unwrap();
    }
    let prediction = dropped.push(&frame(5), 5.0 * DT - 1e-3).unwrap();
    assert_close(&prediction.field.contact, &whole_clip(&dropped, &[2, 4, 5]).1);
    assert!(!prediction.restarted && !prediction.warming_up);
}

#[test]
fn a_jump_back_or_a_long_gap_starts_a_new_stream() {
    let mut predictor = predictor(true, &Config::toy());
    for (i, stamp, restarted, warming_up) in [
        (0, 5.0, true, true),
        (1, 5.04, false, true),
        (2, 5.08, false, false),
        (3, 4.9, true, true),
        (4, 5.89, false, false),
        (5, 6.9, true, true),
    ] {
        let prediction = predictor.push(&frame(i), stamp).unwrap();
        assert_eq!((prediction.restarted, prediction.warming_up), (restarted, warming_up), "{i}");
        if restarted {
            assert_close(&prediction.field.force, &whole_clip(&predictor, &[i, i, i]).0);
        }
    }
    // An image with the same stamp replaces the last one.
    let again = predictor.push(&frame(9), 6.9).unwrap();
    assert_close(&again.field.force, &whole_clip(&predictor, &[9, 9, 9]).0);
    assert_eq!(predictor.cached_frames(), 1);
    predictor.reset();
    assert!(predictor.push(&frame(0), 7.0).unwrap().restarted);
}

#[test]
fn memory_is_bounded_however_fast_the_camera_is() {
    let mut predictor = predictor(true, &Config { vision_depth: 1, depth: 1, ..Config::toy() });
    let image = frame(0);
    let mut prediction = None;
    for i in 0..300 {
        prediction = Some(predictor.push(&image, f64::from(i) * 0.001).unwrap());
        assert!(predictor.cached_frames() <= 24);
    }
    assert!(!prediction.unwrap().warming_up, "thinning must not shorten the window");
}

#[test]
fn a_network_without_a_trained_force_head_gives_nan() {
    let mut predictor = predictor(false, &Config::toy());
    let field = predictor.push(&frame(3), 0.0).unwrap().field;
    assert_eq!(field.force.len(), N_FIELD);
    assert!(field.force.iter().all(|f| f.is_nan()));
    assert!(field.contact.iter().all(|c| (0.0..=1.0).contains(c)));
}

#[test]
fn invalid_stamps_and_images_are_errors_and_leave_the_stream_unchanged() {
    let mut predictor = predictor(true, &Config::toy());
    predictor.push(&frame(0), 0.0).unwrap();
    assert!(predictor.push(&frame(1), f64::NAN).unwrap_err().to_string().contains("stamp"));
    assert!(predictor.push(&RgbImage::new(0, 0), DT).unwrap_err().to_string().contains("0 x 0"));
    let prediction = predictor.push(&frame(1), DT).unwrap();
    assert_close(&prediction.field.force, &whole_clip(&predictor, &[0, 0, 1]).0);
    let options = Options { max_gap_secs: Some(0.0), ..Options::default() };
    let folder = tempfile::tempdir().unwrap();
    let error = Predictor::load(&folder.path().join("absent.safetensors"), options).unwrap_err().to_string();
    assert!(error.contains("absent.safetensors"), "{error}");
}

/// Prepared image number `i` of a predictor.
fn prepared(predictor: &Predictor, i: usize) -> Prepared {
    predictor.preparation().apply(&frame(i)).unwrap()
}

#[test]
fn streams_in_a_batch_are_bit_equal_to_single_streams_in_every_precision() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("pocket.safetensors");
    let vars = VarMap::new();
    let config = Config::pocket();
    EgoTac::new(&config, init::var_builder(&vars, 5, &Device::Cpu)).unwrap();
    Checkpoint::save(&path, &config, &Metadata::new("pocket", 0.7, DT), &vars).unwrap();
    for precision in [Precision::F32, Precision::Bf16, Precision::Int8] {
        let network = Predictor::load(&path, Options { precision, ..Options::default() }).unwrap();
        let mut together = [0, 1, 2].map(|_| network.another_stream());
        let mut single = [0, 1, 2].map(|_| network.another_stream());
        for round in 0..3 {
            // The second camera misses a round, and has other stamps than the first.
            let cameras: Vec<usize> = [0, 1, 2].into_iter().filter(|camera| (round, *camera) != (1, 1)).collect();
            let stamp = |camera: usize| DT * round as f64 + 0.3 * camera as f64;
            let images = together.iter_mut().enumerate().filter(|(camera, _)| cameras.contains(camera));
            let images = images.map(|(camera, stream)| {
                let input = prepared(stream, 3 * round + camera);
                (stream, input, stamp(camera))
            });
            let got = Predictor::push_together(images.collect());
            for (camera, got) in cameras.into_iter().zip(got) {
                let want = single[camera].push(&frame(3 * round + camera), stamp(camera)).unwrap();
                assert_eq!(got.unwrap(), want, "{precision}, round {round}, camera {camera}");
            }
        }
    }
}

#[test]
fn an_image_that_fails_leaves_the_other_streams_of_its_batch_untouched() {
    let network = predictor(true, &Config::toy());
    let mut streams = [0, 1, 2].map(|_| network.another_stream());
    let want = network.another_stream().push(&frame(2), 0.0).unwrap();
    let mut inputs = [0, 1, 2].map(|i| prepared(&network, i));
    inputs[0].whole[7] = f32::NAN;
    let stamps = [0.0, f64::NAN, 0.0];
    let images = streams.iter_mut().zip(inputs).zip(stamps).map(|((stream, input), stamp)| (stream, input, stamp));
    let results = Predictor::push_together(images.collect());
    assert!(results[0].as_ref().unwrap_err().to_string().contains("images"), "{:?}", results[0]);
    assert!(results[1].as_ref().unwrap_err().to_string().contains("image stamp"), "{:?}", results[1]);
    assert_eq!(results[2].as_ref().unwrap(), &want);
    assert_eq!(streams.map(|stream| stream.cached_frames()), [0, 0, 1]);
    assert_eq!(Predictor::push_together(Vec::new()).len(), 0);
}

/// Returns [`frame`] with one patch of the network's input brighter by this many grey levels.
fn brighter(i: usize, levels: u8) -> RgbImage {
    let mut image = RgbImage::from_fn(56, 56, |x, y| Rgb(frame(i).get_pixel(x, y).0.map(|value| value.min(200))));
    (0..14)
        .for_each(|y| (0..14).for_each(|x| image.get_pixel_mut(x, y).0.iter_mut().for_each(|value| *value += levels)));
    image
}

#[test]
fn images_that_hardly_change_take_the_tokens_of_the_last_encoded_one() {
    let config = Config { image: 56, ..Config::toy() };
    let options = Options { reuse_below: 3.5, ..Options::default() };
    let mut network = predictor_with(true, &config, options.clone());
    // 2 and 3 levels beside the first image are too little, 4 are not; then 7 is 3 beside the fourth.
    for (k, (levels, reused)) in
        [(0, false), (2, true), (3, true), (4, false), (7, true), (0, false)].into_iter().enumerate()
    {
        let prediction = network.push(&brighter(0, levels), DT * k as f64).unwrap();
        assert_eq!(prediction.is_reused(), reused, "{levels} levels");
        if k < 3 {
            // The window holds equal tokens only.
            let want = network.another_stream().push(&brighter(0, 0), 0.0).unwrap();
            assert_close(&prediction.field.force, &want.field.force);
        }
    }
    network.reset();
    assert!(!network.push(&brighter(0, 0), 0.0).unwrap().is_reused(), "nothing is left of a stream before a reset");
    // In a batch of streams each compares with its own images.
    let mut streams = [0, 1, 2].map(|_| network.another_stream());
    for (round, expected) in [[false; 3], [true, false, true]].into_iter().enumerate() {
        let inputs = [0, 1, 2].map(|i| if (round, i) == (1, 1) { 9 } else { i });
        let prepared = inputs.map(|i| network.preparation().apply(&brighter(i, 0)).unwrap());
        let images = streams.iter_mut().zip(prepared).map(|(stream, input)| (stream, input, DT * round as f64));
        let results: Vec<bool> =
            Predictor::push_together(images.collect()).into_iter().map(|r| r.unwrap().is_reused()).collect();
        assert_eq!(results, expected);
    }
    for below in [-1.0, f32::NAN] {
        let options = Options { reuse_below: below, ..options.clone() };
        let error = Predictor::load(&egotac::model::shipped::path().unwrap(), options).unwrap_err().to_string();
        assert!(error.contains("reuse_below"), "{error}");
    }
}
