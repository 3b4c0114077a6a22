//! Runs of the importer.

use std::path::Path;
use std::process::Output;

use egotac::dataset::zarr::{MANO_FORCE, MANO_FORCE_VALID, ZarrReader};
use egotac::hand::Side;
use egotac::tactile::N_FIELD;

use crate::check::open;
use crate::common::egotac;
use crate::writers::files::ManoFiles;

/// Imports a data set with images of their original size, and further options.
pub fn import(kind: &str, root: &Path, out: &Path, more: &[&str]) -> Output {
    let [root, out] = [root, out].map(|path| path.to_str().unwrap());
    egotac(&[&["data", "import", kind, root, "--out", out, "--size", "0"][..], more].concat())
}

/// Returns the options for MANO files.
pub fn with_mano(mano: &ManoFiles) -> [&str; 4] {
    ["--mano-left", mano.left.to_str().unwrap(), "--mano-right", mano.right.to_str().unwrap()]
}

/// Checks that everything was imported.
pub fn succeeded(output: &Output) {
    let text = [&output.stdout[..], &output.stderr].concat();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&text));
}

/// Imports a data set of one recording, and opens its store.
pub fn imported(kind: &str, root: &Path, out: &Path, more: &[&str]) -> ZarrReader {
    succeeded(&import(kind, root, out, more));
    open(out)
}

/// Estimates forces from motion in an imported store under gravity along -z; returns the validity of both hands in each frame, 0 = known.
/// In the take both hands press a box between them, so that they push about equally where both are known.
pub fn force_validity(store: &Path, mano: &[&str]) -> Vec<u8> {
    let out = store.with_extension("forces.zarr");
    let [from, to] = [store, &out].map(|path| path.to_str().unwrap());
    succeeded(&egotac(&[&["label", from, "--physics", "--gravity", "0,0,-1", "--out", to][..], mano].concat()));
    let store = open(&out);
    let all = 0..store.len();
    let validity = store.read_u8("data/force_validity", all.clone()).unwrap();
    let (force, mask) =
        (store.read_f32(MANO_FORCE, all.clone()).unwrap(), store.read_u8(MANO_FORCE_VALID, all).unwrap());
    for (frame, hands) in validity.as_chunks::<2>().0.iter().enumerate() {
        let totals = Side::BOTH.map(|side| {
            let vertices = N_FIELD * frame + side.range().start..N_FIELD * frame + side.range().end;
            let known = hands[side as usize] == 0;
            assert!(mask[vertices.clone()].iter().all(|mask| *mask == u8::from(known)), "frame {frame}");
            force[vertices].iter().sum::<f32>()
        });
        let unequal = totals[0].max(totals[1]) / totals[0].min(totals[1]);
        assert!(*hands != [0; 2] || (totals[0] > 0.2 && unequal < 2.0), "frame {frame}: {totals:?} N");
    }
    validity
}
