//! Published DINOv2 checkpoints, with and without register tokens, give the tokens of PyTorch.

use std::collections::HashMap;

use crate::common::{model_data, relative_error};
use candle_core::{DType, Device, Tensor};
use egotac::image::{Filter, Resize};
use egotac::model::pretrained::{self, InitOptions};
use egotac::model::{Checkpoint, Precision};

fn options() -> InitOptions {
    InitOptions { image: 56, horizon: 2, predict: 1, depth: 1, seed: 3 }
}

#[test]
fn tokens_agree_with_the_transformers_library() {
    let folder = tempfile::tempdir().unwrap();
    for (name, registers, pretrain_image) in [("plain", 0, 70), ("registers", 4, 98)] {
        let (config, metadata, tensors) =
            pretrained::init(&model_data(format!("pretrained_{name}.safetensors")), &options()).unwrap();
        assert_eq!((config.registers, config.pretrain_image, config.vision_width), (registers, pretrain_image, 64));
        assert_eq!((config.vision_depth, config.vision_heads, config.patch, config.tokens()), (2, 1, 14, 17));
        assert_eq!((metadata.resize, metadata.filter, metadata.has_force), (Resize::Centre, Filter::Bicubic, false));
        let path = folder.path().join(name);
        Checkpoint::save_tensors(&path, &config, &metadata, &tensors).unwrap();

        let activations = candle_core::safetensors::load(
            model_data(format!("pretrained_{name}_activations.safetensors")),
            &Device::Cpu,
        );
        let activations: HashMap<String, Tensor> = activations.unwrap();
        let images = activations["images"].to_dtype(DType::F32).unwrap();
        let (layers, _) = egotac::model::checkpoint::load_uncompiled(&path).unwrap();
        let compiled = Checkpoint::load(&path, &Device::Cpu).unwrap().model;
        for model in [&layers, &compiled] {
            let error = relative_error(&model.encode(&images).unwrap(), &activations["tokens"]);
            assert!(error < 1e-5, "{name}: {error:e}");
        }
        let int8 = Checkpoint::load_as(&path, &Device::Cpu, Precision::Int8).unwrap().model;
        let error = relative_error(&int8.encode(&images).unwrap(), &activations["tokens"]);
        assert!(error > 1e-5 && error < 0.05, "{name} in int8: {error:e}");
    }
}

#[test]
fn a_missing_or_misshapen_tensor_is_named_with_both_shapes() {
    let folder = tempfile::tempdir().unwrap();
    let whole = candle_core::safetensors::load(model_data("pretrained_plain.safetensors"), &Device::Cpu).unwrap();
    let refused = |change: &dyn Fn(&mut HashMap<String, Tensor>)| {
        let mut tensors = whole.clone();
        change(&mut tensors);
        let path = folder.path().join("changed.safetensors");
        candle_core::safetensors::save(&tensors, &path).unwrap();
        pretrained::init(&path, &options()).unwrap_err().to_string()
    };
    let lacks = refused(&|tensors| drop(tensors.remove("encoder.layer.1.norm2.bias")));
    assert!(lacks.contains("encoder.layer.1.norm2.bias: expected [64], found none"), "{lacks}");
    let misshapen = refused(&|tensors| {
        let name = "encoder.layer.0.mlp.fc1.weight";
        let half = tensors[name].narrow(0, 0, 100).unwrap().contiguous().unwrap();
        tensors.insert(name.into(), half);
    });
    assert!(misshapen.contains("mlp.fc1.weight: expected [256, 64], found [100, 64]"), "{misshapen}");
    let no_square = refused(&|tensors| {
        let name = "embeddings.position_embeddings";
        let fewer = tensors[name].narrow(1, 0, 20).unwrap().contiguous().unwrap();
        tensors.insert(name.into(), fewer);
    });
    assert!(no_square.contains("position_embeddings") && no_square.contains("20 places"), "{no_square}");
    let no_encoder = pretrained::init(&model_data("toy_0_weights.safetensors"), &options()).unwrap_err().to_string();
    assert!(no_encoder.contains("embeddings.cls_token: expected [1, 1, width], found none"), "{no_encoder}");
}

#[test]
fn the_published_preparation_is_a_resize_to_256_and_the_centre_224() {
    // An image whose colour encodes the position: the crop keeps the middle 224/256 of the shorter side.
    let picture = image::RgbImage::from_fn(640, 512, |x, y| image::Rgb([(x / 4) as u8, (y / 4) as u8, 0]));
    let out = egotac::image::resize(&picture, 224, Resize::Centre, Filter::Bicubic).unwrap();
    // Two source pixels per output pixel (512 to 256): output pixel i is centred at 2 (i + 16) + 1 of the shorter side.
    for i in [5u32, 100, 200] {
        let want_y = (2.0 * (f64::from(i) + 16.0) + 1.0) / 4.0;
        let want_x = (2.0 * (f64::from(i) + 16.0) + 1.0 + 64.0) / 4.0;
        let pixel = out.get_pixel(i, i).0;
        assert!(
            (f64::from(pixel[0]) - want_x).abs() < 1.1 && (f64::from(pixel[1]) - want_y).abs() < 1.1,
            "{i}: {pixel:?}"
        );
    }
}
