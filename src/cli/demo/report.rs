//! Writes the demo's results: numbers as JSON and as a table, and the picture.

use std::fmt::Write as _;
use std::path::Path;

use anyhow::{Context, Result, ensure};
use serde_json::{Value, json};

use super::Args;
use super::bag::{self, MessagesByStamp};
use super::figure::{self, TracePoint};
use crate::file;
use crate::hand::{HandModel, HandParams, Side};
use crate::machine::Machine;
use crate::message::TactileFrame;
use crate::tactile::{CONTACT_FORCE_N, TactileField};
use crate::text::significant;

/// Image, prediction and truth of one stamp.
struct Comparison<'a> {
    /// Seconds since the first image.
    seconds: f64,
    image: &'a crate::message::Image,
    predicted: TactileField,
    truth: TactileField,
}

/// Writes `demo.json`, `metrics.md` and `demo.png` into `out`, and prints their paths and the headline numbers.
///
/// # Errors
/// If the verifier's report or the recording can't be read, no image has both prediction and truth, or a file can't be
/// written.
pub fn write(args: &Args, out: &Path, bag: &Path, verifier_report: &Path) -> Result<()> {
    let run = bag::read(&bag.join(crate::dataset::mcap::file_name(bag)))?;
    let text = std::fs::read_to_string(verifier_report).with_context(|| verifier_report.display().to_string())?;
    let verifier: Value = serde_json::from_str(&text).with_context(|| verifier_report.display().to_string())?;
    let summary = summarize(args, &run, &verifier);
    let table = table(&summary);
    file::write(&out.join("demo.json"), format!("{summary:#}\n").as_bytes())?;
    file::write(&out.join("metrics.md"), table.as_bytes())?;
    draw(&out.join("demo.png"), &run)?;
    println!("\n{table}");
    println!("picture    {}", out.join("demo.png").display());
    println!("recording  {}", bag.display());
    println!("numbers    {}", out.join("demo.json").display());
    println!("{}", headline(&summary));
    Ok(())
}

/// Collects the demo's numbers: counts from the recording, scores and latency from the verifier.
fn summarize(args: &Args, run: &MessagesByStamp, verifier: &Value) -> Value {
    let count = |has: fn(&bag::StampMessages) -> bool| run.values().filter(|messages| has(messages)).count();
    let images = count(|messages| messages.image.is_some());
    let predictions = count(|messages| messages.image.is_some() && messages.predicted.is_some());
    let unpaired = count(|messages| messages.image.is_some() && messages.predicted.is_none());
    let without_image = count(|messages| messages.image.is_none() && messages.predicted.is_some());
    json!({
        "command": args.command(),
        "machine": Machine::this().to_string(),
        "images": images,
        "predictions": predictions,
        "dropped_frames": unpaired,
        "predictions_without_image": without_image,
        "verifier": verifier,
        "version": env!("CARGO_PKG_VERSION"),
    })
}

/// Rows of the table: title, JSON pointer into the summary, factor and unit.
const ROWS: [(&str, &str, f64, &str); 18] = [
    ("images published", "/images", 1.0, ""),
    ("predictions with an image's stamp", "/predictions", 1.0, ""),
    ("dropped frames", "/dropped_frames", 1.0, ""),
    ("rate", "/verifier/rate_hz", 1.0, "Hz"),
    ("latency p50 (image stamp to result)", "/verifier/latency_secs/p50", 1e3, "ms"),
    ("latency p95", "/verifier/latency_secs/p95", 1e3, "ms"),
    ("force MAE, all vertices", "/verifier/metrics/mae", 1.0, "N"),
    ("force MAE, vertices above 0.05 N", "/verifier/metrics/active_mae", 1.0, "N"),
    ("temporal Pearson of the total force", "/verifier/metrics/temporal_pearson", 1.0, ""),
    ("force cosine", "/verifier/metrics/force_cosine", 1.0, ""),
    ("contact F1 (mean over frames with touch)", "/verifier/metrics/frame_mean/f1", 1.0, ""),
    ("contact IoU (mean over frames with touch)", "/verifier/metrics/frame_mean/iou", 1.0, ""),
    ("contact AUROC (mean over frames with touch)", "/verifier/metrics/frame_mean/auroc", 1.0, ""),
    ("frames without touch", "/verifier/metrics/share_without_positives", 100.0, "%"),
    ("false-positive rate on these", "/verifier/metrics/false_positive_rate", 100.0, "% of vertices"),
    ("contact F1 (pooled)", "/verifier/metrics/pooled/f1", 1.0, ""),
    ("contact AUROC (pooled)", "/verifier/metrics/pooled/auroc", 1.0, ""),
    ("frames left out as invalid", "/verifier/invalid_truths", 1.0, ""),
];

