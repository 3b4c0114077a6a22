//! Labels for the vertices of a hand: force from contacts, and the distance rules they are compared with.

pub mod force;
pub mod proximity;

pub use force::{ForceLabel, ForceSpreader, LinkContact, SIGMA};
pub use proximity::{PROXIMITY, SampledSurface, resample};
