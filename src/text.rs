//! Formats text for people.

use std::fmt::{Arguments, Write};

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

/// Appends a line.
pub fn put(text: &mut String, line: Arguments<'_>) {
    // Writing to a String cannot fail.
    let _ = writeln!(text, "{line}");
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
}
