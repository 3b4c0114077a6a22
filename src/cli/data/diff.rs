//! `egotac data diff`.

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::process::ExitCode;

use anyhow::{Context, ensure};
use serde_json::json;

use crate::cli::options::Json;
use crate::dataset::Labelled;
use crate::score::metrics::{self, EvalOptions};
use crate::tactile::{N_FIELD, TactileSequence};

/// Arguments of `egotac data diff`.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Either side may be a store, a bag, an .mcap file or a tensor file, labelled or with truth. Frames pair by index \
    if both sides have the same number of frames, otherwise by equal timestamps. If B is a prediction, vertices with a contact \
    above 0.5 count as touched."
)]
pub struct Args {
    /// The labels to score.
    a: PathBuf,
    /// The labels to compare them with.
    b: PathBuf,
    #[command(flatten)]
    json: Json,
}

/// Runs the command.
pub fn run(args: Args) -> anyhow::Result<ExitCode> {
    let read = |path: &PathBuf| Labelled::read(path).with_context(|| path.display().to_string());
    let (a, b) = (read(&args.a)?.labels, read(&args.b)?.labels);
    if let (Some(a), Some(b)) = (a.topology, b.topology) {
        a.must_match(b)?;
    }
    let pairs = pairs(&a, &b);
    ensure!(!pairs.is_empty(), "{} and {} have no frame of equal time", args.a.display(), args.b.display());
    let (pred, mut target) = paired(&a, &b, &pairs);
    // Predictions become 0 or 1, as truth is already.
    for contact in target.contact.iter_mut().filter(|contact| !contact.is_nan()) {
        *contact = f32::from(*contact > 0.5);
    }
    let report = metrics::evaluate(&pred, &target, &EvalOptions::default())?;
    let (only_a, only_b) = (a.n_frames() - pairs.len(), b.n_frames() - pairs.len());
    let mut value = serde_json::to_value(&report)?;
    value["unmatched"] = json!({ "a": only_a, "b": only_b });
    args.json.show(&value, || {
        let mut text = metrics::table(&[("A against B", &report)]);
        if only_a + only_b > 0 {
            text += &format!("\n{only_a} frames of A and {only_b} of B without a partner of equal time");
        }
        text
    })?;
    Ok(ExitCode::SUCCESS)
}

/// Returns both sides over B's frames. Frames without a partner are unknown in A and masked in B, so that they are gaps in
/// the total force over time.
fn paired(a: &TactileSequence, b: &TactileSequence, pairs: &[(usize, usize)]) -> (TactileSequence, TactileSequence) {
    let unknown = vec![f32::NAN; b.force.len()];
    let mut pred =
        TactileSequence { topology: a.topology, force: unknown.clone(), contact: unknown, ..Default::default() };
    let mut target = b.clone();
    for mask in [&mut target.mask_force, &mut target.mask_contact] {
        let is_counted = |at: &usize| mask.get(*at).is_none_or(|mask| *mask != 0);
        let counted: Vec<usize> = pairs.iter().flat_map(|(_, b)| row(*b)).filter(is_counted).collect();
        *mask = vec![0; b.force.len()];
        counted.into_iter().for_each(|at| mask[at] = 1);
    }
    for (from, to) in pairs {
        pred.force[row(*to)].copy_from_slice(a.force_at(*from));
        pred.contact[row(*to)].copy_from_slice(a.contact_at(*from));
    }
    (pred, target)
}

/// Returns the entries of a frame.
fn row(frame: usize) -> std::ops::Range<usize> {
    frame * N_FIELD..(frame + 1) * N_FIELD
}

/// Returns the indices of paired frames of A and B, in B's order.
fn pairs(a: &TactileSequence, b: &TactileSequence) -> Vec<(usize, usize)> {
    if a.n_frames() == b.n_frames() {
        return (0..a.n_frames()).map(|index| (index, index)).collect();
    }
    // Formats round times to nanoseconds, or to f64 seconds since 1970: compare them to the microsecond.
    let key = |seconds: f64| (seconds * 1e6).round() as i64;
    let at: BTreeMap<i64, usize> = a.timestamps.iter().enumerate().map(|(index, stamp)| (key(*stamp), index)).collect();
    let found = b.timestamps.iter().enumerate();
    found.filter_map(|(index, stamp)| Some((*at.get(&key(*stamp))?, index))).collect()
}
