//! Labels for the vertices of a hand: force from contacts, and the distance rules they are compared with.
//!
//! | label | file | says |
//! |---|---|---|
//! | (a) | [`proximity`] | an object's vertex is near: how the paper labels recordings |
//! | (b) | [`surface`], [`solid`] | signed distance from the surface, for any threshold |
//! | (c) | [`force`] | force of the physics engine's contacts, spread over vertices |
//!
//! [`agreement`] scores one against another.

pub mod agreement;
pub mod force;
pub mod hand_surface;
pub mod mesh;
pub mod proximity;
pub mod scores;
pub mod solid;
pub mod surface;
pub mod timing;

pub use agreement::{Parts, Scorer, Sums, TruthFrame};
pub use force::{ForceLabel, ForceSpreader, LinkContact, SIGMA};
pub use hand_surface::HandSurface;
pub use mesh::Sides;
pub use proximity::{PROXIMITY, SPACING, SampledSurface, resample};
pub use solid::{Sampling, Solid};
pub use surface::Surface;
