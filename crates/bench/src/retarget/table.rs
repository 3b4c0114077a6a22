//! The results of `egotac bench retarget` as Markdown.

use egotac::text::{put, significant};

use super::grip::{Grips, PRESSED};
use super::{COST_ROUNDS, Objective, RetargetReport};

/// Returns the tables as Markdown.
pub fn markdown(report: &RetargetReport) -> String {
    let mut text = String::new();
    head(&mut text, report);
    if !report.objectives.is_empty() {
        objectives(&mut text, report);
        peers(&mut text, report);
    }
    whole(&mut text, report);
    grips(&mut text, &report.grips);
    jitter(&mut text, report);
    costs(&mut text, report);
    text
}

fn head(text: &mut String, report: &RetargetReport) {
    put(text, format_args!("# Retargeting: time, exactness, touch\n"));
    put(text, format_args!("Written by `{}` (egotac {}), {}.", report.command, report.version, report.machine));
    if let Some(load) = &report.load {
        put(text, format_args!("The machine's load: {load}."));
    }
    put(text, format_args!("Times are processor time of one thread."));
    put(
        text,
        format_args!(
            "{} frames at 30 Hz of the built-in hand, seed {}: free motion and pinches, with contact flags and forces.\n\n\
             ![Distance from the best objective against the time per frame](retarget.png)\n",
            report.frames, report.seed
        ),
    );
}

/// Writes the results of our solver on the peers' objective.
fn objectives(text: &mut String, report: &RetargetReport) {
    put(text, format_args!("## Tip objective of dex-retargeting (vector), one core\n"));
    put(
        text,
        format_args!(
            "Within: share of the compared frames whose objective is at most 1.001 of the best that ten starts, the last \
             pose among them, find.\n"
        ),
    );
    put(
        text,
        format_args!("| robot | noise, mm | median, us | p99, us | steps | within | ratio p99.9 | frames compared |"),
    );
    put(text, format_args!("|---|---|---|---|---|---|---|---|"));
    for Objective { setup, noise_mm, ours, .. } in &report.objectives {
        put(
            text,
            format_args!(
                "| {} | {noise_mm} | {} | {} | {:.1} | {:.4} | {:.5} | {} |",
                setup.robot,
                significant(ours.median_us),
                significant(ours.p99_us),
                ours.iterations,
                ours.within,
                ours.ratio_p999,
                ours.compared,
            ),
        );
    }
}

/// Writes the results of whole retargeters.
fn whole(text: &mut String, report: &RetargetReport) {
    put(text, format_args!("\n## Everything on: contact, force, collisions, couplings\n"));
    put(
        text,
        format_args!(
            "Net torque: about the middle of the touched places, as large as the robot's hand makes it; fingertips that meet in a \
             point hold none.{}\n",
            in_points(report),
        ),
    );
    put(
        text,
        format_args!(
            "| robot | input | median, us | p99, us | beyond limits or couplings | speed / limit | deepest, mm | pinches within 1 mm | opened in a frame | \
             false contacts | net force error | net torque error | force angle, deg | tip error, mm |"
        ),
    );
    put(text, format_args!("|---|---|---|---|---|---|---|---|---|---|---|---|---|---|"));
    for row in &report.robots {
        let seen = &row.seen;
        put(
            text,
            format_args!(
                "| {} | {} | {} | {} | {:.1e} | {:.3} | {:.2} | {:.3} | {:.3} | {:.4} | {:.4} | {:.4} | {:.1} | {:.2} |",
                row.robot,
                row.input,
                significant(seen.median_us),
                significant(seen.p99_us),
                seen.limit_violation,
                seen.speed_share,
                seen.deepest_mm,
                seen.pinch_closed,
                seen.pinch_opened,
                seen.false_contacts,
                seen.net_force_error,
                seen.net_torque_error,
                seen.force_angle_deg,
                seen.tip_error_mm,
            ),
        );
    }
}

fn grips(text: &mut String, grips: &Grips) {
    put(
        text,
        format_args!(
            "\nGrips in simulation: {} objects (two balls, joined, one where each fingertip is pressed) between the thumb and \
             another finger of `four_finger`, without gravity, at the pose and with the torques that come out; {} were lost. \
             {} poses were left out, at which the expected force is less than {PRESSED} of the one asked for: friction or \
             the actuators' range allow no more. The fingertips' forces differ from the expected ones by {:.0} % (median), \
             {:.0} % (nine of ten).",
            grips.count,
            grips.lost,
            grips.slippery,
            100.0 * grips.error_median,
            100.0 * grips.error_p90,
        ),
    );
}

