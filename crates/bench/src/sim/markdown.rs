//! The results of `egotac bench sim` as Markdown.

use std::fmt::Write as _;

use egotac::text::significant;

use super::knob::Knob;
use super::table::{Entry, Row, SimReport};

/// Explanation of the columns.
const LEGEND: &str = "\
Errors are against two references: **same model** (same cone, impratio, hulls and grids, 0.1 ms, tolerance 1e-12) is the error of
the numbers; **one model** (elliptic, impratio 100, 0.05 ms, all hull corners) is that of the model as well. *Force* sums
|mean normal force - reference| over fingers and palms, relative to the reference's sum, over the seconds in which the hands
press and neither forces nor objects change; *impulse* does the same with the time integral over the whole run; *F1* is that
of the vertices in contact (label c), pooled over all frames. *Lift* is the upward contact force on the objects that are awake over their weight in
the quiet seconds: right is 1, with no reference needed. *Flagged* is the share of frames that a guard refused. *ms* are milliseconds per simulated second: processor time of one thread, least of interleaved repetitions, with
neither labels nor pictures except where these are the knob (pictures: time on the wall); that of the reference is taken once,
along with its forces. *x real time* is its inverse. A dash: nothing to compare.
";

/// Returns the report as Markdown.
pub fn render(report: &SimReport) -> String {
    let mut text = String::from("# What accuracy costs in time\n\n");
    let seeds = if report.seeds == 1 { "1 seed".into() } else { format!("{} seeds", report.seeds) };
    let _ = writeln!(
        text,
        "Written by `{}`: {seeds} from {}, egotac {}, MuJoCo {}, {}.\nNumbers: `sim.json`. \
         The recommended preset is **{}**.\n\n![Error of forces against computation per simulated second](sim.png)\n",
        report.command,
        report.seed,
        report.egotac,
        report.mujoco,
        report.machine,
        report.recommended.name()
    );
    text.push_str(LEGEND);
    let _ = writeln!(
        text,
        "\nEach number is the worst of the scenes: of all in the table of presets, of those in which single knobs are turned \
         ({}) in the other tables and the plot.",
        report.shared_scenes().join(", ")
    );
    scenes(report, &mut text);
    for knob in Knob::ALL {
        let rows: Vec<&Row> = report.rows.iter().filter(|row| row.knob == knob.name()).collect();
        if !rows.is_empty() {
            knob_table(knob, &rows, &mut text);
        }
    }
    if report.rows.iter().any(|row| row.knob == Knob::Preset.name()) {
        presets_by_scene(report, &mut text);
    }
    speed(report, &mut text);
    text
}

fn scenes(report: &SimReport, text: &mut String) {
    text.push_str("\n| scene | simulated s | of these compared |\n|---|---|---|\n");
    for scene in &report.scenes {
        let _ = writeln!(text, "| {} | {:.1} | {:.1} |", scene.name, scene.seconds, scene.quiet_seconds);
    }
}

fn knob_table(knob: Knob, rows: &[&Row], text: &mut String) {
    let _ = writeln!(text, "\n## {}\n", title(knob));
    match knob {
        Knob::Label => {
            text.push_str("| label | ms | F1 against c, 4 mm, pooled | same vertices |\n|---|---|---|---|\n");
            for row in rows {
                let Entry { ms_per_second, same, .. } = row.worst();
                let cells = [number(ms_per_second), percent(same.f1), percent(same.agreement)];
                let _ = writeln!(text, "| {} | {} |", row.setting, cells.join(" | "));
            }
        }
        Knob::Size | Knob::Shadows => {
            text.push_str("| picture | ms | x real time |\n|---|---|---|\n");
            for row in rows {
                let worst = row.worst();
                let ms = worst.refused.unwrap_or_else(|| number(worst.ms_per_second));
                let _ = writeln!(text, "| {} | {ms} | {} |", row.setting, number(worst.real_time_factor));
            }
        }
        _ => physics_table(knob, rows, text),
    }
}

