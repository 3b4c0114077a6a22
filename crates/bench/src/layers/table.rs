//! The results of `egotac bench layers` as Markdown.

use std::fmt::Write as _;

use super::LayersReport;

const LEGEND: &str = "\
Each step of the vision encoder over all its layers, one frame, with weights of each layer in memory of their own. *Peak*: operations
per second in registers, as this machine computes them in this precision, and bytes per second that it reads from memory. *Bound*:
the least time that the peak allows for the step's operations and for its bytes (weights, inputs and outputs once each), and
which of the two sets it. A step that is far from its bound and has few operations waits for memory between its parts. *One thread*: time on
one thread, frame by frame in turn, over that on all.

bf16 and int8 have a peak of their own where the processor has a matrix unit; without one they are compared with the peak of f32.
";

impl LayersReport {
    /// Returns the report as Markdown.
    pub fn markdown(&self) -> String {
        let mut text = String::from("# Where the encoder's time goes\n\n");
        let _ = write!(
            text,
            "Written by `{}`: median of {} frames, {} threads, egotac {}, {}.\nNumbers: `layers.json`.\n\n{LEGEND}",
            self.command, self.runs, self.threads, self.egotac, self.machine
        );
        for row in &self.rows {
            let total: f64 = row.steps.iter().map(|step| step.ms).sum();
            let _ = write!(
                text,
                "\n## {}, {}\n\nPeak: {:.0} GFLOP/s ({:.0} on one thread), {:.0} GB/s.\n\n\
                 | step | ms | share | GFLOP/s | of the peak | GB/s | bound ms | set by | one thread |\n|---|---|---|---|---|---|---|---|---|\n",
                row.preset, row.precision, row.peaks.gflops, row.peaks.gflops_of_one, row.peaks.gbytes
            );
            let mut bounds = 0.0;
            for step in &row.steps {
                let (bound, by_memory) = step.bound(&row.peaks);
                let rate = 1e3 * step.gflop / step.ms;
                bounds += bound;
                let _ = writeln!(
                    text,
                    "| {} | {:.2} | {:.0} % | {rate:.0} | {:.0} % | {:.0} | {bound:.2} | {} | {:.2} x |",
                    step.name,
                    step.ms,
                    100.0 * step.ms / total,
                    100.0 * rate / row.peaks.gflops,
                    step.mbytes / step.ms,
                    if by_memory { "memory" } else { "arithmetic" },
                    step.ms_on_one / step.ms
                );
            }
            let all: f64 = row.steps.iter().map(|step| step.gflop).sum();
            let rate = 1e3 * all / total;
            let on_one: f64 = row.steps.iter().map(|step| step.ms_on_one).sum();
            let _ = writeln!(
                text,
                "| **all** | **{total:.2}** | | **{rate:.0}** | **{:.0} %** | | **{bounds:.2}** | | **{:.2} x** |",
                100.0 * rate / row.peaks.gflops,
                on_one / total
            );
        }
        text
    }
}
