//! The hard cases as a document and as JSON.

use egotac::machine::Machine;
use egotac::text::put;
use serde_json::{Value, json};

use super::Row;

/// Command that writes the document and the JSON file.
pub const COMMAND: &str = "egotac bench hard-cases --out docs";

/// Returns the text of `hard-cases.md`.
pub fn markdown(rows: &[Row], machine: &Machine) -> String {
    let mut text = format!(
        "# Hard cases\n\n\
         Inputs that go wrong silently without guards, the report of the guards, and the remedy. `{COMMAND}`\n\
         runs every row and wrote this page (egotac {}, {machine}); the cases draw no random\n\
         numbers. Tests run the same rows: as written a case is right within its tolerance or flagged, and the remedy is right\n\
         and not flagged.\n\n\
         An audit checks a model before its first step: its errors refuse the model, its advice is logged. A guard checks\n\
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
                    "\n## {name}\n\n| case | what the user does | error of | tolerance | as written | report of the guards | remedy | with the remedy |\n|---|---|---|---|---|---|---|---|"
                ),
            );
        }
        let outcome = &row.outcome;
        let guard = if outcome.guard.is_empty() { "nothing: the result is right" } else { &outcome.guard };
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

/// Returns the cases as JSON.
pub fn json(rows: &[Row], machine: &Machine) -> Value {
    json!({ "command": COMMAND, "version": egotac::VERSION, "machine": machine, "cases": rows })
}

/// Returns the names of the cases in a document, in its order.
pub fn names(markdown: &str) -> Vec<&str> {
    markdown.lines().filter_map(|line| line.strip_prefix("| `")?.split('`').next()).collect()
}

/// Formats a number with two digits: further ones may differ between processors.
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

/// Escapes a text for a cell of a table.
fn cell(text: &str) -> String {
    text.replace('|', "\\|").replace('\n', " ")
}
