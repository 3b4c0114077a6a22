//! Changes of JSON documents.

use rand::Rng as _;
use serde_json::{Value, json};

use super::{Rng, below, chance, extreme, pick, times};

/// Depth of a nested value, beyond the limit of the parser and below it.
const DEPTHS: [usize; 3] = [20, 100, 10_000];

/// Changes a document and returns its text; text that is no JSON is changed as text.
pub fn change_text(rng: &mut Rng, text: &str) -> String {
    if chance(rng, 0.05) {
        let depth = *pick(rng, &DEPTHS);
        return "[".repeat(depth) + &"]".repeat(depth);
    }
    match serde_json::from_str(text) {
        Ok(mut value) => {
            change(rng, &mut value);
            value.to_string()
        }
        Err(_) => super::text::change(rng, text),
    }
}

/// Replaces, removes or multiplies a random value within the document.
pub fn change(rng: &mut Rng, document: &mut Value) {
    let place = below(rng, count(document));
    let mut left = place;
    visit(document, &mut left, &mut |value| change_one(rng, value));
}

fn change_one(rng: &mut Rng, value: &mut Value) {
    // Numbers stay numbers most of the time: another type ends most readers at once.
    let of_kind = chance(rng, 0.7);
    *value = match value.take() {
        Value::Number(_) if of_kind => other_number(rng),
        Value::String(text) if of_kind => Value::String(super::text::change(rng, &text)),
        Value::Bool(flag) if of_kind => Value::Bool(!flag),
        Value::Array(mut items) if of_kind && !items.is_empty() => {
            let at = below(rng, items.len());
            match below(rng, 4) {
                0 => drop(items.remove(at)),
                1 => items.extend(vec![items[at].clone(); times(rng).min(70_000)]),
                2 => items[at] = other_number(rng),
                _ => items.clear(),
            }
            Value::Array(items)
        }
        Value::Object(mut map) if of_kind && !map.is_empty() => {
            let names: Vec<String> = map.keys().cloned().collect();
            let (name, other) = (pick(rng, &names).clone(), pick(rng, &names).clone());
            match below(rng, 3) {
                0 => drop(map.remove(&name)),
                1 => drop(map.insert(name, json!(extreme(rng)))),
                _ => {
                    let copy = map[&name].clone();
                    map.insert(other, copy);
                }
            }
            Value::Object(map)
        }
        old => match below(rng, 7) {
            0 => Value::Null,
            1 => other_number(rng),
            2 => json!([]),
            3 => json!({}),
            4 => json!([old]),
            5 => json!("a".repeat(times(rng))),
            _ => json!(extreme(rng).to_string()),
        },
    };
}

fn other_number(rng: &mut Rng) -> Value {
    match below(rng, 6) {
        0 => json!(rng.random::<u64>()),
        1 => json!(*pick(rng, &[0.5, -0.5, 1e-300, 1e300, -1e300, 1.5])),
        _ => json!(extreme(rng)),
    }
}

/// Number of values in the document, itself included.
fn count(value: &Value) -> usize {
    1 + match value {
        Value::Array(items) => items.iter().map(count).sum(),
        Value::Object(map) => map.values().map(count).sum(),
        _ => 0,
    }
}

/// Calls `change` on the value that comes after `left` others.
fn visit(value: &mut Value, left: &mut usize, change: &mut dyn FnMut(&mut Value)) -> bool {
    if *left == 0 {
        change(value);
        return true;
    }
    *left -= 1;
    match value {
        Value::Array(items) => items.iter_mut().any(|item| visit(item, left, change)),
        Value::Object(map) => map.values_mut().any(|item| visit(item, left, change)),
        _ => false,
    }
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;

    use super::*;

    #[test]
    fn a_changed_document_differs_most_of_the_time() {
        let mut rng = Rng::seed_from_u64(1);
        let text = json!({"a": [1, 2], "b": {"c": "d"}}).to_string();
        let same = (0..200).filter(|_| change_text(&mut rng, &text) == text).count();
        assert!(same < 40, "{same} of 200 unchanged");
    }
}
