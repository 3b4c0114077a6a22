//! Changes of text: YAML, XML, headers.

use rand::Rng as _;

use super::{Rng, below, extreme, pick, times};

/// Words that stand for numbers or structure where a reader may not expect them.
const WORDS: [&str; 18] = [
    "nan",
    ".nan",
    ".inf",
    "-.inf",
    "1e400",
    "1e-400",
    "null",
    "~",
    "true",
    "[]",
    "{}",
    "!!binary aaaa",
    "\u{0}",
    "\u{1b}[2J",
    "../../../etc/passwd",
    "/dev/zero",
    "99999999999999999999999999",
    "0x7fffffffffffffff",
];

/// Changes a token, or the order or number of lines.
pub fn change(rng: &mut Rng, text: &str) -> String {
    let mut lines: Vec<String> = text.lines().map(str::to_string).collect();
    if lines.is_empty() {
        return pick(rng, &WORDS).to_string();
    }
    let (at, other) = (below(rng, lines.len()), below(rng, lines.len()));
    match below(rng, 12) {
        0 => drop(lines.remove(at)),
        1 => {
            let line = lines[at].clone();
            let copies = times(rng).min(1_000_000 / line.len().max(1));
            lines.splice(at..at, vec![line; copies]);
        }
        2 => lines.swap(at, other),
        3 => lines.truncate(at + 1),
        4 => lines[at] = lines[at].trim_start().to_string(),
        5 => lines.splice(at..at, bomb()).for_each(drop),
        _ => lines[at] = other_token(rng, &lines[at]),
    }
    lines.join("\n") + if text.ends_with('\n') { "\n" } else { "" }
}

/// Replaces a number or word of the line.
fn other_token(rng: &mut Rng, line: &str) -> String {
    let is_word = |c: char| c.is_ascii_alphanumeric() || c == '.' || c == '-' || c == '_';
    let mut tokens = Vec::new();
    let mut start = None;
    for (at, c) in line.char_indices().chain([(line.len(), ' ')]) {
        match (start, is_word(c)) {
            (None, true) => start = Some(at),
            (Some(from), false) => {
                tokens.push(from..at);
                start = None;
            }
            _ => {}
        }
    }
    // Numbers are what sizes and counts come from.
    let numbers: Vec<_> =
        tokens.iter().filter(|token| line[(*token).clone()].parse::<f64>().is_ok()).cloned().collect();
    let from = if numbers.is_empty() || rng.random_bool(0.15) { &tokens } else { &numbers };
    if from.is_empty() {
        return line.to_string();
    }
    let token = pick(rng, from).clone();
    let new = match below(rng, 4) {
        0 => pick(rng, &WORDS).to_string(),
        1 => format!("{}", *pick(rng, &[1e-300, 1e300, -1e9, 0.5, 1e9, 1e6])),
        _ => extreme(rng).to_string(),
    };
    format!("{}{new}{}", &line[..token.start], &line[token.end..])
}

/// Lines of YAML whose aliases multiply.
fn bomb() -> Vec<String> {
    let mut lines = vec!["a0: &a0 [x, x, x, x, x, x, x, x, x]".to_string()];
    for level in 1..9 {
        let alias = vec![format!("*a{}", level - 1); 9].join(", ");
        lines.push(format!("a{level}: &a{level} [{alias}]"));
    }
    lines
}
