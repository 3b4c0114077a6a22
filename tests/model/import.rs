//! A table converts another program's checkpoint, or each mismatch is named.

use crate::common::model_data;
use candle_core::{DType, Device};
use egotac::model::import::Mapping;
use egotac::model::{Checkpoint, checkpoint};

const TABLE: &str = r#"
config: { vision_width: 40, vision_depth: 3, vision_heads: 5, width: 36, depth: 1, heads: 3, image: 48, patch: 8,
          pretrain_image: 24, horizon: 1, predict: 1 }
sidecar: { name: theirs, topology: mano, force_scale: 1.5, hand_order: right_left, fps: 30, frame_stride: 3,
           mean: [0.5, 0.5, 0.5], std: [0.25, 0.25, 0.25], resize: squash, filter: bicubic }
tensors:
  encoder.embeddings.cls_token: vision.embeddings.cls_token
  encoder.embeddings.position_embeddings: vision.embeddings.position_embeddings
  encoder.embeddings.patch_embeddings.projection.weight: vision.embeddings.patch_embeddings.projection.weight
  encoder.embeddings.patch_embeddings.projection.bias: vision.embeddings.patch_embeddings.projection.bias
  encoder.layernorm.weight: vision.layernorm.weight
  encoder.layernorm.bias: vision.layernorm.bias
  ENCODER
  temporal.proj.weight: { from: fuse.proj, transpose: true }
  decoder.{i}.attn.q.weight: { from: "decoder.{i}.attn.qkv.weight", part: [0, 3] }
  decoder.{i}.attn.k.weight: { from: "decoder.{i}.attn.qkv.weight", part: [1, 3] }
  decoder.{i}.attn.v.weight: { from: "decoder.{i}.attn.qkv.weight", part: [2, 3] }
  decoder.{i}.attn.q.bias: { from: "decoder.{i}.attn.qkv.bias", part: [0, 3] }
  decoder.{i}.attn.k.bias: { from: "decoder.{i}.attn.qkv.bias", part: [1, 3] }
  decoder.{i}.attn.v.bias: { from: "decoder.{i}.attn.qkv.bias", part: [2, 3] }
same: true
ignore: [vision.embeddings.mask_token]
"#;

fn table() -> String {
    let layer = [
        "norm1.weight",
        "norm1.bias",
        "norm2.weight",
        "norm2.bias",
        "attention.attention.query.weight",
        "attention.attention.query.bias",
        "attention.attention.key.weight",
        "attention.attention.key.bias",
        "attention.attention.value.weight",
        "attention.attention.value.bias",
        "attention.output.dense.weight",
        "attention.output.dense.bias",
        "layer_scale1.lambda1",
        "layer_scale2.lambda1",
        "mlp.fc1.weight",
        "mlp.fc1.bias",
        "mlp.fc2.weight",
        "mlp.fc2.bias",
    ];
    let lines = layer.map(|name| format!("encoder.encoder.layer.{{i}}.{name}: vision.encoder.layer.{{i}}.{name}"));
    TABLE.replace("ENCODER", &lines.join("\n  "))
}

fn mapping(text: &str) -> egotac::Result<Mapping> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("mapping.yaml");
    std::fs::write(&path, text).unwrap();
    Mapping::read(&path)
}

