//! Geometry of hands and objects: meshes, distances, solids, and the distribution of forces over vertices.
//!
//! A vertex is labelled as touched by one of three rules:
//!
//! | label | file | rule |
//! |---|---|---|
//! | (a) | [`proximity`] | a vertex of the object is near; the paper labels recordings by this rule |
//! | (b) | [`surface`], [`solid`] | the signed distance from the object's surface is below a threshold |
//! | (c) | [`force`] | contact forces of the physics engine, distributed over vertices |

mod disc;
pub mod force;
pub mod hand_surface;
pub mod mesh;
pub mod proximity;
pub mod solid;
pub mod surface;
mod tree;

pub use force::{ForceLabel, ForceSpreader, LinkContact, SIGMA};
pub use hand_surface::HandSurface;
pub use mesh::Sides;
pub use proximity::{PROXIMITY, SPACING, SampledSurface, resample};
pub use solid::{Sampling, Solid};
pub use surface::{Beside, Surface};
