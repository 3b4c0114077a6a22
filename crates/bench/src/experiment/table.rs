//! Tables of an experiment's results, Markdown.

use egotac::text::put;

use super::report::{ArmReport, Report, Scores, TestInfo};

/// Score in tables and plots.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Column {
    /// Name in the JSON.
    pub name: &'static str,
    /// Title for readers.
    pub title: &'static str,
    /// True if more is better.
    pub more: bool,
}

const fn column(name: &'static str, title: &'static str, more: bool) -> Column {
    Column { name, title, more }
}

/// Scores against truth by force. Frame means are the paper's averaging, so they stand first.
pub const FORCE: [Column; 11] = [
    column("frame_mean.f1", "F1, frame mean", true),
    column("pooled.f1", "F1, pooled", true),
    column("frame_mean.auroc", "AUROC, frame mean", true),
    column("false_positive_rate", "false-positive rate", false),
    column("active_mae", "active MAE (N)", false),
    column("temporal_pearson", "temporal Pearson", true),
    column("force_cosine", "force cosine", true),
    column("rise_f1", "rise F1", true),
    column("fall_f1", "fall F1", true),
    column("dft_pearson", "DFT Pearson", true),
    column("spectral_convergence", "spectral convergence", false),
];

/// Scores against truth by distance.
pub const CONTACT: [Column; 7] = [
    column("frame_mean.precision", "precision, frame mean", true),
    column("frame_mean.recall", "recall, frame mean", true),
    column("frame_mean.f1", "F1, frame mean", true),
    column("frame_mean.iou", "IoU, frame mean", true),
    column("frame_mean.auroc", "AUROC, frame mean", true),
    column("pooled.f1", "F1, pooled", true),
    column("false_positive_rate", "false-positive rate", false),
];

impl Column {
    /// Returns the score of each seed.
    pub fn of(&self, scores: &Scores) -> Vec<Option<f64>> {
        scores.score(self.name)
    }
}

/// Returns the columns of a test.
pub fn columns(test: &TestInfo) -> &'static [Column] {
    if test.force { &FORCE } else { &CONTACT }
}

impl Report {
    /// Returns the report as Markdown: one table per test.
    pub fn markdown(&self) -> String {
        let mut text = format!(
            "# {0}\n\n{1} Written by `{2}`, egotac {3}, {4}. Numbers: `{0}.json`.\n\n{5}\n",
            self.experiment,
            self.question,
            self.command,
            self.egotac,
            self.machine,
            self.preface(),
        );
        self.imported(&mut text);
        for test in &self.tests {
            put(&mut text, format_args!("\n## {} ({} frames, {} episodes)\n", test.title, test.frames, test.episodes));
            self.table(test, &mut text);
        }
        text
    }

    /// Says what was run, and how to read the tables.
    fn preface(&self) -> String {
        let Self { size, network, .. } = self;
        let run = match size.steps {
            0 => String::new(),
            steps => format!(
                "{} seeds; {steps} steps of up to 30 windows; {} episodes of each training scene, {} held-out ones of each scene; \
                 pictures of {} pixels, {} parameters.\n",
                size.seeds, size.episodes, size.held_out, size.image, self.parameters
            ),
        };
        let part = if size.steps > 0 { "The encoder of all arms is that of" } else { "Measured is" };
        format!(
            "{run}{part} `{}`{}, which has seen {}.\nA score is the mean over seeds, with the least and the most. Contact scores are \
             means over frames with contact, as the paper's,\nand pooled where the title says so; scores over time are means over \
             episodes. Differences are {}, with 95 % intervals over\nepisodes, the same ones for both; with several seeds the \
             interval spans those of all, so a difference beyond it holds in each.",
            network.name,
            network.sha256.get(..12).map(|hash| format!(" ({hash})")).unwrap_or_default(),
            network.has_seen,
            self.differences,
        )
    }

    /// Tells how far the labels of imported recordings agree with the simulator's.
    fn imported(&self, text: &mut String) {
        if self.imported.is_empty() {
            return;
        }
        text.push_str(
            "\n## Imported labels beside the simulator's\n\nContact of `hot3d` against the simulator's 1 cm rule, of the glove against \
             contact by force, where the import knows it.\n\n| kind | frames | vertices with known contact | F1 of contact | force kept |\n\
             |---|---|---|---|---|\n",
        );
        for own in &self.imported {
            let kept = own.force_kept.map_or_else(|| "—".into(), |share| format!("{:.1} %", 100.0 * share));
            put(
                text,
                format_args!(
                    "| {} | {} | {:.1} % | {:.3} | {kept} |",
                    own.kind,
                    own.frames,
                    100.0 * own.known,
                    own.contact_f1
                ),
            );
        }
    }

    fn table(&self, test: &TestInfo, text: &mut String) {
        let columns = columns(test);
        let titles: Vec<&str> = columns.iter().map(|column| column.title).collect();
        let title = |name: &str| columns.iter().find(|column| column.name == name).map_or("", |column| column.title);
        let [first, second] = test.compared.map(title);
        put(
            text,
            format_args!(
                "| arm | what is other | training frames | {} | difference of {first} | of {second} |",
                titles.join(" | ")
            ),
        );
        put(text, format_args!("|---|---|---|{}---|---|", "---|".repeat(columns.len())));
        for arm in &self.arms {
            let Some(scores) = arm.tests.get(&test.name) else { continue };
            let cells: Vec<String> = columns.iter().map(|column| spread(&column.of(scores))).collect();
            let differences = test.compared.map(|name| difference(scores, name));
            put(
                text,
                format_args!(
                    "| {} | {} | {} | {} | {} |",
                    arm.name,
                    arm.about,
                    frames(arm),
                    cells.join(" | "),
                    differences.join(" | ")
                ),
            );
        }
    }
}

fn frames(arm: &ArmReport) -> String {
    arm.training_frames.map_or_else(|| "—".into(), |frames| frames.to_string())
}

/// Formats a difference with its interval; a dash if there is none.
fn difference(scores: &Scores, name: &str) -> String {
    match scores.difference(name) {
        Some((mean, [low, high])) => format!("{mean:+.3} ({low:+.3} .. {high:+.3})"),
        None => "—".into(),
    }
}

/// Formats mean (least..most), one seed as it is; a dash if a seed leaves the score undefined.
pub fn spread(values: &[Option<f64>]) -> String {
    let Some(values) = values.iter().copied().collect::<Option<Vec<f64>>>().filter(|values| !values.is_empty()) else {
        return "—".into();
    };
    let mean = values.iter().sum::<f64>() / values.len() as f64;
    let (low, high) = values.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), x| (l.min(*x), h.max(*x)));
    if values.len() == 1 { format!("{mean:.3}") } else { format!("{mean:.3} ({low:.3}..{high:.3})") }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_spread_names_mean_least_and_most_and_nothing_undefined() {
        assert_eq!(spread(&[Some(0.5), Some(0.25)]), "0.375 (0.250..0.500)");
        assert_eq!(spread(&[Some(0.5)]), "0.500");
        assert_eq!((spread(&[Some(0.5), None]), spread(&[])), ("—".into(), "—".into()));
    }
}
