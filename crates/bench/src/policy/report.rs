//! Results of the experiment: success of each arm with intervals, and the predicted touch beside the true one.

use egotac::machine::Machine;
use egotac::text::put;
use serde::{Deserialize, Serialize};

use super::arm::Arm;
use super::demonstrations::Demonstrations;
use super::interval::{bootstrap, wilson};
use super::senses::TOUCH;
use super::task::{CRUSH_RATIO, End, MASS, Outcome};
use super::{Baselines, ROUNDS, Run, Size};

/// Seed of the bootstraps.
const BOOTSTRAP_SEED: u64 = 0;
/// Force on a hand above which it touches, N, as for a vertex.
const TOUCHES: f64 = 0.05;
/// Regions of a hand, and how many of the first belong to the thumb.
const REGIONS: usize = TOUCH / 2;
const THUMB: usize = 3;

/// Results of the experiment.
#[derive(Debug, Clone, Serialize)]
pub struct PolicyReport {
    /// The command that measures the same again.
    pub command: String,
    /// Version of egotac.
    pub egotac: &'static str,
    /// The machine that it ran on.
    pub machine: Machine,
    /// SHA-256 of the network that predicts touch.
    pub predictor_sha256: String,
    /// Size of the experiment.
    pub size: Size,
    /// Demonstrated frames.
    pub frames: usize,
    /// Predicted touch beside the true one on the demonstrations.
    pub touch: TouchQuality,
    /// Each constant grip, N, with its success rate on seeds of demonstrations.
    pub constants: Vec<(f64, f64)>,
    /// Expert and constant grip, then the arms.
    pub rows: Vec<Row>,
}

/// Agreement of predicted and true touch on the demonstrations.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct TouchQuality {
    /// Correlation of the total force over all frames; `None` if one is constant.
    pub total_pearson: Option<f64>,
    /// Correlation of the thumb's force less the fingers', which tells the weight.
    pub load_pearson: Option<f64>,
    /// F1 of "the hand touches": a total force above 0.05 N.
    pub contact_f1: Option<f64>,
}

/// Results of one arm or baseline.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct Row {
    /// Name.
    pub name: String,
    /// Inputs of the policy, in words.
    pub about: String,
    /// Success rate of each training.
    pub by_seed: Vec<f64>,
    /// Success rate over all trainings.
    pub success: f64,
    /// 95 % interval by Wilson, as if all trials were independent.
    pub wilson: Option<[f64; 2]>,
    /// 95 % interval by a bootstrap over trainings and trials.
    pub bootstrap: Option<[f64; 2]>,
    /// Share of trials that ended with a crushed ball.
    pub crushed: f64,
    /// Share of trials that ended with a dropped ball.
    pub dropped: f64,
    /// Share of trials whose simulation lost its state.
    pub lost: f64,
    /// Difference of the success rate from the arm `image` on the same trials and seeds, with its 95 % interval.
    pub against_image: Option<Difference>,
    /// Mean squared error of the action at the end of each training, in shares of the largest change squared.
    pub losses: Vec<f64>,
    /// Trials of each training.
    pub outcomes: Vec<Vec<Outcome>>,
}

/// Difference of two success rates.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Difference {
    /// The difference.
    pub difference: f64,
    /// 95 % interval by a bootstrap over trainings and trials, the same for both.
    pub interval: Option<[f64; 2]>,
}

/// Returns the share of trials that succeeded; NaN without trials.
pub fn success(outcomes: &[Outcome]) -> f64 {
    share(outcomes.iter(), End::Lifted)
}

fn share<'a>(outcomes: impl Iterator<Item = &'a Outcome>, end: End) -> f64 {
    let (mut counted, mut all) = (0.0, 0.0);
    for outcome in outcomes {
        all += 1.0;
        counted += f64::from(outcome.end == end);
    }
    counted / all
}

