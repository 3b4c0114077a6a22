//! Report of `egotac bench node`.

use egotac::machine::Machine;
use egotac::text::put;
use serde::Serialize;
use serde_json::{Map, Value};

/// A goal and the measured value.
#[derive(Debug, Clone, Serialize)]
pub struct Goal {
    /// Quantity.
    pub what: String,
    /// Demanded value.
    pub goal: String,
    /// Measured value.
    pub got: String,
    /// True if the goal is met.
    pub met: bool,
    /// True if the value is a time, which other work on the machine makes longer.
    pub is_time: bool,
}

/// Measurements and goals.
#[derive(Debug, Clone, Serialize)]
pub struct NodeReport {
    /// The command that measures the same again.
    pub command: String,
    /// Version of the program.
    pub version: &'static str,
    /// The machine that it was measured on.
    pub machine: Machine,
    /// True if other programs were busy at the start, so that times are longer than on an idle machine.
    pub beside_other_work: bool,
    /// Mean number of busy cores in the minute before the start.
    pub load_average: f64,
    /// Results by the name of the measurement.
    pub measurements: Map<String, Value>,
    /// Goals that these measurements decide.
    pub goals: Vec<Goal>,
}

impl NodeReport {
    /// True if all goals are met. Beside other work, times do not count.
    pub fn is_good(&self) -> bool {
        self.goals.iter().all(|goal| goal.met || goal.is_time && self.beside_other_work)
    }

    /// Returns the report as Markdown.
    pub fn markdown(&self) -> String {
        let Self { command, version, machine, load_average, goals, measurements, .. } = self;
        let mut text = format!(
            "# Nodes under load and faults\n\nWritten by `{command}` (egotac {version}, {machine}). All numbers: `node.json`.\n"
        );
        if self.beside_other_work {
            put(
                &mut text,
                format_args!(
                    "\n**Measured beside other work** (load average {load_average:.1}): times are longer than on an idle machine.\n"
                ),
            );
        }
        text += "\n| what | goal | got | met |\n|---|---|---|---|\n";
        for Goal { what, goal, got, met, .. } in goals {
            put(&mut text, format_args!("| {what} | {goal} | {got} | {} |", if *met { "yes" } else { "**no**" }));
        }
        if let Some(rows) = measurements.get("overhead").and_then(|value| value["rows"].as_array()) {
            text += "\n## Latency at 30 Hz\n\nNetwork of almost no cost (`toy`), so that the times are those of the node: decoding, \
                     preparation, messages. *From the stamp* includes sending the image; *from the send* begins when the publisher's call \
                     returns.\n\n| images | subscribers | sent | results | from the stamp p50 / p99 | from the send p50 / p99 | \
                     processing p50 / p99 |\n|---|---|---|---|---|---|---|\n";
            for row in rows {
                put(
                    &mut text,
                    format_args!(
                        "| {} | {} | {} | {} | {} | {} | {} |",
                        word(&row["images"]),
                        word(&row["subscribers"]),
                        row["sent"],
                        row["results"],
                        times(&row["from_stamp"]),
                        times(&row["from_send"]),
                        times(&row["processing"]),
                    ),
                );
            }
            if let Some(rows) = measurements["overhead"]["bare"].as_array() {
                text += "\nA node in Python that takes the image undecoded and answers with a message of a result's size, for comparison: \
                         its time is the middleware's.\n\n| images | sent | answers | from the stamp p50 / p99 | from the send p50 / p99 \
                         |\n|---|---|---|---|---|\n";
                for row in rows {
                    let (stamp, send) = (times(&row["from_stamp"]), times(&row["from_send"]));
                    let (images, sent, results) = (word(&row["images"]), &row["sent"], &row["results"]);
                    put(&mut text, format_args!("| {images} | {sent} | {results} | {stamp} | {send} |"));
                }
            }
        }
        if let Some(rows) = measurements.get("faults").and_then(|value| value["rows"].as_array()) {
            text += "\n## Faults\n\n| fault | nodes live | told by diagnostics or log | recovered after |\n|---|---|---|---|\n";
            for row in rows {
                let (fault, lives, told) = (word(&row["fault"]), yes(&row["lives"]), word(&row["told"]));
                put(&mut text, format_args!("| {fault} | {lives} | {told} | {} |", secs(&row["recovered_secs"])));
            }
        }
        if let Some(rows) = measurements.get("kills").and_then(|value| value["rows"].as_array()) {
            text += "\n## SIGKILL\n\n| killed | others live | others go on | all work again after its start |\n|---|---|---|---|\n";
            for row in rows {
                let (killed, live, go_on) = (word(&row["killed"]), yes(&row["others_live"]), yes(&row["others_go_on"]));
                put(&mut text, format_args!("| {killed} | {live} | {go_on} | {} |", secs(&row["resumed_secs"])));
            }
        }
        text
    }
}

