//! The results of `egotac bench model` as Markdown.

use std::fmt::Write as _;

use super::measure::Row;
use super::peer::{Rounds, Timing, least};
use super::sweep::ModelReport;

const LEGEND: &str = "\
Each row is a process of its own with random weights, or with a checkpoint's where accuracy stands. *Encoder*: one frame. *Stream*:
one more frame of a stream whose other frames are kept, p50 and p95. *Window*: all frames of the observation window. *Picture*: a
JPEG of 640 x 480 pixels to touch, decoding and resizing included. *Memory*: the most that was resident in the process, MB = 2^20
bytes. Accuracy is that of held-out rendered frames against the simulator's contact forces; a dash where there are no trained
weights.
";

/// Returns the report as Markdown.
pub fn render(report: &ModelReport) -> String {
    let mut text = String::from("# What the network's accuracy costs in time\n\n");
    let _ = writeln!(
        text,
        "Written by `{}`: {} runs of each kind, egotac {}, {}.\nNumbers: `model.json`.\n\n![Size and accuracy of networks against milliseconds per frame](model.png)\n",
        report.command, report.runs, report.egotac, report.machine
    );
    text.push_str(LEGEND);
    text.push_str(&rows(&report.rows));
    if let Some(row) = report.varied.first() {
        let _ =
            writeln!(text, "\n## Horizon, input and threads, one at a time\n\nPreset {}, random weights.", row.preset);
        text.push_str(&rows(&report.varied));
    }
    if let Some(peer) = &report.peer {
        beside(peer, &report.rounds, &mut text);
    }
    text
}

/// Returns the table of configurations.
pub fn rows(rows: &[Row]) -> String {
    let mut text = String::from(
        "\n| network | M parameters | T | px | precision | threads | encoder ms | stream ms | p95 | window ms | picture ms \
         | pictures/s | weights MB | memory MB | force MAE mN | active MAE mN | F1, frame mean | F1, pooled | AUROC, pooled |\n\
         |---|---|---|---|---|---|---|---|---|---|---|---|---|---|---|---|---|---|---|\n",
    );
    for row in rows {
        let score = |value: Option<f64>, scale: f64, digits: usize| {
            value.map_or("—".into(), |value| format!("{:.digits$}", scale * value))
        };
        let accuracy = row.accuracy.as_ref();
        let of_device = if row.device == "cpu" { String::new() } else { format!(", {}", row.device) };
        let _ = writeln!(
            text,
            "| {}{of_device} | {:.1} | {} | {} | {} | {} | {:.1} | {:.1} | {:.1} | {:.1} | {:.1} | {:.0} | {} | {:.0} | {} | {} | {} | {} | {} |",
            row.preset,
            row.parameters as f64 / 1e6,
            row.horizon,
            row.image,
            row.precision,
            row.threads,
            row.encoder_ms,
            row.streaming_ms,
            row.streaming.p95,
            row.clip_ms,
            row.picture_ms,
            1e3 / row.picture_ms,
            score(row.weights_mb, 1.0, 1),
            row.peak_memory_mb,
            score(accuracy.and_then(|a| a.force_mae), 1e3, 2),
            score(accuracy.and_then(|a| a.active_mae), 1e3, 1),
            score(accuracy.and_then(|a| a.frame_mean_f1), 1.0, 4),
            score(accuracy.and_then(|a| a.contact_f1), 1.0, 4),
            score(accuracy.and_then(|a| a.auroc), 1.0, 4),
        );
    }
    text
}

fn beside(peer: &str, rounds: &[Rounds], text: &mut String) {
    let _ = writeln!(
        text,
        "\n## Beside PyTorch and OpenVINO\n\n\
         `{peer}` in turn with ours, {} rounds, f32 with the same threads; least of the rounds' medians, ms. The encoder is \
         compared with the faster of both.\n\n\
         | preset | | encoder | stream | window | memory MB |\n|---|---|---|---|---|---|",
        rounds.first().map_or(0, |pair| pair.peer.len())
    );
    for pair in rounds {
        let line = |name: &str, timings: &[Timing]| {
            let memory = least(timings, |t| t.peak_memory_mb.unwrap_or(f64::INFINITY));
            format!(
                "| {} | {name} | {:.1} | {:.1} | {:.1} | {} |\n",
                pair.preset,
                least(timings, |t| t.encoder_ms),
                least(timings, |t| t.streaming_ms),
                least(timings, |t| t.clip_ms),
                if memory.is_finite() { format!("{memory:.0}") } else { "—".into() }
            )
        };
        text.push_str(&line("egotac", &pair.ours));
        if !pair.ours_bf16.is_empty() {
            text.push_str(&line("egotac, bf16", &pair.ours_bf16));
        }
        text.push_str(&line("egotac, int8", &pair.ours_int8));
        text.push_str(&line("PyTorch", &pair.peer));
        let formats = ["", ", bf16", ", int8 by NNCF"];
        for (format, [_, openvino]) in formats.iter().zip(pair.encoders()).filter(|(_, [_, ms])| ms.is_finite()) {
            let _ = writeln!(text, "| {} | OpenVINO{format} | {openvino:.1} | — | — | — |", pair.preset);
        }
        let [encoder, streaming, clip] = pair.ratios();
        let _ = writeln!(
            text,
            "| {} | **ours / theirs** | **{encoder:.2}** | **{streaming:.2}** | **{clip:.2}** | |",
            pair.preset
        );
        let (f32, int8) = (least(&pair.ours, |t| t.streaming_ms), least(&pair.ours_int8, |t| t.streaming_ms));
        for (format, [ours, openvino]) in formats.iter().zip(pair.encoders()).skip(1) {
            if (ours / openvino).is_normal() {
                let ratio = ours / openvino;
                let _ = writeln!(text, "| {} | **ours / OpenVINO{format}** | **{ratio:.2}** | | | |", pair.preset);
            }
        }
        let of_clip = f32 / least(&pair.peer, |t| t.clip_ms);
        let _ = writeln!(
            text,
            "| {} | our stream / their window, f32 / int8 | | {of_clip:.2}, {:.2} x | | |",
            pair.preset,
            f32 / int8
        );
    }
}
