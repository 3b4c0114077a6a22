//! The faults, and which of them a command meets.

use super::inject::{CHANGES, Injection};
use super::subject::{Kind, Subject};

/// Numbers of Linux' errors.
const EIO: &str = "5";
const ENOSPC: &str = "28";
const EROFS: &str = "30";

/// A kind of fault: a row of the table.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Fault {
    /// SIGKILL at a random time.
    KillAtRandom,
    /// SIGKILL at a rename, fsync, write, or creation or removal of a file.
    KillAtCall,
    /// SIGSTOP at a random time, later SIGCONT.
    Stop,
    /// EIO at a read of the input.
    ReadError,
    /// EIO at a write, fsync or rename.
    WriteError,
    /// ENOSPC from some write on, by the preloaded library.
    DiskFull,
    /// A small disk that the output fills.
    SmallDisk,
    /// EROFS from some change on.
    ReadOnly,
    /// The output's folder is moved away.
    Vanishing,
    /// Two runs at once.
    Twice,
    /// SIGKILL, then a run on another input of the same name.
    OtherInput,
    /// A file of the input is cut while it is read.
    Truncated,
    /// A file of the input is still being written.
    Growing,
    /// Few files may be open.
    FewFiles,
}

impl Fault {
    /// All faults, in the order of the table.
    pub const ALL: [Self; 14] = [
        Self::KillAtRandom,
        Self::KillAtCall,
        Self::Stop,
        Self::ReadError,
        Self::WriteError,
        Self::DiskFull,
        Self::SmallDisk,
        Self::ReadOnly,
        Self::Vanishing,
        Self::Twice,
        Self::OtherInput,
        Self::Truncated,
        Self::Growing,
        Self::FewFiles,
    ];

    /// Returns the name in the table.
    pub fn name(self) -> &'static str {
        match self {
            Self::KillAtRandom => "SIGKILL at random",
            Self::KillAtCall => "SIGKILL at a write, fsync or rename",
            Self::Stop => "SIGSTOP, SIGCONT",
            Self::ReadError => "EIO at a read",
            Self::WriteError => "EIO at a write, fsync or rename",
            Self::DiskFull => "disk full (ENOSPC)",
            Self::SmallDisk => "disk full (tmpfs)",
            Self::ReadOnly => "read-only output",
            Self::Vanishing => "output's folder vanishes",
            Self::Twice => "two runs at once",
            Self::OtherInput => "another input of the same name",
            Self::Truncated => "input cut while it is read",
            Self::Growing => "input still growing",
            Self::FewFiles => "out of file descriptors",
        }
    }

    /// Returns the number of runs with `subject`; `most` is that of the faults whose moment is drawn from the whole run.
    pub fn runs(self, subject: &Subject, short: bool, most: usize) -> usize {
        let possible = match self {
            Self::ReadError | Self::Truncated | Self::Growing => subject.input.is_some(),
            Self::OtherInput => subject.other.is_some(),
            // Its rendered data lie in the output and must be there first.
            Self::SmallDisk => subject.kind != Kind::Experiment,
            _ => true,
        };
        let everything = matches!(subject.name, "label, store" | "train");
        let few = matches!(self, Self::KillAtRandom | Self::KillAtCall | Self::Twice | Self::OtherInput);
        match (possible, short, subject.kind) {
            (false, ..) => 0,
            // Rendering its data takes minutes.
            (true, true, Kind::Experiment) => 0,
            (true, true, _) => usize::from(everything || few),
            (true, false, Kind::Experiment) => most.div_ceil(8),
            (true, false, _) if matches!(self, Self::KillAtRandom | Self::KillAtCall | Self::WriteError) => most,
            (true, false, _) => most.div_ceil(4),
        }
    }

    /// Returns the calls that fail in run `run` of `runs`, spread over all that an undisturbed run makes (`of` kinds).
    pub fn injection(self, run: usize, runs: usize, of: impl Fn(&str) -> u32) -> Option<Injection> {
        let (calls, action, goes_on) = match self {
            // Renames and fsyncs first, as the moments when files appear.
            Self::KillAtCall if run.is_multiple_of(2) => ("sync,rename", "kill", false),
            Self::KillAtCall | Self::OtherInput => (CHANGES, "kill", false),
            Self::WriteError => ("write,sync,rename", EIO, false),
            Self::ReadError => ("read", EIO, false),
            Self::DiskFull => ("write,create", ENOSPC, true),
            Self::ReadOnly => (CHANGES, EROFS, true),
            _ => return None,
        };
        let number = 1 + (u64::from(of(calls)) * (2 * run as u64 + 1) / (2 * runs.max(1) as u64)) as u32;
        Some(Injection { calls, number, action: action.into(), goes_on })
    }
}
