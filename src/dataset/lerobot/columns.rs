//! Columns of a LeRobot data set that hold labels.

use std::sync::Arc;

use serde_json::Value;

use super::images::{LeRobotDataset, PolicyInput};
use super::policy_input::{LabelColumn, policy_input, policy_input_names, policy_input_width};
use crate::dataset::label_frame::{KEYPOINT_VALUES, LabelFrame};
use crate::hand::{HandModel, Side, Topology};

/// Returns the values of a column for a label.
type Values = dyn Fn(&LabelFrame) -> Vec<f32>;

/// A new column.
pub struct Column {
    /// Name.
    pub name: String,
    /// Names of the elements, if they have some.
    pub names: Option<Vec<String>>,
    /// Number of first elements that are those of the data set's column of this name.
    pub base: usize,
    /// Number of elements.
    pub width: usize,
    /// Returns the values of the elements behind the first `base` for a label.
    pub value: Box<Values>,
}

impl LeRobotDataset {
    /// Returns the new columns: those that were chosen, each for itself or as an input of policies, and of images that are
    /// `judged` the certainty of the network, and the `keypoints` of the hands.
    pub(super) fn columns(&self, topology: Topology, judged: bool, keypoints: bool) -> Vec<Column> {
        // The regions of MANO's vertices are known with MANO's files alone.
        let regions = match topology {
            Topology::EgotacHand1 => Some(Side::BOTH.map(|side| HandModel::builtin(side).regions())),
            Topology::Mano => self.mano_regions.clone(),
        };
        let known = |column: &LabelColumn| *column != LabelColumn::RegionForce || regions.is_some();
        let regions = Arc::new(regions.clone().unwrap_or_default());
        let inert = match self.input {
            Some(_) => LabelColumn::DEFAULT.to_vec(),
            None => self.chosen.clone(),
        };
        let mut columns: Vec<Column> = inert
            .into_iter()
            .filter(known)
            .map(|column| {
                let regions = Arc::clone(&regions);
                let name = format!("{}.{}", self.prefix, column.name());
                let value = Box::new(move |label: &LabelFrame| column.of_label(label, &regions));
                Column { name, names: column.names(), base: 0, width: column.width(), value }
            })
            .collect();
        if judged {
            columns.push(Column {
                name: format!("{}.certainty", self.prefix),
                names: Some(CERTAINTY.map(String::from).to_vec()),
                base: 0,
                width: CERTAINTY.len(),
                value: Box::new(certainty),
            });
        }
        if keypoints {
            columns.push(Column {
                name: format!("{}.predicted_keypoints", self.prefix),
                names: None,
                base: 0,
                width: KEYPOINT_VALUES,
                value: Box::new(LabelFrame::keypoints),
            });
        }
        if let Some(PolicyInput { name, base, names }) = &self.input {
            let chosen = self.chosen.clone();
            columns.push(Column {
                name: (*name).to_string(),
                names: Some(names.iter().cloned().chain(policy_input_names(&chosen)).collect()),
                base: *base,
                width: base + policy_input_width(&chosen),
                value: Box::new(move |label| {
                    let touch = label.touch.as_ref().ok().map(|field| (field, &label.certainty));
                    policy_input(&chosen, touch, &regions)
                }),
            });
        }
        columns
    }
}

/// Elements of the column of certainty: estimates, and 1 where touch of a hand is known.
const CERTAINTY: [&str; 5] = ["familiarity", "left_presence", "right_presence", "left_known", "right_known"];

fn certainty(label: &LabelFrame) -> Vec<f32> {
    let known = Side::BOTH.map(|side| f32::from(u8::from(label.touch.is_ok() && label.certainty.counts(side))));
    label.estimates().into_iter().chain(known).collect()
}

/// Adds the new columns to the Hugging Face types of a table. The entry copies that of another list, since the type's name
/// differs between versions; None if there is no other list.
pub fn with_types(text: &str, columns: &[Column]) -> Option<String> {
    let mut types: Value = serde_json::from_str(text).ok()?;
    // Not by `[..]`, which panics where a value that is to be changed is not an object.
    let features = types.pointer_mut("/info/features")?.as_object_mut()?;
    let is_list = |feature: &&Value| feature["length"].is_i64() && feature["feature"]["_type"] == "Value";
    let mut list = features.values().find(is_list)?.clone();
    *list.pointer_mut("/feature/dtype")? = "float32".into();
    for column in columns {
        features.remove(&column.name);
        *list.pointer_mut("/length")? = column.width.into();
        features.insert(column.name.clone(), list.clone());
    }
    Some(types.to_string())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn types_of_another_form_are_dropped() {
        let column = Column { name: "a".into(), names: None, base: 0, width: 2, value: Box::new(|_| vec![]) };
        let list = r#"{"length": 3, "feature": {"_type": "Value", "dtype": "int8"}, "_type": "List"}"#;
        let types = format!(r#"{{"info": {{"features": {{"b": {list}}}}}}}"#);
        let added = with_types(&types, std::slice::from_ref(&column)).unwrap();
        let added: Value = serde_json::from_str(&added).unwrap();
        let wanted =
            serde_json::json!({ "length": 2, "feature": { "_type": "Value", "dtype": "float32" }, "_type": "List" });
        assert_eq!(added["info"]["features"]["a"], wanted);
        for text in ["[]", "\"text\"", "3", "{}", r#"{"info": []}"#, r#"{"info": {"features": "x"}}"#, "no JSON"] {
            assert_eq!(with_types(text, std::slice::from_ref(&column)), None, "{text}");
        }
    }
}