/// JSON pointer of the network's scores.
const SCORES: &str = "/verifier/metrics";
/// JSON pointers of the scores of predictions that see no image.
const BASELINES: [&str; 2] = ["/verifier/baselines/zero", "/verifier/baselines/persistence"];

fn table(summary: &Value) -> String {
    let mut text = String::from(
        "| predicted against the simulator's truth | network | no touch ever | truth of the frame before |\n|---|---|---|---|\n",
    );
    for (name, pointer, factor, unit) in ROWS {
        let baselines = BASELINES.map(|baseline| match pointer.strip_prefix(SCORES) {
            Some(score) => cell(summary.pointer(&format!("{baseline}{score}")), factor, unit),
            None => String::new(),
        });
        let _ =
            writeln!(text, "| {name} | {} | {} |", cell(summary.pointer(pointer), factor, unit), baselines.join(" | "));
    }
    let field = |pointer: &str| summary.pointer(pointer).and_then(Value::as_str).unwrap_or("unknown").to_owned();
    let _ = writeln!(text, "\n`{}`, network {}, {}", field("/command"), field("/verifier/model_id"), field("/machine"));
    text
}

fn cell(value: Option<&Value>, factor: f64, unit: &str) -> String {
    let text = match value {
        Some(Value::Number(number)) if number.is_u64() && factor == 1.0 => number.to_string(),
        Some(Value::Number(number)) => significant(number.as_f64().unwrap_or(f64::NAN) * factor),
        _ => return "undefined".into(),
    };
    if unit.is_empty() { text } else { format!("{text} {unit}") }
}

fn headline(summary: &Value) -> String {
    let get = |pointer: &str, factor, unit| cell(summary.pointer(pointer), factor, unit);
    format!(
        "{} predictions for {} images at {}, latency {} (p50); contact F1 {} (frame mean), AUROC {}; active force error {}, temporal Pearson {}",
        get("/predictions", 1.0, ""),
        get("/images", 1.0, ""),
        get("/verifier/rate_hz", 1.0, "Hz"),
        get("/verifier/latency_secs/p50", 1e3, "ms"),
        get("/verifier/metrics/frame_mean/f1", 1.0, ""),
        get("/verifier/metrics/frame_mean/auroc", 1.0, ""),
        get("/verifier/metrics/active_mae", 1.0, "N"),
        get("/verifier/metrics/temporal_pearson", 1.0, ""),
    )
}

