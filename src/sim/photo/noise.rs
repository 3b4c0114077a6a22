//! Smooth random fields for textures, periodic in both directions.

/// Sum of octaves of value noise; equal at the start and the end of each period.
#[derive(Debug, Clone, Copy)]
pub(super) struct Noise {
    seed: u64,
    octaves: u32,
}

impl Noise {
    /// Creates a field; each octave has twice the frequency and half the amplitude of the one before.
    pub fn new(seed: u64, octaves: u32) -> Self {
        Self { seed, octaves }
    }

    /// Returns the field at `(u, v)`, both in periods, with `cells` lattice cells per period in its first octave.
    ///
    /// The value is 0 to 1, about 0.5 on average.
    pub fn at(&self, u: f64, v: f64, cells: [u32; 2]) -> f64 {
        let (mut sum, mut total) = (0.0, 0.0);
        for octave in 0..self.octaves {
            let (weight, factor) = (0.5_f64.powi(octave as i32), 1 << octave);
            let lattice = cells.map(|n| (n * factor).max(1));
            sum += weight * self.octave(u * f64::from(lattice[0]), v * f64::from(lattice[1]), lattice, octave);
            total += weight;
        }
        sum / total
    }

    /// Value noise on a lattice that repeats after `lattice` cells.
    fn octave(&self, x: f64, y: f64, lattice: [u32; 2], octave: u32) -> f64 {
        let corner = |i: i64, j: i64| {
            let wrap = |k: i64, n: u32| k.rem_euclid(i64::from(n)) as u64;
            unit(self.seed, [wrap(i, lattice[0]), wrap(j, lattice[1]), u64::from(octave)])
        };
        let smooth = |t: f64| t * t * (3.0 - 2.0 * t);
        let (i, j) = (x.floor(), y.floor());
        let (s, t) = (smooth(x - i), smooth(y - j));
        let (i, j) = (i as i64, j as i64);
        let mix = |a: f64, b: f64, t: f64| a + (b - a) * t;
        mix(mix(corner(i, j), corner(i + 1, j), s), mix(corner(i, j + 1), corner(i + 1, j + 1), s), t)
    }
}

/// Returns a number from 0 to 1 that depends on all bits of seed and place (SplitMix64).
pub(super) fn unit(seed: u64, place: [u64; 3]) -> f64 {
    let mut state = seed;
    for word in place {
        state = state.wrapping_add(word.wrapping_mul(0x9e37_79b9_7f4a_7c15)).wrapping_add(0x9e37_79b9_7f4a_7c15);
        state = (state ^ (state >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        state = (state ^ (state >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        state ^= state >> 31;
    }
    (state >> 11) as f64 / (1_u64 << 53) as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_field_repeats_and_its_values_are_spread_around_one_half() {
        let noise = Noise::new(7, 4);
        let places = || (0..1000).map(|i| (f64::from(i) * 0.0137, f64::from(i) * 0.0071));
        for (u, v) in places() {
            let value = noise.at(u, v, [5, 3]);
            assert!((0.0..=1.0).contains(&value));
            assert!((value - noise.at(u + 1.0, v - 2.0, [5, 3])).abs() < 1e-9);
        }
        let mean = places().map(|(u, v)| noise.at(u, v, [5, 3])).sum::<f64>() / 1000.0;
        assert!((0.35..0.65).contains(&mean), "{mean}");
    }
}
