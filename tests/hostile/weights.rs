//! Files of weights and hand models that promise more than they hold are refused before memory is allocated.

use std::fs;
use std::path::{Path, PathBuf};

use crate::common::{egotac_bounded, refused};
use egotac::model::Config;
use serde_json::{Value, json};
use tempfile::TempDir;

struct Files(TempDir);

impl Files {
    fn new() -> Self {
        Self(tempfile::tempdir().unwrap())
    }

    fn write(&self, name: &str, content: &[u8]) -> PathBuf {
        let path = self.0.path().join(name);
        fs::write(&path, content).unwrap();
        path
    }

    fn out(&self) -> String {
        self.0.path().join("out.safetensors").display().to_string()
    }
}

fn text(path: &Path) -> &str {
    path.to_str().unwrap()
}

/// Returns a safetensors file of this header and so many bytes of zeros.
fn safetensors(header: &Value, size: usize) -> Vec<u8> {
    let header = header.to_string();
    [&(header.len() as u64).to_le_bytes(), header.as_bytes(), &vec![0; size]].concat()
}

/// Returns a checkpoint without tensors that promises this geometry.
fn promise(config: &Value) -> Vec<u8> {
    let metadata = json!({
        "name": "x", "topology": "egotac-hand-1", "force_scale": "1", "has_force": "true", "frame_dt": "0.04",
        "resize": "crop", "filter": "triangle", "mean": "[0,0,0]", "std": "[1,1,1]", "training": "",
        "config": config.to_string(),
    });
    safetensors(&json!({ "__metadata__": metadata }), 0)
}

#[test]
fn a_checkpoint_that_promises_a_large_network_is_refused() {
    let files = Files::new();
    let toy: Value = serde_json::from_str(&Config::toy().to_json()).unwrap();
    let with = |changes: Value| {
        let mut config = toy.clone();
        config.as_object_mut().unwrap().extend(changes.as_object().unwrap().clone());
        config
    };
    for (name, config, word) in [
        ("grid", with(json!({ "image": 4096, "patch": 1, "pretrain_image": 4095 })), "config.image"),
        ("patch", with(json!({ "image": 4096, "patch": 4096, "pretrain_image": 4096 })), "EGOTAC_LIMIT_PARAMETERS"),
        ("window", with(json!({ "image": 64, "patch": 1, "pretrain_image": 64, "horizon": 256 })), "config.horizon"),
        (
            "largest",
            with(
                json!({ "vision_width": 8192, "vision_heads": 1, "vision_depth": 96, "width": 8192, "heads": 1, "depth": 96 }),
            ),
            "EGOTAC_LIMIT_PARAMETERS",
        ),
        ("wide", with(json!({ "vision_width": 4096, "vision_heads": 1, "width": 4096, "heads": 1 })), "do not fit"),
    ] {
        let path = files.write(&format!("{name}.safetensors"), &promise(&config));
        for command in ["info", "half"] {
            let out = files.out();
            let mut arguments = vec!["model", command, "--checkpoint", text(&path)];
            arguments.extend(if command == "half" { vec!["--out", &out] } else { vec![] });
            refused(&arguments, word);
        }
    }
    assert!(!Path::new(&files.out()).exists());
}

#[test]
fn a_published_encoder_that_promises_many_layers_is_refused() {
    let files = Files::new();
    let (mut header, mut size) = (serde_json::Map::new(), 0);
    let mut add = |name: String, shape: Vec<usize>| {
        let bytes = 2 * shape.iter().product::<usize>();
        header.insert(name, json!({ "dtype": "F16", "shape": shape, "data_offsets": [size, size + bytes] }));
        size += bytes;
    };
    add("embeddings.cls_token".into(), vec![1, 1, 1024]);
    add("embeddings.patch_embeddings.projection.weight".into(), vec![1, 3, 1, 14]);
    add("embeddings.position_embeddings".into(), vec![1, 2, 1]);
    (0..40).for_each(|layer| add(format!("encoder.layer.{layer}.norm1.weight"), vec![1]));
    let path = files.write("dinov2.safetensors", &safetensors(&Value::Object(header), size));
    refused(
        &["model", "init", "--encoder", text(&path), "--out", &files.out()],
        "expected [1, 2, 1024], found [1, 2, 1]",
    );
}

