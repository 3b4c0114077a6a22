//! Columns of a LeRobot data set that hold labels.

use serde_json::Value;

use super::images::LeRobotDataset;
use crate::dataset::label_frame::LabelFrame;
use crate::hand::{HandModel, Region, Side, Topology};
use crate::tactile::N_FIELD;

/// Returns the values of a column for a label.
type Values = dyn Fn(&LabelFrame) -> Vec<f32>;

/// A new column.
pub struct Column {
    /// Name.
    pub name: String,
    /// Names of the elements, if they have some.
    pub names: Option<Vec<String>>,
    /// Number of elements.
    pub width: usize,
    /// Returns the values of the elements for a label.
    pub value: Box<Values>,
}

impl LeRobotDataset {
    /// Returns the new columns: force and contact of each vertex, the force of each region if the regions are known, and of
    /// images that are `judged` the certainty of the network.
    pub fn columns(&self, topology: Topology, judged: bool) -> Vec<Column> {
        let field = |name: &str, value: fn(&crate::TactileField) -> &Vec<f32>| Column {
            name: format!("{}.{name}", self.prefix),
            names: None,
            width: N_FIELD,
            value: Box::new(move |label| match &label.touch {
                Ok(field) => value(field).clone(),
                Err(_) => vec![f32::NAN; N_FIELD],
            }),
        };
        let mut columns = vec![field("force", |field| &field.force), field("contact", |field| &field.contact)];
        // The regions of MANO's vertices are known with MANO's files alone.
        let regions = match topology {
            Topology::EgotacHand1 => Some(Side::BOTH.map(|side| HandModel::builtin(side).regions())),
            Topology::Mano => self.mano_regions.clone(),
        };
        if let Some(regions) = regions {
            columns.push(Column {
                name: format!("{}.region_force", self.prefix),
                names: Some(Region::names_of_both_hands()),
                width: 2 * Region::ALL.len(),
                value: Box::new(region_force(regions)),
            });
        }
        if judged {
            columns.push(Column {
                name: format!("{}.certainty", self.prefix),
                names: Some(CERTAINTY.map(String::from).to_vec()),
                width: CERTAINTY.len(),
                value: Box::new(certainty),
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
    // Not by `[..]`, which panics where a value that is to be changed is no object.
    let features = types.pointer_mut("/info/features")?.as_object_mut()?;
    let is_list = |feature: &&Value| feature["length"].is_i64() && feature["feature"]["_type"] == "Value";
    let mut list = features.values().find(is_list)?.clone();
    *list.pointer_mut("/feature/dtype")? = "float32".into();
    for column in columns {
        *list.pointer_mut("/length")? = column.width.into();
        features.insert(column.name.clone(), list.clone());
    }
    Some(types.to_string())
}

/// Sums the forces of each region, left hand first; NaN if one of them is unknown.
fn region_force(regions: [Vec<Region>; 2]) -> impl Fn(&LabelFrame) -> Vec<f32> {
    move |label| match &label.touch {
        Ok(field) => field.region_forces(&regions),
        Err(_) => vec![f32::NAN; 2 * Region::ALL.len()],
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn types_of_another_form_are_dropped() {
        let column = Column { name: "a".into(), names: None, width: 2, value: Box::new(|_| vec![]) };
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
