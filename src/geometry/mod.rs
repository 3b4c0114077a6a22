//! Geometry of hands and objects: meshes, distances, solids, spread of forces over vertices.
//!
//! Three rules label a vertex as touched:
//!
//! | label | file | rule |
//! |---|---|---|
//! | (a) | [`proximity`] | an object's vertex lies within a distance: how the paper labels recordings |
//! | (b) | [`surface`], [`solid`] | the signed distance from the surface lies below a threshold |
//! | (c) | [`force`] | forces of the physics engine's contacts, spread over vertices |

pub mod force;
pub mod hand_surface;
pub mod mesh;
pub mod proximity;
pub mod solid;
pub mod surface;

pub use force::{ForceLabel, ForceSpreader, LinkContact, SIGMA};
pub use hand_surface::HandSurface;
pub use mesh::Sides;
pub use proximity::{PROXIMITY, SPACING, SampledSurface, resample};
pub use solid::{Sampling, Solid};
pub use surface::Surface;
