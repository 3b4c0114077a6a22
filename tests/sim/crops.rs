//! From a store of whole pictures to a network that sees single hands, and back to labels of the whole pictures.

use std::path::Path;

use candle_core::Device;
use egotac::dataset::zarr::{ZarrReader, read_labels};
use egotac::hand::Side;
use egotac::image::Framing;
use egotac::model::Checkpoint;
use egotac::tactile::N_FIELD;

use crate::common::{egotac, refused};

fn run(arguments: &[&str]) -> String {
    let output = egotac(arguments);
    assert!(output.status.success(), "{arguments:?}: {}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8_lossy(&output.stdout).into_owned()
}

/// Force and touched vertices of each hand in each frame of a store, in the order left, right.
fn touch(store: &Path) -> Vec<[(f32, usize); 2]> {
    let reader = ZarrReader::open(store).unwrap();
    let labels = read_labels(&reader, 0..reader.len()).unwrap();
    let of = |frame: usize, side: Side| {
        let row = |values: &[f32]| values[frame * N_FIELD..(frame + 1) * N_FIELD][side.range()].to_vec();
        let touched = row(&labels.contact).iter().filter(|contact| **contact > 0.5).count();
        (row(&labels.force).iter().sum(), touched)
    };
    (0..reader.len()).map(|frame| Side::BOTH.map(|side| of(frame, side))).collect()
}

#[test]
fn a_network_of_single_hands_is_trained_on_squares_and_labels_whole_pictures() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    let text = |name: &str| path(name).to_str().unwrap().to_owned();
    let (store, crops) = (text("whole.zarr"), text("hands.zarr"));
    run(&["sim", "run", "hold_plate", "--seed", "4", "--size", "64", "--out", &store]);
    let told = run(&["data", "crop", &store, "--out", &crops, "--size", "56"]);

    // The one hand of the scene, in the place of the right one, with all of its touch and none beside it.
    let (whole, single) = (touch(&path("whole.zarr")), touch(&path("hands.zarr")));
    assert_eq!(whole.len(), single.len());
    assert!(told.contains(&format!("{} pictures", whole.len())), "{told}");
    assert!(whole.iter().any(|hands| hands[0].1 + hands[1].1 > 0));
    for (whole, single) in whole.iter().zip(&single) {
        assert_eq!(single[0], (0.0, 0));
        assert_eq!((single[1].0, single[1].1), (whole[0].0 + whole[1].0, whole[0].1 + whole[1].1));
    }
    let reader = ZarrReader::open(&path("hands.zarr")).unwrap();
    assert_eq!((reader.framing().unwrap(), reader.image_size()), (Framing::Hands, (56, 56)));
    assert!(refused(&["data", "crop", &crops, "--out", &text("twice.zarr")], "single hands").contains("hands.zarr"));

    let config = text("train.yaml");
    let yaml = |data: &str| {
        format!("name: single\ndata: [{data}]\nout: {}\nmodel: toy\nseed: 1\nsteps: 2\nthreads: 1\n", text("run"))
    };
    std::fs::write(&config, yaml(&format!("{store}, {crops}"))).unwrap();
    let error = refused(&["train", "--config", &config], "input");
    assert!(error.contains("expected frame, got hands"), "{error}");
    std::fs::write(&config, yaml(&crops)).unwrap();
    run(&["train", "--quiet", "--config", &config]);
    let network = path("run").join("checkpoint.safetensors");
    assert_eq!(Checkpoint::load(&network, &Device::Cpu).unwrap().metadata.framing, Framing::Hands);

    // The shipped network finds the hands; labels are on the frames of the whole pictures.
    let labelled = text("labelled.zarr");
    let network = network.to_str().unwrap();
    run(&["label", &store, "--checkpoint", network, "--locator", "shipped", "--unknown", "guess", "--out", &labelled]);
    assert_eq!(ZarrReader::open(&path("labelled.zarr")).unwrap().len(), whole.len());
    refused(
        &["label", &store, "--checkpoint", network, "--locator", network, "--out", &text("no.zarr")],
        "single hands",
    );
}
