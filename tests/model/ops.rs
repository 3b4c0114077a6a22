//! The fused operations agree with the plain ones, forward and backward, for any shape and magnitude.

use candle_core::{DType, Device, Result, Tensor, Var};
use egotac_kernels::ops::{self, plain};
use proptest::prelude::*;

/// An operation on f32 tensors in its fused form, and on f64 tensors in its plain one.
type Operation<'a> = &'a dyn Fn(&[Tensor]) -> Result<Tensor>;

/// Pseudo-random numbers that do not depend on the platform.
fn numbers(count: usize, seed: u64, scale: f32) -> Vec<f32> {
    let mut state = seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) | 1;
    let mut uniform = || {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        (state >> 40) as f32 / (1 << 24) as f32
    };
    (0..count).map(|_| scale * (uniform() + uniform() + uniform() + uniform() - 2.0) * 1.7).collect()
}

fn tensors(shapes: &[Vec<usize>], seed: u64, scale: f32) -> Vec<Tensor> {
    let tensor = |(i, shape): (usize, &Vec<usize>)| {
        let values = numbers(shape.iter().product(), seed + 1000 * i as u64, scale);
        Tensor::from_vec(values, shape.as_slice(), &Device::Cpu).unwrap()
    };
    shapes.iter().enumerate().map(tensor).collect()
}

fn values(tensor: &Tensor) -> Vec<f64> {
    tensor.to_dtype(DType::F64).unwrap().flatten_all().unwrap().to_vec1().unwrap()
}

/// Largest difference over the largest value.
fn error(got: &[f64], want: &[f64], least: f64) -> f64 {
    assert_eq!(got.len(), want.len());
    let largest = want.iter().fold(least, |a: f64, b| a.max(b.abs()));
    got.iter().zip(want).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max) / largest
}

/// The result, and the gradients of a weighted sum of it.
fn with_gradients(inputs: &[Tensor], operation: Operation) -> Vec<Vec<f64>> {
    let vars: Vec<Var> = inputs.iter().map(|t| Var::from_tensor(t).unwrap()).collect();
    let leaves: Vec<Tensor> = vars.iter().map(|var| var.as_tensor().clone()).collect();
    let result = operation(&leaves).unwrap();
    let weights = Tensor::from_vec(numbers(result.elem_count(), 77, 1.0), result.shape(), &Device::Cpu).unwrap();
    let loss = (&result * weights.to_dtype(result.dtype()).unwrap()).unwrap().sum_all().unwrap();
    let gradients = loss.backward().unwrap();
    let gradients = vars.iter().map(|var| values(gradients.get(var).unwrap()));
    std::iter::once(values(&result)).chain(gradients).collect()
}

fn assert_agree(name: &str, inputs: &[Tensor], fused: Operation, plain: Operation, tolerance: f64) {
    assert_agree_above(1e-30, name, inputs, fused, plain, tolerance);
}

/// As [`assert_agree`], for results that are differences of numbers of about 1: if these cancel, the error is relative to
/// `least`.
fn assert_agree_above(least: f64, name: &str, inputs: &[Tensor], fused: Operation, plain: Operation, tolerance: f64) {
    assert_agree_above_each([least; 2], name, inputs, fused, plain, tolerance);
}

/// As [`assert_agree_above`], with one least size for the result and another for the gradients.
fn assert_agree_above_each(
    least: [f64; 2],
    name: &str,
    inputs: &[Tensor],
    fused: Operation,
    plain: Operation,
    tolerance: f64,
) {
    let exact: Vec<Tensor> = inputs.iter().map(|t| t.to_dtype(DType::F64).unwrap()).collect();
    let (got, want) = (with_gradients(inputs, fused), with_gradients(&exact, plain));
    for (i, (got, want)) in got.iter().zip(&want).enumerate() {
        let what = if i == 0 { "result".into() } else { format!("gradient of input {}", i - 1) };
        let error = error(got, want, least[i.min(1)]);
        let shapes: Vec<_> = inputs.iter().map(|t| t.dims()).collect();
        assert!(error < tolerance, "{name} {shapes:?}, {what}: relative error {error:e}");
    }
}

