//! Labels as an input of policies, and the choice of columns.

use crate::dataset::label_frame::LabelFrame;
use crate::error::{Error, Result};
use crate::hand::{N_VERTICES, Region, Side};
use crate::tactile::{Certainty, N_FIELD, TactileField};

/// Names of the elements behind the labels in an input of policies: 1 where touch of a hand is known.
pub(super) const KNOWN: [&str; 2] = ["left_known", "right_known"];

/// Labels of a frame that a column can hold, left hand first.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
#[value(rename_all = "snake_case")]
pub enum LabelColumn {
    /// Force on each of the 17 regions of both hands, (34) N.
    RegionForce,
    /// Force on each vertex, (1556) N.
    Force,
    /// Contact probability of each vertex, (1556).
    Contact,
    /// Total force on each hand, (2) N.
    Total,
}

/// Role of the columns for policies.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, clap::ValueEnum)]
#[value(rename_all = "snake_case")]
pub enum ColumnRole {
    /// Policies ignore them: their names begin with neither `observation` nor `action`.
    #[default]
    Inert,
    /// They are appended to `observation.state`, which every policy takes.
    State,
    /// They are `observation.environment_state`, which some policies take beside the state, among them ACT and diffusion.
    EnvironmentState,
}

impl ColumnRole {
    /// Returns the feature that holds an input of policies; None if the columns are inert.
    pub fn feature(self) -> Option<&'static str> {
        match self {
            Self::Inert => None,
            Self::State => Some("observation.state"),
            Self::EnvironmentState => Some("observation.environment_state"),
        }
    }
}

impl LabelColumn {
    /// Columns that are written where none are named.
    pub const DEFAULT: [Self; 3] = [Self::Force, Self::Contact, Self::RegionForce];

    /// Parses a name.
    ///
    /// # Errors
    /// If it is unknown; the error lists the valid ones.
    pub fn from_name(name: &str) -> Result<Self> {
        let all = [Self::RegionForce, Self::Force, Self::Contact, Self::Total];
        let found = all.into_iter().find(|column| column.name() == name);
        found.ok_or_else(|| Error::unknown("column", name, all.map(Self::name)))
    }

    /// Returns the name behind the prefix.
    pub fn name(self) -> &'static str {
        match self {
            Self::RegionForce => "region_force",
            Self::Force => "force",
            Self::Contact => "contact",
            Self::Total => "total",
        }
    }

    /// Returns the number of elements.
    pub fn width(self) -> usize {
        match self {
            Self::RegionForce => 2 * Region::ALL.len(),
            Self::Force | Self::Contact => N_FIELD,
            Self::Total => 2,
        }
    }

    /// Returns the names of the elements; None of vertices.
    pub(super) fn names(self) -> Option<Vec<String>> {
        match self {
            Self::RegionForce => Some(Region::names_of_both_hands()),
            Self::Force | Self::Contact => None,
            Self::Total => Some(Side::BOTH.map(|side| side.name().to_string()).to_vec()),
        }
    }

    /// Returns the values of a field. `regions` are those of its vertices, left hand first.
    pub fn values(self, field: &TactileField, regions: &[Vec<Region>; 2]) -> Vec<f32> {
        match self {
            Self::RegionForce => field.region_forces(regions),
            Self::Force => field.force.clone(),
            Self::Contact => field.contact.clone(),
            Self::Total => Side::BOTH.map(|side| field.total_force(side)).to_vec(),
        }
    }

    /// Returns the values of a label; NaN without a label.
    pub(super) fn of_label(self, label: &LabelFrame, regions: &[Vec<Region>; 2]) -> Vec<f32> {
        match &label.touch {
            Ok(field) => self.values(field, regions),
            Err(_) => vec![f32::NAN; self.width()],
        }
    }
}

/// Number of elements of an input of policies.
pub fn policy_input_width(columns: &[LabelColumn]) -> usize {
    columns.iter().map(|column| column.width()).sum::<usize>() + KNOWN.len()
}

/// Returns an input of policies: the columns one behind the other, then whether touch of the left and of the right hand is
/// known, 1 or 0. Policies can't take NaN: what is unknown is 0, and its hand is not known.
pub fn policy_input(
    columns: &[LabelColumn],
    touch: Option<(&TactileField, &Certainty)>,
    regions: &[Vec<Region>; 2],
) -> Vec<f32> {
    let Some((field, certainty)) = touch else { return vec![0.0; policy_input_width(columns)] };
    let mut input = Vec::with_capacity(policy_input_width(columns));
    let mut known = Side::BOTH.map(|side| certainty.counts(side));
    for column in columns {
        let values = column.values(field, regions);
        for (half, known) in values.chunks(values.len() / 2).zip(&mut known) {
            *known &= half.iter().all(|value| !value.is_nan());
        }
        input.extend(values.into_iter().map(|value| if value.is_nan() { 0.0 } else { value }));
    }
    input.extend(known.map(|known| f32::from(u8::from(known))));
    input
}

/// Returns the names of the elements of an input of policies.
pub fn policy_input_names(columns: &[LabelColumn]) -> Vec<String> {
    let of_vertices = |column: LabelColumn| {
        let vertex = move |index: usize| {
            let side = Side::BOTH[index / N_VERTICES].name();
            format!("{side}_{}_{}", column.name(), index % N_VERTICES)
        };
        (0..N_FIELD).map(vertex).collect()
    };
    let prefixed = |column: LabelColumn| match column.names() {
        Some(names) => names.into_iter().map(|name| format!("{name}_{}", column.name())).collect(),
        None => of_vertices(column),
    };
    columns
        .iter()
        .flat_map(|column: &LabelColumn| -> Vec<String> { prefixed(*column) })
        .chain(KNOWN.map(String::from))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::hand::{HandModel, Topology};
    use crate::tactile::Doubt;

    #[test]
    fn unknown_values_are_zero_and_their_hand_is_not_known() {
        let regions = Side::BOTH.map(|side| HandModel::builtin(side).regions());
        let columns = [LabelColumn::Total, LabelColumn::RegionForce];
        let mut field = TactileField::zeros(Topology::EgotacHand1);
        field.force[3] = 2.0;
        field.force[N_VERTICES + 5] = 0.5;
        let known = policy_input(&columns, Some((&field, &Certainty::default())), &regions);
        assert_eq!(known.len(), policy_input_width(&columns));
        assert_eq!((&known[..2], &known[36..]), (&[2.0, 0.5][..], &[1.0, 1.0][..]));
        assert_eq!(known[2..36].iter().sum::<f32>(), 2.5);

        let absent = Certainty { doubt: [Some(Doubt::Absent), None], masked: true, ..Certainty::default() };
        field.force[..N_VERTICES].fill(f32::NAN);
        let half = policy_input(&columns, Some((&field, &absent)), &regions);
        assert_eq!((&half[..2], &half[36..]), (&[0.0, 0.5][..], &[0.0, 1.0][..]));
        // A field whose force alone is unknown is not known either.
        let half = policy_input(&columns, Some((&field, &Certainty::default())), &regions);
        assert_eq!(half[36..], [0.0, 1.0]);
        assert!(policy_input(&columns, None, &regions).iter().all(|value| *value == 0.0));
        assert_eq!(policy_input_names(&columns).len(), 38);
    }
}