fn physics_table(knob: Knob, rows: &[&Row], text: &mut String) {
    let _ = writeln!(
        text,
        "| {} | ms | x real time | force, same model | impulse | F1 | force, one model | impulse | F1 | lift | flagged |\n\
         |---|---|---|---|---|---|---|---|---|---|---|",
        knob.name()
    );
    for row in rows {
        let worst = row.worst();
        let cells = [
            number(worst.ms_per_second),
            number(worst.real_time_factor),
            percent(worst.same.force),
            percent(worst.same.impulse),
            percent(worst.same.f1),
            percent(worst.model.force),
            percent(worst.model.impulse),
            percent(worst.model.f1),
            worst.lift.map_or("—".into(), |lift| format!("{lift:.4}")),
            percent(worst.invalid),
        ];
        let _ = writeln!(text, "| {} | {} |", row.setting, cells.join(" | "));
    }
    if knob == Knob::Grid {
        text.push_str("\nThe one model has the finest grid here, and the scene's grid in the other tables.\n");
    }
    if knob == Knob::Preset {
        text.push_str(
            "\n`replay` has no forces: its contact places on the recorded poses of the default model's reference, each \
             counted as 1 N,\nare compared with the forces' vertices.\n",
        );
    }
}

fn presets_by_scene(report: &SimReport, text: &mut String) {
    let rows: Vec<&Row> =
        report.rows.iter().filter(|row| row.knob == Knob::Preset.name() && row.setting != "replay").collect();
    text.push_str(
        "\n## Presets by scene\n\nms; force error against the same model; against the one model.\n\n| scene |",
    );
    rows.iter().for_each(|row| text.push_str(&format!(" {} |", row.setting)));
    let _ = writeln!(text, "\n|---|{}", "---|".repeat(rows.len()));
    for scene in &report.scenes {
        let _ = write!(text, "| {} |", scene.name);
        for row in &rows {
            let cell = match row.entries.iter().find(|entry| entry.scene == scene.name) {
                Some(Entry { refused: Some(_), .. }) | None => "—".into(),
                Some(e) => [number(e.ms_per_second), percent(e.same.force), percent(e.model.force)].join("; "),
            };
            let _ = write!(text, " {cell} |");
        }
        text.push('\n');
    }
}

fn speed(report: &SimReport, text: &mut String) {
    if let Some(wrapper) = &report.wrapper {
        let more = |ratio: f64| format!("{:+.1} %", 100.0 * (ratio - 1.0));
        let _ = writeln!(
            text,
            "\n## What our code adds to a step\n\n\
             `{}`, {} steps, frame by frame in turn with the engine's own C loop at {} µs per step.\n\n\
             | | over the C loop |\n|---|---|\n| stepping through `World::step` | {} |\n| with the rollout's control | {} |\n\
             | with control and guards | {} |",
            wrapper.scene,
            wrapper.steps,
            significant(wrapper.bare_us),
            more(wrapper.step_ratio),
            more(wrapper.control_ratio),
            more(wrapper.guarded_ratio)
        );
    }
    if let Some(throughput) = &report.throughput {
        let _ = writeln!(
            text,
            "\n## Speed of `egotac sim generate`\n\n\
             {} episodes of {}, {} frames of {size} x {size}, rendered, labelled and written; planning counts.\n\n\
             | jobs | frames per second |\n|---|---|",
            throughput.episodes,
            throughput.scenes.join(", "),
            throughput.frames,
            size = throughput.size
        );
        for rate in &throughput.rates {
            let _ = writeln!(text, "| {} | {:.1} |", rate.jobs, rate.frames_per_second);
        }
    }
}

fn title(knob: Knob) -> &'static str {
    match knob {
        Knob::Preset => "Presets",
        Knob::Timestep => "Timestep",
        Knob::Cone => "Friction cone",
        Knob::Iterations => "Cap on the solver's iterations",
        Knob::Integrator => "Integrator",
        Knob::Impratio => "Stiffness of friction (impratio)",
        Knob::Hull => "Corners of each link's collision hull",
        Knob::Grid => "Points of a soft body's grid, along each edge",
        Knob::Label => "Kind of label",
        Knob::Size => "Size of the picture",
        Knob::Shadows => "Shadows",
    }
}

fn number(value: Option<f64>) -> String {
    value.map_or("—".into(), significant)
}

fn percent(value: Option<f64>) -> String {
    value.map_or("—".into(), |value| format!("{} %", significant(100.0 * value)))
}
