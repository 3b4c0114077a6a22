//! TODO sim.
