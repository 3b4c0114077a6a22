//! `egotac label` on images unlike those of the network's training: touch is unknown in every format, and the user is told.

use std::fs;
use std::path::Path;

use crate::common::egotac;
use egotac::dataset::Labelled;
use egotac::dataset::zarr::{MANO_CONTACT_VALID, MANO_FORCE, MANO_FORCE_VALID, ZarrReader};
use egotac::tactile::N_FIELD;
use image::{Rgb, RgbImage};
use serde_json::Value;

const IMAGES: usize = 12;

/// Writes images of noise, which hold no hand.
fn write_noise(folder: &Path) {
    fs::create_dir_all(folder).unwrap();
    for index in 0..IMAGES as u32 {
        let byte = |x: u32, y: u32, c: u32| {
            let mixed = (x * 7919 + y * 104_729 + c * 15_485_863 + index * 31).wrapping_mul(2_654_435_761);
            (mixed >> 24) as u8
        };
        let image = RgbImage::from_fn(96, 72, |x, y| Rgb([byte(x, y, 0), byte(x, y, 1), byte(x, y, 2)]));
        image.save(folder.join(format!("frame_{index}.png"))).unwrap();
    }
}

fn run(arguments: &[&str]) -> (String, String) {
    let output = egotac(arguments);
    let [out, err] = [output.stdout, output.stderr].map(|bytes| String::from_utf8(bytes).unwrap());
    assert!(output.status.success(), "{arguments:?}: {out}{err}");
    (out, err)
}

#[test]
fn touch_in_unfamiliar_images_is_unknown_in_every_format_and_form() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name).to_str().unwrap().to_string();
    write_noise(Path::new(&at("in")));
    for unknown in ["nan", "zero", "guess"] {
        for (kind, out) in [("store", "a.zarr"), ("tensors", "b.safetensors"), ("bag", "c")] {
            let out = at(&format!("{unknown}_{out}"));
            let more = ["--to", kind, "--fps", "20", "--unknown", unknown, "--json", "-"];
            let (json, _) = run(&[&["label", &at("in"), "--out", &out], &more[..]].concat());
            let json: Value = serde_json::from_str(&json).unwrap();
            assert_eq!(json["summary"]["unfamiliar"], IMAGES, "{unknown} {kind}: {json}");
            let labelled = Labelled::read(Path::new(&out)).unwrap();
            let rule = labelled.info.unwrap().provenance.doubt.unwrap();
            assert_eq!((rule.unknown.name(), rule.familiarity), (unknown, Some(0.02)));
            assert_eq!(labelled.labels.familiarity.len(), IMAGES, "{unknown} {kind}");
            assert!(labelled.labels.familiarity.iter().all(|familiarity| *familiarity < 0.02));
            // Readers make zeros unknown again.
            let is_nan = unknown != "guess";
            for values in [&labelled.labels.force, &labelled.labels.contact] {
                assert_eq!(values.len(), IMAGES * N_FIELD);
                assert!(values.iter().all(|value| value.is_nan() == is_nan), "{unknown} {kind}");
            }
        }
        let store = ZarrReader::open(Path::new(&at(&format!("{unknown}_a.zarr")))).unwrap();
        for name in [MANO_FORCE_VALID, MANO_CONTACT_VALID] {
            let valid = u8::from(unknown == "guess");
            assert_eq!(store.read_u8(name, 0..IMAGES).unwrap(), vec![valid; IMAGES * N_FIELD], "{unknown} {name}");
        }
        if unknown == "zero" {
            assert_eq!(store.read_f32(MANO_FORCE, 0..IMAGES).unwrap(), vec![0.0; IMAGES * N_FIELD]);
        }
    }
}

#[test]
fn summary_and_report_warn_of_many_unfamiliar_images() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name).to_str().unwrap().to_string();
    write_noise(Path::new(&at("in")));
    let (text, _) = run(&["label", &at("in"), "--out", &at("a.zarr")]);
    assert!(text.contains("unfamiliar: 100.0 % of the images"), "{text}");
    assert!(text.contains("warning: 100.0 % of the images are unlike those"), "{text}");
    assert!(text.contains("touch is unknown in all of them") && !text.contains("touched"), "{text}");
    assert!(!text.contains("labels of the others"), "{text}");
    run(&["report", &at("a.zarr"), "--out", &at("page.html")]);
    assert!(fs::read_to_string(at("page.html")).unwrap().contains("<p id=\"warning\""));
    let (_, warning) = run(&["predict", "--data", &at("in"), "--out", &at("fields")]);
    assert!(warning.contains("unlike those"), "{warning}");
}
