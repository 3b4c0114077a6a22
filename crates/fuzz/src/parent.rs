//! Starts children, keeps the inputs that ended them, and makes those inputs smaller.

use std::collections::BTreeMap;
use std::fs::{self, File};
use std::os::unix::process::ExitStatusExt;
use std::path::{Path, PathBuf};
use std::process::{Command, ExitStatus, Stdio};
use std::time::{Duration, Instant};

use anyhow::{Context, bail};

use egotac::file::limits::MODEL_MEMORY;
use egotac::text::tell;

use crate::case::Case;
use crate::child::{self, Span};
use crate::limits;
use crate::targets::Target;

/// Time for making one finding's input smaller.
const SHRINK: Duration = Duration::from_secs(20);
/// Inputs up to this size are not made smaller, bytes.
const SMALL: usize = 256;

/// Result of a target's run.
#[derive(Debug, Default)]
pub struct FuzzReport {
    /// Number of inputs read.
    pub inputs: u64,
    /// Number of inputs that the target accepted.
    pub accepted: u64,
    /// Kept input and number of inputs, by reason.
    pub findings: BTreeMap<String, (PathBuf, u64)>,
}

/// Reads `inputs` hostile inputs in children, fewer if `time` is over before, and keeps in `keep` one input per reason.
pub fn run(target: &Target, seed: u64, inputs: u64, time: Duration, keep: &Path) -> anyhow::Result<FuzzReport> {
    let temp = tempfile::tempdir()?;
    let folder = temp.path();
    let (begun, mut report, mut first) = (Instant::now(), FuzzReport::default(), 0);
    while let Some(left) = time.checked_sub(begun.elapsed()).filter(|left| first < inputs && !left.is_zero()) {
        let span = Span { seed, first, end: inputs, time: left };
        let _ = fs::remove_file(folder.join(child::NUMBER));
        let ended = start(
            target,
            folder,
            &[
                "--seed".into(),
                seed.to_string(),
                "--first".into(),
                first.to_string(),
                "--end".into(),
                span.end.to_string(),
                "--seconds".into(),
                span.time.as_secs_f64().to_string(),
            ],
        )?;
        let Some(reason) = ended else {
            let counts = fs::read_to_string(folder.join(child::COUNTS))?;
            let mut numbers = counts.split(' ').map(str::parse::<u64>);
            report.inputs += numbers.next().context("counts")??;
            report.accepted += numbers.next().context("counts")??;
            break;
        };
        let number = fs::read_to_string(folder.join(child::NUMBER)).ok().and_then(|text| text.parse::<u64>().ok());
        let Some(number) = number else { bail!("{}: the child ended before its first input: {reason}", target.name) };
        report.inputs += number + 1 - first;
        first = number + 1;
        if let Some((_, times)) = report.findings.get_mut(&reason) {
            *times += 1;
            continue;
        }
        let case = shrunk(target, folder, Case::read(&child::input(target, folder))?, &reason)?;
        let path = keep.join(target.name).join(file_name(target, &reason));
        fs::create_dir_all(path.parent().unwrap_or(keep))?;
        case.write(&path)?;
        tell(format_args!("{}: {reason}\n    {}", target.name, path.display()));
        report.findings.insert(reason, (path, 1));
    }
    Ok(report)
}

/// Reads one input in a child. Returns the reason if it ended the child.
pub fn replay(target: &Target, case: &Path) -> anyhow::Result<Option<String>> {
    let temp = tempfile::tempdir()?;
    start(target, temp.path(), &["--replay".into(), case.display().to_string()])
}

/// Runs a child to its end. Returns the reason if it did not come to its end by itself.
fn start(target: &Target, folder: &Path, arguments: &[String]) -> anyhow::Result<Option<String>> {
    let errors = folder.join("errors");
    let mut command = Command::new(std::env::current_exe()?);
    command.args(["child", target.name, "--folder"]).arg(folder).args(arguments);
    // One thread in each pool: processor time is then the time of the input.
    command.env("RAYON_NUM_THREADS", "1").env("RUST_BACKTRACE", "0").env("MALLOC_ARENA_MAX", "1");
    // A model that its trial accepts must fit into the memory of the process that tried it.
    command.env(MODEL_MEMORY.variable(), (limits::MEMORY / 2).to_string());
    let status = command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(File::create(&errors)?).status()?;
    Ok((!status.success()).then(|| reason(status, &String::from_utf8_lossy(&fs::read(&errors).unwrap_or_default()))))
}

/// Returns why a child ended: the line of its last messages that tells most, without numbers that differ per input.
fn reason(status: ExitStatus, errors: &str) -> String {
    let lines: Vec<&str> = errors.lines().collect();
    let telling = |line: &&&str| {
        line.contains("panicked at") || line.contains("memory allocation of") || line.contains("overflowed its stack")
    };
    match lines.iter().find(telling) {
        Some(line) if line.contains("panicked at") => {
            let place = line.split("panicked at ").nth(1).unwrap_or(line);
            let message = lines.iter().skip_while(|other| other != &line).nth(1).unwrap_or(&"");
            let words: String = message.chars().filter(|c| !c.is_ascii_digit()).take(60).collect();
            format!("panic at {} {words}", place.trim_end_matches(':'))
        }
        Some(line) if line.contains("memory allocation of") => "memory: an allocation failed".into(),
        Some(_) => "stack overflow".into(),
        None => match status.signal() {
            Some(signal) => limits::reason(signal),
            None => format!("{status}: {}", lines.last().unwrap_or(&"")),
        },
    }
}

/// Leaves out parts of the input as long as the reason stays.
fn shrunk(target: &Target, folder: &Path, mut case: Case, reason: &str) -> anyhow::Result<Case> {
    let begun = Instant::now();
    let path = folder.join("smaller");
    // Each attempt on a hang costs its whole limit of time.
    if reason.starts_with("hang") {
        return Ok(case);
    }
    'smaller: while case.size() > SMALL {
        for smaller in case.smaller() {
            if begun.elapsed() > SHRINK {
                break 'smaller;
            }
            smaller.write(&path)?;
            if replay(target, &path)?.as_deref() == Some(reason) {
                case = smaller;
                continue 'smaller;
            }
        }
        break;
    }
    Ok(case)
}

/// Returns a file name that tells the reason, with the target's ending.
fn file_name(target: &Target, reason: &str) -> String {
    let reason = reason.rsplit_once("/src/").map_or(reason, |(_, end)| end);
    let words: Vec<&str> = reason.split(|c: char| !c.is_ascii_alphanumeric()).filter(|word| !word.is_empty()).collect();
    let name: String = words.join("-").chars().take(60).collect();
    let end = Path::new(target.file).extension().map(|end| format!(".{}", end.to_string_lossy())).unwrap_or_default();
    name.to_lowercase() + &end
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_reason_of_a_panic_is_its_place() {
        let errors = "warn\n\nthread 'main' (7) panicked at src/a.rs:5:9:\nindex 17 is too large\nnote: run\n";
        assert_eq!(reason(ExitStatus::from_raw(libc::SIGABRT), errors), "panic at src/a.rs:5:9 index  is too large");
        assert_eq!(reason(ExitStatus::from_raw(libc::SIGSEGV), "warn"), "SIGSEGV");
        let memory = "memory allocation of 5 bytes failed";
        assert_eq!(reason(ExitStatus::from_raw(libc::SIGABRT), memory), "memory: an allocation failed");
    }
}
