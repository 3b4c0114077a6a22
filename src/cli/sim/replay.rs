//! `egotac sim replay`: contact forces along recorded poses, beside those that the store holds.

use super::Replay;
use crate::cli::label_physics;
use crate::dataset::zarr::ZarrReader;
use crate::label::replay::{Agreement, ReplayReport};

/// Replays a store, and prints the agreement.
pub fn run(args: &Replay) -> anyhow::Result<()> {
    let models = label_physics::models(&ZarrReader::open(&args.store)?, &args.hands)?;
    let report = ReplayReport::of(&args.store, &models, &args.bodies.options())?;
    Ok(args.json.show(&serde_json::to_value(&report)?, || table(&report))?)
}

fn table(report: &ReplayReport) -> String {
    let row =
        |quantity: &str, [a, b, c, d, e]: [&str; 5]| format!("{quantity:56} {a:>8} {b:>11} {c:>10} {d:>10} {e:>10}\n");
    let ReplayReport { frames, replayed, missed_rotation_degrees, .. } = report;
    let mut text = format!(
        "{replayed} of {frames} frames count; the hinges of the hand miss recorded joints by {missed_rotation_degrees:.1} degrees in the mean\n"
    );
    text += &row("quantity", ["entries", "correlation", "rel. error", "replay (N)", "store (N)"]);
    for Agreement { quantity, entries, correlation, relative_error, replay, other } in &report.agreements {
        let numbers = [correlation, relative_error, replay, other].map(|value| format!("{value:.3}"));
        let [correlation, relative, replay, other] = numbers.each_ref().map(String::as_str);
        text += &row(quantity, [&entries.to_string(), correlation, relative, replay, other]);
    }
    if report.agreements.is_empty() {
        text += "the store holds no forces to compare with\n";
    }
    text
}
