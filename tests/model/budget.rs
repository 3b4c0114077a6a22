//! A latency budget chooses the best network that meets it, and reports which and why.

use std::path::{Path, PathBuf};

use candle_core::Device;
use candle_nn::VarMap;
use egotac::model::predictor::Options;
use egotac::model::{Checkpoint, Config, EgoTac, Metadata, Precision, budget, init};

fn save(folder: &Path, name: &str, config: &Config) -> PathBuf {
    let vars = VarMap::new();
    EgoTac::new(config, init::var_builder(&vars, 1, &Device::Cpu)).unwrap();
    let path = folder.join(name);
    Checkpoint::save(&path, config, &Metadata::new(name, 1.0, 0.04), &vars).unwrap();
    path
}

#[test]
fn a_generous_budget_chooses_the_largest_network_in_f32() {
    let folder = tempfile::tempdir().unwrap();
    let small = save(folder.path(), "a.safetensors", &Config::toy());
    let large = save(folder.path(), "b.safetensors", &Config::pocket());
    std::fs::write(folder.path().join("notes.txt"), "no checkpoint").unwrap();
    let paths = budget::candidates(folder.path()).unwrap();
    assert_eq!(paths, [small.clone(), large.clone()]);
    let (predictor, choice) = budget::pick(&paths, 60_000.0, &Options::default()).unwrap();
    assert_eq!(predictor.config(), &Config::pocket());
    assert_eq!((&choice.chosen.path, choice.chosen.precision, choice.fits), (&large, Precision::F32, true));
    assert!(choice.too_slow.is_empty());
    let text = choice.to_string();
    assert!(text.contains("b.safetensors in f32") && text.contains("best that keeps the budget of 60000 ms"), "{text}");
}

#[test]
fn a_budget_that_nothing_meets_chooses_the_fastest_and_says_so() {
    let folder = tempfile::tempdir().unwrap();
    let paths = ["a.safetensors", "b.safetensors"]
        .map(|name| save(folder.path(), name, &if name.starts_with('a') { Config::toy() } else { Config::pocket() }));
    let (predictor, choice) = budget::pick(&paths, 1e-6, &Options::default()).unwrap();
    assert!(!choice.fits);
    assert_eq!(choice.too_slow.len(), 3, "two networks in two precisions, less the chosen one");
    assert!(choice.too_slow.iter().all(|tried| tried.latency_ms >= choice.chosen.latency_ms));
    assert_eq!((predictor.config(), predictor.cached_frames()), (&Config::toy(), 0));
    let text = choice.to_string();
    assert!(text.contains("nothing keeps the budget") && text.contains("too slow: "), "{text}");
}

#[test]
fn a_folder_without_checkpoints_is_an_error() {
    let folder = tempfile::tempdir().unwrap();
    assert!(budget::candidates(folder.path()).unwrap_err().to_string().contains("has no *.safetensors"));
    let absent = folder.path().join("absent.safetensors");
    assert_eq!(budget::candidates(&absent).unwrap(), std::slice::from_ref(&absent));
    assert!(budget::pick(&[absent], 10.0, &Options::default()).unwrap_err().to_string().contains("absent"));
    assert!(budget::pick(&[], 10.0, &Options::default()).unwrap_err().to_string().contains("at least one"));
}
