//! One list of what became of several inputs, the same whichever process wrote it.

use std::fs::File;
use std::path::Path;

use serde_json::json;

use super::input::Item;
use super::summary::Summary;
use crate::error::{Error, Result};
use crate::file;

/// Name of the list in the folder of the outputs.
pub const MANIFEST: &str = "manifest.json";

/// Writes `manifest.json` into the folder `out`: provenance and numbers of each output that is there, by name, and their
/// sum; and of what could not be opened. Every shard writes it when it is done, from the outputs themselves, so the last one's list is complete.
///
/// # Errors
/// If it can't be written.
pub fn write_manifest(out: &Path, items: &[Item], unreadable: &[(String, Error)]) -> Result<()> {
    let lock = out.join(".manifest.lock");
    let held = File::create(&lock).map_err(Error::io(&lock))?;
    // Where files can't be locked, shards that end at the same moment may miss each other's outputs until one is run again.
    let _ = held.lock();
    let (mut outputs, mut total, mut missing) = (Vec::new(), Summary::default(), Vec::new());
    for item in items {
        let place = item.out.strip_prefix(out).unwrap_or(&item.out).display().to_string();
        match item.out.exists().then(|| item.output.about(&item.out)).flatten() {
            Some(about) => {
                total.add(&about.summary);
                outputs.push(json!({ "output": place, "labels": about }));
            }
            None => missing.push(place),
        }
    }
    let unreadable: Vec<_> =
        unreadable.iter().map(|(name, error)| json!({ "input": name, "reason": error.to_string() })).collect();
    let manifest = json!({ "outputs": outputs, "missing": missing, "unreadable": unreadable, "summary": total });
    file::write(&out.join(MANIFEST), format!("{manifest:#}\n").as_bytes())
}
