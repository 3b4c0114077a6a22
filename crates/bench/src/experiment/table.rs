//! Tables of an experiment's results, Markdown.

use egotac::text::put;

use super::report::{ArmReport, Head, Report, Scores, TestInfo};
use super::training::BATCH;

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
        let mut text = format!("{}\n{}\n{}\n", self.head.markdown(), self.figure(), self.preface());
        self.imported(&mut text);
        for test in &self.tests {
            put(&mut text, format_args!("\n## {} ({} frames, {} episodes)\n", test.title, test.frames, test.episodes));
            self.table(test, &mut text);
            let recovered = recovered(&self.arms, &test.name);
            if !recovered.is_empty() {
                put(
                    &mut text,
                    format_args!("\nOf the difference between `{WITHOUT}` and `{BOUND}`: {}.", recovered.join("; ")),
                );
            }
        }
        text
    }

    /// Shows the plot, and says how to read it.
    fn figure(&self) -> String {
        let name = self.head.experiment;
        let (alt, reading) = match name {
            "decline" => ("Scores against the strength of each degradation", "Curves are scores on a test."),
            _ => {
                ("Scores of each arm on each test", "Bars are means over seeds, dots single seeds; colours are tests.")
            }
        };
        format!("![{alt}]({name}.png)\n\n{reading}\n")
    }

    /// Says what was run, and how to read the tables.
    fn preface(&self) -> String {
        let Head { size, network, .. } = &self.head;
        let run = match size.steps {
            0 => String::new(),
            steps => format!(
                "{} seeds; {steps} steps of {} windows; {} episodes of each training scene, {} held-out ones of each scene; \
                 pictures of {} pixels, {} parameters.\n",
                size.seeds,
                BATCH.clips * BATCH.windows,
                size.episodes,
                size.held_out,
                size.image,
                self.parameters
            ),
        };
        let (part, learning) = match size.steps > 0 {
            true => (
                "The encoder of all arms is that of",
                format!(
                    "; it does not learn here, and the rest learns with the paper's loss weights and optimiser, at a learning rate of {}",
                    size.learning_rate
                ),
            ),
            false => ("Measured is", String::new()),
        };
        let again = match size.repetition {
            0 => String::new(),
            n => format!(
                "Repetition {n}: episodes for training and test, and seeds of the runs, are others than those of the first time.\n"
            ),
        };
        format!(
            "{run}{again}{part} `{}`{}, which has seen {}{learning}.\nA score is the mean over seeds, with the least and the most. Contact scores are \
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

/// Arms without force and with the best forces there are; others that learn force are between them.
const WITHOUT: &str = "contact_only";
const BOUND: &str = "true_force";
/// Scores whose shares the table tells.
const RECOVERED: [&str; 2] = ["active_mae", "temporal_pearson"];

/// Says for each arm which share of what separates [`WITHOUT`] from [`BOUND`] it recovers, means over seeds, in the scores in
/// which the bound is better; empty if the experiment has not both arms.
fn recovered(arms: &[ArmReport], test: &str) -> Vec<String> {
    let mean = |arm: &ArmReport, score: &str| {
        let values = arm.tests.get(test)?.score(score).into_iter().collect::<Option<Vec<f64>>>()?;
        (!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64)
    };
    let named = |name: &str| arms.iter().find(|arm| arm.name == name);
    let (Some(without), Some(bound)) = (named(WITHOUT), named(BOUND)) else { return Vec::new() };
    let between = arms.iter().filter(|arm| !arm.constant && arm.name != WITHOUT && arm.name != BOUND);
    let share = |arm: &ArmReport, column: &Column| {
        let (low, high) = (mean(without, column.name)?, mean(bound, column.name)?);
        let gain = if column.more { high - low } else { low - high };
        (gain > 0.0).then(|| Some(100.0 * (mean(arm, column.name)? - low) / (high - low)))?
    };
    let says = |arm: &ArmReport| {
        let scores =
            FORCE.iter().filter(|column| RECOVERED.contains(&column.name)).map(|column| match share(arm, column) {
                Some(share) => format!("{share:.0} % in {}", column.title),
                None => format!("nothing in {}, where true forces teach no more than none", column.title),
            });
        format!("`{}` recovers {}", arm.name, scores.collect::<Vec<_>>().join(" and "))
    };
    between.map(says).collect()
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

    #[test]
    fn an_arm_half_way_between_no_force_and_true_force_recovers_half() {
        let arm = |name: &str, mae: f64, pearson: f64| {
            let seeds = vec![serde_json::json!({"active_mae": mae, "temporal_pearson": pearson})];
            let scores = Scores { seeds, differences: Vec::new() };
            let tests = [("ood".to_string(), scores)].into();
            let (about, minutes) = (String::new(), Vec::new());
            ArmReport { name: name.into(), about, constant: false, training_frames: None, minutes, tests }
        };
        let arms = [arm(BOUND, 0.1, 0.8), arm("from_motion", 0.2, 0.5), arm(WITHOUT, 0.3, 0.0)];
        let expected = "`from_motion` recovers 50 % in active MAE (N) and 62 % in temporal Pearson";
        assert_eq!(recovered(&arms, "ood"), [expected]);
        assert!(recovered(&arms[..2], "ood").is_empty());
        let worse = [arm(BOUND, 0.3, 0.8), arm("from_motion", 0.2, 0.4), arm(WITHOUT, 0.3, 0.0)];
        assert!(recovered(&worse, "ood")[0].contains("recovers nothing in active MAE (N), where"));
    }
}
