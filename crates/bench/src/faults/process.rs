//! A program under test, as a process.

use std::fs;
use std::os::unix::process::ExitStatusExt;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus, Stdio};
use std::time::{Duration, Instant};

use egotac::error::{Error, Result};

/// Environment variable that marks processes of one case, also those that the program starts.
const MARK: &str = "EGOTAC_FAULTS_CASE";
/// Time that processes get to end after the one that started them.
const GRACE: Duration = Duration::from_secs(5);
const POLL: Duration = Duration::from_millis(2);

/// How a process ended.
#[derive(Debug, Clone)]
pub struct Ended {
    /// Exit status; None = by a signal.
    pub code: Option<i32>,
    /// Signal that ended it.
    pub signal: Option<i32>,
    /// True if it was killed because it did not end.
    pub hangs: bool,
    /// Wall time, s.
    pub secs: f64,
    /// Its standard error output.
    pub told: String,
}

/// A running process.
#[derive(Debug)]
pub struct Running {
    child: Child,
    started: Instant,
    told: PathBuf,
}

impl Running {
    /// Starts a command in `folder`, with temporary files in `folder/tmp`; `name` names the file of its error output.
    ///
    /// # Errors
    /// If it can't be started.
    pub fn start(mut command: Command, folder: &Path, name: &str) -> Result<Self> {
        let told = folder.join(format!("{name}.txt"));
        let file = fs::File::create(&told).map_err(Error::io(&told))?;
        command.current_dir(folder).env(MARK, folder).env("TMPDIR", folder.join("tmp"));
        command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(file);
        let child = command.spawn().map_err(Error::io(command.get_program()))?;
        Ok(Self { child, started: Instant::now(), told })
    }

    /// Sleeps until `secs` after its start, or until it ended.
    pub fn sleep_until(&mut self, secs: f64) {
        while self.started.elapsed().as_secs_f64() < secs && self.child.try_wait().is_ok_and(|status| status.is_none())
        {
            std::thread::sleep(POLL);
        }
    }

    /// Sends a signal by its name.
    ///
    /// # Errors
    /// If `kill` can't be started; a process that ended is not an error.
    pub fn signal(&self, name: &str) -> Result<()> {
        let mut kill = Command::new("sh");
        kill.args(["-c", &format!("kill -{name} {}", self.child.id())]).stderr(Stdio::null());
        kill.status().map_err(Error::io("sh")).map(drop)
    }

    /// Waits for its end; after `limit` it counts as hanging and is killed.
    ///
    /// # Errors
    /// If waiting fails.
    pub fn wait(mut self, limit: Duration) -> Result<Ended> {
        let mut hangs = false;
        let status: ExitStatus = loop {
            if let Some(status) = self.child.try_wait().map_err(Error::io("wait"))? {
                break status;
            }
            if self.started.elapsed() > limit {
                hangs = true;
                // An error means that it has just ended.
                let _ = self.child.kill();
            }
            std::thread::sleep(POLL);
        };
        let secs = self.started.elapsed().as_secs_f64();
        let told = String::from_utf8_lossy(&fs::read(&self.told).unwrap_or_default()).into_owned();
        Ok(Ended { code: status.code(), signal: status.signal(), hangs, secs, told })
    }
}

/// Waits for the processes of the case in `folder` to end; kills those that do not, and returns their number.
pub fn left_behind(folder: &Path) -> usize {
    let started = Instant::now();
    loop {
        let left = marked(folder);
        if left.is_empty() {
            return 0;
        }
        if started.elapsed() > GRACE {
            for process in &left {
                let _ = Command::new("sh").args(["-c", &format!("kill -KILL {process}")]).status();
            }
            return left.len();
        }
        std::thread::sleep(10 * POLL);
    }
}

/// Returns the processes whose environment has the mark of the case in `folder`.
fn marked(folder: &Path) -> Vec<u32> {
    let mark = format!("{MARK}={}\0", folder.display());
    let has_mark = |process: &u32| {
        let environment = fs::read(format!("/proc/{process}/environ")).unwrap_or_default();
        environment.windows(mark.len()).any(|part| part == mark.as_bytes())
    };
    let entries = fs::read_dir("/proc").into_iter().flatten().flatten();
    entries.filter_map(|entry| entry.file_name().to_str()?.parse().ok()).filter(has_mark).collect()
}