/// Compares the derivative along a random direction with central differences of the fused form.
fn assert_gradient(name: &str, inputs: &[Tensor], fused: Operation) {
    let all = with_gradients(inputs, fused);
    let directions = tensors(&inputs.iter().map(|t| t.dims().to_vec()).collect::<Vec<_>>(), 555, 1.0);
    let step = 5e-3;
    let loss = |sign: f64| -> f64 {
        let moved: Vec<Tensor> =
            inputs.iter().zip(&directions).map(|(x, d)| (x + (d * (sign * step)).unwrap()).unwrap()).collect();
        let result = values(&fused(&moved).unwrap());
        result.iter().zip(numbers(result.len(), 77, 1.0)).map(|(a, b)| a * f64::from(b)).sum()
    };
    let numeric = (loss(1.0) - loss(-1.0)) / (2.0 * step);
    let terms = all[1..].iter().zip(&directions).flat_map(|(gradient, direction)| {
        gradient.iter().zip(values(direction)).map(|(a, b)| a * b).collect::<Vec<_>>()
    });
    let (analytic, size) = terms.fold((0.0, 0.0), |(sum, size): (f64, f64), term| (sum + term, size + term * term));
    assert!((numeric - analytic).abs() < 5e-3 * size.sqrt().max(0.1), "{name}: {numeric} for {analytic}");
}

fn linear(t: &[Tensor]) -> Result<Tensor> {
    ops::linear(&t[0], &t[1], &t[2])
}

fn linear_plain(t: &[Tensor]) -> Result<Tensor> {
    plain::linear(&t[0], &t[1], &t[2])
}

fn gelu(t: &[Tensor]) -> Result<Tensor> {
    ops::gelu_linear(&t[0], &t[1], &t[2])
}

fn gelu_plain(t: &[Tensor]) -> Result<Tensor> {
    plain::gelu_linear(&t[0], &t[1], &t[2])
}

/// Scales projections to the size of a trained network's, so that more than one key has weight.
fn projection(weight: &Tensor) -> Result<Tensor> {
    weight / (weight.dim(1)? as f64).sqrt()
}

fn attention(t: &[Tensor], heads: usize) -> Result<Tensor> {
    ops::self_attention(&t[0], &projection(&t[1])?, &t[2], heads)
}

fn attention_plain(t: &[Tensor], heads: usize) -> Result<Tensor> {
    plain::self_attention(&t[0], &projection(&t[1])?, &t[2], heads)
}

/// Self-attention of queries, keys and values side by side.
fn attention_of(qkv: &Tensor, heads: usize) -> Result<Tensor> {
    let width = qkv.dim(2)?;
    let same = Tensor::eye(width, DType::F32, &Device::Cpu)?;
    ops::self_attention(qkv, &same, &Tensor::zeros(width, DType::F32, &Device::Cpu)?, heads)
}

fn norm(t: &[Tensor]) -> Result<Tensor> {
    ops::layer_norm(&t[0], t.get(1).zip(t.get(2)), 1e-6)
}

fn norm_plain(t: &[Tensor]) -> Result<Tensor> {
    plain::layer_norm(&t[0], t.get(1).zip(t.get(2)), 1e-6)
}

fn residual(t: &[Tensor]) -> Result<Tensor> {
    ops::scaled_residual(&t[0], &t[1], &t[2])
}

