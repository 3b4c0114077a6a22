//! Hard cases: inputs that go wrong silently without guards, the guard that reports each, and its remedy.
//!
//! Each case runs as the user wrote it, under the guards, and with the remedy. The tests and
//! `docs/hard-cases.md` use the same registry.

mod entrances;
mod hand;
mod label;
mod motion;
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

/// Subject of a case.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Family {
    /// Contacts: masses, depths, speeds, sizes.
    Contact,
    /// Stiffness, damping and integration in relation to the timestep.
    Stability,
    /// Meshes and inertias.
    Mesh,
    /// Servos and constraints.
    Actuation,
    /// Long holds.
    Hold,
    /// States and memory.
    State,
    /// Inputs that would end the process.
    Process,
    /// Scene files with extreme values.
    Scene,
    /// Rotations.
    Rotation,
    /// The hand model.
    Hand,
    /// Labels on vertices.
    Label,
    /// Forces from motion.
    Motion,
    /// NaN and infinity at public functions.
    Entrance,
    /// The network and its stream of images.
    Network,
    /// Inputs and steps of training.
    Training,
    /// Retargeting of hands to robots.
    Retargeting,
}

impl Family {
    /// Returns a case of this family.
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

/// A hard case.
#[derive(Debug, Clone, Copy)]
pub struct HardCase {
    /// Subject.
    pub family: Family,
    /// Unique name.
    pub name: &'static str,
    /// Actions of the user, in words.
    pub recipe: &'static str,
    /// Remedy, in words.
    pub remedy: &'static str,
    /// Runs the case.
    pub run: fn() -> Result<Outcome>,
}

/// Results of the runs of a case.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Outcome {
    /// Measured quantity with its unit; 0 is exact.
    pub error_of: &'static str,
    /// Largest error that counts as right.
    pub tolerance: f64,
    /// Error as the user wrote it; `None` if it was refused and not run, because it would end the process or take all memory.
    #[serde(serialize_with = "optional_or_word")]
    pub unguarded: Option<f64>,
    /// Report of the guards; empty if there is none.
    pub guard: String,
    /// Error with the remedy.
    #[serde(serialize_with = "finite_or_word")]
    pub remedied: f64,
    /// Report of the guards about the remedy; empty if there is none.
    pub remedied_guard: String,
}

impl Outcome {
    /// Returns the outcome of calls that must be refused, as [`accepted`] counts them, and of one that must not.
    fn of_refusals<T>(error_of: &'static str, (through, refusal): (f64, String), good: Result<T>) -> Self {
        Self {
            error_of,
            tolerance: 0.0,
            unguarded: Some(through),
            // A call that was accepted must not hide behind the refusal of another.
            guard: if through > 0.0 { String::new() } else { refusal },
            remedied: 0.0,
            remedied_guard: good.err().map(|error| error.to_string()).unwrap_or_default(),
        }
    }

    /// Checks that nothing failed silently: as written the case is right or flagged; with the remedy it is right and not
    /// flagged.
    ///
    /// # Errors
    /// If it failed silently; the text says how.
    pub fn verdict(&self) -> std::result::Result<(), String> {
        let right = |error: f64| error.abs() <= self.tolerance;
        let (error_of, tolerance) = (self.error_of, self.tolerance);
        let silent = self.guard.is_empty();
        match self.unguarded {
            Some(error) if !right(error) && silent => {
                return Err(format!("{error_of} is {error:.3e}, allowed {tolerance:.3e}, and no guard says so"));
            }
            None if silent => return Err("it was not run, and no guard says why".into()),
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

/// A case with its results.
#[derive(Debug, Clone, Serialize)]
pub struct Row {
    /// Subject.
    pub family: Family,
    /// Name.
    pub name: &'static str,
    /// Actions of the user, in words.
    pub recipe: &'static str,
    /// Remedy, in words.
    pub remedy: &'static str,
    /// Results.
    #[serde(flatten)]
    pub outcome: Outcome,
}

/// Returns all cases, family by family.
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
    for family in
        [rotation::CASES, hand::CASES, label::CASES, motion::CASES, entrances::CASES, network::CASES, trainer::CASES]
    {
        cases.extend_from_slice(family);
    }
    #[cfg(feature = "sim")]
    cases.extend_from_slice(retarget::CASES);
    cases
}

/// Runs a case.
///
/// # Errors
/// If one of its runs could not be made.
pub fn run(case: &HardCase) -> Result<Row> {
    let HardCase { family, name, recipe, remedy, run } = *case;
    let mut outcome = run()?;
    for report in [&mut outcome.guard, &mut outcome.remedied_guard] {
        *report = without_temporary_folders(report);
    }
    Ok(Row { family, name, recipe, remedy, outcome })
}

/// Strips temporary paths, which vary per run.
fn without_temporary_folders(text: &str) -> String {
    let start = format!("{}/.tmp", std::env::temp_dir().display());
    let mut pieces = text.split(start.as_str());
    let mut kept = pieces.next().unwrap_or_default().to_owned();
    for piece in pieces {
        kept += piece.split_once('/').map_or("", |(_, rest)| rest);
    }
    kept
}

/// Writes a number, or "lost" for infinity and NaN, which JSON does not have.
fn finite_or_word<S: Serializer>(value: &f64, serializer: S) -> std::result::Result<S::Ok, S::Error> {
    match value.is_finite() {
        true => serializer.serialize_f64(*value),
        false => serializer.serialize_str("lost"),
    }
}

/// As [`finite_or_word`], and `null` if there was no run.
fn optional_or_word<S: Serializer>(value: &Option<f64>, serializer: S) -> std::result::Result<S::Ok, S::Error> {
    match value {
        Some(value) => finite_or_word(value, serializer),
        None => serializer.serialize_none(),
    }
}

/// Counts the calls that succeeded although they must be refused; returns the count and the first error.
fn accepted<T>(calls: impl IntoIterator<Item = Result<T>>) -> (f64, String) {
    let (mut through, mut first) = (0, String::new());
    for call in calls {
        match call {
            Ok(_) => through += 1,
            Err(error) if first.is_empty() => first = error.to_string(),
            Err(_) => {}
        }
    }
    (f64::from(through), first)
}

#[cfg(test)]
mod tests {
    #[test]
    fn temporary_folders_are_stripped_from_reports() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().display();
        assert_eq!(
            super::without_temporary_folders(&format!("{path}/a.obj: no, {path}/b/c.obj")),
            "a.obj: no, b/c.obj"
        );
        assert_eq!(super::without_temporary_folders("nothing"), "nothing");
    }
}
