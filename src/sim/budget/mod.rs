//! Physics preset from a limit on computation time or on the error of forces.
//!
//! ```text
//! table (docs/bench/sim.json, measured on one machine) --+--> pick --> preset, with the reason
//! calibration (this machine's time over the table's) ----+
//! ```

pub mod calibration;
pub mod clock;
pub mod pick;
pub mod table;

pub use calibration::this_machines_factor;
pub use pick::{Choice, Request, pick};
pub use table::Table;
