//! The network: extreme inputs, weights and stamps.

use std::collections::BTreeMap;

use ::image::{Rgb, RgbImage};
use candle_core::{DType, Device, Tensor};
use candle_nn::{VarBuilder, VarMap};
use egotac::error::Result;
use egotac::model::predictor::{Options, Predictor};
use egotac::model::{Checkpoint, Config, EgoTac, Metadata, Precision, init};

use super::{Family, HardCase, Outcome};

pub(super) const CASES: &[HardCase] = &[
    Family::Network.case(
        "weight_infinite",
        "an infinite weight in each of the 10 layers of a network",
        "finite weights",
        weight,
    ),
    Family::Network.case("input_1e6", "noise of amplitude 1e6 in place of a picture", "a picture", input_1e6),
    Family::Network.case("input_1e30", "noise of amplitude 1e30 in place of a picture", "a picture", input_1e30),
    Family::Network.case("one_colour", "pictures that are all black, all white, one colour", "none needed", colours),
    Family::Network.case("stamp_not_a_number", "an image whose stamp is NaN or infinite", "a stamp in seconds", stamps),
    Family::Network.case(
        "stamp_jumps_back",
        "a recording that is played a second time",
        "none needed: the stream restarts",
        jump_back,
    ),
];

/// One bias of each kind of layer.
const BIASES: [&str; 10] = [
    "encoder.embeddings.patch_embeddings.projection.bias",
    "encoder.encoder.layer.0.attention.output.dense.bias",
    "encoder.encoder.layer.1.mlp.fc2.bias",
    "encoder.layernorm.bias",
    "temporal.proj.bias",
    "temporal.norm_out.bias",
    "decoder.0.attn.out.bias",
    "decoder.1.mlp.fc2.bias",
    "force_head.bias",
    "contact_head.bias",
];

fn tensors() -> Result<BTreeMap<String, Tensor>> {
    let vars = VarMap::new();
    EgoTac::new(&Config::toy(), init::var_builder(&vars, 1, &Device::Cpu))?;
    let data = vars.data().lock().map_err(|_| egotac::Error::value("variables", "unlocked ones", "locked"))?;
    Ok(data.iter().map(|(name, var)| (name.clone(), var.as_tensor().clone())).collect())
}

fn layers(tensors: &BTreeMap<String, Tensor>) -> Result<EgoTac> {
    let map = tensors.iter().map(|(name, tensor)| (name.clone(), tensor.clone())).collect();
    EgoTac::new(&Config::toy(), VarBuilder::from_tensors(map, DType::F32, &Device::Cpu))
}

fn clip(size: f32) -> Result<Tensor> {
    let Config { horizon, image, .. } = Config::toy();
    let noise = |i: usize| size * ((i * 7919 % 2003) as f32 / 2003.0 - 0.5);
    let values = (0..horizon * 3 * image.pow(2)).map(noise).collect::<Vec<_>>();
    Ok(Tensor::from_vec(values, (1, horizon, 3, image, image), &Device::Cpu)?)
}

/// Counts the non-finite values in the outputs of all stages.
fn lost(model: &EgoTac, images: &Tensor) -> Result<f64> {
    let stages = model.stages(images)?;
    let mut count = 0;
    for stage in [stages.tokens, stages.z, stages.force, stages.contact_logits] {
        count += stage.flatten_all()?.to_vec1::<f32>()?.iter().filter(|x| !x.is_finite()).count();
    }
    Ok(count as f64)
}

/// Runs the plain layers, which have no guard, then the compiled network in each precision, which has one. Returns the
/// count of non-finite values of the plain layers and the report of the guard.
fn watched(tensors: &BTreeMap<String, Tensor>, images: &Tensor) -> Result<(f64, String)> {
    let unguarded = lost(&layers(tensors)?, images)?;
    let mut guard = String::new();
    for precision in Precision::ALL {
        match lost(&layers(tensors)?.compile(precision)?, images) {
            // A precision that lets the values pass must not hide behind the report of another.
            Ok(count) if count > 0.0 => return Ok((unguarded, String::new())),
            Ok(_) => {}
            Err(error) => guard = error.to_string(),
        }
    }
    Ok((unguarded, guard))
}

