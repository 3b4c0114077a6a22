//! Look-up of a model's parts by name.

use crate::error::{Error, Result};
use crate::mujoco::parts::Parts;

/// Returns the index of a body.
///
/// # Errors
/// If there is none of that name; the error lists all.
pub fn body(parts: &Parts, name: &str) -> Result<usize> {
    let found = parts.bodies.iter().position(|body| body.name == name);
    found.ok_or_else(|| Error::unknown("body", name, parts.bodies.iter().map(|body| body.name.as_str())))
}

/// Returns the index of a geom.
///
/// # Errors
/// If there is none of that name; the error lists all that have one.
pub fn geom(parts: &Parts, name: &str) -> Result<usize> {
    let known = parts.geoms.iter().map(|geom| geom.name.as_str()).filter(|name| !name.is_empty());
    parts.geoms.iter().position(|geom| geom.name == name).ok_or_else(|| Error::unknown("geom", name, known))
}

/// Returns the index of a joint.
///
/// # Errors
/// If there is none of that name; the error lists all.
pub fn joint(parts: &Parts, name: &str) -> Result<usize> {
    let found = parts.joints.iter().position(|joint| joint.name == name);
    found.ok_or_else(|| Error::unknown("joint", name, parts.joints.iter().map(|joint| joint.name.as_str())))
}

/// Returns the index of a site.
///
/// # Errors
/// If there is none of that name; the error lists all.
pub fn site(parts: &Parts, name: &str) -> Result<usize> {
    let found = parts.sites.iter().position(|site| site.name == name);
    found.ok_or_else(|| Error::unknown("site", name, parts.sites.iter().map(|site| site.name.as_str())))
}
