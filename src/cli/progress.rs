//! Progress bars on standard error.

use indicatif::{ProgressBar, ProgressStyle};

/// Creates a bar that counts `unit`s and shows rate and remaining time.
pub fn bar(unit: &str) -> ProgressBar {
    styled(&format!("{{bar:40}} {{pos}}/{{len}} {unit} {{per_sec}} {{eta}} left"))
}

/// Creates a bar with a message and the elapsed time.
pub fn told_bar() -> ProgressBar {
    styled("{bar:30} {pos}/{len} {msg} ({elapsed})")
}

/// Sets the position of a bar to `done` of `all`.
pub fn step(bar: &ProgressBar, done: usize, all: usize) {
    bar.set_length(all as u64);
    bar.set_position(done as u64);
}

fn styled(template: &str) -> ProgressBar {
    let bar = ProgressBar::new(0);
    if let Ok(style) = ProgressStyle::with_template(template) {
        bar.set_style(style);
    }
    bar
}