/// Makes the report.
pub fn make(
    size: &Size,
    baselines: &Baselines,
    demonstrations: &Demonstrations,
    runs: &[Run],
    predictor_sha256: &str,
    command: String,
) -> PolicyReport {
    let of = |arm: Arm| -> Vec<&Run> { runs.iter().filter(|run| run.arm == arm).collect() };
    let outcomes = |arm: Arm| -> Vec<Vec<Outcome>> { of(arm).iter().map(|run| run.outcomes.clone()).collect() };
    let image = outcomes(Arm::Image);
    let mut rows = vec![
        row("expert", "forces, load, friction and transmission: the ceiling", vec![baselines.expert.clone()], &[]),
        row(
            "constant_grip",
            &format!("nothing: always {} N, the best of {}", baselines.best, baselines.constants.len()),
            vec![baselines.constant.clone()],
            &[],
        ),
    ];
    for arm in Arm::ALL {
        let about = match arm {
            Arm::Image => "pictures",
            Arm::ImagePredictedTouch => "pictures, and the touch that the shipped network predicts from them",
            Arm::ImageTrueTouch => "pictures, and the simulator's touch",
        };
        let first: &[_] = if arm == Arm::Image { &[] } else { &image };
        let losses = of(arm).iter().map(|run| run.trained.last_loss).collect();
        rows.push(Row { losses, ..row(arm.name(), about, outcomes(arm), first) });
    }
    PolicyReport {
        command,
        egotac: egotac::VERSION,
        machine: Machine::this(),
        predictor_sha256: predictor_sha256.to_owned(),
        size: *size,
        frames: demonstrations.len(),
        touch: touch_quality(&demonstrations.true_touch, &demonstrations.predicted_touch),
        constants: baselines.constants.clone(),
        rows,
    }
}

/// Summarises the trials of all trainings of an arm; `image`: those of the arm that it is compared with, if any.
fn row(name: &str, about: &str, outcomes: Vec<Vec<Outcome>>, image: &[Vec<Outcome>]) -> Row {
    let all: Vec<Outcome> = outcomes.iter().flatten().copied().collect();
    let lifted = |outcome: &Outcome| f64::from(outcome.end == End::Lifted);
    let rates =
        |of: &[Vec<Outcome>]| -> Vec<Vec<f64>> { of.iter().map(|row| row.iter().map(lifted).collect()).collect() };
    let own = rates(&outcomes);
    let differences: Vec<Vec<f64>> = own
        .iter()
        .zip(rates(image))
        .map(|(own, image)| own.iter().zip(image).map(|(own, image)| own - image).collect())
        .collect();
    let count = differences.iter().map(Vec::len).sum::<usize>();
    let against_image = (count > 0).then(|| Difference {
        difference: differences.iter().flatten().sum::<f64>() / count as f64,
        interval: bootstrap(&differences, BOOTSTRAP_SEED),
    });
    Row {
        name: name.into(),
        about: about.into(),
        by_seed: outcomes.iter().map(|row| success(row)).collect(),
        success: success(&all),
        wilson: wilson(all.iter().filter(|outcome| outcome.end == End::Lifted).count(), all.len()),
        bootstrap: bootstrap(&own, BOOTSTRAP_SEED),
        crushed: share(all.iter(), End::Crushed),
        dropped: share(all.iter(), End::Dropped),
        lost: share(all.iter(), End::Lost),
        against_image,
        losses: Vec::new(),
        outcomes,
    }
}

/// Compares (N, 34) true and predicted forces on the regions.
fn touch_quality(truth: &[f32], predicted: &[f32]) -> TouchQuality {
    let sums =
        |touch: &[f32], value: &dyn Fn(&[f32]) -> f64| -> Vec<f64> { touch.chunks_exact(TOUCH).map(value).collect() };
    let sum = |of: &[f32]| of.iter().map(|force| f64::from(*force)).sum::<f64>();
    let total = |touch: &[f32]| sum(touch);
    let load =
        |touch: &[f32]| touch.chunks_exact(REGIONS).map(|hand| sum(&hand[..THUMB]) - sum(&hand[THUMB..])).sum::<f64>();
    let (of_truth, of_prediction) = (sums(truth, &total), sums(predicted, &total));
    let pairs = of_truth.iter().zip(&of_prediction).map(|(a, b)| (*a > TOUCHES, *b > TOUCHES));
    let (mut both, mut either) = (0.0, 0.0);
    for (a, b) in pairs {
        both += f64::from(a && b);
        either += f64::from(u8::from(a) + u8::from(b));
    }
    TouchQuality {
        total_pearson: pearson(&of_truth, &of_prediction),
        load_pearson: pearson(&sums(truth, &load), &sums(predicted, &load)),
        contact_f1: (either > 0.0).then_some(2.0 * both / either),
    }
}

