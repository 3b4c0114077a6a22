//! A grown network is the same function as the original, and its copies have uneven weights.

use std::collections::BTreeMap;
use std::path::Path;

use candle_core::{Device, Tensor};
use candle_nn::VarMap;
use egotac::model::checkpoint::{self, Stored};
use egotac::model::grow::{self, Growth};
use egotac::model::{Checkpoint, Config, EgoTac, Metadata, init};

type Tensors = BTreeMap<String, Tensor>;

/// A network with every tensor away from its initial value, so that AdaLN and LayerScale have an effect.
fn trained(config: &Config) -> Tensors {
    let vars = VarMap::new();
    EgoTac::new(config, init::var_builder(&vars, 5, &Device::Cpu)).unwrap();
    let vars = vars.data().lock().unwrap();
    let moved = |tensor: &Tensor| (tensor + tensor.randn_like(0.0, 0.1).unwrap()).unwrap();
    vars.iter().map(|(name, var)| (name.clone(), moved(var.as_tensor()))).collect()
}

fn grown(config: &Config, tensors: &Tensors, width: usize, vision_depth: usize, depth: usize) -> (Config, Tensors) {
    grow::grow(Path::new("a"), config, tensors, &Growth { width, vision_depth, depth, seed: 2 }).unwrap()
}

fn fields(config: &Config, tensors: &Tensors) -> [Vec<f32>; 2] {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.safetensors");
    Checkpoint::save_tensors(&path, config, &Metadata::new("a", 1.0, 0.04), tensors).unwrap();
    let values: Vec<f32> =
        (0..2 * 3 * 3 * 56 * 56).map(|i| (i as f32 * 0.37).sin() + (i as f32 * 0.0011).cos()).collect();
    let images = Tensor::from_vec(values, (2, 3, 3, 56, 56), &Device::Cpu).unwrap();
    let (model, _) = checkpoint::load_uncompiled(&path).unwrap();
    let (force, contact) = model.forward(&images).unwrap();
    [force, contact].map(|field| field.flatten_all().unwrap().to_vec1().unwrap())
}

fn relative_error(got: &[f32], want: &[f32]) -> f64 {
    assert_eq!(got.len(), want.len());
    let norm = |values: &mut dyn Iterator<Item = f32>| values.map(|x| f64::from(x).powi(2)).sum::<f64>().sqrt();
    norm(&mut got.iter().zip(want).map(|(a, b)| a - b)) / norm(&mut want.iter().copied())
}

#[test]
fn whole_copies_and_silent_layers_keep_the_function() {
    let config = Config::toy();
    let tensors = trained(&config);
    let want = fields(&config, &tensors);
    for (width, vision_depth, depth) in [(64, 2, 2), (96, 2, 2), (32, 3, 2), (32, 2, 5), (64, 5, 3)] {
        let (larger, more) = grown(&config, &tensors, width, vision_depth, depth);
        assert_eq!((larger.width, larger.vision_depth, larger.depth), (width, vision_depth, depth));
        assert_eq!(larger.heads * (config.width / config.heads), width);
        let elements: usize = more.values().map(|tensor| tensor.elem_count()).sum();
        assert_eq!(elements, checkpoint::parameter_count(&larger).unwrap());
        for (got, want) in fields(&larger, &more).iter().zip(&want) {
            let error = relative_error(got, want);
            assert!(error < 2e-5, "{width} wide, {vision_depth} + {depth} layers: {error:e}");
        }
    }
    // The measure detects a difference: without the weights of one copy, the function is another.
    let (larger, mut more) = grown(&config, &tensors, 64, 2, 2);
    let halves = more["force_head.weight"].narrow(1, 0, 32).unwrap().pad_with_zeros(1, 0, 32).unwrap();
    more.insert("force_head.weight".into(), halves);
    assert!(relative_error(&fields(&larger, &more)[0], &want[0]) > 0.1);
}

#[test]
fn copies_of_some_channels_keep_the_function_approximately() {
    let config = Config { width: 128, heads: 8, ..Config::toy() };
    let tensors = trained(&config);
    let want = fields(&config, &tensors);
    let (larger, more) = grown(&config, &tensors, 224, 2, 2);
    assert_eq!(larger.heads, 14);
    let errors: Vec<f64> =
        fields(&larger, &more).iter().zip(&want).map(|(got, want)| relative_error(got, want)).collect();
    assert!(errors.iter().all(|error| (1e-4..0.3).contains(error)), "{errors:?}");
}

