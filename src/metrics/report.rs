//! Scores as a table for the terminal.

use super::{Report, Scores};

/// One score out of those of contact.
type ContactScore = fn(&Scores) -> Option<f64>;

/// A table with one column per named report; undefined scores say so.
pub fn table(reports: &[(&str, &Report)]) -> String {
    let contact = |name: &'static str, part: fn(&Report) -> &Scores| {
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
    let row = |name: &str, score: fn(&Report) -> Option<f64>| {
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
            text += &value.map_or(format!("{:>width$}", "undefined"), |value| format!("{value:>width$.5}"));
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
