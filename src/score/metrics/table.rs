//! Scores as a table for the terminal.

use super::{Comparison, ContactScores, Metrics};

/// Selects one contact score.
type ContactScore = fn(&ContactScores) -> Option<f64>;

/// Returns a table with one column per named evaluation.
pub fn table(reports: &[(&str, &Metrics)]) -> String {
    let contact = |name: &'static str, part: fn(&Metrics) -> &ContactScores| {
        let rows: [(&str, ContactScore); 5] = [
            ("precision", |s| s.precision),
            ("recall", |s| s.recall),
            ("F1", |s| s.f1),
            ("IoU", |s| s.iou),
            ("AUROC", |s| s.auroc),
        ];
        rows.map(|(row, score)| {
            (format!("{row}, {name}"), reports.iter().map(|(_, r)| score(part(r))).collect::<Vec<_>>())
        })
    };
    let row = |name: &str, score: fn(&Metrics) -> Option<f64>| {
        (name.to_string(), reports.iter().map(|(_, r)| score(r)).collect::<Vec<_>>())
    };
    let mut rows = vec![
        row("MAE (N)", |r| r.mae),
        row("active MAE (N)", |r| r.active_mae),
        row("temporal Pearson", |r| r.temporal_pearson),
    ];
    rows.extend(contact("frame mean", |r| &r.frame_mean));
    rows.extend(contact("pooled", |r| &r.pooled));
    rows.extend([
        row("force cosine", |r| r.force_cosine),
        row("rise F1", |r| r.rise_f1),
        row("fall F1", |r| r.fall_f1),
        row("DFT Pearson", |r| r.dft_pearson),
        row("spectral convergence", |r| r.spectral_convergence),
        row("dominant frequency error (Hz)", |r| r.dominant_frequency_error_hz),
    ]);

    let width = reports.iter().map(|(name, _)| name.len()).max().unwrap_or(0).max(9) + 2;
    let mut text = format!("{:30}", "");
    reports.iter().for_each(|(name, _)| text += &format!("{name:>width$}"));
    for (name, values) in rows {
        text += &format!("\n{name:30}");
        for value in values {
            text += &cell(value, width, 5);
        }
    }
    if let Some((_, first)) = reports.first() {
        let c = &first.counts;
        text += &format!(
            "\n{} frames in {} episodes, {} of them without contact (left out of the frame mean); \
             {} force entries, {} active",
            c.frames, c.episodes, c.frames_without_positives, c.force_entries, c.active_entries
        );
    }
    text
}

/// Returns a table with one line per named group of vertices.
pub fn groups_table(groups: &[(String, Metrics)]) -> String {
    let mut text = format!(
        "{:18}{:>12}{:>17}{:>11}{:>11}{:>11}{:>11}{:>11}{:>16}",
        "part", "MAE (N)", "active MAE (N)", "precision", "recall", "F1", "IoU", "AUROC", "active entries"
    );
    for (name, report) in groups {
        let ContactScores { precision, recall, f1, iou, auroc } = report.pooled;
        text += &format!("\n{name:18}{}{}", cell(report.mae, 12, 5), cell(report.active_mae, 17, 4));
        [precision, recall, f1, iou, auroc].into_iter().for_each(|score| text += &cell(score, 11, 4));
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
        let interval = d.interval.map_or("-".to_string(), |[low, high]| format!("{low:.5} .. {high:.5}"));
        text += &format!("{}{interval:>24}", cell(d.difference, 12, 5));
    }
    let few = if comparison.episodes < 2 { "; intervals need at least two episodes" } else { "" };
    text + &format!("\n{} resamples of {} episodes, the same for both{few}", comparison.resamples, comparison.episodes)
}

fn cell(value: Option<f64>, width: usize, digits: usize) -> String {
    value.map_or(format!("{:>width$}", "undefined"), |value| format!("{value:>width$.digits$}"))
}