/// Returns the goals that the measurements decide.
pub(super) fn goals(measurements: &Map<String, Value>) -> Vec<Goal> {
    let mut goals = Vec::new();
    let at = |name: &str| measurements.get(name);
    if let Some(rows) = at("overhead").and_then(|value| value["rows"].as_array()) {
        overhead_goals(rows, &mut goals);
    }
    if let Some(overload) = at("overload") {
        count(&mut goals, "images of four cameras beyond capacity that nobody counted", 0.0, &overload["uncounted"]);
        let superseded = overload["superseded"].as_f64().is_some_and(|count| count > 0.0);
        holds(&mut goals, "the images of four cameras are more than the network can process", &superseded.into());
        holds(&mut goals, "results beyond capacity come in order", &overload["in_order"]);
        let [first, second] = ["first_half", "second_half"].map(|half| number(&overload[half]["p50_ms"]));
        time(&mut goals, "latency beyond capacity, p50 of the second half beside the first", 1.25 * first, second);
    }
    if let Some(soak) = at("soak") {
        let secs = number(&soak["secs"]);
        count(&mut goals, &format!("images of {secs:.0} s that nobody counted"), 0.0, &soak["uncounted"]);
        let warm_up = number(&soak["warm_up_secs"]);
        for (name, bytes) in soak["growth_bytes"].as_object().into_iter().flatten() {
            // Null: the soak was too short to tell.
            let Some(bytes) = bytes.as_f64() else { continue };
            let got = bytes / 1e6;
            let what = format!("growth of memory of the {name} in {secs:.0} s, after a warm-up of {warm_up:.0} s");
            goals.push(Goal {
                what,
                goal: "< 1 MB".into(),
                got: format!("{got:.2} MB"),
                met: got < 1.0,
                is_time: false,
            });
        }
        let all = soak["alive"].as_object().is_some_and(|alive| alive.values().all(|value| value == true));
        holds(&mut goals, "all nodes live after the soak", &all.into());
        for (name, key) in [
            ("verifier scores", "scored_pairs"),
            ("retargeter moves", "joint_states"),
            ("trainer records", "recorded_frames"),
        ] {
            let works = soak[key].as_f64().is_some_and(|count| count > 0.0);
            holds(&mut goals, &format!("the {name} in the soak"), &works.into());
        }
    }
    if let Some(rows) = at("faults").and_then(|value| value["rows"].as_array()) {
        for row in rows {
            let fault = word(&row["fault"]);
            let told = row["lives"] == true && row["told"].is_string();
            holds(&mut goals, &format!("{fault}: the nodes live and tell"), &told.into());
            time(&mut goals, &format!("{fault}: recovery"), 1000.0, 1e3 * number(&row["recovered_secs"]));
        }
    }
    if let Some(rows) = at("kills").and_then(|value| value["rows"].as_array()) {
        for row in rows {
            let good = row["others_live"] == true && row["others_go_on"] == true && row["resumed_secs"].is_number();
            holds(
                &mut goals,
                &format!("SIGKILL of the {}: the others go on, and it resumes", word(&row["killed"])),
                &good.into(),
            );
            if let Some(before) = row["recorded_before_the_kill"].as_f64() {
                let lost = (before - number(&row["frames_read_back"])).max(0.0);
                count(&mut goals, "recorded frames lost by SIGKILL of the trainer", 0.0, &lost.into());
            }
        }
    }
    goals
}

fn overhead_goals(rows: &[Value], goals: &mut Vec<Goal>) {
    let row = |images: &str, one: bool| {
        rows.iter().find(|row| row["images"] == images && (row["subscribers"] == "one") == one)
    };
    for (images, p50, p99) in [("VGA", 1.0, 3.0), ("1080p", 3.0, 8.0)] {
        let Some(row) = row(images, true) else { continue };
        let got = &row["from_send"];
        time(goals, &format!("node beside the network, {images} at 30 Hz, p50"), p50, number(&got["p50_ms"]));
        time(goals, &format!("node beside the network, {images} at 30 Hz, p99"), p99, number(&got["p99_ms"]));
    }
    if let (Some(alone), Some(beside)) = (row("VGA", true), row("VGA", false)) {
        let [alone, beside] = [alone, beside].map(|row| number(&row["from_stamp"]["p50_ms"]));
        time(goals, "stamp to result beside a slow subscriber, p50", alone + 1.0, beside);
    }
}

