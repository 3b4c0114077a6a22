//! Distances, meshes and the spread of forces.

mod force;
mod surface;
