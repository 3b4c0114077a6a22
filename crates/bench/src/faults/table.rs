//! The table of faults.

use egotac::machine::Machine;
use egotac::text::put;
use serde::Serialize;

use super::check::Harm;

/// Cases of one command with one fault. Counts are runs in which it was found.
#[derive(Debug, Clone, Default, Serialize)]
pub struct Row {
    /// The command.
    pub command: String,
    /// The fault.
    pub fault: String,
    /// Number of runs.
    pub runs: usize,
    /// Runs in which an image, label or file of the undisturbed run was missing.
    pub lost: usize,
    /// Runs in which a label stood beside another image than its own.
    pub mixed_up: usize,
    /// Runs in which an image was there twice.
    pub doubled: usize,
    /// Runs with an output that was not whole, or differed from the undisturbed one.
    pub half_written: usize,
    /// Runs with a wrong exit status, a signal or a hang.
    pub wrong_status: usize,
    /// Runs that left files or processes behind.
    pub leftovers: usize,
    /// Median time of the recovery, s.
    pub recovery_p50_secs: f64,
    /// Longest time of the recovery, s.
    pub recovery_max_secs: f64,
    /// Findings: number of the run, and what was found.
    pub findings: Vec<(usize, String)>,
}

impl Row {
    /// Sums up the cases of one command and fault: what was found, and the time of recovery, s.
    pub fn of(command: &str, fault: &str, cases: &[(Harm, f64)]) -> Self {
        let count = |is: fn(&Harm) -> bool| cases.iter().filter(|(harm, _)| is(harm)).count();
        let mut secs: Vec<f64> = cases.iter().map(|(_, secs)| *secs).collect();
        secs.sort_by(f64::total_cmp);
        let findings = cases.iter().enumerate();
        Self {
            command: command.into(),
            fault: fault.into(),
            runs: cases.len(),
            lost: count(|harm| harm.lost),
            mixed_up: count(|harm| harm.mixed_up),
            doubled: count(|harm| harm.doubled),
            half_written: count(|harm| harm.half_written),
            wrong_status: count(|harm| harm.wrong_status),
            leftovers: count(|harm| harm.leftovers),
            recovery_p50_secs: secs.get(secs.len() / 2).copied().unwrap_or_default(),
            recovery_max_secs: secs.last().copied().unwrap_or_default(),
            findings: findings
                .flat_map(|(run, (harm, _))| harm.notes.iter().map(move |note| (run, note.clone())))
                .collect(),
        }
    }

    /// True if no run found anything.
    pub fn is_clean(&self) -> bool {
        self.counts().iter().all(|count| *count == 0)
    }

    fn counts(&self) -> [usize; 6] {
        [self.lost, self.mixed_up, self.doubled, self.half_written, self.wrong_status, self.leftovers]
    }
}

/// All rows.
#[derive(Debug, Clone, Serialize)]
pub struct FaultsReport {
    /// The command that measures the same again.
    pub command: String,
    /// Version of the program.
    pub version: &'static str,
    /// The machine that it was measured on.
    pub machine: Machine,
    /// Seed of the times at which faults happen.
    pub seed: u64,
    /// True if small disks could be mounted.
    pub small_disk: bool,
    /// One per command and fault.
    pub rows: Vec<Row>,
}

impl FaultsReport {
    /// True if no run found anything.
    pub fn is_clean(&self) -> bool {
        self.rows.iter().all(Row::is_clean)
    }

    /// Returns the report as Markdown.
    pub fn markdown(&self) -> String {
        let Self { command, version, machine, seed, small_disk, rows } = self;
        let disk = match small_disk {
            true => "or a small tmpfs is full.",
            false => "no small tmpfs was mounted, which needs root.",
        };
        let runs: usize = rows.iter().map(|row| row.runs).sum();
        let mut text = format!(
            "# Faults while a command writes its output\n\nWritten by `{command}` (egotac {version}, {machine}, seed {seed}): \
             {runs} runs. Numbers and findings: `faults.json`.\n\n\
             Each run meets one fault; then the same command is given again, and the output is compared with that of an\n\
             undisturbed run. Counts are runs. *Lost*: an image, label or file is missing. *Mixed up*: a label beside another\n\
             image than its own. *Doubled*: an image twice. *Half-written*: an output that is not whole, or has other bytes.\n\
             *Wrong status*: an exit status that is not documented, a signal, a panic or a hang. *Leftovers*: files or processes\n\
             that stay behind. All should be 0. *Recovery*: time of the second command.\n\
             *Disk full*: each write fails from some write on (ENOSPC by a preloaded library), {disk}\n\n\
             | command | fault | runs | lost | mixed up | doubled | half-written | wrong status | leftovers | recovery p50 | max |\n\
             |---|---|---|---|---|---|---|---|---|---|---|\n"
        );
        for row in rows {
            let counts = row.counts().map(|count| if count > 0 { format!("**{count}**") } else { "0".into() });
            let Row { command, fault, runs, recovery_p50_secs: p50, recovery_max_secs: max, .. } = row;
            put(
                &mut text,
                format_args!("| {command} | {fault} | {runs} | {} | {p50:.2} s | {max:.2} s |", counts.join(" | ")),
            );
        }
        text
    }
}
