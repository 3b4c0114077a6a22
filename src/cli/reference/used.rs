//! Keys that the shipped files use, for the tests of the pages that list keys.

use std::collections::BTreeSet;

use serde_yaml::Value;

use crate::text::parse_yaml;

/// Values below a key, each with what stands before its keys, where the page does not name them by their path; None = by their path.
pub(super) type Rule = dyn for<'v> Fn(&str, &'v Value) -> Option<Vec<(&'v Value, String)>>;

/// Collects the keys of YAML files as their page names them.
pub(super) fn keys(texts: impl IntoIterator<Item = String>, rule: &Rule) -> BTreeSet<String> {
    let mut found = BTreeSet::new();
    texts.into_iter().for_each(|text| collect(&parse_yaml(&text).unwrap(), "", rule, &mut found));
    found
}

fn collect(value: &Value, before: &str, rule: &Rule, found: &mut BTreeSet<String>) {
    for (name, value) in value.as_mapping().into_iter().flatten() {
        let name = format!("{before}{}", name.as_str().unwrap());
        let by_path = || match value {
            Value::Sequence(entries) => entries.iter().map(|entry| (entry, format!("{name}[]."))).collect(),
            value => vec![(value, format!("{name}."))],
        };
        for (value, before) in rule(&name, value).unwrap_or_else(by_path) {
            collect(value, &before, rule, found);
        }
        found.insert(name);
    }
}

/// Asserts that a page has a row with a meaning for each key.
pub(super) fn assert_explained(page: &str, used: &BTreeSet<String>) {
    for name in used {
        let row = page.lines().find(|line| line.starts_with(&format!("| `{name}` |")));
        let row = row.unwrap_or_else(|| panic!("{name} is not on the page"));
        assert!(!row.ends_with("|  |"), "{row}");
    }
}