#[test]
fn a_pytorch_file_gives_the_outputs_it_was_saved_with() {
    let (config, metadata, tensors) = mapping(&table()).unwrap().apply(&model_data("foreign.pth")).unwrap();
    assert_eq!((metadata.force_scale, metadata.frame_dt, metadata.has_force), (1.5, 0.1, true));
    assert_eq!((metadata.topology.id(), metadata.mean, metadata.std), ("mano", [0.5; 3], [0.25; 3]));
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("imported.safetensors");
    Checkpoint::save_tensors(&path, &config, &metadata, &tensors).unwrap();
    let imported = Checkpoint::load(&path, &Device::Cpu).unwrap();
    assert_eq!(imported.metadata, metadata);
    // The same network under egotac's names, and the outputs that PyTorch computed with it.
    let ours = checkpoint::load_model(&model_data("other_0_weights.safetensors"), None, &Device::Cpu)
        .unwrap()
        .freeze()
        .unwrap();
    let activations =
        candle_core::safetensors::load(model_data("other_0_activations.safetensors"), &Device::Cpu).unwrap();
    let images = activations["images"].to_dtype(DType::F32).unwrap();
    let (force, contact) = imported.model.forward(&images).unwrap();
    let values = |t: &candle_core::Tensor| t.flatten_all().unwrap().to_vec1::<f32>().unwrap();
    assert_eq!(
        [values(&force), values(&contact)],
        [0, 1].map(|i| {
            let (force, contact) = ours.forward(&images).unwrap();
            values(if i == 0 { &force } else { &contact })
        })
    );
    for (got, want) in values(&force).iter().zip(values(&activations["force"])) {
        assert!((got - want).abs() < 1e-4, "{got} for {want}");
    }
}

#[test]
fn tensors_that_do_not_fit_are_named() {
    let fails = |from: &str, to: &str| {
        assert!(table().contains(from));
        let error =
            mapping(&table().replace(from, to)).and_then(|mapping| mapping.apply(&model_data("foreign.pth")).map(drop));
        error.unwrap_err().to_string()
    };
    let absent = fails("from: fuse.proj", "from: fuse.absent");
    assert!(absent.contains("temporal.proj.weight: expected [36, 40] in fuse.absent, found none"), "{absent}");
    assert!(absent.contains("fuse.proj [40, 36]: left over"), "{absent}");
    let on_its_side = fails(", transpose: true", "");
    assert!(
        on_its_side.contains("temporal.proj.weight: expected [36, 40] from fuse.proj, found [40, 36]"),
        "{on_its_side}"
    );
    let unnamed = fails("same: true", "same: false");
    assert!(unnamed.contains("the table does not name it"), "{unnamed}");
    let geometry = fails("width: 36,", "width: 72,");
    assert!(geometry.contains("tensors do not fit") && geometry.contains("and "), "{geometry}");
}

#[test]
fn a_table_with_a_mistake_is_refused() {
    for (from, to, named) in [
        ("topology: mano", "topology: glove", "glove"),
        ("force_scale: 1.5", "force_scale: -1", "force_scale"),
        ("fps: 30", "fps: 0", "frame_dt"),
        ("horizon: 1", "horizon: 0", "config.horizon"),
        ("same: true", "same: true\nsams: true", "sams"),
        ("part: [0, 3]", "part: [3, 3]", "part"),
        ("hand_order: right_left", "hand_order: upside_down", "hand_order"),
    ] {
        assert!(table().contains(from), "{from}");
        let error = mapping(&table().replacen(from, to, 1)).unwrap_err().to_string();
        assert!(error.contains(named) && error.contains("mapping.yaml"), "{to}: {error}");
    }
}

#[test]
fn code_in_a_pytorch_file_is_not_executed() {
    use std::io::Write;
    // protocol 2: os.system("touch MARK")
    let folder = tempfile::tempdir().unwrap();
    let (mark, path) = (folder.path().join("mark"), folder.path().join("evil.pth"));
    let command = format!("touch {}", mark.display());
    let mut pickle = b"\x80\x02cos\nsystem\nX".to_vec();
    pickle.extend((command.len() as u32).to_le_bytes());
    pickle.extend(command.as_bytes());
    pickle.extend(b"\x85R.");
    let mut zip = zip::ZipWriter::new(std::fs::File::create(&path).unwrap());
    let stored = zip::write::SimpleFileOptions::default().compression_method(zip::CompressionMethod::Stored);
    zip.start_file("evil/data.pkl", stored).unwrap();
    zip.write_all(&pickle).unwrap();
    zip.finish().unwrap();
    let error = checkpoint::read_tensors(&path).unwrap_err().to_string();
    assert!(error.contains("evil.pth"), "{error}");
    assert!(!mark.exists());
}
