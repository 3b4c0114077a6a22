//! Random numbers that depend on a key alone, so that a sample of the unknowns is the same at every frame.

/// Stream of numbers of one sample.
#[derive(Debug, Clone, Copy)]
pub(super) struct Draw(pub u64);

impl Draw {
    /// Returns a uniform number between 0 and 1 for a key.
    pub fn uniform(self, key: u64) -> f64 {
        // SplitMix64: a bijection of 64 bits whose outputs pass statistical tests.
        let mut x = self.0.wrapping_mul(0x9e37_79b9_7f4a_7c15) ^ key.wrapping_mul(0xd1b5_4a32_d192_ed03);
        x = x.wrapping_add(0x9e37_79b9_7f4a_7c15);
        x = (x ^ (x >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        x = (x ^ (x >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((x ^ (x >> 31)) >> 11) as f64 / (1u64 << 53) as f64
    }

    /// Returns a standard normal number for a key.
    pub fn normal(self, key: u64) -> f64 {
        let radius = (-2.0 * self.uniform(key).max(1e-300).ln()).sqrt();
        radius * (2.0 * std::f64::consts::PI * self.uniform(!key)).cos()
    }
}

/// Returns the probability that a standard normal number is below `x`.
pub(super) fn normal_below(x: f64) -> f64 {
    // Abramowitz and Stegun 7.1.26, absolute error below 1e-7.
    let z = x.abs() / std::f64::consts::SQRT_2;
    let t = 1.0 / (1.0 + 0.327_591_1 * z);
    let terms = [0.254_829_592, -0.284_496_736, 1.421_413_741, -1.453_152_027, 1.061_405_429];
    let erf = 1.0 - terms.iter().rev().fold(0.0, |sum, a| (sum + a) * t) * (-z * z).exp();
    if x < 0.0 { 0.5 * (1.0 - erf) } else { 0.5 * (1.0 + erf) }
}