fn residual_plain(t: &[Tensor]) -> Result<Tensor> {
    plain::scaled_residual(&t[0], &t[1], &t[2])
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 48, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn fused_forms_agree_with_plain_ones_at_any_shape(
        (b, n, heads, size) in (1usize..4, 1usize..90, 1usize..4, 1usize..20), k in 1usize..80, seed in 0u64..1000,
    ) {
        let d = heads * size;
        // A gradient may be a sum of hundreds of terms that cancel.
        assert_agree_above(1.0, "linear", &tensors(&[vec![b, n, k], vec![d, k], vec![d]], seed, 1.0), &linear, &linear_plain, 3e-5);
        let wide = d + 7; // normalising one or two values leaves little but rounding errors
        let affine = [vec![b, n, wide], vec![wide], vec![wide]];
        assert_agree_above(0.1, "layer norm", &tensors(&affine, seed, 1.0), &norm, &norm_plain, 3e-4);
        assert_agree_above(0.1, "layer norm, bare", &tensors(&affine[..1], seed, 1.0), &norm, &norm_plain, 3e-4);
        assert_agree_above(1.0, "residual", &tensors(&[vec![b, n, d], vec![b, n, d], vec![d]], seed, 1.0), &residual, &residual_plain, 3e-5);
        assert_agree_above(1.0, "gelu", &tensors(&[vec![b, n, k], vec![d, k], vec![d]], seed, 2.0), &gelu, &gelu_plain, 3e-5);
        let projected = tensors(&[vec![b, n, k], vec![3 * d, k], vec![3 * d]], seed, 1.0);
        assert_agree_above(1.0, "self-attention", &projected, &|t| attention(t, heads), &|t| attention_plain(t, heads), 3e-5);
    }

    #[test]
    fn layers_that_multiply_in_bf16_agree_with_f64_within_its_rounding(
        (b, n, heads, size) in (1usize..4, 1usize..90, 1usize..4, 1usize..20), k in 1usize..80, seed in 0u64..1000,
    ) {
        let d = heads * size;
        // The gradient of a weight or a bias is a sum over all rows, whose errors add up even where the terms cancel.
        let least = [1.0, ((b * n) as f64).sqrt()];
        let layer = tensors(&[vec![b, n, k], vec![d, k], vec![d]], seed, 1.0);
        assert_agree_above_each(least, "linear", &layer, &|t| ops::in_bf16(|| linear(t)), &linear_plain, 2e-2);
        assert_agree_above_each(least, "gelu", &layer, &|t| ops::in_bf16(|| gelu(t)), &gelu_plain, 2e-2);
        let projected = tensors(&[vec![b, n, k], vec![3 * d, k], vec![3 * d]], seed, 1.0);
        let attended = |t: &[Tensor]| ops::in_bf16(|| attention(t, heads));
        assert_agree_above_each(least, "self-attention", &projected, &attended, &|t| attention_plain(t, heads), 2e-2);
    }

    #[test]
    fn gradients_agree_with_finite_differences(
        (b, n, heads, size) in (1usize..3, 2usize..12, 1usize..3, 2usize..6), seed in 0u64..1000,
    ) {
        let d = heads * size;
        assert_gradient("linear", &tensors(&[vec![b, n, 5], vec![d, 5], vec![d]], seed, 1.0), &linear);
        assert_gradient("residual", &tensors(&[vec![b, n, d], vec![b, n, d], vec![d]], seed, 1.0), &residual);
        assert_gradient("gelu", &tensors(&[vec![b, n, 5], vec![d, 5], vec![d]], seed, 1.0), &gelu);
        let projected = tensors(&[vec![b, n, 5], vec![3 * d, 5], vec![3 * d]], seed, 1.0);
        assert_gradient("self-attention", &projected, &|t| attention(t, heads));
        // Far from rows without variance, where the derivative has a pole.
        let wide = [vec![b, n, 16], vec![16], vec![16]];
        assert_gradient("layer norm", &tensors(&wide, seed, 2.0), &norm);
    }

    #[test]
    fn numbers_of_any_size_stay_finite(scale in prop::sample::select(vec![1e-30f32, 1e-6, 1e-3, 1e3, 1e6]), seed in 0u64..100) {
        let finite = |name: &str, inputs: &[Tensor], fused: Operation| {
            for part in with_gradients(inputs, fused) {
                assert!(part.iter().all(|x| x.is_finite()), "{name} at {scale:e}");
            }
        };
        finite("linear", &tensors(&[vec![9, 33], vec![17, 33], vec![17]], seed, scale), &linear);
        finite("layer norm", &tensors(&[vec![9, 33], vec![33], vec![33]], seed, scale), &norm);
        finite("layer norm, bare", &tensors(&[vec![9, 33]], seed, scale), &norm);
        finite("gelu", &tensors(&[vec![9, 33], vec![17, 33], vec![17]], seed, scale), &gelu);
        finite("self-attention", &tensors(&[vec![1, 70, 9], vec![24, 9], vec![24]], seed, scale), &|t| attention(t, 2));
        finite("residual", &tensors(&[vec![9, 33], vec![9, 33], vec![33]], seed, scale), &residual);
    }
}