/// Returns Pearson's correlation; `None` if a series is constant.
fn pearson(a: &[f64], b: &[f64]) -> Option<f64> {
    let mean = |of: &[f64]| of.iter().sum::<f64>() / of.len() as f64;
    let (ma, mb) = (mean(a), mean(b));
    let sum = |of: &dyn Fn(f64, f64) -> f64| a.iter().zip(b).map(|(a, b)| of(a - ma, b - mb)).sum::<f64>();
    let (aa, bb, ab) = (sum(&|a, _| a * a), sum(&|_, b| b * b), sum(&|a, b| a * b));
    (aa > 0.0 && bb > 0.0).then(|| ab / (aa * bb).sqrt())
}

impl PolicyReport {
    /// Formats the report as Markdown.
    pub fn markdown(&self) -> String {
        let Size { demonstrations, steps, trials, seeds } = self.size;
        let [lightest, heaviest] = MASS.map(|mass| 1000.0 * mass);
        let mut text = String::new();
        put(
            &mut text,
            format_args!(
                "# policy\n\nDoes touch help a policy? Written by `{}`, egotac {}, {}. Numbers: `policy.json`.\n\n![Success of each arm, and success by the weight of the ball](policy.png)\n",
                self.command, self.egotac, self.machine
            ),
        );
        put(
            &mut text,
            format_args!(
                "A simulated human hand lifts a hollow ball. All balls look alike, and weigh {lightest:.0} to {heaviest:.0} g; a ball bears {CRUSH_RATIO} times the\n\
                 force that just holds it, so a light one breaks under the grip that a heavy one needs. The hand's transmission from\n\
                 commanded to applied grip is unknown, too. The policy sets the grip 12.5 times a second; the lift is given. The thumb\n\
                 grips below the equator: its normal force less the fingers' tells the weight as soon as the ball leaves the table.\n\n\
                 All arms have the same small network (two pictures of 64 px, 34 forces on regions now and 0.16 s earlier, commanded grip and\n\
                 height; zeros in place of a touch that an arm lacks), the same initial weights, and the same {demonstrations} demonstrations\n\
                 ({} frames) of an expert with disturbed commands. In each of {ROUNDS} rounds the expert then corrects trials of the policy's own, on\n\
                 seeds that are the same for all arms (DAgger; added to all arms after a first look at pictures alone, on seeds that are not\n\
                 used here); {steps} steps on all data, {seeds} trainings of each arm, each tried on the same\n\
                 {trials} unseen seeds. A predicted touch is a function of the same pictures (three, over 0.24 s): it can bring what\n\
                 the shipped network has learned, and nothing that pictures do not show. Pictures are rendered, and the true touch has no noise.\n",
                self.frames
            ),
        );
        put(
            &mut text,
            format_args!(
                "| | is given | success | Wilson 95 % | bootstrap 95 % | each training | crushed | dropped | against `image` |\n\
                 |---|---|---|---|---|---|---|---|---|"
            ),
        );
        for row in &self.rows {
            let by_seed: Vec<String> = row.by_seed.iter().map(|rate| format!("{rate:.2}")).collect();
            let against = row
                .against_image
                .map_or("—".into(), |d| format!("{:+.3} ({})", d.difference, range(d.interval, true)));
            put(
                &mut text,
                format_args!(
                    "| {} | {} | **{:.3}** | {} | {} | {} | {:.3} | {:.3} | {against} |",
                    row.name,
                    row.about,
                    row.success,
                    range(row.wilson, false),
                    range(row.bootstrap, false),
                    by_seed.join(", "),
                    row.crushed,
                    row.dropped
                ),
            );
        }
        let number = |value: Option<f64>| value.map_or("undefined".into(), |value| format!("{value:.3}"));
        put(
            &mut text,
            format_args!(
                "\nSuccess: the ball rises by three quarters of the lift, is held at its end, and was never pressed beyond its limit on a side (mean over\n\
                 0.08 s). Wilson's interval counts all trials as independent; the bootstrap draws trainings and trials anew, and in the last\n\
                 column the same ones for both arms. {seeds} trainings are few: read the column of each training beside the intervals.\n\n\
                 Predicted touch beside the true one, on the demonstrations: Pearson of the total force {}, of the thumb's force less the\n\
                 fingers' {}, F1 of \"the hand touches\" {}.",
                number(self.touch.total_pearson),
                number(self.touch.load_pearson),
                number(self.touch.contact_f1)
            ),
        );
        let constants: Vec<String> = self.constants.iter().map(|(grip, rate)| format!("{grip} N {rate:.2}")).collect();
        put(&mut text, format_args!("Success of constant grips on seeds of demonstrations: {}.", constants.join(", ")));
        let lost: Vec<String> =
            self.rows.iter().filter(|row| row.lost > 0.0).map(|row| format!("{} {:.3}", row.name, row.lost)).collect();
        if !lost.is_empty() {
            put(
                &mut text,
                format_args!("Trials whose simulation lost its state, counted as failures: {}.", lost.join(", ")),
            );
        }
        text
    }
}

