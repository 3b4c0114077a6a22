//! What accuracy costs in simulation.
pub mod clock;
pub mod errors;
pub mod knob;
pub mod trace;
