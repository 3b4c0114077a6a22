//! One case: the fault, recovery as a user would do it, and the check.

use std::ffi::OsString;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::Duration;

use egotac::error::{Error, Result};

use super::alter::{clear, cut, restore};
use super::check::{Harm, Reference};
use super::fault::Fault;
use super::inject::{CallCounts, Injection, Library};
use super::process::{Ended, Running};
use super::small_disk::SmallDisk;
use super::subject::{Kind, Subject};

/// Exit status if a part of the input could not be labelled.
pub(super) const PARTLY: i32 = 3;
/// Time for which a process is stopped.
const PAUSE: Duration = Duration::from_millis(100);
/// Longest time of an undisturbed run; the experiment renders its data.
const LONGEST: Duration = Duration::from_secs(1800);
/// Fewest open files: the program starts with them, and needs more.
const FEW_FILES: usize = 8;

/// A command ready to meet faults.
#[derive(Debug)]
pub struct Bench<'a> {
    /// The program.
    pub program: &'a Path,
    /// Library of faults.
    pub library: &'a Library,
    /// The command.
    pub subject: &'a Subject,
    /// Output of an undisturbed run.
    pub reference: &'a Reference,
    /// Output of an undisturbed run on the other input of the same name.
    pub other: Option<&'a Reference>,
    /// Wall time of an undisturbed run, s.
    pub secs: f64,
    /// Calls of an undisturbed run on the output, and on the input.
    pub calls: [CallCounts; 2],
    /// Data of the experiment.
    pub rendered: PathBuf,
}

/// Number of a run among those with the same fault, and its draw from the seeded generator.
#[derive(Debug, Clone, Copy)]
pub struct Draw {
    /// Number of the run.
    pub run: usize,
    /// Number of runs.
    pub runs: usize,
    /// Share of the undisturbed run's time at which the fault happens.
    pub share: f64,
}

/// Result of a case.
#[derive(Debug)]
pub struct Outcome {
    /// Findings.
    pub harm: Harm,
    /// Time of the recovery, s.
    pub recovery_secs: f64,
}

