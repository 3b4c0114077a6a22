//! The child process of a trial: its limits, its answer, and its end.

use std::fmt::Display;
use std::io::{self, Read, Write};
use std::path::Path;
use std::process::{Child, Command, ExitStatus, Stdio};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use nix::sys::prctl::set_pdeathsig;
use nix::sys::resource::{Resource, getrlimit, setrlimit};
use nix::sys::signal::Signal;
use nix::unistd::Pid;
use serde::{Deserialize, Serialize};

use super::{Trial, trust_parent};
use crate::error::{Error, Result};
use crate::file::limits;

/// Longest wait for a child, as a multiple of its processor time: it shares the processor with others.
const WAIT_PER_SECOND: u64 = 3;
/// Pause between looks whether the child has ended.
const POLL: Duration = Duration::from_millis(5);
/// Greatest number of bytes of the child's output that are kept; an error text is far shorter.
const MAX_OUTPUT: u64 = 64 << 10;

/// Line of the child.
#[derive(Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
enum Line {
    /// The limits are set and the load begins.
    Ready,
    /// The load succeeded.
    Loaded,
    /// The load failed with this error.
    Refused(String),
}

/// End of a child.
#[derive(Debug)]
pub(super) enum Ending {
    /// The load succeeded.
    Loaded,
    /// The load failed with this error.
    Refused(String),
    /// The program does not serve this trial.
    NotServed,
    /// The processor time or the wait was exceeded.
    TimedOut,
    /// The process ended without an answer; with its standard error.
    Ended(ExitStatus, String),
}

/// Ends this process as soon as its parent ends, however that ends.
///
/// # Errors
/// If the parent has ended already; `parent`: its process id.
pub fn end_with_parent(parent: u32) -> Result<()> {
    let system = |error: nix::Error| Error::value("parent process", "one that can be watched", error);
    set_pdeathsig(Signal::SIGKILL).map_err(system)?;
    // It may have ended before the line above.
    let own = Pid::parent().as_raw();
    match i32::try_from(parent) == Ok(own) {
        true => Ok(()),
        false => Err(Error::value("parent process", parent, own)),
    }
}

/// Runs a trial in this process, which the parent started for it, and writes its result to standard output.
///
/// # Errors
/// If the request can't be read, the parent has ended, a limit can't be set, or the answer can't be written; a load that
/// fails is an answer.
pub fn serve(request: &str, parent: u32, load: impl FnOnce(Trial) -> Result<()>) -> Result<()> {
    let trial = serde_json::from_str(request).map_err(|error| Error::value("trial", "a request", error))?;
    end_with_parent(parent)?;
    trust_parent();
    set_limits()?;
    say(&Line::Ready)?;
    let answer = match load(trial) {
        Ok(()) => Line::Loaded,
        Err(error) => Line::Refused(error.to_string().chars().take(MAX_OUTPUT as usize / 8).collect()),
    };
    say(&answer)
}

fn say(line: &Line) -> Result<()> {
    let failed = |error: &dyn Display| Error::file("standard output", error);
    let text = serde_json::to_string(line).map_err(|error| failed(&error))?;
    let mut out = io::stdout().lock();
    writeln!(out, "{text}").and_then(|()| out.flush()).map_err(|error| failed(&error))
}

/// Limits memory and processor time of this process, and keeps it from writing files.
fn set_limits() -> Result<()> {
    let seconds = limits::MODEL_SECONDS.value();
    // The memory of the program itself does not count.
    let memory = limits::MODEL_MEMORY.value().saturating_add(address_space()?);
    let all = [
        (Resource::RLIMIT_AS, memory, memory),
        // The first limit ends the process with a signal of its own, the second in any case.
        (Resource::RLIMIT_CPU, seconds, seconds.saturating_add(1)),
        (Resource::RLIMIT_CORE, 0, 0),
        (Resource::RLIMIT_FSIZE, MAX_OUTPUT, MAX_OUTPUT),
    ];
    for (resource, soft, hard) in all {
        let failed = |error: nix::Error| Error::value(format!("{resource:?}"), "a limit that can be set", error);
        let (_, most) = getrlimit(resource).map_err(failed)?;
        setrlimit(resource, soft.min(most), hard.min(most)).map_err(failed)?;
    }
    Ok(())
}

