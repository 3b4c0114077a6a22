//! The hard cases as a document and as JSON.

use egotac::machine::Machine;
use egotac::text::put;
use serde_json::{Value, json};

use super::Row;

/// The command that writes both.
pub const COMMAND: &str = "egotac bench hard-cases --out docs";

/// The document `hard-cases.md`.
pub fn markdown(rows: &[Row], machine: &Machine) -> String {
    let mut text = format!(
        "# Hard cases\n\n\
         What a user does, what goes wrong when nobody looks, what the guards say, and what helps. Every row is run by\n\
         `{COMMAND}`, which wrote this page (egotac {}, {machine}); the cases draw no random\n\
         numbers. Tests run the same rows: as written a case is right within its tolerance or flagged, and the remedy is right\n\
         and not flagged.\n\n\
         An audit looks at a model before its first step: its errors refuse the model, its advice is logged. A guard looks at\n\
         every step and every frame, and its reason becomes the frame's validity. \"lost\" = not a number, or infinite;\n\
         \"refused\" = not run: it would end the process, or take all memory.\n",
        egotac::VERSION,
    );
    let mut family = None;
    for row in rows {
        if family != Some(row.family) {
            family = Some(row.family);
            let name = format!("{:?}", row.family);
            put(
                &mut text,
                format_args!(
                    "\n## {name}\n\n| case | what a user does | error of | tolerance | as written | what is said | remedy | with it |\n|---|---|---|---|---|---|---|---|"
                ),
            );
        }
        let outcome = &row.outcome;
        let guard = if outcome.guard.is_empty() { "nothing: it is right" } else { &outcome.guard };
        put(
            &mut text,
            format_args!(
                "| `{}` | {} | {} | {} | {} | {} | {} | {} |",
                row.name,
                cell(row.recipe),
                cell(outcome.error_of),
                number(outcome.tolerance),
                outcome.unguarded.map_or("refused".into(), number),
                cell(guard),
                cell(row.remedy),
                number(outcome.remedied),
            ),
        );
    }
    text
}

/// The same as JSON.
pub fn json(rows: &[Row], machine: &Machine) -> Value {
    json!({ "command": COMMAND, "version": egotac::VERSION, "machine": machine, "cases": rows })
}

/// Names of the cases in a document, in its order.
pub fn names(markdown: &str) -> Vec<&str> {
    markdown.lines().filter_map(|line| line.strip_prefix("| `")?.split('`').next()).collect()
}

/// Two digits: another processor may round the last ones otherwise.
fn number(value: f64) -> String {
    if !value.is_finite() {
        return "lost".into();
    }
    match value.abs() {
        0.0 => "0".into(),
        small if !(0.01..1e4).contains(&small) => format!("{value:.0e}"),
        below_ten if below_ten < 10.0 => format!("{value:.2}").trim_end_matches('0').trim_end_matches('.').to_owned(),
        _ => format!("{value:.0}"),
    }
}

/// Text within a table.
fn cell(text: &str) -> String {
    text.replace('|', "\\|").replace('\n', " ")
}
