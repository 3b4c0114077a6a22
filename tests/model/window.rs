//! A stream and a batch choose the same frames for the same stamps.

use candle_core::{Device, Tensor};
use candle_nn::VarMap;
use egotac::model::predictor::{Options, Predictor};
use egotac::model::{Checkpoint, Config, EgoTac, Metadata, init};
use egotac::train::sampler;

const HORIZON: usize = 4;
const FRAMES: usize = 350;

/// A network of one patch and one layer per part, with no parameter at its zero start.
fn network() -> EgoTac {
    let config = Config {
        vision_width: 8,
        vision_depth: 1,
        vision_heads: 1,
        width: 8,
        depth: 1,
        heads: 1,
        image: 14,
        pretrain_image: 14,
        horizon: HORIZON,
        predict: 1,
        ..Config::toy()
    };
    let vars = VarMap::new();
    let model = EgoTac::new(&config, init::var_builder(&vars, 3, &Device::Cpu)).unwrap();
    for (name, var) in vars.data().lock().unwrap().iter() {
        let numbers: Vec<f32> = (0..var.elem_count()).map(|i| 0.5 * ((i * 37 + name.len()) as f32).sin()).collect();
        let noise = Tensor::from_vec(numbers, var.shape(), &Device::Cpu).unwrap();
        var.set(&(var.as_tensor() + noise).unwrap()).unwrap();
    }
    model.freeze().unwrap()
}

/// Pixels of frame `i`, unlike those of every other frame.
fn pixels(i: usize) -> Vec<f32> {
    (0..3 * 14 * 14).map(|at| ((at * (i + 3)) as f32 * 0.7).sin() + ((i * i) as f32 * 0.31).cos()).collect()
}

/// Contact probabilities that the network gives for each window of frames.
fn batch(model: &EgoTac, windows: &[Vec<usize>]) -> Vec<Vec<f32>> {
    let projected: Vec<Tensor> = (0..windows.len())
        .map(|i| {
            let image = Tensor::from_vec(pixels(i), (1, 3, 14, 14), &Device::Cpu).unwrap();
            model.project(&model.encode(&image).unwrap()).unwrap()
        })
        .collect();
    let contact = |window: &Vec<usize>| {
        let frames: Vec<&Tensor> = window.iter().map(|frame| &projected[*frame]).collect();
        let (_, logits) = model.heads(&model.fuse(&Tensor::stack(&frames, 1).unwrap()).unwrap()).unwrap();
        let logits = logits.flatten_all().unwrap().to_vec1::<f32>().unwrap();
        logits.into_iter().map(|x| (1.0 / (1.0 + (-f64::from(x)).exp())) as f32).collect()
    };
    windows.iter().map(contact).collect()
}

fn stream(model: &EgoTac, stamps: &[f64], frame_dt: f64) -> Vec<Vec<f32>> {
    let metadata = Metadata::new("toy", 1.0, frame_dt);
    let checkpoint = Checkpoint::new(model.clone(), metadata);
    let mut predictor = Predictor::new(checkpoint, Options::default()).unwrap();
    let contact = |(i, stamp): (usize, &f64)| predictor.push_prepared(pixels(i), *stamp).unwrap().field.contact;
    stamps.iter().enumerate().map(contact).collect()
}

fn distance(a: &[f32], b: &[f32]) -> f32 {
    a.iter().zip(b).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max)
}

/// Stamps of a camera at `rate`, in Hz: regular, with jitter of a quarter of the interval, or with dropped frames.
fn stamps(rate: f64, start: f64, disturbance: &str) -> Vec<f64> {
    let random = |i: usize| (i * 7919 % 1013) as f64 / 1013.0;
    let all = 0..FRAMES;
    match disturbance {
        "regular" => all.map(|i| start + i as f64 / rate).collect(),
        "jitter" => all.map(|i| start + (i as f64 + 0.5 * (random(i) - 0.5)) / rate).collect(),
        "gaps" => all.filter(|i| random(*i) > 0.3).map(|i| start + i as f64 / rate).collect(),
        other => panic!("{other}"),
    }
}

#[test]
fn a_stream_and_a_batch_choose_the_same_frames() {
    let model = network();
    let mut differences = Vec::new();
    for rate in [25.0, 30.0, 60.0] {
        for frame_dt in [0.1, 0.12] {
            for (start, disturbance) in [(0.0, "regular"), (0.0, "jitter"), (0.0, "gaps"), (1.7e9, "regular")] {
                let stamps = stamps(rate, start, disturbance);
                let windows: Vec<Vec<usize>> =
                    (0..stamps.len()).map(|newest| sampler::window(&stamps, 0, newest, HORIZON, frame_dt)).collect();
                let (batch, stream) = (batch(&model, &windows), stream(&model, &stamps, frame_dt));
                let apart = batch.windows(2).map(|pair| distance(&pair[0], &pair[1])).fold(f32::MAX, f32::min);
                // Ten times the tolerance below: a window of other frames cannot pass for the same.
                assert!(apart > 1e-5, "outputs of different frames differ by {apart} only");
                let differ = batch.iter().zip(&stream).filter(|(batch, stream)| distance(batch, stream) > 1e-6).count();
                if differ > 0 {
                    let count = stamps.len();
                    differences.push(format!(
                        "{rate} Hz, frame_dt {frame_dt} s, {disturbance} from {start} s: {differ} of {count} windows"
                    ));
                }
            }
        }
    }
    assert!(differences.is_empty(), "{}", differences.join("\n"));
}
