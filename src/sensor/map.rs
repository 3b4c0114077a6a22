//! Taxel map: readings of a glove's taxels on the vertices of a hand, in both meanings.

use glam::Vec3;

use super::layout::Layout;
use crate::error::{Error, Result};
use crate::hand::{N_FIELD, N_VERTICES, Side, Topology};

/// Places of a glove's taxels on both hands.
#[derive(Debug, Clone, PartialEq)]
pub struct TaxelMap {
    /// Layout that the map was built from.
    pub layout: Layout,
    /// Meaning of the vertex indices.
    pub topology: Topology,
    /// Left and right hand.
    pub hands: [HandTaxels; 2],
}

/// Taxels of one hand, N channels.
#[derive(Debug, Clone, PartialEq)]
pub struct HandTaxels {
    /// (778) lists of (channel, weight): interpolation of the readings at each vertex; weights sum to 1. Empty = no taxel.
    pub reading: Vec<Vec<(u32, f32)>>,
    /// (N) lists of (vertex, share): shares of each taxel's force; they sum to 1. Empty = no taxel.
    pub spread: Vec<Vec<(u32, f32)>>,
    /// (778) force on a vertex per newton of its reading; 0 = no taxel.
    pub factors: Vec<f32>,
    /// (N) places of the taxels on the hand at rest, m; NaN = no taxel.
    pub positions: Vec<Vec3>,
}

impl TaxelMap {
    /// Returns the readings of both hands' taxels, (N) each, left first, as readings at the vertices, (1556); `None` and
    /// vertices without a taxel give NaN.
    ///
    /// # Errors
    /// If a hand has another number of channels.
    pub fn reading(&self, taxels: [Option<&[f32]>; 2]) -> Result<Vec<f32>> {
        self.by_hand(taxels, HandTaxels::reading)
    }

    /// Returns the forces of both hands' taxels, (N) N each, left first, spread over the vertices, (1556) N; as
    /// [`TaxelMap::reading`].
    ///
    /// # Errors
    /// If a hand has another number of channels.
    pub fn spread(&self, taxels: [Option<&[f32]>; 2]) -> Result<Vec<f32>> {
        self.by_hand(taxels, HandTaxels::spread)
    }

    fn by_hand(&self, taxels: [Option<&[f32]>; 2], of: fn(&HandTaxels, &[f32]) -> Vec<f32>) -> Result<Vec<f32>> {
        let mut field = Vec::with_capacity(N_FIELD);
        for (side, (hand, taxels)) in Side::BOTH.into_iter().zip(self.hands.iter().zip(taxels)) {
            match taxels {
                None => field.extend([f32::NAN; N_VERTICES]),
                Some(taxels) if taxels.len() == self.layout.channels => field.extend(of(hand, taxels)),
                Some(taxels) => {
                    let name = format!("{} taxels of {}", side.name(), self.layout.name);
                    return Err(Error::shape(name, format!("[{}]", self.layout.channels), [taxels.len()]));
                }
            }
        }
        Ok(field)
    }

    /// Turns readings at the vertices, (n, 1556), into spread forces: multiplied by the factors of the vertices. The sum over a
    /// hand is that of its taxels up to [`TaxelMap::conversion_error`]. Vertices without a taxel become NaN.
    ///
    /// # Errors
    /// If the number of values is not a multiple of 1556.
    pub fn spread_of_reading(&self, reading: &[f32]) -> Result<Vec<f32>> {
        self.scaled(reading, |value, factor| value * factor)
    }

    /// Turns spread forces, (n, 1556), into readings at the vertices: the inverse of [`TaxelMap::spread_of_reading`].
    ///
    /// # Errors
    /// If the number of values is not a multiple of 1556.
    pub fn reading_of_spread(&self, spread: &[f32]) -> Result<Vec<f32>> {
        self.scaled(spread, |value, factor| value / factor)
    }

    fn scaled(&self, values: &[f32], scale: fn(f32, f32) -> f32) -> Result<Vec<f32>> {
        if !values.len().is_multiple_of(N_FIELD) {
            return Err(Error::shape("force", format!("(n, {N_FIELD})"), [values.len()]));
        }
        let factors = self.hands.iter().flat_map(|hand| &hand.factors).cycle();
        let one = |(value, factor): (&f32, &f32)| if *factor > 0.0 { scale(*value, *factor) } else { f32::NAN };
        Ok(values.iter().zip(factors).map(one).collect())
    }

    /// Largest share of a taxel's force that is lost or added when its reading at the vertices is turned into spread forces; 0 =
    /// the sum is kept. Taxels that are finer than the mesh have none that is exact.
    pub fn conversion_error(&self) -> f32 {
        self.hands.iter().map(HandTaxels::conversion_error).fold(0.0, f32::max)
    }

    /// Number of taxels of each hand, left first: channels with a place.
    pub fn counts(&self) -> [usize; 2] {
        self.hands.each_ref().map(|hand| hand.spread.iter().filter(|shares| !shares.is_empty()).count())
    }
}

impl HandTaxels {
    /// Returns the readings at the vertices, (778); NaN = no taxel, or an unknown one. `taxels`: (N).
    pub fn reading(&self, taxels: &[f32]) -> Vec<f32> {
        let value = |list: &Vec<(u32, f32)>| match list.is_empty() {
            true => f32::NAN,
            false => list.iter().map(|&(taxel, weight)| taxels[taxel as usize] * weight).sum(),
        };
        self.reading.iter().map(value).collect()
    }

    /// Returns the forces spread over the vertices, (778) N, whose sum is that of the taxels; NaN = no taxel, or an unknown
    /// one. `taxels`: (N) N.
    pub fn spread(&self, taxels: &[f32]) -> Vec<f32> {
        let covered = self.reading.iter().map(|list| if list.is_empty() { f64::NAN } else { 0.0 });
        let mut force: Vec<f64> = covered.collect();
        for (shares, newtons) in self.spread.iter().zip(taxels).filter(|(_, newtons)| **newtons != 0.0) {
            let sum: f64 = shares.iter().map(|(_, share)| f64::from(*share)).sum();
            for &(vertex, share) in shares {
                force[vertex as usize] += f64::from(*newtons) * f64::from(share) / sum;
            }
        }
        force.into_iter().map(|force| force as f32).collect()
    }

    /// Returns true for each vertex, (778), that has a taxel.
    pub fn covered(&self) -> Vec<bool> {
        self.reading.iter().map(|list| !list.is_empty()).collect()
    }

    fn conversion_error(&self) -> f32 {
        let mut sums = vec![0.0; self.spread.len()];
        for (list, factor) in self.reading.iter().zip(&self.factors) {
            list.iter().for_each(|&(taxel, weight)| sums[taxel as usize] += weight * factor);
        }
        let placed = sums.iter().zip(&self.spread).filter(|(_, shares)| !shares.is_empty());
        placed.map(|(sum, _)| (sum - 1.0).abs()).fold(0.0, f32::max)
    }
}
