//! Loops compiled for the widest vectors of the processor at hand, which are detected at run time.
//!
//! The functions here are inlined into the closure that [`dispatch`] runs, where the compiler vectorises them. They have
//! no branches, and sum in 16 lanes in a fixed order, so that results do not depend on the width of the vectors.

/// Lanes of a sum: one AVX-512 register, two of AVX2.
pub const LANES: usize = 16;

/// Runs `f`, compiled for the widest vectors of this processor.
///
/// `f` and all closures inside it need `#[inline(always)]`: a function that is not inlined is compiled for the oldest
/// processor, where a multiply-add is a library call.
#[inline(always)]
pub fn dispatch<R>(f: impl FnOnce() -> R) -> R {
    pulp::Arch::new().dispatch(f)
}

/// Returns the sum of `f(value)`.
#[inline(always)]
pub fn sum(values: &[f32], f: impl Fn(f32) -> f32) -> f32 {
    let (chunks, rest) = values.as_chunks::<LANES>();
    let mut lanes = [0.0; LANES];
    for chunk in chunks {
        for (lane, value) in lanes.iter_mut().zip(chunk) {
            *lane += f(*value);
        }
    }
    let rest: f32 = rest.iter().map(|value| f(*value)).sum();
    fold(lanes) + rest
}

/// Returns two sums at once: those of both results of `f(a, b)`.
#[inline(always)]
pub fn sum2(a: &[f32], b: &[f32], f: impl Fn(f32, f32) -> [f32; 2]) -> [f32; 2] {
    let ((a, a_rest), (b, b_rest)) = (a.as_chunks::<LANES>(), b.as_chunks::<LANES>());
    let mut lanes = [[0.0; LANES]; 2];
    for (a, b) in a.iter().zip(b) {
        for i in 0..LANES {
            let [first, second] = f(a[i], b[i]);
            lanes[0][i] += first;
            lanes[1][i] += second;
        }
    }
    let mut total = lanes.map(fold);
    for (a, b) in a_rest.iter().zip(b_rest) {
        let [first, second] = f(*a, *b);
        total[0] += first;
        total[1] += second;
    }
    total
}

/// Returns Σ a b. Four independent registers hide the latency of the multiply-add.
#[inline(always)]
pub fn dot(a: &[f32], b: &[f32]) -> f32 {
    const WIDE: usize = 4 * LANES;
    let ((wide_a, a), (wide_b, b)) = (a.as_chunks::<WIDE>(), b.as_chunks::<WIDE>());
    let mut lanes = [0.0; WIDE];
    for (a, b) in wide_a.iter().zip(wide_b) {
        for i in 0..WIDE {
            lanes[i] = a[i].mul_add(b[i], lanes[i]);
        }
    }
    let mut total = [0.0; LANES];
    for quarter in lanes.as_chunks::<LANES>().0 {
        for i in 0..LANES {
            total[i] += quarter[i];
        }
    }
    fold(total)
        + sum2(
            a,
            b,
            #[inline(always)]
            |a, b| [a * b, 0.0],
        )[0]
}

/// Returns the largest value; -∞ for an empty slice.
#[inline(always)]
pub fn max(values: &[f32]) -> f32 {
    #[inline(always)]
    fn larger(a: f32, b: f32) -> f32 {
        if a > b { a } else { b }
    }
    let (chunks, rest) = values.as_chunks::<LANES>();
    let mut lanes = [f32::NEG_INFINITY; LANES];
    for chunk in chunks {
        for (lane, value) in lanes.iter_mut().zip(chunk) {
            *lane = larger(*value, *lane);
        }
    }
    lanes.iter().chain(rest).fold(f32::NEG_INFINITY, |a, b| larger(a, *b))
}

/// Adds all lanes, the upper half onto the lower, until one is left.
#[inline(always)]
pub fn fold(lanes: [f32; LANES]) -> f32 {
    let mut lanes = lanes;
    let mut half = LANES / 2;
    while half > 0 {
        for i in 0..half {
            lanes[i] += lanes[i + half];
        }
        half /= 2;
    }
    lanes[0]
}

// The coefficients are minimax fits by tests/data/model/approximate.py of the egotac repository.

