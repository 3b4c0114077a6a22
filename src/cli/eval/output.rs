//! Scores of `egotac eval` as a table or as JSON.

use serde_json::{Map, Value, json};

use super::{Case, Scored};
use crate::cli::options::Json;
use crate::score::metrics::{
    self, Coverage, EgophiScores, Metrics, Reliability, egophi::egophi_table, evaluate_egophi,
};
use crate::text::printable;

/// Prints the scores.
pub fn write(scored: &Scored, json_option: &Json) -> anyhow::Result<()> {
    if json_option.take(&to_json(scored)?)? {
        return Ok(());
    }
    let mut columns: Vec<(&str, &Metrics)> = vec![("prediction", &scored.metrics)];
    columns.extend(scored.baselines.iter().map(|(name, metrics)| (*name, metrics)));
    println!("{}", printable(&metrics::table_with_intervals(&columns, &scored.intervals)));
    println!("{}", about_persistence(scored.lag));
    if let Some(unknown) = scored.unknown {
        println!("unknown to the prediction, and left out of all scores: {:.2} % of the vertices", 100.0 * unknown);
    }
    println!("{}", about_reliability(&scored.reliability));
    if let Some(coverage) = &scored.coverage {
        println!("{}", about_coverage(coverage));
    }
    if let Some(calibration) = &scored.options.calibration {
        let (pred, target) = (calibration.pred(), calibration.target());
        println!(
            "calibration: total force {} .. {} N predicted, {} .. {} N true; spectra and differences of normalised traces",
            pred.min, pred.max, target.min, target.max
        );
    }
    for group in &scored.groups {
        println!("\nby {}\n{}", group.by.name(), printable(&metrics::groups_table(&group.groups)));
    }
    if let Some(comparison) = &scored.against {
        println!("\n{}", printable(&metrics::comparison_table(comparison)));
    }
    Ok(())
}

/// Prints the scores of EgoPHI's protocol.
pub fn write_egophi(case: &Case, seed: u64, json_option: &Json) -> anyhow::Result<()> {
    let own = evaluate_egophi(&case.pred, &case.target, seed)?;
    let mut baselines: Vec<(&str, EgophiScores)> = Vec::new();
    for (name, fields) in &case.baselines {
        baselines.push((*name, evaluate_egophi(fields, &case.target, seed)?));
    }
    let mut value = serde_json::to_value(&own)?;
    value["protocol"] = "egophi".into();
    value["baselines"] = named(baselines.iter().map(|(name, scores)| (name.to_string(), scores)))?;
    value["persistence_secs"] = json!(case.lag);
    if json_option.take(&value)? {
        return Ok(());
    }
    let mut columns = vec![("prediction", &own)];
    columns.extend(baselines.iter().map(|(name, scores)| (*name, scores)));
    println!("{}", printable(&egophi_table(&columns)));
    println!("{}", about_persistence(case.lag));
    Ok(())
}

fn about_persistence(lag: Option<f64>) -> String {
    match lag {
        Some(secs) => format!("persistence: the truth of {secs:.3} s ago; it reads the truth"),
        None => "persistence: the truth of the frame before; it reads the truth".into(),
    }
}

/// Describes the reliability diagram: a line for each bin, with a bar for the share of true contacts.
fn about_reliability(reliability: &Reliability) -> String {
    let shown = |error: Option<f64>| error.map_or("undefined".to_owned(), |error| format!("{error:.4}"));
    let mut text = format!(
        "expected calibration error of contact {}; of vertices with a probability of at least 0.05: {}",
        shown(reliability.expected_calibration_error),
        shown(reliability.expected_calibration_error_in_question)
    );
    for bin in &reliability.bins {
        let bar = "#".repeat((40.0 * bin.frequency).round() as usize);
        text += &format!(
            "\n  probability {:.3}: {:5.1} % in contact, {:>9} vertices {bar}",
            bin.probability,
            100.0 * bin.frequency,
            bin.entries
        );
    }
    text
}

fn about_coverage(coverage: &Coverage) -> String {
    let percent = |share: Option<f64>| share.map_or("undefined".to_owned(), |share| format!("{:.1} %", 100.0 * share));
    let width = |width: Option<f64>| width.map_or("undefined".to_owned(), |width| format!("{width:.3} N"));
    format!(
        "{:.0} % intervals of the force hold the truth of {} of the vertices with a predicted contact (mean width {}), {} of \
         those with at least 0.01 N, {} of all vertices, and of {} of the hands with a predicted contact (total force, mean \
         width {})",
        100.0 * coverage.level,
        percent(coverage.touched),
        width(coverage.touched_width),
        percent(coverage.pressed),
        percent(coverage.all),
        percent(coverage.total),
        width(coverage.total_width)
    )
}

/// Returns the prediction's scores at the top level, with the baselines, groups and the comparison under names of their own.
fn to_json(scored: &Scored) -> anyhow::Result<Value> {
    let mut value = serde_json::to_value(&scored.metrics)?;
    value["intervals"] = serde_json::to_value(&scored.intervals)?;
    value["baselines"] = named(scored.baselines.iter().map(|(name, metrics)| (name.to_string(), metrics)))?;
    value["persistence_secs"] = json!(scored.lag);
    value["unknown_share"] = json!(scored.unknown);
    value["reliability"] = serde_json::to_value(&scored.reliability)?;
    value["coverage"] = serde_json::to_value(&scored.coverage)?;
    value["calibration"] = json!(scored.options.calibration);
    if !scored.groups.is_empty() {
        let mut by = Map::new();
        for group in &scored.groups {
            let mut groups = Map::new();
            for (name, metrics, intervals) in &group.groups {
                let mut scores = serde_json::to_value(metrics)?;
                scores["intervals"] = serde_json::to_value(intervals)?;
                groups.insert(name.clone(), scores);
            }
            by.insert(group.by.name().into(), groups.into());
        }
        value["by"] = by.into();
    }
    if let Some(comparison) = &scored.against {
        value["against"] = serde_json::to_value(comparison)?;
    }
    Ok(value)
}

fn named<'a, T: serde::Serialize + 'a>(values: impl Iterator<Item = (String, &'a T)>) -> anyhow::Result<Value> {
    let map = values.map(|(name, value)| Ok((name, serde_json::to_value(value)?)));
    Ok(map.collect::<serde_json::Result<Map<_, _>>>()?.into())
}
