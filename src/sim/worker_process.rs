//! Episodes in child processes: the engine ends its process where it cannot go on, and then takes down one episode only.
//!
//! A worker is a program that runs [`serve`]; it makes one episode after another, asked for by a line of JSON on its
//! standard input and answered by one on its standard output. One that died is replaced at the next episode.

use std::ffi::OsString;
use std::io::{BufRead, BufReader, Write};
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdin, ChildStdout, Command, Stdio};

use serde::{Deserialize, Serialize};

use super::record::{Generate, Progress, Recorder, Summary, generate_by, record_part};
use super::rollout::RolloutOptions;
use super::scene::Scene;
use crate::error::{Error, Result};

/// Environment variable of Mesa's llvmpipe: threads that draw.
const RENDER_THREADS: &str = "LP_NUM_THREADS";

/// How to start a worker.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Workers {
    /// The program.
    pub program: PathBuf,
    /// Its arguments; with them it knows the scenes in the plan's order and the plan's options.
    pub arguments: Vec<OsString>,
}

/// An episode to record.
#[derive(Debug, Serialize, Deserialize)]
struct Request {
    /// Index of the scene.
    scene: usize,
    seed: u64,
    /// Store to write.
    out: PathBuf,
}

/// What became of it.
#[derive(Debug, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
enum Answer {
    Done,
    Failed(String),
}

/// As [`super::generate`], with each of the plan's jobs in a child process; `skip_failed` leaves out episodes that fail.
///
/// # Errors
/// As [`super::generate`]; an episode whose process ended counts as failed.
pub fn generate_isolated(
    plan: &Generate,
    workers: &Workers,
    skip_failed: bool,
    out: &Path,
    progress: impl Fn(Progress) + Sync,
) -> Result<Summary> {
    let recorder = || {
        let mut running: Option<Running> = None;
        let record = move |scene: usize, seed: u64, out: &Path| -> Result<()> {
            let mut worker = match running.take() {
                Some(worker) => worker,
                None => Running::start(workers)?,
            };
            match worker.ask(&Request { scene, seed, out: std::path::absolute(out).map_err(Error::io(out))? }) {
                Some(answer) => {
                    running = Some(worker);
                    match answer {
                        Answer::Done => Ok(()),
                        Answer::Failed(why) => Err(Error::Engine(why)),
                    }
                }
                None => Err(worker.died()),
            }
        };
        Box::new(record) as Recorder
    };
    generate_by(plan, &recorder, skip_failed, out, progress)
}

/// Records the episodes asked for on `requests` until it ends.
///
/// # Errors
/// If a request cannot be read or an answer not be written; an episode that fails is an answer.
pub fn serve(
    scenes: &[Scene],
    options: &RolloutOptions,
    requests: impl BufRead,
    mut answers: impl Write,
) -> Result<()> {
    for line in requests.lines() {
        let line = line.map_err(Error::io("standard input"))?;
        let request: Request = serde_json::from_str(&line).map_err(|e| Error::file("standard input", e))?;
        if request.scene >= scenes.len() {
            return Err(Error::value("scene", format!("below {}", scenes.len()), request.scene));
        }
        let answer = match record_part(scenes, request.scene, request.seed, options, &request.out) {
            Ok(()) => Answer::Done,
            Err(error) => Answer::Failed(error.to_string()),
        };
        let text = serde_json::to_string(&answer).map_err(|e| Error::file("standard output", e))?;
        writeln!(answers, "{text}").and_then(|()| answers.flush()).map_err(Error::io("standard output"))?;
    }
    Ok(())
}

/// A worker at work.
#[derive(Debug)]
struct Running {
    child: Child,
    /// Closed when it shall end.
    requests: Option<ChildStdin>,
    answers: BufReader<ChildStdout>,
}

impl Running {
    fn start(workers: &Workers) -> Result<Self> {
        let mut command = Command::new(&workers.program);
        command.args(&workers.arguments).stdin(Stdio::piped()).stdout(Stdio::piped());
        if std::env::var_os(RENDER_THREADS).is_none() {
            // None beside the worker's own: jobs that draw with all cores wait for each other.
            command.env(RENDER_THREADS, "0");
        }
        let mut child = command.spawn().map_err(Error::io(&workers.program))?;
        let requests = child.stdin.take();
        let none = || Error::file(&workers.program, "gives no standard output");
        let answers = BufReader::new(child.stdout.take().ok_or_else(none)?);
        Ok(Self { child, requests, answers })
    }

    /// `None` = it is no more.
    fn ask(&mut self, request: &Request) -> Option<Answer> {
        let text = serde_json::to_string(request).ok()?;
        let requests = self.requests.as_mut()?;
        writeln!(requests, "{text}").and_then(|()| requests.flush()).ok()?;
        let mut line = String::new();
        self.answers.read_line(&mut line).ok()?;
        serde_json::from_str(&line).ok()
    }

    /// What its end says. One that still lives, though it gave no answer, is ended.
    fn died(mut self) -> Error {
        self.requests = None;
        if let Ok(None) = self.child.try_wait() {
            // It closed its output, or wrote something else: a moment to end by itself.
            std::thread::sleep(std::time::Duration::from_millis(200));
            let _ = self.child.kill();
        }
        let how = self.child.wait().map_or_else(|error| error.to_string(), |status| status.to_string());
        Error::Engine(format!("the process that simulated it ended with {how}"))
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        self.requests = None;
        let _ = self.child.wait();
    }
}
