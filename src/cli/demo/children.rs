//! Child processes of the demo, whose output goes to log files.

use std::fs::File;
use std::path::{Path, PathBuf};
use std::process::{ExitStatus, Stdio};
use std::time::Duration;

use anyhow::{Context, Result, bail};
use nix::sys::signal::{Signal, kill};
use nix::unistd::Pid;
use tokio::process::{Child, Command};
use tokio::time::timeout;

/// A running node, which is killed on drop.
#[derive(Debug)]
pub struct NodeProcess {
    name: &'static str,
    log: PathBuf,
    child: Child,
}

impl NodeProcess {
    /// Starts `egotac_<name>` from the directory of this program; its output goes to `<logs>/<name>.log`.
    ///
    /// # Errors
    /// If the binary is missing or can't be started.
    pub fn start(name: &'static str, arguments: &[String], logs: &Path) -> Result<Self> {
        let this = std::env::current_exe().context("own path")?;
        let binary = this.with_file_name(format!("egotac_{name}"));
        if !binary.is_file() {
            bail!(
                "{} is missing: build it with `cargo build --release --features ros,sim`, or run `make demo`",
                binary.display()
            );
        }
        let log = logs.join(format!("{name}.log"));
        let output = File::create(&log).with_context(|| log.display().to_string())?;
        let child = Command::new(&binary)
            .args(arguments)
            .stdin(Stdio::null())
            .stdout(output.try_clone()?)
            .stderr(output)
            .kill_on_drop(true)
            .spawn()
            .with_context(|| binary.display().to_string())?;
        Ok(Self { name, log, child })
    }

    /// Waits for the end of the process.
    ///
    /// # Errors
    /// If it fails; the error holds the end of its log.
    pub async fn ended(&mut self) -> Result<()> {
        let status = self.child.wait().await.with_context(|| self.name)?;
        if status.success() { Ok(()) } else { Err(self.failure(status)) }
    }

    /// Sends SIGINT to the process and waits for its end.
    ///
    /// # Errors
    /// If it fails, or does not end within `limit`.
    pub async fn stop(mut self, limit: Duration) -> Result<()> {
        // The id is absent after the process was waited for.
        if let Some(id) = self.child.id() {
            kill(Pid::from_raw(i32::try_from(id)?), Signal::SIGINT)?;
        }
        match timeout(limit, self.ended()).await {
            Ok(result) => result,
            Err(_) => bail!("{} did not stop within {limit:?}; its log: {}", self.name, self.log.display()),
        }
    }

    fn failure(&self, status: ExitStatus) -> anyhow::Error {
        let log = std::fs::read_to_string(&self.log).unwrap_or_default();
        let lines: Vec<&str> = log.lines().collect();
        let tail = lines[lines.len().saturating_sub(8)..].join("\n  ");
        anyhow::anyhow!("{} ended with {status}; the end of {}:\n  {tail}", self.name, self.log.display())
    }
}