#[test]
fn copies_divide_weights_unevenly_by_the_seed() {
    let config = Config::toy();
    let tensors = trained(&config);
    let (_, more) = grown(&config, &tensors, 64, 2, 2);
    let rows = more["contact_head.weight"].to_vec2::<f32>().unwrap();
    let old = tensors["contact_head.weight"].to_vec2::<f32>().unwrap();
    let apart = |i: usize, j: usize| (rows[i][j] - rows[i][j + 32]).abs();
    assert!((0..rows.len()).all(|i| (0..32).all(|j| (rows[i][j] + rows[i][j + 32] - old[i][j]).abs() < 1e-6)));
    let even = (0..rows.len()).flat_map(|i| (0..32).map(move |j| (i, j))).filter(|(i, j)| apart(*i, *j) < 1e-6);
    assert!(even.count() < rows.len() * 32 / 100);
    let bytes = |tensors: &Tensors| tensors["contact_head.weight"].flatten_all().unwrap().to_vec1::<f32>().unwrap();
    assert_eq!(bytes(&more), bytes(&grown(&config, &tensors, 64, 2, 2).1));
    let other = Growth { width: 64, vision_depth: 2, depth: 2, seed: 3 };
    assert_ne!(bytes(&more), bytes(&grow::grow(Path::new("a"), &config, &tensors, &other).unwrap().1));
}

#[test]
fn smaller_sizes_and_split_heads_are_refused() {
    let config = Config::toy();
    let tensors = trained(&config);
    let refused = |width, vision_depth, depth| {
        let growth = Growth { width, vision_depth, depth, seed: 0 };
        grow::grow(Path::new("a.safetensors"), &config, &tensors, &growth).unwrap_err().to_string()
    };
    let errors = [refused(24, 2, 2), refused(32, 1, 2), refused(32, 2, 1), refused(36, 2, 2), refused(80_000, 2, 2)];
    let expected = ["at least the 32 of a.safetensors", "vision_depth", "depth", "heads' 8 channels", "config.width"];
    for (error, expected) in errors.iter().zip(expected) {
        assert!(error.contains(expected), "{expected}: {error}");
    }
    let mut other = tensors.clone();
    other.remove("norm.bias");
    let growth = Growth { width: 64, vision_depth: 2, depth: 2, seed: 0 };
    let error = grow::grow(Path::new("a.safetensors"), &config, &other, &growth).unwrap_err().to_string();
    assert!(error.contains("norm.bias: expected [32], found none"), "{error}");
}

#[test]
fn f16_weights_keep_eleven_bits() {
    let folder = tempfile::tempdir().unwrap();
    let [whole, half] = ["whole", "half"].map(|name| folder.path().join(name));
    let (config, metadata) = (Config::toy(), Metadata::new("a", 3.5, 0.04));
    let mut tensors = trained(&config);
    Checkpoint::save_tensors(&whole, &config, &metadata, &tensors).unwrap();
    Checkpoint::save_as(&half, &config, &metadata, &tensors, Stored::F16).unwrap();
    let bytes = |path: &Path| path.metadata().unwrap().len();
    let elements = checkpoint::parameter_count(&config).unwrap() as u64;
    assert!((bytes(&whole) - bytes(&half)).abs_diff(2 * elements) < 1000, "{} {}", bytes(&whole), bytes(&half));
    let (read_config, read_metadata, read) = checkpoint::load_tensors(&half).unwrap();
    assert_eq!((read_config, read_metadata), (config.clone(), metadata.clone()));
    for (name, tensor) in &tensors {
        let [got, want] = [&read[name], tensor].map(|t| t.flatten_all().unwrap().to_vec1::<f32>().unwrap());
        // Half a unit of the last of 11 bits; below 2^-14, of the smallest step there is.
        let fits = |(a, b): (&f32, &f32)| (a - b).abs() <= (b.abs() / 2048.0).max(2_f32.powi(-25));
        assert!(got.iter().zip(&want).all(fits), "{name}");
    }
    let large = (&tensors["norm.bias"] * 1e6).unwrap();
    tensors.insert("norm.bias".into(), large);
    let error = Checkpoint::save_as(&half, &config, &metadata, &tensors, Stored::F16).unwrap_err().to_string();
    assert!(error.contains("norm.bias: expected at most 65504, found"), "{error}");
    assert_eq!(checkpoint::load_tensors(&half).unwrap().0, config, "the file of before is left");
}
