//! The shipped table of costs and errors: the part of `docs/bench/sim.json` that a choice needs.

use std::path::Path;

use serde::Deserialize;

use crate::error::{Error, Result};
use crate::file;
use crate::machine::Machine;
use crate::mujoco::Preset;

/// Path in the repository, and text of the table that `egotac bench sim` wrote.
const SHIPPED: (&str, &str) = ("docs/bench/sim.json", include_str!("../../../docs/bench/sim.json"));
/// Name of the rows that hold presets.
const PRESET_ROWS: &str = "preset";

/// Costs and errors of the presets, scene by scene, measured on one machine.
#[derive(Debug, Clone, PartialEq, Deserialize)]
pub struct Table {
    /// The machine that the times were measured on.
    pub machine: Machine,
    /// Seed of the timed episodes.
    pub seed: u64,
    /// The measured scenes.
    pub scenes: Vec<MeasuredScene>,
    /// Settings, with the presets among them.
    pub rows: Vec<Row>,
    /// SHA-256 of the text that the table was read from.
    #[serde(skip)]
    pub sha256: String,
}

/// A scene of the table.
#[derive(Debug, Clone, PartialEq, Deserialize)]
pub struct MeasuredScene {
    /// Name.
    pub name: String,
}

/// One setting in all scenes.
#[derive(Debug, Clone, PartialEq, Deserialize)]
pub struct Row {
    /// Kind of setting.
    pub knob: String,
    /// Name of the setting; for presets the name of the preset.
    pub setting: String,
    /// One entry per scene.
    pub entries: Vec<Entry>,
}

/// One setting in one scene.
#[derive(Debug, Clone, PartialEq, Deserialize)]
pub struct Entry {
    /// Name of the scene.
    pub scene: String,
    /// Errors against the reference model.
    pub model: ModelErrors,
    /// Computation per simulated second on the table's machine, without labels and pictures, ms.
    pub ms_per_second: Option<f64>,
}

/// Errors against the reference model.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
pub struct ModelErrors {
    /// Relative error of quasi-static forces; `None` if no hand presses in the scene.
    pub force: Option<f64>,
}

impl Table {
    /// Reads the shipped table.
    ///
    /// # Errors
    /// If the program was built with a broken one.
    pub fn shipped() -> Result<Self> {
        Self::parse(Path::new(SHIPPED.0), SHIPPED.1)
    }

    /// Reads a table from the text of a `sim.json`; `path` is for the error message.
    ///
    /// # Errors
    /// If the text is not a table.
    pub fn parse(path: &Path, text: &str) -> Result<Self> {
        let table: Self = serde_json::from_str(text).map_err(|error| Error::file(path, error))?;
        Ok(Self { sha256: file::sha256(text.as_bytes()), ..table })
    }

    /// Returns the entries of a preset, one per scene.
    pub fn entries(&self, preset: Preset) -> &[Entry] {
        let row = self.rows.iter().find(|row| row.knob == PRESET_ROWS && row.setting == preset.name());
        row.map_or(&[], |row| &row.entries)
    }

    /// Returns the entry of a preset in a scene.
    pub fn entry(&self, preset: Preset, scene: &str) -> Option<&Entry> {
        self.entries(preset).iter().find(|entry| entry.scene == scene)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_shipped_table_has_every_preset_in_every_scene() {
        let table = Table::shipped().unwrap();
        for preset in Preset::ALL {
            assert_eq!(table.entries(preset).len(), table.scenes.len(), "{}", preset.name());
        }
        assert_eq!(table.sha256.len(), 64);
    }

    #[test]
    fn a_text_that_is_no_table_is_refused_with_its_path() {
        assert!(Table::parse(Path::new("my.json"), "{}").unwrap_err().to_string().contains("my.json"));
    }
}
