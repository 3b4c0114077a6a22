//! Runs of the importer.

use std::path::Path;
use std::process::Output;

use egotac::dataset::zarr::ZarrReader;

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
