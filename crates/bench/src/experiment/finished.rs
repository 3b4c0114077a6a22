//! Conditions of an experiment that are finished: they are not measured again.

use std::path::PathBuf;

use egotac::error::{Error, Result};
use egotac::file::{self, input, limits};

use super::Setup;
use super::recipe::Recipe;
use super::report::ArmReport;

/// Folder of finished conditions, named by the network and the data.
#[derive(Debug)]
pub struct Finished {
    folder: PathBuf,
}

impl Finished {
    /// Names the folder for an experiment on some stores.
    pub fn new(setup: &Setup, experiment: &str, recipes: &[Recipe]) -> Self {
        let names: Vec<String> = recipes.iter().map(|recipe| recipe.path.display().to_string()).collect();
        let text = format!("{experiment} {} {}", setup.network.sha256, names.join(" "));
        Self { folder: setup.work.join("measured").join(&file::sha256(text.as_bytes())[..12]) }
    }

    /// Returns the result of a condition: the one that was saved, or that of `measure`, which is then saved.
    ///
    /// # Errors
    /// If `measure` fails, or the result can't be saved.
    pub fn or_measure(&self, name: &str, measure: impl FnOnce() -> Result<ArmReport>) -> Result<ArmReport> {
        let path = self.folder.join(format!("{name}.json"));
        if path.exists() {
            let text = input::read_text(&path, limits::TEXT)?;
            return serde_json::from_str(&text).map_err(|e| Error::file(&path, e));
        }
        let report = measure()?;
        let text = serde_json::to_string(&report).map_err(|e| Error::file(&path, e))?;
        std::fs::create_dir_all(&self.folder).map_err(Error::io(&self.folder))?;
        file::write(&path, text.as_bytes())?;
        Ok(report)
    }
}