impl Bench<'_> {
    /// Runs a case in the new folder `folder`.
    ///
    /// # Errors
    /// If the case itself can't be run.
    pub fn case(&self, fault: Fault, draw: Draw, folder: &Path) -> Result<Outcome> {
        self.subject.prepare(folder, &self.rendered)?;
        let own = self.own_input(fault, folder)?;
        let input = own.as_deref().or(self.subject.input.as_deref());
        let mut harm = Harm::default();
        let disk = self.small_disk(fault, draw, folder)?;
        let ended = self.disturb(fault, draw, folder, input, &mut harm)?;
        let out = folder.join(self.subject.out);
        self.judge(fault, ended.as_ref(), &out, &mut harm);
        if let (Some(own), Some(whole)) = (&own, &self.subject.input) {
            restore(whole, own)?;
        }
        fs::create_dir_all(folder.join("out")).map_err(Error::io(folder))?;
        disk.as_ref().map_or(Ok(()), SmallDisk::make_room)?;
        let recovery_secs = self.recover(fault, folder, input, ended.and_then(|ended| ended.code), &mut harm)?;
        self.reference.compare(&out, false, &mut harm);
        self.leftovers(folder, &mut harm)?;
        harm.notes.iter_mut().for_each(|note| *note = self.subject.shortened(note, folder));
        harm.notes.dedup();
        Ok(Outcome { harm, recovery_secs })
    }

    /// Returns the time after which a run hangs.
    fn limit(&self) -> Duration {
        Duration::from_secs_f64(60.0 + 20.0 * self.secs)
    }

    /// Copies the input if the fault changes it.
    fn own_input(&self, fault: Fault, folder: &Path) -> Result<Option<PathBuf>> {
        let (Fault::Truncated | Fault::Growing, Some(input)) = (fault, &self.subject.input) else { return Ok(None) };
        let own = folder.join("in").join(input.file_name().unwrap_or_default());
        restore(input, &own)?;
        Ok(Some(own))
    }

    /// Mounts the disk that the fault is about; its sizes are spread from nothing to that of the output.
    fn small_disk(&self, fault: Fault, draw: Draw, folder: &Path) -> Result<Option<SmallDisk>> {
        if fault != Fault::SmallDisk {
            return Ok(None);
        }
        let part = (2 * draw.run as u64 + 1, 2 * draw.runs.max(1) as u64);
        SmallDisk::mount(&folder.join("out"), self.reference.bytes * part.0 / part.1).map(Some)
    }

    fn command(&self, arguments: Vec<OsString>) -> Command {
        let mut command = Command::new(self.program);
        command.args(arguments);
        command
    }

    /// Runs the command with the fault; None = it is one after which the status means nothing.
    fn disturb(
        &self,
        fault: Fault,
        draw: Draw,
        folder: &Path,
        input: Option<&Path>,
        harm: &mut Harm,
    ) -> Result<Option<Ended>> {
        let at = draw.share * self.secs;
        let mut command = self.command(self.subject.arguments(input));
        let [of_output, of_input] = &self.calls;
        let of = |kinds: &str| if kinds == "read" { of_input.of(kinds) } else { of_output.of(kinds) };
        if let Some(injection) = fault.injection(draw.run, draw.runs, of) {
            let below = if fault == Fault::ReadError { input.unwrap_or(folder) } else { &folder.join("out") };
            self.library.load(&mut command, &injection, below, &folder.join("counts"))?;
            let ended = Running::start(command, folder, "faulted")?.wait(self.limit())?;
            if fault == Fault::OtherInput {
                self.label_other(folder, harm)?;
            }
            return Ok(Some(ended));
        }
        if fault == Fault::SmallDisk {
            return Running::start(command, folder, "faulted")?.wait(self.limit()).map(Some);
        }
        if fault == Fault::FewFiles {
            let mut limited = Command::new("sh");
            limited.args(["-c", "ulimit -n $0; exec \"$@\"", &(FEW_FILES + 3 * draw.run).to_string()]);
            limited.arg(self.program).args(self.subject.arguments(input));
            return Running::start(limited, folder, "faulted")?.wait(self.limit()).map(Some);
        }
        let cut = || cut(input.unwrap_or(folder));
        if fault == Fault::Growing {
            cut()?;
        }
        let mut running = Running::start(command, folder, "faulted")?;
        if fault == Fault::Twice {
            let second = Running::start(self.command(self.subject.arguments(input)), folder, "second")?;
            return self.both(running.wait(self.limit())?, second.wait(self.limit())?, harm).map(Some);
        }
        running.sleep_until(at);
        match fault {
            Fault::Stop => {
                running.signal("STOP")?;
                std::thread::sleep(PAUSE);
                self.visible(&folder.join(self.subject.out), harm);
                running.signal("CONT")?;
            }
            Fault::Vanishing => {
                let out = folder.join("out");
                fs::rename(&out, folder.join("gone")).map_err(Error::io(&out))?;
            }
            Fault::Truncated => cut()?,
            Fault::Growing => {
                if let (Some(whole), Some(own)) = (&self.subject.input, input) {
                    restore(whole, own)?;
                }
            }
            _ => running.signal("KILL")?,
        }
        running.wait(self.limit()).map(Some)
    }

    /// Of two runs at once, one succeeds, or each labels a part; of two trainings in one folder, only one succeeds.
    fn both(&self, first: Ended, second: Ended, harm: &mut Harm) -> Result<Ended> {
        let good = [&first, &second].iter().filter(|ended| ended.code == Some(0)).count();
        let parts = [&first, &second].iter().all(|ended| ended.code == Some(PARTLY));
        if good == 0 && !parts {
            harm.add(|harm| &mut harm.wrong_status, format!("both runs fail: {} {}", first.told, second.told));
        }
        if good == 2 && self.subject.kind == Kind::Train {
            harm.add(|harm| &mut harm.wrong_status, "two trainings in one folder both succeed");
        }
        Ok(if second.code == Some(0) || second.signal.is_some() { second } else { first })
    }

    /// Labels another input of the same name into the same output: refused, or the other's own labels.
    fn label_other(&self, folder: &Path, harm: &mut Harm) -> Result<()> {
        let (Some(input), Some(reference)) = (&self.subject.other, self.other) else { return Ok(()) };
        let out = folder.join(self.subject.out);
        let command = self.command(self.subject.arguments(Some(input)));
        let ended = Running::start(command, folder, "other")?.wait(self.limit())?;
        if ended.code != Some(0) {
            return Ok(());
        }
        let mut found = Harm::default();
        reference.compare(&out, false, &mut found);
        if !found.is_none() {
            harm.add(|harm| &mut harm.mixed_up, "another input of the same name gets the first one's labels");
        }
        clear(&folder.join("out"))
    }

    /// Gives the command again, without the fault; returns the time that it takes, s.
    fn recover(
        &self,
        fault: Fault,
        folder: &Path,
        input: Option<&Path>,
        code: Option<i32>,
        harm: &mut Harm,
    ) -> Result<f64> {
        let out = folder.join(self.subject.out);
        // Who let labels be missing, or changed the input, starts afresh where the command says so.
        let changed = matches!(fault, Fault::Truncated | Fault::Growing);
        // A file written after its folder has vanished, such as a log, has no beginning; a recording's output is whole or absent.
        let vanished = fault == Fault::Vanishing && !self.subject.is_atomic() && !self.subject.tells_of_parts();
        let parts_stay = matches!(fault, Fault::Twice | Fault::Vanishing);
        if code == Some(PARTLY) && !parts_stay || changed && code == Some(0) || vanished {
            clear(&folder.join("out"))?;
        }
        let before = out.exists();
        let again = || {
            let arguments = match fault {
                Fault::Vanishing => self.subject.arguments(input),
                _ => self.subject.resume(input),
            };
            Running::start(self.command(arguments), folder, "recovery")?.wait(self.limit())
        };
        let mut ended = again()?;
        let mut secs = ended.secs;
        if ended.code != Some(0) && (changed || ended.code == Some(PARTLY)) {
            clear(&folder.join("out"))?;
            ended = again()?;
            secs += ended.secs;
        }
        let there = before && self.subject.kind == Kind::Generate && ended.told.contains("exists");
        if ended.code != Some(0) && !there {
            let told = ended.told.trim();
            harm.add(|harm| &mut harm.wrong_status, format!("the same command again: {:?}, {told}", ended.code));
        }
        Ok(secs)
    }

    /// Runs the undisturbed command in a new folder and counts its calls on files below `below`.
    ///
    /// # Errors
    /// If it fails.
    pub fn count(&self, folder: &Path, below: Option<&Path>) -> Result<CallCounts> {
        self.subject.prepare(folder, &self.rendered)?;
        let mut command = self.command(self.subject.arguments(self.subject.input.as_deref()));
        let (out, counts) = (folder.join("out"), folder.join("counts"));
        let injection = match below {
            Some(_) => Injection { calls: "read", ..Injection::count() },
            None => Injection::count(),
        };
        self.library.load(&mut command, &injection, below.unwrap_or(&out), &counts)?;
        succeed(Running::start(command, folder, "count")?.wait(self.limit())?, self.subject.name)?;
        CallCounts::read(&counts)
    }
}

/// Runs the undisturbed command on `input` in a new folder; returns its wall time, s.
///
/// # Errors
/// If it fails.
pub fn undisturbed(
    program: &Path,
    subject: &Subject,
    input: Option<&Path>,
    folder: &Path,
    rendered: &Path,
) -> Result<f64> {
    subject.prepare(folder, rendered)?;
    let mut command = Command::new(program);
    command.args(subject.arguments(input));
    let ended = Running::start(command, folder, "undisturbed")?.wait(LONGEST)?;
    let secs = ended.secs;
    succeed(ended, subject.name)?;
    Ok(secs)
}

fn succeed(ended: Ended, name: &str) -> Result<()> {
    match ended.code {
        Some(0) => Ok(()),
        code => Err(Error::value(name, "exit status 0 without a fault", format!("{code:?}: {}", ended.told))),
    }
}
