//! Numbers of a JSON value as names and values, the form that messages carry.

use serde_json::Value;

/// Returns the numbers of `value` under dotted names, for instance `pooled.f1`; null becomes NaN.
pub(crate) fn flatten(value: &Value) -> Vec<(String, f64)> {
    let mut numbers = Vec::new();
    collect("", value, &mut numbers);
    numbers
}

fn collect(prefix: &str, value: &Value, numbers: &mut Vec<(String, f64)>) {
    match value {
        Value::Object(entries) => {
            for (key, value) in entries {
                let name = if prefix.is_empty() { key.clone() } else { format!("{prefix}.{key}") };
                collect(&name, value, numbers);
            }
        }
        value => numbers.push((prefix.to_owned(), value.as_f64().unwrap_or(f64::NAN))),
    }
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    #[test]
    fn nested_numbers_get_dotted_names_and_null_is_nan() {
        let numbers = flatten(&json!({ "mae": 0.25, "pooled": { "f1": 1, "auroc": null } }));
        assert_eq!(numbers[0], ("mae".into(), 0.25));
        assert!(numbers.contains(&("pooled.f1".into(), 1.0)));
        assert!(numbers.iter().any(|(name, value)| name == "pooled.auroc" && value.is_nan()));
    }
}