/// Formats an interval.
fn range(interval: Option<[f64; 2]>, signed: bool) -> String {
    match interval {
        Some([low, high]) if signed => format!("{low:+.3} .. {high:+.3}"),
        Some([low, high]) => format!("{low:.3} .. {high:.3}"),
        None => "—".into(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn outcome(end: End) -> Outcome {
        Outcome { seed: 0, mass: 0.1, end, peak: 0.5, rise: 0.05 }
    }

    #[test]
    fn a_row_counts_each_end_and_pairs_trials_with_those_of_the_image() {
        let own =
            vec![vec![outcome(End::Lifted), outcome(End::Lifted)], vec![outcome(End::Lifted), outcome(End::Crushed)]];
        let image =
            vec![vec![outcome(End::Lifted), outcome(End::Dropped)], vec![outcome(End::Lifted), outcome(End::Dropped)]];
        let row = row("a", "b", own, &image);
        assert_eq!((row.success, row.crushed, row.dropped, row.lost), (0.75, 0.25, 0.0, 0.0));
        assert_eq!(row.by_seed, [1.0, 0.5]);
        assert_eq!(row.against_image.unwrap().difference, 0.25);
    }

    #[test]
    fn the_weight_is_told_by_the_thumbs_force_less_the_fingers() {
        let frame = |thumb: f32, index: f32| {
            let mut touch = vec![0.0; TOUCH];
            (touch[REGIONS], touch[REGIONS + THUMB]) = (thumb, index);
            touch
        };
        let truth = [frame(1.0, 0.5), frame(2.0, 1.0), frame(0.0, 0.0)].concat();
        let half: Vec<f32> = truth.iter().map(|force| 0.5 * force).collect();
        let quality = touch_quality(&truth, &half);
        for value in [quality.total_pearson, quality.load_pearson, quality.contact_f1] {
            assert!((value.unwrap() - 1.0).abs() < 1e-9);
        }
        let swapped = [frame(0.5, 1.0), frame(1.0, 2.0), frame(0.0, 0.0)].concat();
        assert!((touch_quality(&truth, &swapped).load_pearson.unwrap() + 1.0).abs() < 1e-9);
        assert_eq!(touch_quality(&truth, &vec![0.0; truth.len()]).total_pearson, None);
    }
}
