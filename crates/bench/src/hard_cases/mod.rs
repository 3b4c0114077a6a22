//! Hard cases: what a user does, what goes wrong when nobody looks, which guard says so, and what helps.
//!
//! Each case runs three times over: as the user wrote it, watched by the guards, and with the remedy. The tests and
//! `docs/hard-cases.md` use the same registry, so a case is defined once.

mod entrances;
mod hand;
mod label;
mod network;
pub mod report;
mod rotation;
mod trainer;

#[cfg(feature = "sim")]
mod actuation;
#[cfg(feature = "sim")]
mod contact;
#[cfg(feature = "sim")]
mod hold;
#[cfg(feature = "sim")]
mod mesh;
#[cfg(feature = "sim")]
mod process;
#[cfg(feature = "sim")]
mod retarget;
#[cfg(feature = "sim")]
mod scene;
#[cfg(feature = "sim")]
mod stability;
#[cfg(feature = "sim")]
mod state;
#[cfg(feature = "sim")]
mod watch;

use serde::{Serialize, Serializer};

use egotac::error::Result;

/// What a case is about.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Family {
    /// Bodies that touch: masses, depths, speeds, sizes.
    Contact,
    /// Stiffness, damping and integration against the timestep.
    Stability,
    /// Meshes and inertias.
    Mesh,
    /// Servos and constraints.
    Actuation,
    /// Holding for long.
    Hold,
    /// States and memory.
    State,
    /// What would end the process.
    Process,
    /// Scene files with extreme values.
    Scene,
    /// Rotations.
    Rotation,
    /// The hand model.
    Hand,
    /// Labels on vertices.
    Label,
    /// NaN and infinities at public entrances.
    Entrance,
    /// The network and its stream of images.
    Network,
    /// What enters training, and its steps.
    Training,
    /// Hands that robots follow.
    Retargeting,
}

impl Family {
    /// A case of this family.
    const fn case(
        self,
        name: &'static str,
        recipe: &'static str,
        remedy: &'static str,
        run: fn() -> Result<Outcome>,
    ) -> HardCase {
        HardCase { family: self, name, recipe, remedy, run }
    }
}

/// A recipe with its three runs.
#[derive(Debug, Clone, Copy)]
pub struct HardCase {
    /// What it is about.
    pub family: Family,
    /// Its name, unique.
    pub name: &'static str,
    /// What a user does.
    pub recipe: &'static str,
    /// What helps.
    pub remedy: &'static str,
    /// Runs it.
    pub run: fn() -> Result<Outcome>,
}

/// What the three runs gave.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Outcome {
    /// What is measured, with its unit; 0 would be exact.
    pub error_of: &'static str,
    /// The error that is borne.
    pub tolerance: f64,
    /// Error as the user wrote it; `None` = it was refused, and not run: the process or the machine's memory is at stake.
    #[serde(serialize_with = "optional_or_word")]
    pub unguarded: Option<f64>,
    /// What the guards say about it; empty = nothing.
    pub guard: String,
    /// Error with the remedy.
    #[serde(serialize_with = "finite_or_word")]
    pub remedied: f64,
    /// What the guards say about the remedy; empty = nothing.
    pub remedied_guard: String,
}

impl Outcome {
    /// Whether nothing failed silently: right or flagged as written, right and not flagged with the remedy.
    ///
    /// # Errors
    /// What is not so, in words.
    pub fn verdict(&self) -> std::result::Result<(), String> {
        let right = |error: f64| error.abs() <= self.tolerance;
        let (error_of, tolerance) = (self.error_of, self.tolerance);
        let silent = self.guard.is_empty();
        match self.unguarded {
            Some(error) if !right(error) && silent => {
                return Err(format!("{error_of} is {error:.3e}, allowed {tolerance:.3e}, and no guard says so"));
            }
            None if silent => return Err("it was not run, and nothing says why".into()),
            _ => {}
        }
        if !right(self.remedied) {
            return Err(format!("{error_of} is {:.3e} with the remedy, allowed {tolerance:.3e}", self.remedied));
        }
        if !self.remedied_guard.is_empty() {
            return Err(format!("a guard says of the remedy: {}", self.remedied_guard));
        }
        Ok(())
    }
}

/// A case with what it gave.
#[derive(Debug, Clone, Serialize)]
pub struct Row {
    /// What it is about.
    pub family: Family,
    /// Its name.
    pub name: &'static str,
    /// What a user does.
    pub recipe: &'static str,
    /// What helps.
    pub remedy: &'static str,
    /// What it gave.
    #[serde(flatten)]
    pub outcome: Outcome,
}

/// All cases, family by family.
pub fn registry() -> Vec<HardCase> {
    let mut cases = Vec::new();
    #[cfg(feature = "sim")]
    for family in [
        contact::CASES,
        stability::CASES,
        mesh::CASES,
        actuation::CASES,
        hold::CASES,
        state::CASES,
        process::CASES,
        scene::CASES,
    ] {
        cases.extend_from_slice(family);
    }
    for family in [rotation::CASES, hand::CASES, label::CASES, entrances::CASES, network::CASES, trainer::CASES] {
        cases.extend_from_slice(family);
    }
    #[cfg(feature = "sim")]
    cases.extend_from_slice(retarget::CASES);
    cases
}

/// Runs a case.
///
/// # Errors
/// If one of its runs could not be made at all.
pub fn run(case: &HardCase) -> Result<Row> {
    let HardCase { family, name, recipe, remedy, run } = *case;
    let mut outcome = run()?;
    for said in [&mut outcome.guard, &mut outcome.remedied_guard] {
        *said = without_temporary_folders(said);
    }
    Ok(Row { family, name, recipe, remedy, outcome })
}

/// Their names differ from run to run, and say nothing.
fn without_temporary_folders(text: &str) -> String {
    let start = format!("{}/.tmp", std::env::temp_dir().display());
    let mut pieces = text.split(start.as_str());
    let mut kept = pieces.next().unwrap_or_default().to_owned();
    for piece in pieces {
        kept += piece.split_once('/').map_or("", |(_, rest)| rest);
    }
    kept
}

/// JSON has no infinity and no NaN.
fn finite_or_word<S: Serializer>(value: &f64, serializer: S) -> std::result::Result<S::Ok, S::Error> {
    match value.is_finite() {
        true => serializer.serialize_f64(*value),
        false => serializer.serialize_str("lost"),
    }
}

/// `null` where there was no run.
fn optional_or_word<S: Serializer>(value: &Option<f64>, serializer: S) -> std::result::Result<S::Ok, S::Error> {
    match value {
        Some(value) => finite_or_word(value, serializer),
        None => serializer.serialize_none(),
    }
}

/// Errors of calls that must be refused: how many of them went through, and what the first said.
fn accepted<T>(calls: impl IntoIterator<Item = Result<T>>) -> (f64, String) {
    let (mut through, mut said) = (0, String::new());
    for call in calls {
        match call {
            Ok(_) => through += 1,
            Err(error) if said.is_empty() => said = error.to_string(),
            Err(_) => {}
        }
    }
    (f64::from(through), said)
}

#[cfg(test)]
mod tests {
    #[test]
    fn temporary_folders_are_left_out_of_what_is_said() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().display();
        assert_eq!(
            super::without_temporary_folders(&format!("{path}/a.obj: no, {path}/b/c.obj")),
            "a.obj: no, b/c.obj"
        );
        assert_eq!(super::without_temporary_folders("nothing"), "nothing");
    }
}
