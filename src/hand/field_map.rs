//! Maps of per-vertex fields of both hands between the built-in hands and a pair of MANO files.

use std::path::Path;

use super::{HandMap, HandModel, HandParams, N_BETAS, N_FIELD, N_VERTICES, Region, Side, Topology, Transfer};
use crate::error::{Error, Result};
use crate::file::{self, input, limits};

/// A pair of MANO files, registered on the built-in hands: carries fields over from one vertex numbering to the other.
#[derive(Debug, Clone)]
pub struct FieldMap {
    mano: [HandModel; 2],
    maps: [HandMap; 2],
    sha256: Vec<String>,
}

impl FieldMap {
    /// Loads the MANO files of both hands and registers them.
    ///
    /// # Errors
    /// If a file can't be read.
    pub fn load(left: &Path, right: &Path) -> Result<Self> {
        let mano = [HandModel::load(left, Side::Left)?, HandModel::load(right, Side::Right)?];
        let maps = [HandMap::new(&mano[0]), HandMap::new(&mano[1])];
        let sha256 = [left, right].map(|path| Ok(file::sha256(&input::read(path, limits::FILE)?)));
        Ok(Self { mano, maps, sha256: sha256.into_iter().collect::<Result<_>>()? })
    }

    /// Registers one MANO file and takes the mirror image of its hand as the other hand.
    ///
    /// # Errors
    /// If the file can't be read.
    pub fn mirrored(path: &Path, side: Side) -> Result<Self> {
        let mano = HandModel::load(path, side)?;
        let map = HandMap::new(&mano);
        let sha256 = vec![file::sha256(&input::read(path, limits::FILE)?)];
        Ok(Self { mano: [mano.clone(), mano], maps: [map.clone(), map], sha256 })
    }

    /// MANO's hands, left first; of a mirrored map, the file's hand twice.
    pub fn mano(&self) -> &[HandModel; 2] {
        &self.mano
    }

    /// Registrations, left first.
    pub fn maps(&self) -> &[HandMap; 2] {
        &self.maps
    }

    /// SHA-256 of the MANO files, left first.
    pub fn sha256(&self) -> &[String] {
        &self.sha256
    }

    /// Returns the regions of the vertices of both hands, (778) each, left first.
    pub fn regions(&self, topology: Topology) -> [Vec<Region>; 2] {
        match topology {
            Topology::Mano => self.mano.each_ref().map(HandModel::regions),
            Topology::EgotacHand1 => Side::BOTH.map(|side| HandModel::builtin(side).regions()),
        }
    }

    /// Carries forces over to the vertices of `to`, (n, 1556) N. The sum of each hand stays the same, to 1e-6 of it. A vertex
    /// that takes force from an unknown one (NaN) is unknown.
    ///
    /// # Errors
    /// If the number of values is not a multiple of 1556.
    pub fn force(&self, to: Topology, force: &[f32]) -> Result<Vec<f32>> {
        self.by_hand("force", force, |transfer, hand| transfer.force_of_hand(hand), to)
    }

    /// Takes values over from the nearest vertex, (n, 1556): contact, distances, masks of contact.
    ///
    /// # Errors
    /// If the number of values is not a multiple of 1556.
    pub fn nearest<T: Copy>(&self, to: Topology, values: &[T]) -> Result<Vec<T>> {
        self.by_hand("values", values, |transfer, hand| transfer.nearest_of_hand(hand), to)
    }

    /// Carries over a mask of forces, (n, 1556): 1 where all vertices that give force are 1.
    ///
    /// # Errors
    /// If the number of values is not a multiple of 1556.
    pub fn force_mask(&self, to: Topology, mask: &[u8]) -> Result<Vec<u8>> {
        self.by_hand("mask_force", mask, |transfer, hand| transfer.force_mask_of_hand(hand), to)
    }

    /// Carries over a hand's parameters: rotations are copied, the wrist joint stays where it is, and betas, which mean
    /// different shapes on different hands, become 0.
    pub fn params(&self, side: Side, to: Topology, params: &HandParams) -> HandParams {
        let (builtin, mano) = (HandModel::builtin(side), &self.mano[side as usize]);
        let (from, to) = if to == Topology::Mano { (&builtin, mano) } else { (mano, &builtin) };
        let wrist = |model: &HandModel, betas: [f32; N_BETAS]| {
            let mut wrist = model.joints(&HandParams { betas, ..HandParams::default() })[0];
            // The one model of a mirrored map may be of the other side.
            if model.side != side {
                wrist.x = -wrist.x;
            }
            wrist
        };
        let moved = wrist(from, params.betas) - wrist(to, [0.0; N_BETAS]);
        HandParams { betas: [0.0; N_BETAS], transl: params.transl + moved, ..params.clone() }
    }

    fn by_hand<T>(
        &self,
        name: &str,
        values: &[T],
        carry: impl Fn(&Transfer, &[T]) -> Vec<T>,
        to: Topology,
    ) -> Result<Vec<T>> {
        if !values.len().is_multiple_of(N_FIELD) {
            return Err(Error::shape(name, format!("(n, {N_FIELD})"), [values.len()]));
        }
        let hands = values.chunks_exact(N_VERTICES).enumerate();
        Ok(hands.flat_map(|(index, hand)| carry(self.maps[index % 2].towards(to), hand)).collect())
    }
}
