//! Progress bars and details on standard error, and how much of both is shown.

use std::fmt::Arguments;
use std::path::Path;
use std::sync::atomic::{AtomicU8, Ordering};
use std::time::Duration;

use indicatif::{ProgressBar, ProgressStyle};

use crate::model::Predictor;
use crate::text::tell;

/// How much a command says beside its results, warnings and errors.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
#[repr(u8)]
pub enum Verbosity {
    /// Nothing.
    Quiet,
    /// Progress, where standard error is a terminal.
    Normal,
    /// Also what is loaded, and the time at the end.
    Verbose,
}

static VERBOSITY: AtomicU8 = AtomicU8::new(Verbosity::Normal as u8);

/// Sets the verbosity of this process.
pub fn set_verbosity(verbosity: Verbosity) {
    VERBOSITY.store(verbosity as u8, Ordering::Relaxed);
}

/// Prints a line to standard error if the process is verbose.
pub fn detail(line: Arguments<'_>) {
    if VERBOSITY.load(Ordering::Relaxed) >= Verbosity::Verbose as u8 {
        tell(format_args!("egotac: {}", crate::text::printable_name(&line.to_string())));
    }
}

/// Tells which network was loaded from `path`.
pub fn tell_network(path: &Path, predictor: &Predictor) {
    detail(format_args!("checkpoint {}: {}", path.display(), predictor.metadata().name));
}

/// Creates a bar that counts `unit`s and shows rate and remaining time. It is hidden where standard error is not a terminal.
pub fn bar(unit: &str) -> ProgressBar {
    styled(&format!("{{bar:40}} {{pos}}/{{len}} {unit} {{per_sec}} {{eta}} left"))
}

/// Creates a bar as [`bar`], with a message behind it.
pub fn told_bar(unit: &str) -> ProgressBar {
    styled(&format!("{{bar:30}} {{pos}}/{{len}} {unit} {{per_sec}} {{eta}} left  {{msg}}"))
}

/// Creates a moving sign with a message, for work of unknown length.
pub fn spinner(message: &'static str) -> ProgressBar {
    shown(ProgressBar::new_spinner()).with_message(message)
}

/// Sets the position of a bar to `done` of `all`.
pub fn step(bar: &ProgressBar, done: usize, all: usize) {
    bar.set_length(all as u64);
    bar.set_position(done as u64);
}

fn styled(template: &str) -> ProgressBar {
    let bar = shown(ProgressBar::new(0));
    if let Ok(style) = ProgressStyle::with_template(template) {
        bar.set_style(style);
    }
    // The remaining time also changes while one step takes long.
    bar.enable_steady_tick(Duration::from_millis(500));
    bar
}

fn shown(bar: ProgressBar) -> ProgressBar {
    if VERBOSITY.load(Ordering::Relaxed) == Verbosity::Quiet as u8 {
        return ProgressBar::hidden();
    }
    bar
}
