//! The report as Markdown.

use egotac::text::put;

use super::model::{GBITS, RANKS, SPEEDS};
use super::{RanksReport, Row, Run, WINDOWS};

impl RanksReport {
    /// Returns the report as Markdown.
    pub fn markdown(&self) -> String {
        let mut text = format!(
            "# Training on several ranks\n\nWritten by `{}`: best of {} rounds,\negotac {}, {}, load {:.2} before the measurement, \
             {}. Numbers: `ranks.json`.\n\n## Measured: {} ranks on this machine\n\n\
             Each rank takes {WINDOWS} windows per step, which share the frames of a clip, f32. *Exchange* is the time of a step in which rank 0 sums \
             gradients with the\nothers or waits for them; *bytes* are those that a rank gives to the sum. All ranks have one thread each.\n\n\
             | preset | 1 rank, 1 thread, windows/s | 1 rank, N threads, windows/s | N ranks, windows/s | ranks / threads | ranks / 1 thread | \
             exchange | bytes per step |\n|---|---|---|---|---|---|---|---|\n",
            self.command,
            self.rows.first().map_or(0, |row| row.ranks.len()),
            self.egotac,
            self.machine,
            self.load_before,
            self.launcher,
            self.n_ranks,
        )
        .replace(" N threads", &format!(" {} threads", self.n_ranks))
        .replace("| N ranks", &format!("| {} ranks", self.n_ranks));
        for row in &self.rows {
            let [one, threads, ranks] = best(row);
            put(
                &mut text,
                format_args!(
                    "| {} | {:.2} | {:.2} | {:.2} | **{:.2}** | {:.2} | {:.1} % | {:.1} MB |",
                    row.preset,
                    one.windows_per_s,
                    threads.windows_per_s,
                    ranks.windows_per_s,
                    ranks.windows_per_s / threads.windows_per_s,
                    ranks.windows_per_s / one.windows_per_s,
                    100.0 * ranks.exchange_share,
                    ranks.exchange_bytes / 1e6
                ),
            );
        }
        text += "\n## Computed, not measured: more ranks, each on a machine of its own\n\n\
                 Share of the speed of all ranks that remains. The first number is for messages after the backward pass, as the program sends them; the second \
                 would be reached if all messages\nran during the backward pass, two thirds of a step. A step of one rank takes the measured time above, or a \
                 sixteenth of it (a rank with many cores). A ring sum sends 2 (R - 1) / R\ntimes the bytes of a step. Latency, uneven \
                 ranks and reading of data are left out. Larger batches per rank raise all numbers.\n\n";
        let columns: Vec<String> = GBITS.iter().map(|gbit| format!("{gbit:.0} Gbit/s")).collect();
        put(
            &mut text,
            format_args!(
                "| preset | speed of a rank | ranks | {} |\n|---|---|---|{}",
                columns.join(" | "),
                "---|".repeat(GBITS.len())
            ),
        );
        for row in &self.rows {
            for speed in SPEEDS {
                for ranks in RANKS {
                    let cells = self
                        .computed
                        .iter()
                        .filter(|c| c.preset == row.preset && c.speed == speed && c.ranks == ranks)
                        .map(|c| format!("{:.0} %, {:.0} %", 100.0 * c.efficiency, 100.0 * c.efficiency_with_overlap));
                    let cells: Vec<String> = cells.collect();
                    put(&mut text, format_args!("| {} | {speed:.0} | {ranks} | {} |", row.preset, cells.join(" | ")));
                }
            }
        }
        text
    }
}

/// Returns the fastest run of each kind.
fn best(row: &Row) -> [Run; 3] {
    let none = Run { step_secs: f64::NAN, windows_per_s: 0.0, exchange_share: f64::NAN, exchange_bytes: f64::NAN };
    [&row.one_thread, &row.threads, &row.ranks].map(|runs| {
        runs.iter().copied().fold(none, |best, run| if run.windows_per_s > best.windows_per_s { run } else { best })
    })
}
