//! Hand models: MANO's pickle and `.npz`.

use std::io::{Cursor, Read};
use std::path::Path;
use std::sync::OnceLock;

use egotac::{HandModel, Result, Side};
use flate2::read::GzDecoder;

use super::seed;
use crate::case::Case;
use crate::mutate::{self, Rng, archive, below, bytes, chance, extreme, pick};

/// Reads a hand model.
pub fn read(path: &Path, _scratch: &Path) -> Result<()> {
    HandModel::load(path, Side::Right).map(drop)
}

/// Returns a whole hand model as a pickle: plain arrays, or chumpy objects and a sparse matrix.
fn mano(rng: &mut Rng) -> &'static [u8] {
    static PICKLES: OnceLock<[Vec<u8>; 2]> = OnceLock::new();
    let pickles = PICKLES.get_or_init(|| {
        ["left_plain", "right_chumpy"].map(|name| {
            let mut pickle = Vec::new();
            let packed = seed(&format!("tests/data/hand/{name}.pkl.gz"));
            let read = GzDecoder::new(&packed[..]).read_to_end(&mut pickle);
            read.unwrap_or_else(|error| panic!("seed {name}: {error}"));
            pickle
        })
    });
    pick::<Vec<u8>>(rng, pickles)
}

/// Changes the pickle of a hand model, or a small pickle of numpy in any protocol.
pub fn pickle(rng: &mut Rng) -> Case {
    let (python, protocol) = *pick(rng, &[("2", 0), ("2", 1), ("2", 2), ("3", 2), ("3", 3), ("3", 4), ("3", 5)]);
    let mut pickle = match chance(rng, 0.7) {
        true => mano(rng).to_vec(),
        false => seed(&format!("tests/data/hand/small_python{python}_{protocol}.pkl")),
    };
    if chance(rng, 0.8) {
        pickle = mutate::pickle::change(rng, &pickle);
    }
    if chance(rng, 0.3) {
        pickle = mutate::pickle::change_content(rng, &pickle);
    }
    if chance(rng, 0.1) {
        bytes::change(rng, &mut pickle);
    }
    Case::File(pickle)
}

/// Changes members of the archive of a hand model.
pub fn npz(rng: &mut Rng) -> Case {
    let mut members = members().clone();
    for _ in 0..1 + below(rng, 2) {
        let place = below(rng, members.len());
        let (_, member) = &mut members[place];
        match below(rng, 4) {
            0 => *member = npy(rng),
            1 => bytes::change(rng, member),
            _ => change_header(rng, member),
        }
    }
    if chance(rng, 0.2) {
        // The three arrays of a sparse matrix.
        for part in ["data", "indices", "indptr"] {
            members.push((format!("J_regressor_{part}.npy"), numbers(rng)));
        }
    }
    Case::File(archive::zip(rng, &members))
}

/// Returns the members of a whole hand model.
fn members() -> &'static Vec<(String, Vec<u8>)> {
    static MEMBERS: OnceLock<Vec<(String, Vec<u8>)>> = OnceLock::new();
    MEMBERS.get_or_init(|| {
        let read = || -> anyhow::Result<Vec<(String, Vec<u8>)>> {
            let mut archive = zip::ZipArchive::new(Cursor::new(seed("tests/data/hand/right.npz")))?;
            (0..archive.len())
                .map(|index| {
                    let mut member = archive.by_index(index)?;
                    let (name, mut bytes) = (member.name()?.to_string(), Vec::new());
                    member.read_to_end(&mut bytes)?;
                    Ok((name, bytes))
                })
                .collect()
        };
        read().unwrap_or_else(|error| panic!("seed right.npz: {error}"))
    })
}

/// Changes the header of a `.npy` file, and makes its length right again.
fn change_header(rng: &mut Rng, npy: &mut Vec<u8>) {
    // Magic number, version, and length of the header.
    const START: usize = 10;
    let Some(length) = npy.get(8..START).map(|length| usize::from(u16::from_le_bytes([length[0], length[1]]))) else {
        return;
    };
    let Some(header) = npy.get(START..START + length) else { return };
    let header = mutate::text::change(rng, &String::from_utf8_lossy(header));
    let told = (header.len() as u16).to_le_bytes();
    npy.splice(8..START + length, told.into_iter().chain(header.bytes()));
}

/// Makes a `.npy` file of a few numbers, some of them extreme.
fn numbers(rng: &mut Rng) -> Vec<u8> {
    let count = *pick(rng, &[0, 1, 16, 17, 779]);
    let header = format!("{{'descr': '<i8', 'fortran_order': False, 'shape': ({count},), }}\n");
    let mut npy = b"\x93NUMPY\x01\x00".to_vec();
    npy.extend((header.len() as u16).to_le_bytes());
    npy.extend(header.bytes());
    let values = (0..count).map(|index| mutate::often(rng, index));
    npy.extend(values.flat_map(i64::to_le_bytes));
    npy
}

/// Makes a `.npy` file with a lying header.
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