fn jitter(text: &mut String, report: &RetargetReport) {
    put(text, format_args!("\n## Jitter\n"));
    put(text, format_args!("| robot | input | lag, ms | jerk, rad/s³ | the motion's own | off the clean run, rad |"));
    put(text, format_args!("|---|---|---|---|---|---|"));
    for row in &report.robots {
        put(
            text,
            format_args!(
                "| {} | {} | {:.0} | {:.0} | {:.0} | {:.3} |",
                row.robot,
                row.input,
                1e3 * row.lag_secs,
                row.seen.jerk,
                row.own_jerk,
                row.deviation,
            ),
        );
    }
}

fn costs(text: &mut String, report: &RetargetReport) {
    put(text, format_args!("\n## What accuracy costs in time\n"));
    put(
        text,
        format_args!(
            "Each choice takes turns with the others of its robot; the least of {COST_ROUNDS} medians counts.\n"
        ),
    );
    put(text, format_args!("| robot | choice | median, us | objective over best, p99.9 | tip error, mm |"));
    put(text, format_args!("|---|---|---|---|---|"));
    let known = |value: f64, digits: usize| if value.is_nan() { "-".to_owned() } else { format!("{value:.digits$}") };
    for cost in &report.costs {
        put(
            text,
            format_args!(
                "| {} | {} | {} | {} | {} |",
                cost.robot,
                cost.choice,
                significant(cost.median_us),
                known(cost.ratio_p999, 5),
                known(cost.tip_error_mm, 2),
            ),
        );
    }
}

/// Explains the force angle of robots whose fingertips meet in points; empty if there are none.
fn in_points(report: &RetargetReport) -> String {
    let mut names: Vec<&str> =
        report.robots.iter().filter(|row| row.seen.meets_in_points).map(|row| row.robot.as_str()).collect();
    names.dedup();
    if names.is_empty() {
        return String::new();
    }
    format!(
        " The fingertips of {} have no shapes where they end: they meet in points, with the human's own normals, and their \
         force angle says nothing about how the links lie.",
        names.join(" and ")
    )
}

/// Writes the results of the peers on the same vectors.
fn peers(text: &mut String, report: &RetargetReport) {
    let all = || report.objectives.iter().flat_map(|row| row.peers.iter().map(move |peer| (row, peer)));
    if all().next().is_none() {
        return;
    }
    put(text, format_args!("\n### Others on the same vectors\n"));
    let lag = |noise_mm: f64| {
        let rows = report.objectives.iter().filter(|row| row.noise_mm == noise_mm);
        1e3 * rows.map(|row| row.smoothness.lag_secs).fold(0.0, f64::max)
    };
    put(
        text,
        format_args!(
            "dexi-rs and dex-retargeting solve the same objective; mink takes one step per frame towards the same points. \
             Jerk: root mean square, behind a low pass that lags by 50 ms (theirs: dex-retargeting's, on the joints; ours: the \
             retargeter's own, on the keypoints; measured, ours lags by at most {:.1} ms with 2 mm noise, {:.1} ms with 5), and in \
             brackets without it. \
             Objective: theirs over ours from the same last pose, median and p99, and the share of frames in which ours is at \
             most 1.001 of theirs.\n",
            lag(2.0),
            lag(5.0),
        ),
    );
    put(
        text,
        format_args!(
            "| robot | noise, mm | program | median, us | p99, us | times ours | objective | ours within | jerk, rad/s³ |"
        ),
    );
    put(text, format_args!("|---|---|---|---|---|---|---|---|---|"));
    for row in &report.objectives {
        put(
            text,
            format_args!(
                "| {} | {} | egotac | {} | {} | 1 | 1 | - | {:.0} ({:.0}) |",
                row.setup.robot,
                row.noise_mm,
                significant(row.ours.median_us),
                significant(row.ours.p99_us),
                row.smoothness.jerk_50ms,
                row.smoothness.jerk,
            ),
        );
    }
    for (row, peer) in all() {
        let objective = peer.objective.as_ref().map_or("- | -".to_owned(), |seen| {
            format!("{:.4}, {} | {:.4}", seen.median, significant(seen.p99), seen.ours_within)
        });
        put(
            text,
            format_args!(
                "| {} | {} | {} | {} | {} | {} | {objective} | {:.0} ({:.0}) |",
                row.setup.robot,
                row.noise_mm,
                peer.name,
                significant(peer.median_us),
                significant(peer.p99_us),
                significant(peer.median_us / row.ours.median_us),
                peer.jerk_50ms,
                peer.jerk,
            ),
        );
    }
}
