//! Pages of docs/reference are those that the program writes now.
#![cfg(all(feature = "ros", feature = "sim"))]

use std::fs;
use std::path::Path;

use crate::common::egotac;

#[test]
fn the_reference_in_the_docs_is_up_to_date() {
    let folder = tempfile::tempdir().unwrap();
    let output = egotac(&["reference", folder.path().to_str().unwrap()]);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let docs = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/docs/reference"));
    for name in ["cli.md", "training-keys.md", "scene-keys.md", "robot-keys.md", "glove-keys.md"] {
        let [written, kept] = [folder.path(), docs].map(|folder| fs::read_to_string(folder.join(name)).unwrap());
        let first = written.lines().zip(kept.lines()).find(|(written, kept)| written != kept);
        assert!(written == kept, "docs/reference/{name}: run scripts/reference; first difference: {first:?}");
    }
}
