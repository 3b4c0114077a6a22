//! Scores as a table for the terminal.

use super::{Comparison, EpisodesDefined, Intervals, Metrics};

/// Selects the number of episodes on which a temporal score is defined.
type Defined = fn(&EpisodesDefined) -> usize;

/// Returns a table with one column per named evaluation.
pub fn table(reports: &[(&str, &Metrics)]) -> String {
    table_with_intervals(reports, &Intervals::new())
}

/// Returns a table with one column per named evaluation, and the 95 % intervals of the first one.
pub fn table_with_intervals(reports: &[(&str, &Metrics)], intervals: &Intervals) -> String {
    let width = reports.iter().map(|(name, _)| name.len()).max().unwrap_or(0).max(9) + 2;
    let mut text = format!("{:30}", "");
    reports.iter().for_each(|(name, _)| text += &format!("{name:>width$}"));
    if !intervals.is_empty() {
        text += &format!("{:>24}", "95 % of the first");
    }
    if let Some((_, first)) = reports.first() {
        let episodes = first.counts.episodes;
        for (name, title) in ROWS {
            text += &format!("\n{title:30}");
            reports.iter().for_each(|(_, report)| text += &cell(report.score(name), width, 5));
            if !intervals.is_empty() {
                text += &format!("{:>24}", interval(intervals.get(name), 5));
            }
            if let Some((_, defined)) = TEMPORAL.iter().find(|(temporal, _)| *temporal == name) {
                text += &format!("   on {} of {episodes} episodes", defined(&first.episodes_defined));
            }
        }
        text += &footer(first);
    }
    text
}

/// Scores in tables: name in the JSON report, title.
const ROWS: [(&str, &str); 20] = [
    ("frame_mean.f1", "F1, frame mean"),
    ("frame_mean.precision", "precision, frame mean"),
    ("frame_mean.recall", "recall, frame mean"),
    ("frame_mean.iou", "IoU, frame mean"),
    ("frame_mean.auroc", "AUROC, frame mean"),
    ("false_positive_rate", "false positives without contact"),
    ("pooled.f1", "F1, pooled"),
    ("pooled.precision", "precision, pooled"),
    ("pooled.recall", "recall, pooled"),
    ("pooled.iou", "IoU, pooled"),
    ("pooled.auroc", "AUROC, pooled"),
    ("mae", "MAE (N)"),
    ("active_mae", "active MAE (N)"),
    ("temporal_pearson", "temporal Pearson"),
    ("force_cosine", "force cosine"),
    ("rise_f1", "rise F1"),
    ("fall_f1", "fall F1"),
    ("dft_pearson", "DFT Pearson"),
    ("spectral_convergence", "spectral convergence"),
    ("dominant_frequency_error_hz", "dominant frequency error (Hz)"),
];

/// Temporal scores with their numbers of episodes.
const TEMPORAL: [(&str, Defined); 7] = [
    ("temporal_pearson", |d| d.temporal_pearson),
    ("force_cosine", |d| d.force_cosine),
    ("rise_f1", |d| d.rise_f1),
    ("fall_f1", |d| d.fall_f1),
    ("dft_pearson", |d| d.dft_pearson),
    ("spectral_convergence", |d| d.spectral_convergence),
    ("dominant_frequency_error_hz", |d| d.dominant_frequency_error_hz),
];

/// Describes the frames that scores were computed from, and the rules that a table alone does not tell.
fn footer(report: &Metrics) -> String {
    let c = &report.counts;
    let share = report.share_without_positives.map_or(String::new(), |share| format!(", {:.1} %", 100.0 * share));
    let gaps = c.frames - c.trace_frames;
    format!(
        "\n{} frames in {} episodes, {} of them without contact{share} (left out of the frame mean); {} force entries, {} active\n\
         temporal scores: means over episodes whose true force changes; {gaps} masked frames are gaps; a constant prediction has \
         correlations of 0",
        c.frames, c.episodes, c.frames_without_positives, c.force_entries, c.active_entries
    )
}

/// Returns a table with one line per named group of frames or vertices, each with the interval of its frame-mean F1.
pub fn groups_table(groups: &[(String, Metrics, Intervals)]) -> String {
    let width = groups.iter().map(|(name, ..)| name.len()).max().unwrap_or(0).max(16) + 2;
    let mut text = format!(
        "{:width$}{:>15}{:>18}{:>11}{:>11}{:>11}{:>11}{:>11}{:>17}{:>16}",
        "",
        "F1, frame mean",
        "95 %",
        "F1, pooled",
        "IoU, fr.m.",
        "AUROC",
        "false pos.",
        "MAE (N)",
        "active MAE (N)",
        "active entries"
    );
    for (name, report, intervals) in groups {
        text += &format!("\n{name:width$}{}", cell(report.frame_mean.f1, 15, 4));
        text += &format!("{:>18}", interval(intervals.get("frame_mean.f1"), 3));
        let scores = [report.pooled.f1, report.frame_mean.iou, report.frame_mean.auroc, report.false_positive_rate];
        scores.into_iter().for_each(|score| text += &cell(score, 11, 4));
        text += &format!("{}{}", cell(report.mae, 11, 5), cell(report.active_mae, 17, 4));
        text += &format!("{:>16}", report.counts.active_entries);
    }
    text
}

/// Returns a table with one line per score of two predictions.
pub fn comparison_table(comparison: &Comparison) -> String {
    let mut text =
        format!("{:30}{:>12}{:>12}{:>12}{:>24}", "score", "prediction", "other", "difference", "95 % interval");
    for d in &comparison.differences {
        text += &format!("\n{:30}{}{}", d.name, cell(d.value, 12, 5), cell(d.other, 12, 5));
        text += &format!("{}{:>24}", cell(d.difference, 12, 5), interval(d.interval.as_ref(), 5));
    }
    let few = if comparison.episodes < 2 { "; intervals need at least two episodes" } else { "" };
    text + &format!("\n{} resamples of {} episodes, the same for both{few}", comparison.resamples, comparison.episodes)
}

fn cell(value: Option<f64>, width: usize, digits: usize) -> String {
    value.map_or(format!("{:>width$}", "undefined"), |value| format!("{value:>width$.digits$}"))
}

fn interval(interval: Option<&[f64; 2]>, digits: usize) -> String {
    interval.map_or("-".into(), |[low, high]| format!("{low:.digits$} .. {high:.digits$}"))
}