fn time(goals: &mut Vec<Goal>, what: &str, most_ms: f64, got_ms: f64) {
    // A comparison with NaN, a missing value, is false.
    let met = got_ms <= most_ms;
    let got = if got_ms.is_nan() { "never".into() } else { format!("{got_ms:.1} ms") };
    // A missing value is no matter of other work.
    let is_time = !got_ms.is_nan();
    goals.push(Goal { what: what.into(), goal: format!("<= {most_ms:.1} ms"), got, met, is_time });
}

fn count(goals: &mut Vec<Goal>, what: &str, most: f64, got: &Value) {
    let met = got.as_f64().is_some_and(|got| got.abs() <= most);
    goals.push(Goal { what: what.into(), goal: format!("{most}"), got: got.to_string(), met, is_time: false });
}

fn holds(goals: &mut Vec<Goal>, what: &str, got: &Value) {
    let met = *got == true;
    goals.push(Goal { what: what.into(), goal: "yes".into(), got: yes(got).into(), met, is_time: false });
}

fn number(value: &Value) -> f64 {
    value.as_f64().unwrap_or(f64::NAN)
}

fn word(value: &Value) -> String {
    value.as_str().map_or_else(|| "-".into(), |text| text.replace('|', "/"))
}

fn yes(value: &Value) -> &'static str {
    if *value == true { "yes" } else { "**no**" }
}

fn secs(value: &Value) -> String {
    value.as_f64().map_or_else(|| "never".into(), |secs| format!("{secs:.2} s"))
}

fn times(value: &Value) -> String {
    format!("{:.1} / {:.1} ms", number(&value["p50_ms"]), number(&value["p99_ms"]))
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    fn report(measurements: Value, beside_other_work: bool) -> NodeReport {
        let Value::Object(measurements) = measurements else { panic!("an object") };
        NodeReport {
            command: "egotac bench node".into(),
            version: "1",
            machine: Machine { cpu: "a".into(), cores: 2 },
            beside_other_work,
            load_average: 0.0,
            goals: goals(&measurements),
            measurements,
        }
    }

    #[test]
    fn a_missed_time_fails_on_an_idle_machine_only() {
        let row = json!({ "fault": "f", "lives": true, "told": "x", "recovered_secs": 1.5 });
        let late = json!({ "faults": { "rows": [row] } });
        assert!(!report(late.clone(), false).is_good() && report(late, true).is_good());
    }

    #[test]
    fn a_dead_node_a_silent_one_and_one_that_never_recovers_fail_always() {
        for (key, value) in [("lives", json!(false)), ("told", json!(null)), ("recovered_secs", json!(null))] {
            let mut row = json!({ "fault": "f", "lives": true, "told": "x", "recovered_secs": 0.5 });
            row[key] = value;
            assert!(!report(json!({ "faults": { "rows": [row] } }), true).is_good(), "{key}");
        }
    }

    #[test]
    fn uncounted_images_growth_and_lost_recordings_fail() {
        let soak = |uncounted: i32, growth: f64| {
            json!({ "soak": {
                "secs": 600.0, "warm_up_secs": 120.0, "uncounted": uncounted, "growth_bytes": { "predictor": growth, "verifier": null },
                "alive": { "predictor": true }, "scored_pairs": 9, "joint_states": 9, "recorded_frames": 9,
            } })
        };
        assert!(report(soak(0, 0.9e6), false).is_good());
        assert!(!report(soak(1, 0.0), false).is_good() && !report(soak(0, 1.1e6), false).is_good());
        let kill = |read: i32| {
            json!({ "kills": { "rows": [{
                "killed": "trainer", "others_live": true, "others_go_on": true, "resumed_secs": 1.0,
                "recorded_before_the_kill": 50, "frames_read_back": read,
            }] } })
        };
        assert!(report(kill(50), false).is_good() && !report(kill(49), false).is_good());
        assert!(report(kill(49), false).markdown().contains("| 1.0 | **no** |"));
    }
}
