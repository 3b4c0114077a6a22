//! The report as Markdown and JSON.

use std::path::Path;

use egotac::render::figure;
use egotac::text::put;
use serde::Deserialize;

use super::determined::Determined;
use super::plot::Plot;
use super::record::{Disturbance, MassKnowledge};
use super::{PhysicsReport, Score};

/// Returns a condition in words.
pub(super) fn name(condition: &Disturbance) -> String {
    let noise = match condition.millimetres {
        0.0 => "exact".to_string(),
        millimetres => format!("{millimetres:.0} mm, {:.0}°", condition.degrees),
    };
    let mass = match condition.mass {
        MassKnowledge::Known => "known",
        MassKnowledge::Density => "from density",
        MassKnowledge::Wrong => "wrong by 50 %",
    };
    format!("{noise} | {:.0} Hz | {mass}", condition.rate)
}

const HEAD: &str = " | net force within 2 % + 0.05 N | touched: within, faster than poses show, other misses | touched: within of what poses show | net force error (N) | net moment error (mN m) | determined links: within 10 % + 0.05 N (median) | all links: error of mean force (N) | inside the 90 % interval: all, determined, other | determined, but flagged | unknown | ms |\n";

impl PhysicsReport {
    /// Writes `physics.md`, `physics.json`, `physics.png` and `physics.svg` into a folder.
    ///
    /// # Errors
    /// If a file can't be written.
    pub fn write_plots(&self, folder: &Path) -> anyhow::Result<()> {
        figure::write(folder, "physics", &Plot::deserialize(serde_json::to_value(self)?)?)?;
        figure::write(folder, "physics-determined", &Determined::new()?)?;
        Ok(())
    }

    /// Returns the report as Markdown.
    pub fn markdown(&self) -> String {
        let mut text = String::from("# Forces from motion against the simulator's contacts\n\n");
        put(
            &mut text,
            format_args!(
                "Written by `{}`: egotac {}, {}, beside other work (mean load {:.1}), which the times include. Seeds {} to {} of each scene; left out, \
                 because nothing moves freely there: {}. Numbers: `physics.json`. How the forces come about: [physics.md](../physics.md).\n\n\
                 ![Error against noise of the poses](physics.png)\n\n\
                 Lines have rotations of 1° beside 1 and 3 mm, and 3° beside 5 mm; rings have 3° beside 3 mm. Lower is better in the \
                 first two; in the third, 0.9 is right.\n",
                self.command,
                self.version,
                self.machine,
                self.load,
                self.seeds[0],
                self.seeds[1] - 1,
                self.left_out.join(", ")
            ),
        );
        text.push_str(
            "Noise is independent in each frame, of each object and wrist, per axis. *Net* compares the wrench that the motion asks for with the sum of the engine's contacts \
             at the same instant: median and 95th percentile. *Touched* counts bodies that a hand touches. A force is *faster than poses show* if the engine's own net force of all steps, through the \
             estimation's smoother, is outside of the tolerance of the instant's force: no poses of that rate tell it. *Within of what poses show* compares with that smoothed truth. Bodies do not sleep, since the engine lists no contacts of sleeping ones. A link is *determined* if the true contact points and the motion leave less than a tenth of \
             the variance that a hand without motion would have; of these, links that are not flagged count in the column. *All links* are links with a true force above \
             0.05 N. *Inside* counts links with a true or estimated force above 0.05 N. *Flagged*: determined links that are flagged as undetermined. *Unknown*: touched links whose force is not stated; `physics.json` has the reasons, such as a hand on the table. *ms* is per frame and hand. The first and the last three frames of an episode do not count.\n",
        );
        text.push_str("\n## Conditions\n\n");
        table(&mut text, "poses | rate | mass", self.conditions.iter().map(|score| (name(&score.condition), score)));
        text.push_str("\n## Scenes, exact poses at 60 Hz, masses known\n\n");
        table(&mut text, "scene", self.scenes.iter().map(|(scene, score)| (format!("`{scene}`"), score)));
        text.push_str("\n## Scenes that chose the settings, and scenes that did not\n\n");
        let rows = self.splits.iter().map(|(split, score)| (format!("{split} | {}", name(&score.condition)), score));
        table(&mut text, "split | poses | rate | mass", rows);
        let Some(first) = self.solvers.first() else { return text };
        put(
            &mut text,
            format_args!(
                "\n## Solver\n\nRandom problems, solved by egotac's Newton method on the six dual variables and by Clarabel {}, an interior-point solver \
                 of cone programs. Times are means on one thread; Clarabel's is the one that it states itself.\n\n\
                 | contact points | problems | egotac (µs) | Clarabel (µs) | ratio | largest difference of a force (N) | unsolved |\n|---|---|---|---|---|---|---|",
                first.version
            ),
        );
        for row in &self.solvers {
            put(
                &mut text,
                format_args!(
                    "| {} | {} | {:.1} | {:.1} | {:.3} | {:.1e} | {} |",
                    row.points,
                    row.problems,
                    row.own_us,
                    row.peer_us,
                    row.own_us / row.peer_us,
                    row.force_difference,
                    row.unsolved
                ),
            );
        }
        text
    }
}

fn table<'a>(text: &mut String, first: &str, rows: impl Iterator<Item = (String, &'a Score)>) {
    let columns = first.split('|').count() + HEAD.trim().trim_matches('|').split('|').count();
    text.push_str(&format!("| {first}{HEAD}{}|\n", "|---".repeat(columns)));
    for (name, score) in rows {
        let percent = |share: f64| if share.is_nan() { "–".to_string() } else { format!("{:.1} %", 100.0 * share) };
        let [in_time, fast, missed] = score.net_touched.map(percent);
        let [median, tail] = score.net_error;
        let [moment, moment_tail] = score.moment_error.map(|error| 1e3 * error);
        let links = match score.link_error {
            [error, _] if error.is_nan() => "–".to_string(),
            [error, mean] => format!("{error:.3} of {mean:.2}"),
        };
        let [all, determined, other] = score.coverage.map(percent);
        let relative = match score.determined {
            0 => "–".to_string(),
            links => {
                format!("{} ({}) of {links}", percent(score.determined_error[1]), percent(score.determined_error[0]))
            }
        };
        put(
            text,
            format_args!(
                "| {name} | {} | {in_time}, {fast}, {missed} | {} | {median:.3}, {tail:.3} | {moment:.1}, {moment_tail:.1} | {relative} | {links} | {all}, {determined}, {other} | {} | {} | {:.2} |",
                percent(score.net_within),
                percent(score.net_shown),
                percent(score.wrongly_flagged),
                percent(score.unknown.values().sum::<f64>().abs()),
                score.milliseconds
            ),
        );
    }
}
