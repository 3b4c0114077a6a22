//! Text for people.

use std::borrow::Cow;
use std::error::Error;
use std::fmt::{Arguments, Write};
use std::io;

/// Formats a number with three significant digits and at most six decimals, without an exponent.
pub fn significant(value: f64) -> String {
    let magnitude = if value == 0.0 { 0 } else { value.abs().log10().floor() as i32 };
    format!("{value:.*}", usize::try_from(2 - magnitude).unwrap_or(0).min(6))
}

/// Parses YAML. Refuses a text with many nested brackets, for which the parser's time grows with their number squared.
///
/// # Errors
/// If it is not YAML of the type, or nested too deep.
pub fn parse_yaml<T: serde::de::DeserializeOwned>(text: &str) -> std::result::Result<T, serde_yaml::Error> {
    /// Greatest nesting; brackets in comments and quotes count too.
    const MAX_NESTING: usize = 1000;
    let mut open = 0_usize;
    for byte in text.bytes() {
        match byte {
            b'[' | b'{' => open += 1,
            b']' | b'}' => open = open.saturating_sub(1),
            _ => {}
        }
        if open > MAX_NESTING {
            let message = format!("expected at most {MAX_NESTING} nested brackets, got more");
            return Err(serde::de::Error::custom(message));
        }
    }
    serde_yaml::from_str(text)
}

/// Shortens a text to its first `most` characters, and says how long it was: a file may hold a name of any length.
pub fn shortened(text: &str, most: usize) -> Cow<'_, str> {
    match text.char_indices().nth(most) {
        None => Cow::Borrowed(text),
        Some((end, _)) => Cow::Owned(format!("{}... ({} bytes)", &text[..end], text.len())),
    }
}

/// Appends a line.
pub fn put(text: &mut String, line: Arguments<'_>) {
    // Writing to a String cannot fail.
    let _ = writeln!(text, "{line}");
}

/// Prints a line to standard error. If that fails, as on a full disk or a closed pipe, the line is lost and the program goes
/// on: `eprintln!` would panic, and the exit status would no longer tell the result.
pub fn tell(line: Arguments<'_>) {
    // Nowhere is left to report the failure.
    let _ = io::Write::write_fmt(&mut io::stderr().lock(), format_args!("{line}\n"));
}

/// Escapes what a text from outside could do to a terminal: control characters except line feeds and tabs, and the
/// characters that reverse the direction of text. The escapes are those of JSON, so JSON stays JSON.
pub fn printable(text: &str) -> Cow<'_, str> {
    escaped(text, |c| acts_on_terminal(c) && !matches!(c, '\n' | '\t'))
}

/// As [`printable()`], and escapes line feeds and tabs: for a name within a line.
pub fn printable_name(text: &str) -> Cow<'_, str> {
    escaped(text, acts_on_terminal)
}

fn acts_on_terminal(c: char) -> bool {
    c.is_control() || matches!(c, '\u{200e}' | '\u{200f}' | '\u{2028}'..='\u{202e}' | '\u{2066}'..='\u{2069}')
}

fn escaped(text: &str, acts: impl Fn(char) -> bool) -> Cow<'_, str> {
    if !text.chars().any(&acts) {
        return Cow::Borrowed(text);
    }
    let mut escaped = String::with_capacity(text.len());
    for c in text.chars() {
        match acts(c) {
            // All of them lie below 2^16.
            true => escaped += &format!("\\u{:04x}", u32::from(c)),
            false => escaped.push(c),
        }
    }
    Cow::Owned(escaped)
}

/// Formats an error and its causes for a terminal, each once: some errors quote their cause in their own text.
pub fn error_chain(error: &dyn Error) -> String {
    /// Largest number of characters of the text.
    const MOST: usize = 3000;
    let mut text = error.to_string();
    let mut cause = error.source();
    while let Some(error) = cause {
        let words = error.to_string();
        if !text.contains(&words) {
            text += &format!(": {words}");
        }
        cause = error.source();
    }
    printable(&shortened(&text, MOST)).into_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_keep_three_significant_digits() {
        let cases = [(0.0, "0.00"), (0.012_345, "0.0123"), (1.2345, "1.23"), (123.4, "123"), (98_765.0, "98765")];
        for (value, text) in cases {
            assert_eq!(significant(value), text);
        }
        assert_eq!((significant(-2e-9), significant(4e-6)), ("-0.000000".into(), "0.000004".into()));
    }

    #[test]
    fn all_yaml_of_the_library_is_parsed_with_bounded_nesting() {
        let nested = |depth: usize| parse_yaml::<serde_yaml::Value>(&("[".repeat(depth) + &"]".repeat(depth)));
        assert!(nested(1001).unwrap_err().to_string().contains("at most 1000 nested brackets"));
        assert!(nested(100).is_ok());
        // No other module parses a text by itself.
        let mut folders = vec![std::path::PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/src"))];
        while let Some(folder) = folders.pop() {
            for entry in std::fs::read_dir(folder).unwrap() {
                let path = entry.unwrap().path();
                if path.is_dir() {
                    folders.push(path);
                    continue;
                }
                let text = std::fs::read_to_string(&path).unwrap_or_default();
                let product = text.split("#[cfg(test)]").next().unwrap();
                let parses = ["from_str", "from_slice", "from_reader"].map(|name| format!("serde_yaml::{name}"));
                let is_here = path.ends_with("src/text.rs");
                assert!(is_here || !parses.iter().any(|call| product.contains(call)), "{}", path.display());
            }
        }
    }

    #[test]
    fn names_from_outside_cannot_act_on_a_terminal() {
        assert!(matches!(printable("/camera/image\n\ttouché"), Cow::Borrowed(_)));
        assert_eq!(printable("a\u{1b}[2J\u{7f}\u{9b}\u{202e}b\r"), "a\\u001b[2J\\u007f\\u009b\\u202eb\\u000d");
        assert_eq!(printable_name("a\nlost: b\t"), "a\\u000alost: b\\u0009");
        let json = serde_json::json!({ "topic": "\u{9b}31m\u{1b}" });
        assert_eq!(serde_json::from_str::<serde_json::Value>(&printable(&json.to_string())).unwrap(), json);
    }

    #[test]
    fn a_long_text_is_cut_between_characters() {
        assert!(matches!(shortened("touché", 6), Cow::Borrowed("touché")));
        assert_eq!(shortened("touchée", 6), "touché... (8 bytes)");
    }

    #[test]
    fn an_error_states_its_cause_once() {
        let error = crate::error::Error::io("a")(std::io::Error::from_raw_os_error(libc::EIO));
        assert_eq!(error_chain(&error), "a: Input/output error (os error 5)");
        let error = anyhow::Error::from(error).context("b.mcap");
        assert_eq!(error_chain(error.as_ref()), "b.mcap: a: Input/output error (os error 5)");
    }
}
