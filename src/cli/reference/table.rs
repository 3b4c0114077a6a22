//! Table of the keys of a file: name, default, meaning. Leaving a key out of a whole file shows its default.

use anyhow::Context;
use serde::{Serialize, de::DeserializeOwned};
use serde_yaml::Value;

use super::keys::{Holds, Key};
use crate::text::{parse_yaml, put};

/// File whose keys are described.
pub(super) struct Form {
    /// File with all of its optional parts, in which each part has the keys that it must have.
    whole: Value,
    /// Returns a file as it is written after it was read; None if it is refused.
    reread: fn(Value) -> anyhow::Result<Option<Value>>,
    /// Word for a name of the user's choice.
    named: &'static str,
}

/// Step from a YAML value to one inside it.
#[derive(Debug, Clone, PartialEq)]
enum Step {
    Key(String),
    /// The first entry of a list or of a mapping.
    First,
}

impl Form {
    /// Describes a file that is read as `T`. `whole` has all optional parts, with the keys that each must have; `named` is the
    /// word for a name of the user's choice.
    ///
    /// # Errors
    /// If `whole` is no YAML.
    pub(super) fn of<T: Serialize + DeserializeOwned>(whole: &str, named: &'static str) -> anyhow::Result<Self> {
        Ok(Self { whole: parse_yaml(whole).context("whole file")?, reread: reread::<T>, named })
    }

    /// Writes the table of `keys`; returns the forms that keys may have.
    ///
    /// # Errors
    /// If a default can't be written as YAML.
    pub(super) fn write<'a>(&self, keys: &'a [Key], page: &mut String) -> anyhow::Result<Vec<&'a Key>> {
        page.push_str("| key | default | meaning |\n|---|---|---|\n");
        let mut forms = Vec::new();
        self.write_rows(keys, &mut Vec::new(), "", &mut forms, page)?;
        Ok(forms)
    }

    fn write_rows<'a>(
        &self,
        keys: &'a [Key],
        path: &mut Vec<Step>,
        before: &str,
        forms: &mut Vec<&'a Key>,
        page: &mut String,
    ) -> anyhow::Result<()> {
        for key in keys {
            let name = format!("{before}{}", key.name);
            path.push(Step::Key(key.name.clone()));
            put(page, format_args!("| `{name}` | {} | {} |", self.default(path)?, key.text.replace('|', "\\|")));
            match key.holds {
                Holds::Choice => forms.extend(&key.below),
                Holds::Keys => self.write_rows(&key.below, path, &format!("{name}."), forms, page)?,
                Holds::List | Holds::Map => {
                    path.push(Step::First);
                    let entry = if key.holds == Holds::List { "[]." } else { &format!(".{}.", self.named) };
                    self.write_rows(&key.below, path, &format!("{name}{entry}"), forms, page)?;
                    path.pop();
                }
            }
            path.pop();
        }
        Ok(())
    }

    /// Returns the value of a key that a file leaves out.
    fn default(&self, path: &[Step]) -> anyhow::Result<String> {
        let Some(written) = (self.reread)(without(self.whole.clone(), path))? else { return Ok("required".into()) };
        Ok(match at(&written, path) {
            // The keys of a part stand in rows of their own.
            Some(Value::Mapping(_)) => "as below".into(),
            None | Some(Value::Null) => "none".into(),
            Some(value) => format!("`{}`", serde_json::to_string(value)?),
        })
    }
}

fn reread<T: Serialize + DeserializeOwned>(file: Value) -> anyhow::Result<Option<Value>> {
    let Ok(read) = serde_yaml::from_value::<T>(file) else { return Ok(None) };
    Ok(Some(serde_yaml::to_value(&read)?))
}

fn at<'a>(value: &'a Value, path: &[Step]) -> Option<&'a Value> {
    path.iter().try_fold(value, |value, step| match (step, value) {
        (Step::Key(name), value) => value.get(name.as_str()),
        (Step::First, Value::Sequence(entries)) => entries.first(),
        (Step::First, value) => value.as_mapping()?.values().next(),
    })
}

fn without(mut whole: Value, path: &[Step]) -> Value {
    if let Some((Step::Key(name), above)) = path.split_last() {
        let part = above.iter().try_fold(&mut whole, |value, step| match (step, value) {
            (Step::Key(name), value) => value.get_mut(name.as_str()),
            (Step::First, Value::Sequence(entries)) => entries.first_mut(),
            (Step::First, value) => value.as_mapping_mut()?.values_mut().next(),
        });
        if let Some(Value::Mapping(part)) = part {
            part.remove(name.as_str());
        }
    }
    whole
}
