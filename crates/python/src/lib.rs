//! The Python module `egotac._egotac`: egotac's library with numpy arrays.
//!
//! Each file holds the classes of one part; `python/egotac/__init__.pyi` has their types. All take and give SI units; vertex
//! fields hold the left hand first, 778 values each.
//!
//! The allocator is the system's: mimalloc, which the programs use, needs static thread-local memory, of which none is left in a
//! process that has loaded PyTorch.

mod arrays;
mod command;
mod error;
mod hand;
mod labels;
mod predictor;
#[cfg(feature = "sim")]
mod retargeter;
#[cfg(feature = "sim")]
mod sim;

use pyo3::prelude::*;

/// Egotac's library.
#[pymodule]
mod _egotac {
    #[pymodule_export]
    use super::command::{label, run_command, set_host};
    #[pymodule_export]
    use super::error::Error;
    #[pymodule_export]
    use super::hand::{Hand, PosedHand};
    #[pymodule_export]
    use super::labels::{Labels, metrics, read, write};
    #[pymodule_export]
    use super::predictor::{Predictor, Touch, TouchBatch, policy_input_names};
    #[cfg(feature = "sim")]
    #[pymodule_export]
    use super::retargeter::{Retargeter, RobotPose};
    #[cfg(feature = "sim")]
    #[pymodule_export]
    use super::sim::{Rollout, Scene, SimFrame};

    use super::*;

    #[pymodule_init]
    fn init(module: &Bound<'_, PyModule>) -> PyResult<()> {
        module.add("__version__", egotac::VERSION)?;
        module.add("REGIONS", super::hand::region_names())?;
        module.add("N_VERTICES", egotac::hand::N_VERTICES)?;
        module.add("CONTACT_THRESHOLD", 0.5)
    }
}