/// Coefficients of eʳ for |r| ≤ ln 2 / 2; largest relative error 1.9e-9.
const EXP: [f32; 7] = [1.0, 1.0, 0.4999999, 0.1666642, 0.041668225, 0.008374816, 0.0013836846];

/// Coefficients of (1 - Φ(a)) exp(a²/2) in t = 1 / (1 + 0.3 a), for a in 0 to 14; largest relative error 5.8e-8.
const TAIL: [f32; 9] =
    [7.168876e-06, 0.11948769, 0.12192034, 0.09468352, 0.14253552, -0.07650648, 0.22866008, -0.16916612, 0.03837829];

/// Coefficients of 1 - Φ(a) in 2 a / [`SATURATION`] - 1, for a in 0 to [`SATURATION`]; largest error 1.9e-8 max(1, 1 / a).
const UPPER: [f32; 16] = [
    0.004_024_587,
    -0.031_567_78,
    0.110_841_416,
    -0.222_496_55,
    0.260_913_07,
    -0.132_330_73,
    -0.089_632_936,
    0.202_187_31,
    -0.109_095_96,
    -0.058_586_765,
    0.107_003_69,
    -0.023_506_317,
    -0.040_275_943,
    0.020_936_683,
    0.006_222_005,
    -0.004_635_735_4,
];
/// |x| beyond which Φ is taken as 0 or 1; the error is at most 5.8e-8.
const SATURATION: f32 = 5.3;

/// Returns eˣ for x ≤ 0. Below -87 the result is e⁻⁸⁷ = 1.6e-38, so that it is never subnormal. NaN gives NaN.
#[inline(always)]
pub fn exp(x: f32) -> f32 {
    // Adding 1.5 · 2²³ rounds to an integer and leaves it in the low bits of the mantissa.
    const ROUND: f32 = 12_582_912.0;
    // ln 2 in two parts. The first has few bits, so that its product with n is exact and r keeps full precision.
    const LN2: [f32; 2] = [0.693_359_4, -2.121_944_4e-4];
    let x = if x < -87.0 { -87.0 } else { x };
    let shifted = x.mul_add(std::f32::consts::LOG2_E, ROUND);
    let n = shifted - ROUND;
    let r = n.mul_add(-LN2[1], n.mul_add(-LN2[0], x));
    let p = polynomial(&EXP, r);
    // Times 2ⁿ: adds n to the exponent.
    f32::from_bits(p.to_bits().wrapping_add(shifted.to_bits() << 23))
}

/// Returns the normal distribution function Φ(x) and its density φ(x).
///
/// The smaller of Φ(x) and Φ(-x) has a relative error of about 1e-6 out to |x| = 13.
#[inline(always)]
pub fn normal(x: f32) -> [f32; 2] {
    const INV_SQRT_2PI: f32 = 0.398_942_3;
    let a = x.abs();
    let bell = exp(-0.5 * a * a);
    let tail = bell * polynomial(&TAIL, 1.0 / 0.3f32.mul_add(a, 1.0));
    [if x > 0.0 { 1.0 - tail } else { tail }, INV_SQRT_2PI * bell]
}

/// Returns x Φ(x), the exact GELU, with an error of at most 2e-7 max(|x|, 1). Takes fewer operations than [`normal`] and no
/// division, and serves forward passes, which need no density.
#[inline(always)]
pub fn gelu(x: f32) -> f32 {
    let a = x.abs();
    let inside = if a > SATURATION { SATURATION } else { a };
    let upper = polynomial_by_halves(&UPPER, inside.mul_add(2.0 / SATURATION, -1.0));
    let upper = if a > SATURATION { 0.0 } else { upper };
    // x Φ(x) = max(x, 0) - |x| (1 - Φ(|x|))
    let linear = if x > 0.0 { x } else { 0.0 };
    a.mul_add(-upper, linear)
}

/// Evaluates a polynomial by Horner's rule, lowest coefficient first.
#[inline(always)]
fn polynomial<const N: usize>(coefficients: &[f32; N], x: f32) -> f32 {
    let mut value = coefficients[N - 1];
    for i in (0..N - 1).rev() {
        value = value.mul_add(x, coefficients[i]);
    }
    value
}

