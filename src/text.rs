//! Formats text for people.

use std::fmt::{Arguments, Write};

/// Formats a number with three significant digits and at most six decimals, without an exponent.
pub fn significant(value: f64) -> String {
    let magnitude = if value == 0.0 { 0 } else { value.abs().log10().floor() as i32 };
    format!("{value:.*}", usize::try_from(2 - magnitude).unwrap_or(0).min(6))
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
