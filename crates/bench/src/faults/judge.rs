//! Judgement of a disturbed run: its status, what it shows, and what is left at the end.

use std::fs;
use std::path::Path;

use egotac::error::{Error, Result};

use super::case::{Bench, PARTLY};
use super::check::Harm;
use super::content;
use super::fault::Fault;
use super::process::{Ended, left_behind};

impl Bench<'_> {
    /// Checks the status of the disturbed run and the output that it left.
    pub(super) fn judge(&self, fault: Fault, ended: Option<&Ended>, out: &Path, harm: &mut Harm) {
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
            (.., Some(PARTLY)) if self.subject.tells_of_parts() => {
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
    pub(super) fn visible(&self, out: &Path, harm: &mut Harm) {
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

    /// Looks for processes and files that the finished command left.
    pub(super) fn leftovers(&self, folder: &Path, harm: &mut Harm) -> Result<()> {
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
}