/// Evaluates a polynomial as those of its even and of its odd powers, each by Horner's rule. The two do not wait for each other: a long
/// polynomial takes less time than by [`polynomial`].
#[inline(always)]
fn polynomial_by_halves<const N: usize>(coefficients: &[f32; N], x: f32) -> f32 {
    const { assert!(N.is_multiple_of(2), "a number of coefficients that is even") };
    let square = x * x;
    let (mut even, mut odd) = (coefficients[N - 2], coefficients[N - 1]);
    for i in (0..N / 2 - 1).rev() {
        even = even.mul_add(square, coefficients[2 * i]);
        odd = odd.mul_add(square, coefficients[2 * i + 1]);
    }
    odd.mul_add(x, even)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_exponential_has_a_relative_error_below_3e_7() {
        for i in 0..=87_000 {
            let x = -(i as f32) / 1000.0;
            let (got, want) = (f64::from(exp(x)), f64::from(x).exp());
            assert!((got / want - 1.0).abs() < 3e-7, "{x}: {got} for {want}");
        }
        assert_eq!(exp(0.0), 1.0);
        assert!(exp(f32::NEG_INFINITY) < 2e-38 && exp(f32::NAN).is_nan());
    }

    #[test]
    fn normal_distribution_matches_published_values() {
        // Φ(-x) as tabulated to ten digits.
        for (x, tail) in [
            (0.0, 0.5),
            (0.5, 0.308_537_538_7),
            (1.0, 0.158_655_253_9),
            (2.0, 0.022_750_131_95),
            (3.0, 1.349_898_032e-3),
            (5.0, 2.866_515_719e-7),
            (8.0, 6.220_960_574e-16),
            (12.0, 1.776_482_112e-33),
        ] {
            let x = x as f32;
            assert!((f64::from(normal(-x)[0]) / tail - 1.0).abs() < 3e-6, "{x}: {}", normal(-x)[0]);
            assert!((f64::from(normal(x)[0]) - (1.0 - tail)).abs() < 1e-7, "{x}");
            let density = (-0.5 * f64::from(x).powi(2)).exp() / std::f64::consts::TAU.sqrt();
            assert!((f64::from(normal(x)[1]) / density - 1.0).abs() < 1e-5, "{x}");
        }
    }

    #[test]
    fn gelu_agrees_with_its_definition_and_stays_finite() {
        // The distribution with its tails is tested above against published values.
        for i in -200_000..=200_000 {
            let x = i as f32 * 1e-4;
            let want = f64::from(x) * f64::from(normal(x)[0]);
            assert!((f64::from(gelu(x)) - want).abs() < 2e-7 * f64::from(x.abs().max(1.0)), "{x}: {}", gelu(x));
        }
        for x in [1e4, 1e19, 1e30, f32::MAX] {
            assert_eq!((gelu(x), gelu(-x)), (x, 0.0));
        }
        assert!(gelu(f32::NAN).is_nan());
        assert_eq!(gelu(1e-40), 0.5 * 1e-40);
    }

    #[test]
    fn sums_and_products_of_any_length_agree_with_f64() {
        for n in [0, 1, 15, 16, 17, 63, 64, 65, 200] {
            let a: Vec<f32> = (0..n).map(|i| (i as f32 * 0.37).sin()).collect();
            let b: Vec<f32> = (0..n).map(|i| (i as f32 * 0.11).cos()).collect();
            let exact = |f: &dyn Fn(f64, f64) -> f64| -> f64 {
                a.iter().zip(&b).map(|(a, b)| f(f64::from(*a), f64::from(*b))).sum()
            };
            let close = |got: f32, want: f64| assert!((f64::from(got) - want).abs() < 1e-5, "{n}: {got} for {want}");
            close(dispatch(|| dot(&a, &b)), exact(&|a, b| a * b));
            close(dispatch(|| sum(&a, |a| a * a)), exact(&|a, _| a * a));
            let [first, second] = sum2(&a, &b, |a, b| [a + b, a * b]);
            close(first, exact(&|a, b| a + b));
            close(second, exact(&|a, b| a * b));
            assert_eq!(max(&a), a.iter().copied().fold(f32::NEG_INFINITY, f32::max));
        }
    }
}
