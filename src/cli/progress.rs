//! Progress bars on standard error.

use indicatif::{ProgressBar, ProgressStyle};

/// A bar that counts `unit`s, with speed and the time that is left.
pub fn bar(unit: &str) -> ProgressBar {
    styled(&format!("{{bar:40}} {{pos}}/{{len}} {unit} {{per_sec}} {{eta}} left"))
}

/// A bar that says what is being done, and for how long it has been.
pub fn told_bar() -> ProgressBar {
    styled("{bar:30} {pos}/{len} {msg} ({elapsed})")
}

/// Shows that `done` of `all` are done.
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