fn outcome(unguarded: f64, guard: String, (remedied, remedied_guard): (f64, String)) -> Outcome {
    Outcome {
        error_of: "non-finite outputs",
        tolerance: 0.0,
        unguarded: Some(unguarded),
        guard,
        remedied,
        remedied_guard,
    }
}

fn weight() -> Result<Outcome> {
    let good = tensors()?;
    let images = clip(3.0)?;
    let (mut unguarded, mut report) = (0.0, String::new());
    for name in BIASES {
        let mut bias = good[name].flatten_all()?.to_vec1::<f32>()?;
        bias[3] = f32::INFINITY;
        let mut tensors = good.clone();
        tensors.insert(name.into(), Tensor::from_vec(bias, good[name].shape(), &Device::Cpu)?);
        let (lost, guard) = watched(&tensors, &images)?;
        unguarded += lost;
        if guard.is_empty() {
            report.clear();
            break;
        }
        report = guard;
    }
    Ok(outcome(unguarded, report, watched(&good, &images)?))
}

fn input_1e6() -> Result<Outcome> {
    let tensors = tensors()?;
    let (unguarded, guard) = watched(&tensors, &clip(1e6)?)?;
    Ok(outcome(unguarded, guard, watched(&tensors, &clip(1.0)?)?))
}

fn input_1e30() -> Result<Outcome> {
    let tensors = tensors()?;
    let (unguarded, guard) = watched(&tensors, &clip(1e30)?)?;
    Ok(outcome(unguarded, guard, watched(&tensors, &clip(1.0)?)?))
}

fn predictor() -> Result<Predictor> {
    let model = layers(&tensors()?)?.compile(Precision::F32)?;
    let metadata = Metadata::new("toy", 1.0, 0.1);
    Predictor::new(Checkpoint::new(model, metadata), Options::default())
}

fn colour(colour: [u8; 3]) -> RgbImage {
    RgbImage::from_pixel(32, 32, Rgb(colour))
}

fn colours() -> Result<Outcome> {
    let mut predictor = predictor()?;
    let mut lost = 0;
    for (second, one) in [[0; 3], [255; 3], [255, 0, 0], [127; 3]].into_iter().enumerate() {
        let field = predictor.push(&colour(one), second as f64)?.field;
        lost += field.force.iter().chain(&field.contact).filter(|x| !x.is_finite()).count();
    }
    Ok(outcome(lost as f64, String::new(), (0.0, String::new())))
}

fn stamps() -> Result<Outcome> {
    let mut predictor = predictor()?;
    let (through, guard) =
        super::accepted([f64::NAN, f64::INFINITY, -f64::INFINITY].map(|stamp| predictor.push(&colour([9; 3]), stamp)));
    let guard = if through > 0.0 { String::new() } else { guard };
    // The refused images must leave no state: the next one begins the stream.
    let remedied = match predictor.push(&colour([9; 3]), 1.0)?.restarted {
        true => 0.0,
        false => f64::NAN,
    };
    Ok(Outcome { error_of: "non-finite stamps accepted", ..outcome(through, guard, (remedied, String::new())) })
}

/// Checks that the second playback gives the same forces as the first.
fn jump_back() -> Result<Outcome> {
    let mut predictor = predictor()?;
    let mut run = || -> Result<(Vec<f32>, bool)> {
        let (mut forces, mut restarted) = (Vec::new(), false);
        for frame in 0..6 {
            let shown = predictor.push(&colour([40 * frame; 3]), f64::from(frame) * 0.1)?;
            restarted |= shown.restarted;
            forces.extend(shown.field.force);
        }
        Ok((forces, restarted))
    };
    let (first, again) = (run()?, run()?);
    let difference = first.0.iter().zip(&again.0).map(|(a, b)| f64::from((a - b).abs())).fold(0.0, f64::max);
    let guard = if again.1 { "`restarted` is set".to_string() } else { String::new() };
    let outcome = outcome(difference, guard, (difference, String::new()));
    Ok(Outcome { error_of: "force against the first playback, N", ..outcome })
}
