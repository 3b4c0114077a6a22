//! Where the report of a measurement goes.

use std::path::{Path, PathBuf};

use egotac::cli::options::Json;
use serde::Serialize;

/// Options `--json` and `--out`.
#[derive(Debug, clap::Args)]
pub struct Output {
    #[command(flatten)]
    json: Json,
    /// Folder for the report as Markdown and JSON, and for its plots; without it, the report is only printed.
    #[arg(long, value_name = "FOLDER")]
    out: Option<PathBuf>,
}

impl Output {
    /// Returns the folder for files.
    pub fn folder(&self) -> Option<&Path> {
        self.out.as_deref()
    }

    /// Returns the end of the command that measures the same again: the folder, or nothing.
    pub fn words(&self) -> String {
        self.folder().map(|folder| format!(" --out {}", folder.display())).unwrap_or_default()
    }

    /// Writes NAME.md and NAME.json into the folder, if there is one, and prints the report as `--json` says.
    pub fn write(&self, name: &str, report: &impl Serialize, markdown: &str) -> anyhow::Result<()> {
        if let Some(folder) = self.folder() {
            write_report(folder, name, report, markdown)?;
        }
        self.print(report, || markdown.to_owned())
    }

    /// Prints `value` as `--json` says, or the text.
    pub fn print(&self, value: &impl Serialize, text: impl FnOnce() -> String) -> anyhow::Result<()> {
        Ok(self.json.show(&serde_json::to_value(value)?, text)?)
    }
}

/// Writes a report as NAME.md and NAME.json into a folder.
pub fn write_report(folder: &Path, name: &str, report: &impl Serialize, markdown: &str) -> anyhow::Result<()> {
    let json = format!("{:#}\n", serde_json::to_value(report)?);
    egotac::file::write(&folder.join(format!("{name}.md")), markdown.as_bytes())?;
    Ok(egotac::file::write(&folder.join(format!("{name}.json")), json.as_bytes())?)
}