/// Draws the picture of a moment in which prediction and truth can be compared.
fn draw(path: &Path, run: &MessagesByStamp) -> Result<()> {
    let moments = comparisons(run)?;
    ensure!(
        !moments.is_empty(),
        "no image has both a prediction and a truth: see the logs of the nodes in {}",
        path.with_file_name("").display()
    );
    // Of the hands whose touch is known: an absent one adds nothing.
    let total = |field: &TactileField| {
        let known = Side::BOTH.into_iter().filter(|side| !field.is_unknown(*side));
        known.map(|side| f64::from(field.total_force(side))).reduce(|sum, force| sum + force).unwrap_or(f64::NAN)
    };
    let trace: Vec<TracePoint> = moments
        .iter()
        .map(|m| TracePoint { seconds: m.seconds, predicted: total(&m.predicted), truth: total(&m.truth) })
        .collect();
    let shown = shown(&moments, &trace);
    let side = if shown.truth.total_force(Side::Left) > shown.truth.total_force(Side::Right) {
        Side::Left
    } else {
        Side::Right
    };
    let hand = HandModel::builtin(side);
    let posed = hand.forward(&HandParams::default());
    let image = bag::picture(shown.image)?;
    let shown = figure::Snapshot {
        seconds: shown.seconds,
        image: &image,
        predicted: &shown.predicted.force[side.range()],
        truth: &shown.truth.force[side.range()],
    };
    Ok(figure::write(path, &hand, &posed, &shown, &trace)?)
}

/// Returns the stamps that have all three messages, in time order.
fn comparisons(run: &MessagesByStamp) -> Result<Vec<Comparison<'_>>> {
    let first = run.keys().next().copied().unwrap_or(0);
    let field = |frame: &TactileFrame| frame.to_field();
    let mut moments = Vec::new();
    for (stamp, messages) in run {
        if let (Some(image), Some(predicted), Some(truth)) = (&messages.image, &messages.predicted, &messages.truth) {
            moments.push(Comparison {
                seconds: (stamp - first) as f64 * 1e-9,
                image,
                predicted: field(predicted)?,
                truth: field(&truth.frame)?,
            });
        }
    }
    Ok(moments)
}

/// Share of the peak force that the shown moment has at least.
const SHOWN_FORCE: f64 = 0.3;
/// Largest difference between the totals of the shown moment, as a share of the true one.
const COMPARABLE: f64 = 0.25;

/// Returns the moment of the picture: of those with much force and comparable totals, the one whose F1 of contact is the median. If no
/// totals are comparable, it is the one where they differ least.
fn shown<'a, 'b>(moments: &'a [Comparison<'b>], trace: &[TracePoint]) -> &'a Comparison<'b> {
    let peak = trace.iter().map(|point| point.truth).filter(|force| force.is_finite()).fold(0.0, f64::max);
    let off = |index: usize| ((trace[index].predicted - trace[index].truth) / trace[index].truth).abs();
    let is_known = |index: &usize| off(*index).is_finite() && trace[*index].truth >= SHOWN_FORCE * peak;
    let mut touched: Vec<usize> = (0..moments.len()).filter(is_known).collect();
    touched.sort_by(|&a, &b| off(a).total_cmp(&off(b)));
    let mut comparable: Vec<(f64, usize)> =
        touched.iter().filter(|index| off(**index) <= COMPARABLE).map(|index| (f1(&moments[*index]), *index)).collect();
    comparable.sort_by(|a, b| a.0.total_cmp(&b.0));
    let index = comparable.get(comparable.len() / 2).map(|(_, index)| *index).or_else(|| touched.first().copied());
    index.map_or(&moments[0], |index| &moments[index])
}

/// Returns the F1 of contact over the vertices whose prediction is known.
fn f1(moment: &Comparison) -> f64 {
    let pairs = moment.predicted.contact.iter().zip(&moment.truth.force).filter(|(contact, _)| contact.is_finite());
    let [hits, errors] =
        pairs.fold([0.0, 0.0], |[hits, errors], (contact, force)| match (*contact > 0.5, *force > CONTACT_FORCE_N) {
            (true, true) => [hits + 1.0, errors],
            (false, false) => [hits, errors],
            _ => [hits, errors + 1.0],
        });
    2.0 * hits / f64::max(2.0 * hits + errors, 1.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn undefined_metrics_are_marked() {
        let summary = json!({ "images": 3, "verifier": { "metrics": { "mae": null } } });
        let table = table(&summary);
        assert!(table.contains("| images published | 3 |"), "{table}");
        assert!(table.contains("| force MAE, all vertices | undefined |"), "{table}");
    }
}
