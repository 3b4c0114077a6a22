//! What `egotac bench` measures; one module per subject.

use std::fmt;

use serde::{Deserialize, Serialize};

#[cfg(feature = "sim")]
pub mod effects;
mod front;
#[cfg(feature = "sim")]
pub mod guards;
pub mod hard_cases;
pub mod label;
pub mod model;
pub mod peer;
#[cfg(feature = "sim")]
pub mod retarget;
#[cfg(feature = "sim")]
pub mod sim;
pub mod train;

/// Where numbers were measured.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Machine {
    /// Model name of the processor.
    pub cpu: String,
    /// Cores a program may use.
    pub cores: usize,
}

impl Machine {
    /// This one.
    pub fn this() -> Self {
        let cores = std::thread::available_parallelism().map_or(1, usize::from);
        let cpuinfo = std::fs::read_to_string("/proc/cpuinfo").unwrap_or_default();
        let model = cpuinfo.lines().find_map(|line| line.strip_prefix("model name")?.split_once(": "));
        Self { cpu: model.map_or("unknown processor", |(_, name)| name).to_owned(), cores }
    }
}

impl fmt::Display for Machine {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}, {} cores", self.cpu, self.cores)
    }
}
