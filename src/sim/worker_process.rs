//! Generation of data sets in child processes: a fatal error of the engine ends one episode only.
//!
//! A worker process runs [`serve`]: it reads one request per line of JSON from standard input, records the episode, and
//! writes one line of JSON to standard output. A worker that ended is replaced at the next episode.

use std::ffi::OsString;
use std::io::{BufRead, BufReader, Write};
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdin, ChildStdout, Command, Stdio};

use serde::{Deserialize, Serialize};

use super::generate::{DatasetPlan, GenerateProgress, Recorder, generate_with};
use super::record::{RecordSummary, record_part};
use super::rollout::RolloutOptions;
use super::scene::Scene;
use crate::error::{Error, Result};
use crate::host;

/// Environment variable of Mesa's llvmpipe: number of render threads beside the caller's.
const RENDER_THREADS: &str = "LP_NUM_THREADS";
/// Time that a process without an answer gets to exit before it is killed.
const EXIT_GRACE: std::time::Duration = std::time::Duration::from_millis(200);

/// Command line of a worker process.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct WorkerCommand {
    /// Program.
    pub program: PathBuf,
    /// Arguments; they name the plan's scenes in order, and its options.
    pub arguments: Vec<OsString>,
}

impl WorkerCommand {
    /// Creates the command that starts this same program as a worker: `sim worker` and further arguments. The worker ends
    /// with this process.
    ///
    /// # Errors
    /// If the path of this program is unknown.
    pub fn of_this_program(arguments: impl IntoIterator<Item = OsString>) -> Result<Self> {
        let program = host::program().map_err(Error::io("/proc/self/exe"))?;
        let parent = std::process::id().to_string();
        let first = ["sim", "worker", "--parent", &parent].map(OsString::from);
        Ok(Self { program, arguments: first.into_iter().chain(arguments).collect() })
    }
}

/// Request to record an episode.
#[derive(Debug, Serialize, Deserialize)]
struct EpisodeRequest {
    /// Index of the scene.
    scene: usize,
    /// Seed of the episode.
    seed: u64,
    /// Store to write.
    out: PathBuf,
}

/// Answer to a request.
#[derive(Debug, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
enum EpisodeOutcome {
    Done,
    Failed(String),
}

/// Generates a data set as [`super::generate`], with one child process per job; `skip_failed` leaves out failed
/// episodes.
///
/// # Errors
/// As [`super::generate`]; an episode whose process ended counts as failed.
pub fn generate_in_processes(
    plan: &DatasetPlan,
    workers: &WorkerCommand,
    skip_failed: bool,
    out: &Path,
    progress: impl Fn(GenerateProgress) + Sync,
) -> Result<RecordSummary> {
    let recorder = || {
        let mut running: Option<WorkerProcess> = None;
        let record = move |scene: usize, seed: u64, out: &Path| -> Result<()> {
            let mut worker = match running.take() {
                Some(worker) => worker,
                None => WorkerProcess::start(workers)?,
            };
            match worker.ask(&EpisodeRequest { scene, seed, out: std::path::absolute(out).map_err(Error::io(out))? }) {
                Some(outcome) => {
                    running = Some(worker);
                    match outcome {
                        EpisodeOutcome::Done => Ok(()),
                        EpisodeOutcome::Failed(why) => Err(Error::Engine(why)),
                    }
                }
                None => Err(worker.exit_error()),
            }
        };
        Box::new(record) as Recorder
    };
    generate_with(plan, &recorder, skip_failed, out, progress)
}

/// Records the episodes of `requests` until its end, and writes an outcome for each to `answers`.
///
/// # Errors
/// If a request cannot be read, or an outcome cannot be written; a failed episode is an outcome.
pub fn serve(
    scenes: &[Scene],
    options: &RolloutOptions,
    requests: impl BufRead,
    mut answers: impl Write,
) -> Result<()> {
    for line in requests.lines() {
        let line = line.map_err(Error::io("standard input"))?;
        let request: EpisodeRequest = serde_json::from_str(&line).map_err(|e| Error::file("standard input", e))?;
        if request.scene >= scenes.len() {
            return Err(Error::value("scene", format!("below {}", scenes.len()), request.scene));
        }
        let outcome = match record_part(scenes, request.scene, request.seed, options, &request.out) {
            Ok(()) => EpisodeOutcome::Done,
            Err(error) => EpisodeOutcome::Failed(error.to_string()),
        };
        let text = serde_json::to_string(&outcome).map_err(|e| Error::file("standard output", e))?;
        writeln!(answers, "{text}").and_then(|()| answers.flush()).map_err(Error::io("standard output"))?;
    }
    Ok(())
}

/// Running worker process.
#[derive(Debug)]
struct WorkerProcess {
    child: Child,
    /// Standard input of the process; dropping it ends the process.
    requests: Option<ChildStdin>,
    answers: BufReader<ChildStdout>,
}

impl WorkerProcess {
    fn start(workers: &WorkerCommand) -> Result<Self> {
        let mut command = Command::new(&workers.program);
        command.args(&workers.arguments).stdin(Stdio::piped()).stdout(Stdio::piped());
        if std::env::var_os(RENDER_THREADS).is_none() {
            // Jobs that each render with all cores slow each other down: let each worker render in its own thread only.
            command.env(RENDER_THREADS, "0");
        }
        let mut child = command.spawn().map_err(Error::io(&workers.program))?;
        let requests = child.stdin.take();
        let none = || Error::file(&workers.program, "expected a piped standard output, got none");
        let answers = BufReader::new(child.stdout.take().ok_or_else(none)?);
        Ok(Self { child, requests, answers })
    }

    /// Sends a request and waits for its outcome; `None` = the process ended or wrote something else.
    fn ask(&mut self, request: &EpisodeRequest) -> Option<EpisodeOutcome> {
        let text = serde_json::to_string(request).ok()?;
        let requests = self.requests.as_mut()?;
        writeln!(requests, "{text}").and_then(|()| requests.flush()).ok()?;
        let mut line = String::new();
        self.answers.read_line(&mut line).ok()?;
        serde_json::from_str(&line).ok()
    }

    /// Returns an error with the exit status; ends a process that still runs.
    fn exit_error(mut self) -> Error {
        self.requests = None;
        if let Ok(None) = self.child.try_wait() {
            // It closed its output, or wrote something else: give it time to exit by itself.
            std::thread::sleep(EXIT_GRACE);
            let _ = self.child.kill();
        }
        let how = self.child.wait().map_or_else(|error| error.to_string(), |status| status.to_string());
        Error::Engine(format!("its worker process ended with {how}"))
    }
}

impl Drop for WorkerProcess {
    fn drop(&mut self) {
        self.requests = None;
        let _ = self.child.wait();
    }
}
