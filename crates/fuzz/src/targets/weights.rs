//! Files of tensors: safetensors with their metadata, PyTorch archives.

use std::path::Path;

use candle_core::Device;
use egotac::Result;
use egotac::dataset::Labelled;
use egotac::model::pretrained::{self, InitOptions};
use egotac::model::{Checkpoint, Config, checkpoint};
use serde_json::{Value, json};

use super::seed;
use crate::case::Case;
use crate::mutate::{self, Rng, archive, below, chance, extreme, json, often, pick};

/// Reads the file as a checkpoint, as a published encoder, as tensors and as labels.
pub fn read(path: &Path, _scratch: &Path) -> Result<()> {
    let results = [
        Checkpoint::load(path, &Device::Cpu).map(drop),
        checkpoint::geometry(path).map(drop),
        pretrained::init(path, &InitOptions::default()).map(drop),
        checkpoint::read_tensors(path).map(drop),
        Labelled::read(path).map(drop),
    ];
    results.into_iter().reduce(Result::or).unwrap_or(Ok(()))
}

/// Makes a header that lies about geometry, shapes, types or places.
pub fn safetensors(rng: &mut Rng) -> Case {
    let mut header = match below(rng, 3) {
        0 => checkpoint_header(rng),
        1 => encoder_header(rng),
        _ => seed_header(rng),
    };
    for _ in 0..below(rng, 3) {
        json::change(rng, &mut header);
    }
    let mut text = header.to_string();
    if chance(rng, 0.05) {
        text = json::change_text(rng, &text);
    }
    let mut file = often(rng, text.len() as i64).to_le_bytes().to_vec();
    file.extend(text.bytes());
    file.extend(vec![0; *pick(rng, &[0, 4, 64, 4096])]);
    Case::File(file)
}

/// A checkpoint of ours whose geometry may be extreme, with few tensors or none.
fn checkpoint_header(rng: &mut Rng) -> Value {
    let mut config: Value = serde_json::from_str(&Config::toy().to_json()).unwrap_or_default();
    let names: Vec<String> = config.as_object().map(|map| map.keys().cloned().collect()).unwrap_or_default();
    for _ in 0..1 + below(rng, 4) {
        let name = pick(rng, &names).clone();
        config[name] = json!(if chance(rng, 0.5) { extreme(rng) } else { *pick(rng, &[4096, 16_384, 14, 96, 7]) });
    }
    json!({
        "__metadata__": { "config": config.to_string(), "format": "pt" },
        "queries": { "dtype": "F32", "shape": [1, 1], "data_offsets": [0, 4] },
    })
}

/// A published encoder that promises layers, width and places by names and empty tensors.
fn encoder_header(rng: &mut Rng) -> Value {
    let width = often(rng, 64);
    let positions = often(rng, 17);
    let mut header = json!({
        "embeddings.cls_token": tensor(&[1, 1, width]),
        "embeddings.patch_embeddings.projection.weight": tensor(&[width, 3, often(rng, 14), often(rng, 14)]),
        "embeddings.position_embeddings": tensor(&[1, positions, width]),
    });
    for layer in 0..*pick(rng, &[1, 12, 96, 1000]) {
        header[format!("encoder.layer.{layer}.norm1.weight")] = tensor(&[0]);
    }
    header
}

fn tensor(shape: &[i64]) -> Value {
    let size = shape.iter().fold(4i64, |size, side| size.wrapping_mul(*side));
    json!({ "dtype": "F32", "shape": shape, "data_offsets": [0, size] })
}

/// The header of a checkpoint of the tests.
fn seed_header(rng: &mut Rng) -> Value {
    let names = ["toy_0_weights", "pretrained_plain", "pretrained_registers", "other_0_weights"];
    let file = seed(&format!("tests/data/model/{}.safetensors", pick(rng, &names)));
    let length = u64::from_le_bytes(file[..8].try_into().unwrap_or_default()) as usize;
    serde_json::from_slice(&file[8..8 + length]).unwrap_or_default()
}

/// Makes a PyTorch archive whose tensors lie about storage, offset, size or stride.
pub fn pt(rng: &mut Rng) -> Case {
    let names = ["w", "embeddings.cls_token", "queries"];
    let kinds = ["FloatStorage", "HalfStorage", "BFloat16Storage", "LongStorage", "DoubleStorage", "OddStorage"];
    let mut pickle = b"\x80\x02}(".to_vec();
    for _ in 0..1 + below(rng, 3) {
        text(&mut pickle, pick::<&str>(rng, &names));
        pickle.extend(b"ctorch._utils\n_rebuild_tensor_v2\n((");
        text(&mut pickle, "storage");
        pickle.extend(format!("ctorch\n{}\n", pick(rng, &kinds)).bytes());
        text(&mut pickle, pick::<&str>(rng, &["0", "1", "../0"]));
        text(&mut pickle, "cpu");
        pickle.extend(mutate::pickle::integer(often(rng, 4)));
        pickle.extend(b"tQ");
        pickle.extend(mutate::pickle::integer(often(rng, 0)));
        let rank = *pick(rng, &[0, 1, 2, 2, 2, 3, 70, 5000]);
        for side in [2, 1] {
            pickle.push(b'(');
            for _ in 0..if chance(rng, 0.1) { below(rng, 4) } else { rank } {
                pickle.extend(mutate::pickle::integer(often(rng, side)));
            }
            pickle.push(b't');
        }
        pickle.extend(b"\x89ccollections\nOrderedDict\n)RtR");
    }
    pickle.extend(b"u.");
    if chance(rng, 0.5) {
        pickle = mutate::pickle::change(rng, &pickle);
    }
    let members = [
        ("archive/data.pkl".to_string(), pickle),
        ("archive/version".to_string(), b"3\n".to_vec()),
        ("archive/data/0".to_string(), vec![0; *pick(rng, &[0, 8, 16, 16, 16, 64])]),
    ];
    Case::File(archive::zip(rng, &members))
}

fn text(pickle: &mut Vec<u8>, text: &str) {
    pickle.push(b'X');
    pickle.extend((text.len() as u32).to_le_bytes());
    pickle.extend(text.bytes());
}
