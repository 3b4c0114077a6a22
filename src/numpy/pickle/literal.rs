//! Parses the text lines of a pickle: numbers and strings of protocol 0.

use super::{Outcome, Value};

/// Parses a line of text.
pub(super) fn text(line: &[u8]) -> Outcome<&str> {
    std::str::from_utf8(line).map_err(|_| "a line that is not text".to_string())
}

/// Parses a memo number.
pub(super) fn number(line: &[u8]) -> Outcome<u64> {
    let line = text(line)?;
    line.parse().map_err(|_| format!("{line:?} is not a memo number"))
}

/// Parses an `I` or `L` line: a decimal number, after `L` with an optional suffix `L`; 00 and 01 are booleans.
pub(super) fn integer<'a>(line: &[u8]) -> Outcome<Value<'a>> {
    let line = text(line)?;
    match line {
        "00" => Ok(Value::Bool(false)),
        "01" => Ok(Value::Bool(true)),
        _ => {
            let digits = line.strip_suffix('L').unwrap_or(line);
            digits.parse().map(Value::Int).map_err(|_| format!("{line:?} is not an integer of at most 64 bits"))
        }
    }
}

/// Parses a Python 2 string literal with its quotes and escapes.
pub(super) fn python2_string(line: &[u8]) -> Outcome<Vec<u8>> {
    let inner = match line {
        [open @ (b'\'' | b'"'), inner @ .., close] if open == close => inner,
        _ => return Err("a string without its quotes".into()),
    };
    let mut bytes = Vec::with_capacity(inner.len());
    let mut rest = inner;
    while let [first, tail @ ..] = rest {
        rest = tail;
        if *first != b'\\' {
            bytes.push(*first);
            continue;
        }
        let [escape, tail @ ..] = rest else { return Err("a string that ends in a backslash".into()) };
        rest = tail;
        match escape {
            b'x' => {
                let digits = rest.get(..2).and_then(|digits| std::str::from_utf8(digits).ok());
                let byte = digits.and_then(|digits| u8::from_str_radix(digits, 16).ok());
                bytes.push(byte.ok_or("a \\x without two hexadecimal digits")?);
                rest = &rest[2..];
            }
            b'n' => bytes.push(b'\n'),
            b'r' => bytes.push(b'\r'),
            b't' => bytes.push(b'\t'),
            b'\\' | b'\'' | b'"' => bytes.push(*escape),
            _ => return Err(format!("the unknown escape \\{}", char::from(*escape))),
        }
    }
    Ok(bytes)
}

/// Decodes Python's raw-unicode-escape: latin-1 with \uXXXX and \UXXXXXXXX.
pub(super) fn raw_unicode(line: &[u8]) -> Outcome<String> {
    let mut text = String::with_capacity(line.len());
    let mut rest = line;
    while let [first, tail @ ..] = rest {
        let length = match (first, tail.first()) {
            (b'\\', Some(b'u')) => 4,
            (b'\\', Some(b'U')) => 8,
            _ => {
                text.push(char::from(*first));
                rest = tail;
                continue;
            }
        };
        let digits = tail.get(1..=length).and_then(|digits| std::str::from_utf8(digits).ok());
        let code = digits.and_then(|digits| u32::from_str_radix(digits, 16).ok()).and_then(char::from_u32);
        text.push(code.ok_or("a \\u that is not a character")?);
        rest = &tail[length + 1..];
    }
    Ok(text)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn python2_strings_keep_every_byte() {
        assert_eq!(python2_string(br#"'a\x00\n\\ \'"'"#).unwrap(), b"a\0\n\\ '\"");
        assert_eq!(python2_string(b"\"it's\"").unwrap(), b"it's");
        for bad in [&b"'a"[..], b"a", b"'", b"'\\", b"'\\x0'", b"'\\q'"] {
            assert!(python2_string(bad).is_err(), "{bad:?}");
        }
    }

    #[test]
    fn unicode_escapes_are_characters() {
        assert_eq!(raw_unicode(b"a\xe9\\u20ac\\U0001f590 \\n").unwrap(), "a\u{e9}\u{20ac}\u{1f590} \\n");
        assert!(raw_unicode(b"\\ud800").is_err() && raw_unicode(b"\\u12").is_err());
    }

    #[test]
    fn integers_and_booleans_are_distinguished() {
        assert!(matches!(integer(b"01"), Ok(Value::Bool(true))));
        assert!(matches!(integer(b"1"), Ok(Value::Int(1))));
        assert!(matches!(integer(b"-7L"), Ok(Value::Int(-7))));
        assert!(integer(b"99999999999999999999L").is_err() && integer(b"x").is_err());
    }
}
