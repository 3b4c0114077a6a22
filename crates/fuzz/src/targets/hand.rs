//! Hand models: MANO's pickle and `.npz`.

use std::path::Path;

use egotac::{HandModel, Result, Side};

use super::seed;
use crate::case::Case;
use crate::mutate::{self, Rng, archive, below, bytes, chance, extreme, pick};

const NAMES: [&str; 6] = ["v_template", "f", "shapedirs", "J_regressor", "weights", "kintree_table"];

/// Reads a hand model.
pub fn read(path: &Path, _scratch: &Path) -> Result<()> {
    HandModel::load(path, Side::Right).map(drop)
}

/// Changes a small pickle of numpy.
pub fn pickle(rng: &mut Rng) -> Case {
    let (python, protocol) = *pick(rng, &[("2", 0), ("2", 1), ("2", 2), ("3", 2), ("3", 3), ("3", 4), ("3", 5)]);
    let seed = seed(&format!("tests/data/hand/small_python{python}_{protocol}.pkl"));
    let mut pickle = mutate::pickle::change(rng, &seed);
    if chance(rng, 0.2) {
        bytes::change(rng, &mut pickle);
    }
    Case::File(pickle)
}

/// Makes an archive of arrays with lying headers.
pub fn npz(rng: &mut Rng) -> Case {
    let members: Vec<_> = NAMES.iter().map(|name| (format!("{name}.npy"), npy(rng))).collect();
    Case::File(archive::zip(rng, &members))
}

fn npy(rng: &mut Rng) -> Vec<u8> {
    let descr = *pick(rng, &["<f8", "<f4", "<i8", "|u1", "<u4", ">f8", "|O", "<f99999999999", "|V8", "<c16"]);
    let shape = match below(rng, 5) {
        0 => "1, ".repeat(*pick(rng, &[32, 1000, 60_000])),
        1 => format!("{}, {}", extreme(rng), extreme(rng)),
        2 => format!("{},", extreme(rng)),
        3 => "778, 3".into(),
        _ => "2, 2".into(),
    };
    let order = *pick(rng, &["True", "False"]);
    let mut header = format!("{{'descr': '{descr}', 'fortran_order': {order}, 'shape': ({shape}), }}\n");
    if chance(rng, 0.2) {
        header = mutate::text::change(rng, &header);
    }
    let mut npy = b"\x93NUMPY".to_vec();
    let told = mutate::often(rng, header.len() as i64);
    if header.len() > usize::from(u16::MAX) || chance(rng, 0.3) {
        npy.extend([2, 0]);
        npy.extend((told as u32).to_le_bytes());
    } else {
        npy.extend([1, 0]);
        npy.extend((told as u16).to_le_bytes());
    }
    npy.extend(header.bytes());
    match descr {
        "|O" => npy.extend(mutate::pickle::change(rng, &seed("tests/data/hand/small_python3_4.pkl"))),
        _ => npy.extend(vec![0; *pick(rng, &[0, 4, 8, 32, 18_672])]),
    }
    npy
}