#[test]
fn large_shapes_of_the_real_network_agree_too() {
    let shapes = [vec![2, 257, 192], vec![768, 192], vec![768]];
    assert_agree("linear", &tensors(&shapes, 1, 1.0), &linear, &linear_plain, 1e-5);
    let projected = tensors(&[vec![2, 257, 192], vec![576, 192], vec![576]], 2, 1.0);
    assert_agree("self-attention", &projected, &|t| attention(t, 3), &|t| attention_plain(t, 3), 1e-5);
    let norms = [vec![3, 257, 768], vec![768], vec![768]];
    assert_agree("layer norm", &tensors(&norms, 3, 1.0), &norm, &norm_plain, 1e-4);
    let wide = tensors(&[vec![2, 257, 768], vec![192, 768], vec![192]], 4, 3.0);
    assert_agree("gelu", &wide, &gelu, &gelu_plain, 1e-5);
}

#[test]
fn rows_without_variance_normalise_to_the_bias() {
    let x = Tensor::full(1e4f32, (3, 40), &Device::Cpu).unwrap();
    let [weight, bias]: [Tensor; 2] = tensors(&[vec![40], vec![40]], 5, 1.0).try_into().unwrap();
    let out = ops::layer_norm(&x, Some((&weight, &bias)), 1e-6).unwrap();
    for row in out.to_vec2::<f32>().unwrap() {
        for (got, want) in row.iter().zip(bias.to_vec1::<f32>().unwrap()) {
            assert!((got - want).abs() < 1e-3, "{got} for {want}");
        }
    }
}

#[test]
fn one_dominant_key_gets_all_the_weight() {
    let (n, d) = (50, 8);
    let mut qkv = numbers(n * 3 * d, 9, 1.0);
    for token in 0..n {
        qkv[token * 3 * d..token * 3 * d + d].fill(100.0); // queries
        qkv[token * 3 * d + d..token * 3 * d + 2 * d].fill(if token == 7 { 100.0 } else { -100.0 });
    }
    let value = qkv[7 * 3 * d + 2 * d..7 * 3 * d + 3 * d].to_vec();
    let qkv = Tensor::from_vec(qkv, (1, n, 3 * d), &Device::Cpu).unwrap();
    let out = attention_of(&qkv, 2).unwrap();
    for row in out.get(0).unwrap().to_vec2::<f32>().unwrap() {
        assert_eq!(row, value);
    }
}

#[test]
fn nan_in_the_input_gives_nan_in_the_output() {
    for (i, name) in ["gelu", "layer norm", "self-attention"].iter().enumerate() {
        let mut values = numbers(2 * 20 * 24, 3, 1.0);
        values[100] = f32::NAN;
        let x = Tensor::from_vec(values, (2, 20, 24), &Device::Cpu).unwrap();
        let out = match i {
            0 => ops::gelu_linear(
                &x,
                &x.zeros_like().unwrap().narrow(0, 0, 1).unwrap().squeeze(0).unwrap(),
                &Tensor::zeros(20, DType::F32, &Device::Cpu).unwrap(),
            ),
            1 => ops::layer_norm(&x, None, 1e-6),
            _ => attention_of(&x, 2),
        };
        let out = out.unwrap().flatten_all().unwrap().to_vec1::<f32>().unwrap();
        assert!(out.iter().any(|x| x.is_nan()), "{name}");
    }
}

#[test]
fn shapes_that_do_not_fit_are_errors() {
    let t = |shape: &[usize]| Tensor::zeros(shape, DType::F32, &Device::Cpu).unwrap();
    for (name, result) in [
        ("linear", ops::linear(&t(&[3, 4]), &t(&[5, 6]), &t(&[5]))),
        ("linear", ops::linear(&t(&[3, 6]), &t(&[5, 6]), &t(&[4]))),
        ("layer norm", ops::layer_norm(&t(&[3, 4]), Some((&t(&[5]), &t(&[5]))), 1e-6)),
        ("linear", ops::gelu_linear(&t(&[3, 4]), &t(&[5, 6]), &t(&[5]))),
        ("self-attention", attention_of(&t(&[2, 3, 13]), 2)),
        ("scaled residual", ops::scaled_residual(&t(&[3, 4]), &t(&[3, 5]), &t(&[4]))),
    ] {
        let error = result.unwrap_err().to_string();
        assert!(error.contains(name), "{error}");
    }
}