/// Returns the size of this process's address space, bytes.
fn address_space() -> Result<u64> {
    let path = Path::new("/proc/self/status");
    let status = std::fs::read_to_string(path).map_err(Error::io(path))?;
    let line = status.lines().find_map(|line| line.strip_prefix("VmSize:"));
    let kilobytes = line.and_then(|line| line.split_whitespace().next()?.parse::<u64>().ok());
    Ok(1024 * kilobytes.ok_or_else(|| Error::file(path, "expected a line VmSize, got none"))?)
}

/// Starts `program` for a trial and waits for its end.
///
/// # Errors
/// If it can't be started.
pub(super) fn run(program: &Path, request: &str) -> Result<Ending> {
    let mut command = Command::new(program);
    command.args(["sim", "trial", "--parent", &std::process::id().to_string(), request]);
    // Each arena reserves 64 MB of address space, also of threads that compile meshes.
    command.env("MALLOC_ARENA_MAX", "2");
    command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
    let mut child = command.spawn().map_err(Error::io(program))?;
    let readers = (child.stdout.take().map(keep_start), child.stderr.take().map(keep_start));
    let status = wait(&mut child).map_err(Error::io(program))?;
    let [said, complained] = [readers.0, readers.1].map(|reader| {
        let bytes = reader.and_then(|reader| reader.join().ok()).unwrap_or_default();
        String::from_utf8_lossy(&bytes).into_owned()
    });
    Ok(ending(status, &said, complained))
}

/// Returns the end that a status and the output stand for; status None: the wait was exceeded.
fn ending(status: Option<ExitStatus>, said: &str, complained: String) -> Ending {
    use std::os::unix::process::ExitStatusExt;
    // The engine may write lines of its own.
    let mut lines = said.lines().filter_map(|line| serde_json::from_str::<Line>(line).ok());
    let is_ready = lines.next() == Some(Line::Ready);
    let Some(status) = status else { return Ending::TimedOut };
    match lines.next() {
        _ if !is_ready => Ending::NotServed,
        Some(Line::Loaded) => Ending::Loaded,
        Some(Line::Refused(text)) => Ending::Refused(text),
        _ if status.signal() == Some(Signal::SIGXCPU as i32) => Ending::TimedOut,
        _ => Ending::Ended(status, complained),
    }
}

/// Waits for a child; ends it and returns None if it takes too long.
fn wait(child: &mut Child) -> io::Result<Option<ExitStatus>> {
    let patience = Duration::from_secs(limits::MODEL_SECONDS.value().saturating_mul(WAIT_PER_SECOND));
    let deadline = Instant::now().checked_add(patience);
    loop {
        if let Some(status) = child.try_wait()? {
            return Ok(Some(status));
        }
        if deadline.is_some_and(|deadline| Instant::now() >= deadline) {
            child.kill()?;
            child.wait()?;
            return Ok(None);
        }
        std::thread::sleep(POLL);
    }
}

/// Reads a pipe to its end in a thread; keeps the start.
fn keep_start(mut pipe: impl Read + Send + 'static) -> JoinHandle<Vec<u8>> {
    std::thread::spawn(move || {
        let mut kept = Vec::new();
        // A pipe that breaks ends like one that closes.
        let _ = pipe.by_ref().take(MAX_OUTPUT).read_to_end(&mut kept);
        let _ = io::copy(&mut pipe, &mut io::sink());
        kept
    })
}

#[cfg(test)]
mod tests {
    use std::os::unix::process::ExitStatusExt;

    use super::*;

    #[test]
    fn end_of_a_child_tells_answer_time_and_crash_apart() {
        let of = |status: i32, said: &str| ending(Some(ExitStatus::from_raw(status)), said, String::new());
        assert!(matches!(of(0, "\"ready\"\n\"loaded\"\n"), Ending::Loaded));
        assert!(matches!(of(0, "\"ready\"\nnoise\n{\"refused\":\"why\"}\n"), Ending::Refused(why) if why == "why"));
        assert!(matches!(of(24, "\"ready\"\n"), Ending::TimedOut));
        assert!(matches!(of(11, "\"ready\"\n"), Ending::Ended(status, _) if status.signal() == Some(11)));
        assert!(matches!(of(2 << 8, "usage"), Ending::NotServed));
        assert!(matches!(ending(None, "\"ready\"\n", String::new()), Ending::TimedOut));
    }
}
