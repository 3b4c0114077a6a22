//! One case: the fault, recovery as a user would do it, and the check.

use std::ffi::OsString;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::Duration;

use egotac::dataset::copy_folder;
use egotac::error::{Error, Result};

use super::check::{Harm, Reference};
use super::content;
use super::fault::Fault;
use super::inject::{Counts, Injection, Library};
use super::process::{Ended, Running, left_behind};
use super::subject::{Kind, Subject};

/// Exit status if a part of the input could not be labelled.
const PARTLY: i32 = 3;
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
    pub calls: [Counts; 2],
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
    /// What was found.
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
        let ended = self.disturb(fault, draw, folder, input, &mut harm)?;
        let out = folder.join(self.subject.out);
        self.judge(fault, ended.as_ref(), &out, &mut harm);
        if let (Some(own), Some(whole)) = (&own, &self.subject.input) {
            restore(whole, own)?;
        }
        fs::create_dir_all(folder.join("out")).map_err(Error::io(folder))?;
        let recovery_secs = self.recover(fault, folder, input, ended.and_then(|ended| ended.code), &mut harm)?;
        self.reference.compare(&out, false, &mut harm);
        self.leftovers(folder, &mut harm)?;
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

    /// Of two runs at once, one succeeds; of two trainings in one folder, only one.
    fn both(&self, first: Ended, second: Ended, harm: &mut Harm) -> Result<Ended> {
        let good = [&first, &second].iter().filter(|ended| ended.code == Some(0)).count();
        if good == 0 {
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

    /// Checks the status of the disturbed run and the output that it left.
    fn judge(&self, fault: Fault, ended: Option<&Ended>, out: &Path, harm: &mut Harm) {
        let Some(ended) = ended else { return };
        let killed = matches!(fault, Fault::KillAtRandom | Fault::KillAtCall | Fault::OtherInput);
        let said = ended.told.lines().last().unwrap_or_default();
        let wrong = |harm: &mut Harm, what: &str| harm.add(|harm| &mut harm.wrong_status, format!("{what}: {said}"));
        match (ended.hangs, ended.signal, ended.code) {
            (true, ..) => wrong(harm, "the run hangs"),
            (_, Some(9), _) if killed => {}
            (_, Some(signal), _) => wrong(harm, &format!("signal {signal}")),
            (.., Some(0)) if !out.exists() && fault != Fault::Vanishing => {
                wrong(harm, "exit status 0 without an output");
            }
            (.., Some(0 | 1)) => {}
            (.., Some(PARTLY)) if self.subject.kind == Kind::Label => {
                return self.reference.compare(out, true, harm);
            }
            // The loader of shared libraries says 127 where it can't open one.
            (.., Some(127)) if fault == Fault::FewFiles => {}
            (.., code) => wrong(harm, &format!("exit status {code:?}")),
        }
        if ended.code == Some(1) && ended.told.trim().is_empty() {
            wrong(harm, "a failure without a reason");
        }
        if ended.code == Some(0) && out.exists() {
            self.reference.compare(out, matches!(fault, Fault::Growing | Fault::Truncated), harm);
        } else {
            self.visible(out, harm);
        }
    }

    /// Checks that an unfinished run shows no output, or a valid one.
    fn visible(&self, out: &Path, harm: &mut Harm) {
        if !out.exists() {
            return;
        }
        if self.subject.is_atomic() {
            return self.reference.compare(out, false, harm);
        }
        for (name, bytes) in content::files(out).unwrap_or_default() {
            let hidden = name.iter().any(|part| part.to_string_lossy().starts_with('.'));
            if let (false, Err(why)) = (hidden, content::whole(&name, &bytes)) {
                harm.add(|harm| &mut harm.half_written, why);
            }
        }
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
        if code == Some(PARTLY) || changed && code == Some(0) {
            clear(&folder.join("out"))?;
        }
        let before = out.exists();
        let again = || {
            let arguments = match fault {
                // If nothing is left to go on from, the run begins anew.
                Fault::Vanishing if !before => self.subject.arguments(input),
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

    fn leftovers(&self, folder: &Path, harm: &mut Harm) -> Result<()> {
        let processes = left_behind(folder);
        if processes > 0 {
            harm.add(|harm| &mut harm.leftovers, format!("{processes} processes"));
        }
        let expected = Path::new(self.subject.out).file_name();
        for place in ["out", "tmp"] {
            let path = folder.join(place);
            for entry in fs::read_dir(&path).map_err(Error::io(&path))? {
                let name = entry.map_err(Error::io(&path))?.file_name();
                if Some(name.as_os_str()) != expected || place == "tmp" {
                    harm.add(|harm| &mut harm.leftovers, format!("{place}/{}", name.display()));
                }
            }
        }
        Ok(())
    }

    /// Runs the undisturbed command in a new folder and counts its calls on files below `below`.
    ///
    /// # Errors
    /// If it fails.
    pub fn count(&self, folder: &Path, below: Option<&Path>) -> Result<Counts> {
        self.subject.prepare(folder, &self.rendered)?;
        let mut command = self.command(self.subject.arguments(self.subject.input.as_deref()));
        let (out, counts) = (folder.join("out"), folder.join("counts"));
        let injection = match below {
            Some(_) => Injection { calls: "read", ..Injection::count() },
            None => Injection::count(),
        };
        self.library.load(&mut command, &injection, below.unwrap_or(&out), &counts)?;
        succeed(Running::start(command, folder, "count")?.wait(self.limit())?, self.subject.name)?;
        Counts::read(&counts)
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

/// Removes everything in a folder.
fn clear(folder: &Path) -> Result<()> {
    fs::remove_dir_all(folder).map_err(Error::io(folder))?;
    fs::create_dir_all(folder).map_err(Error::io(folder))
}

/// Copies a file or folder over `to`, with the times of the original.
fn restore(from: &Path, to: &Path) -> Result<()> {
    if from.is_file() {
        let parent = to.parent().unwrap_or(to);
        fs::create_dir_all(parent).map_err(Error::io(parent))?;
        fs::copy(from, to).map_err(Error::io(to))?;
    } else {
        if to.exists() {
            fs::remove_dir_all(to).map_err(Error::io(to))?;
        }
        copy_folder(from, to, false)?;
    }
    for name in content::files(from)?.keys() {
        let [from, to] = [from, to].map(|path| if name.as_os_str().is_empty() { path.into() } else { path.join(name) });
        let times = fs::metadata(&from).and_then(|metadata| metadata.modified()).map_err(Error::io(&from))?;
        fs::File::options().write(true).open(&to).and_then(|file| file.set_modified(times)).map_err(Error::io(&to))?;
    }
    Ok(())
}

/// Cuts the largest file of an input in half.
fn cut(input: &Path) -> Result<()> {
    let files = content::files(input)?;
    let Some((name, bytes)) = files.iter().max_by_key(|(_, bytes)| bytes.len()) else { return Ok(()) };
    let path = if name.as_os_str().is_empty() { input.to_path_buf() } else { input.join(name) };
    let file = fs::File::options().write(true).open(&path).map_err(Error::io(&path))?;
    file.set_len(bytes.len() as u64 / 2).map_err(Error::io(&path))
}
