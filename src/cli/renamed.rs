//! Old spellings of options, and the errors that name the new ones.

use std::ffi::OsString;

use clap::error::{ContextKind, ContextValue, ErrorKind};

/// Renamed options: command, old spelling, new spelling. An old spelling without dashes stands for positional arguments.
#[doc(hidden)]
pub const RENAMED: [(&str, &str, &str); 19] = [
    ("verify", "--predictor", "--checkpoint"),
    ("demo", "--model", "--checkpoint"),
    ("model forward", "--weights", "--checkpoint"),
    ("model import", "--weights", "--checkpoint"),
    ("model init", "--image", "--size"),
    ("model info", "FILE", "--checkpoint FILE"),
    ("model grow", "FILE", "--checkpoint FILE"),
    ("model half", "FILE", "--checkpoint FILE"),
    ("model familiarity", "FILE STORE", "--checkpoint FILE --data STORE"),
    ("model presence", "FILE STORE", "--checkpoint FILE --data STORE"),
    ("model calibrate", "FILE STORE", "--checkpoint FILE --data STORE"),
    ("label", "--side", "--size"),
    ("label", "--observation", "--as environment_state or --as state"),
    ("data import", "--side", "--size"),
    ("retarget run", "--rate", "--fps"),
    ("experiment", "--init", "--checkpoint"),
    ("experiment", "--image", "--size"),
    ("bench model", "--image", "--size"),
    ("bench guards", "--out", "--json FILE"),
];

/// Returns `error`, or in place of an unknown option or argument that was renamed, an error that names the new spelling. `arguments` begin
/// with the program's name.
pub fn explain(error: clap::Error, arguments: &[OsString]) -> clap::Error {
    let Some(ContextValue::String(unknown)) = error.get(ContextKind::InvalidArg) else { return error };
    if error.kind() != ErrorKind::UnknownArgument {
        return error;
    }
    let words: Vec<_> = arguments.iter().skip(1).map(|word| word.to_string_lossy()).collect();
    let words: Vec<&str> = words.iter().map(AsRef::as_ref).filter(|word| !word.starts_with('-')).collect();
    let is_meant = |command: &str| command.split(' ').eq(words.iter().copied().take(command.split(' ').count()));
    let is_option = |text: &str| text.starts_with('-');
    let is_old = |old: &str| if is_option(old) { old == unknown } else { !is_option(unknown) };
    let found = RENAMED.iter().find(|(command, old, _)| is_old(old) && is_meant(command));
    match found {
        Some((command, old, new)) => {
            clap::Error::raw(ErrorKind::UnknownArgument, format!("`egotac {command} {old}` is now {new}\n"))
        }
        None => error,
    }
}
