//! The list of all outputs of one command with several inputs.

use std::fs::File;
use std::path::Path;

use serde_json::json;

use super::input::LabelTask;
use crate::dataset::LabelSummary;
use crate::error::{Error, Result};
use crate::file;

/// Name of the list in the folder of the outputs.
pub const MANIFEST: &str = "manifest.json";

/// Writes `manifest.json` into the folder `out`: the label info of each existing output by name, the sum of their
/// summaries, and the inputs that could not be opened. Every shard writes it from the outputs themselves, so the list of
/// the last shard is complete and the same whichever process wrote it.
///
/// # Errors
/// If it can't be written.
pub fn write_manifest(out: &Path, tasks: &[LabelTask], unreadable: &[(String, Error)]) -> Result<()> {
    let lock = out.join(".manifest.lock");
    let held = File::create(&lock).map_err(Error::io(&lock))?;
    // Ignore a file system without locks: shards that end at the same moment may then miss each other's outputs.
    let _ = held.lock();
    let (mut outputs, mut total, mut missing) = (Vec::new(), LabelSummary::default(), Vec::new());
    for task in tasks {
        let place = task.out.strip_prefix(out).unwrap_or(&task.out).display().to_string();
        match task.out.exists().then(|| task.output.info(&task.out)).flatten() {
            Some(info) => {
                total.add(&info.summary);
                outputs.push(json!({ "output": place, "labels": info }));
            }
            None => missing.push(place),
        }
    }
    let unreadable: Vec<_> =
        unreadable.iter().map(|(name, error)| json!({ "input": name, "reason": error.to_string() })).collect();
    let manifest = json!({ "outputs": outputs, "missing": missing, "unreadable": unreadable, "summary": total });
    file::write(&out.join(MANIFEST), format!("{manifest:#}\n").as_bytes())
}
