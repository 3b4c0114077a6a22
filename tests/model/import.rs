//! A table converts another program's checkpoint, or each mismatch is named.

use crate::common::model_data;
use candle_core::{DType, Device};
use egotac::model::import::Mapping;
use egotac::model::{Checkpoint, checkpoint};

const TABLE: &str = include_str!("../data/model/foreign.yaml");

fn mapping(text: &str) -> egotac::Result<Mapping> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("mapping.yaml");
    std::fs::write(&path, text).unwrap();
    Mapping::read(&path)
}

#[test]
fn a_pytorch_file_gives_the_outputs_it_was_saved_with() {
    let (config, metadata, tensors) = mapping(TABLE).unwrap().apply(&model_data("foreign.pth")).unwrap();
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
        assert!(TABLE.contains(from));
        let error =
            mapping(&TABLE.replace(from, to)).and_then(|mapping| mapping.apply(&model_data("foreign.pth")).map(drop));
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
        assert!(TABLE.contains(from), "{from}");
        let error = mapping(&TABLE.replacen(from, to, 1)).unwrap_err().to_string();
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