#[test]
fn tables_and_growth_beyond_any_network_are_refused() {
    let files = Files::new();
    let table = |width: usize, depth: usize| {
        format!(
            "config: {{ vision_width: 48, vision_depth: 2, vision_heads: 3, width: {width}, depth: {depth}, heads: 4,\n  \
             image: 56, patch: 14, pretrain_image: 70, horizon: 3, predict: 2 }}\n\
             sidecar: {{ name: x, topology: mano, fps: 30 }}\nsame: true\n"
        )
    };
    let weights = files.write("empty.safetensors", &safetensors(&json!({}), 0));
    for (width, depth, word) in [(8192, 96, "EGOTAC_LIMIT_PARAMETERS"), (4096, 4, "do not fit")] {
        let path = files.write("table.yaml", table(width, depth).as_bytes());
        refused(
            &["model", "import", "--checkpoint", text(&weights), "--mapping", text(&path), "--out", &files.out()],
            word,
        );
    }
    let shipped = concat!(env!("CARGO_MANIFEST_DIR"), "/models/egotac.safetensors");
    let grown = ["model", "grow", "--checkpoint", shipped, "--width", "8192", "--depth", "96", "--out", &files.out()];
    refused(&grown, "EGOTAC_LIMIT_PARAMETERS");
}

#[test]
fn special_files_are_refused_as_weights() {
    let files = Files::new();
    let pipe = files.0.path().join("pipe");
    assert!(std::process::Command::new("mkfifo").arg(&pipe).status().unwrap().success());
    for path in [text(&pipe), "/dev/zero"] {
        refused(&["model", "info", "--checkpoint", path], "expected a regular file");
        refused(&["hand", "show", "--model", path, "--out", &files.out()], "expected a regular file");
    }
}

#[test]
fn hostile_hand_models_are_refused() {
    let files = Files::new();
    let name = [&b"X"[..], &100_000u32.to_le_bytes(), b"numpy.", &[b'a'; 99_994]].concat();
    let header = format!("{{'descr': '|u1', 'fortran_order': True, 'shape': ({}), }}\n", "1,".repeat(60_000));
    let npy = [&b"\x93NUMPY\x02\x00"[..], &(header.len() as u32).to_le_bytes(), header.as_bytes(), &[0]].concat();
    let mut npz = zip::ZipWriter::new(std::io::Cursor::new(Vec::new()));
    npz.start_file("v_template.npy", zip::write::SimpleFileOptions::default()).unwrap();
    std::io::Write::write_all(&mut npz, &npy).unwrap();
    for (file, content, word) in [
        ("marks.pkl", vec![b'('; 12 << 20], "bytes of memory"),
        ("memo.pkl", [&b"N"[..], &vec![0x94; 3 << 20]].concat(), "bytes of memory"),
        (
            "names.pkl",
            [&name[..], b"q\0", &name, b"q\x01", &b"h\0h\x01\x93".repeat(20_000)].concat(),
            "bytes of memory",
        ),
        ("rank.npz", npz.finish().unwrap().into_inner(), "at most 32 dimensions"),
    ] {
        let path = files.write(file, &content);
        refused(&["hand", "show", "--model", text(&path), "--out", &files.out()], word);
    }
}

#[test]
fn the_shipped_network_loads_within_the_bounds_of_these_tests() {
    let shipped = concat!(env!("CARGO_MANIFEST_DIR"), "/models/egotac.safetensors");
    let output = egotac_bounded(&["model", "info", "--checkpoint", shipped]);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
}
