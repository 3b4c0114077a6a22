//! Objects as a scene file gives them.

use std::ops::RangeInclusive;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use super::limits::{MAX_ANGLE, positive, within, zero};
use crate::error::{Error, Result};
use crate::sim::range::UniformRange;

/// Points of a soft body along each edge of its grid.
const POINTS: RangeInclusive<usize> = 4..=15;

/// Value of `points` that is not given.
fn default_points() -> usize {
    7
}

/// An object on the table.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ObjectSpec {
    /// Name, unique in the scene: letters, digits and `_`.
    pub name: String,
    /// Shape; the object frame has the centre of the shape as origin and z up.
    #[serde(with = "serde_yaml::with::singleton_map")]
    pub shape: ShapeSpec,
    /// Mass of the moving part, kg.
    pub mass: UniformRange,
    /// Coefficient of sliding friction.
    pub friction: UniformRange,
    /// Coefficient of sliding friction against the table where it differs, as of a cloth that slides under the fingers.
    pub table_friction: Option<UniformRange>,
    /// Position on the table, x and y, m; x is mirrored for the left hand.
    pub position: [UniformRange; 2],
    /// Height above its position on the table, m; only for objects that are not solid.
    pub raised: Option<UniformRange>,
    /// Rotation about z for the right hand, rad; mirrored for the left hand.
    #[serde(default = "zero")]
    pub yaw: UniformRange,
    /// True if the object exists in the world; false makes it a place to reach that nothing can touch or see.
    #[serde(default = "yes")]
    pub solid: bool,
    /// True if the surface gets a random pattern instead of one colour.
    #[serde(default)]
    pub texture: bool,
}

/// Shapes; lengths are in metres. All are symmetric about the xz plane of the object frame.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase", deny_unknown_fields)]
pub enum ShapeSpec {
    /// Cuboid with the given edges along x, y and z.
    Box {
        /// Edges.
        size: [UniformRange; 3],
    },
    /// Cuboid with three equal edges.
    Cube {
        /// Edge.
        size: UniformRange,
    },
    /// Ball.
    Ball {
        /// Radius.
        radius: UniformRange,
    },
    /// Upright cylinder.
    Cylinder {
        /// Radius.
        radius: UniformRange,
        /// Height.
        height: UniformRange,
    },
    /// Mug of convex pieces, open above, with its handle along +x.
    Mug {
        /// Outer radius.
        radius: UniformRange,
        /// Height.
        height: UniformRange,
        /// Thickness of wall and floor.
        wall: UniformRange,
    },
    /// Round push button on a fixed housing; a spring pushes it up.
    Button {
        /// Radius of the button.
        radius: UniformRange,
        /// Travel of the button.
        travel: UniformRange,
        /// Stiffness of its spring, N/m.
        stiffness: UniformRange,
    },
    /// Knob on a fixed plate; it turns about its upright axis.
    Knob {
        /// Radius.
        radius: UniformRange,
        /// Height.
        height: UniformRange,
        /// Torque of the joint's dry friction, N m.
        resistance: UniformRange,
    },
    /// Swing door that faces -y, with an upright hinge at its -x edge.
    Door {
        /// Width of the leaf along x.
        width: UniformRange,
        /// Height of the leaf.
        height: UniformRange,
        /// Thickness of the leaf.
        thickness: UniformRange,
        /// Torque of the joint's dry friction, N m.
        resistance: UniformRange,
    },
    /// Elastic ball.
    Soft {
        /// Radius at rest.
        radius: UniformRange,
        /// Young's modulus, Pa.
        stiffness: UniformRange,
        /// Points of the surface along each edge of the cube that it is made from: more make it rounder, and the simulation slower.
        #[serde(default = "default_points")]
        points: usize,
    },
    /// Surface from a file, decomposed into convex pieces for contact.
    Mesh {
        /// OBJ or STL file; a relative path starts at the scene's folder.
        file: PathBuf,
        /// Metres per unit of the file.
        scale: UniformRange,
    },
}

impl ObjectSpec {
    /// Checks ranges; `key` names the object in errors.
    pub(super) fn check(&self, key: &str) -> Result<()> {
        positive(&format!("{key}.mass"), self.mass)?;
        positive(&format!("{key}.friction"), self.friction)?;
        // The table is 1.2 m wide.
        self.position.iter().try_for_each(|axis| within(&format!("{key}.position"), *axis, -1.0, 1.0))?;
        within(&format!("{key}.yaw"), self.yaw, -MAX_ANGLE, MAX_ANGLE)?;
        if let Some(friction) = self.table_friction {
            positive(&format!("{key}.table_friction"), friction)?;
        }
        if let Some(raised) = self.raised {
            within(&format!("{key}.raised"), raised, 0.0, 2.0)?;
            if self.solid {
                return Err(Error::value(format!("{key}.raised"), "none for a solid object", "a height"));
            }
        }
        self.shape.check(&format!("{key}.shape"))
    }

    /// True if only contact holds the object.
    pub(crate) fn is_free(&self) -> bool {
        self.solid && !self.shape.is_articulated()
    }
}

impl ShapeSpec {
    /// True if the object has a joint.
    pub(crate) fn is_articulated(&self) -> bool {
        matches!(self, Self::Button { .. } | Self::Knob { .. } | Self::Door { .. })
    }

    /// Changes the points of a soft body's grid, 4 to 15; other shapes stay.
    pub fn set_points(&mut self, wanted: usize) {
        if let Self::Soft { points, .. } = self {
            *points = wanted;
        }
    }

    /// True if the object deforms.
    pub(crate) fn is_soft(&self) -> bool {
        matches!(self, Self::Soft { .. })
    }

    /// Resolves a relative mesh path against `folder`.
    pub(super) fn resolve(&mut self, folder: &Path) {
        if let Self::Mesh { file, .. } = self
            && file.is_relative()
        {
            *file = folder.join(&*file);
        }
    }

    fn check(&self, key: &str) -> Result<()> {
        let length = |name: &str, range: UniformRange| within(&format!("{key}.{name}"), range, 1e-3, 10.0);
        let torque = |range: UniformRange| within(&format!("{key}.resistance"), range, 0.0, 100.0);
        match self {
            Self::Box { size } => size.iter().try_for_each(|s| length("size", *s)),
            Self::Cube { size } => length("size", *size),
            Self::Ball { radius } => length("radius", *radius),
            Self::Cylinder { radius, height } => length("radius", *radius).and(length("height", *height)),
            Self::Mug { radius, height, wall } => {
                length("radius", *radius)?;
                length("height", *height)?;
                within(&format!("{key}.wall"), *wall, 1e-3, 0.5 * radius.low().min(height.low()))
            }
            Self::Button { radius, travel, stiffness } => {
                length("radius", *radius)?;
                within(&format!("{key}.travel"), *travel, 1e-3, 0.05)?;
                within(&format!("{key}.stiffness"), *stiffness, 1.0, 1e5)
            }
            Self::Knob { radius, height, resistance } => {
                length("radius", *radius).and(length("height", *height)).and(torque(*resistance))
            }
            Self::Door { width, height, thickness, resistance } => {
                length("width", *width).and(length("height", *height))?;
                length("thickness", *thickness).and(torque(*resistance))
            }
            Self::Soft { radius, stiffness, points } => {
                within(&format!("{key}.radius"), *radius, 5e-3, 0.2)?;
                within(&format!("{key}.stiffness"), *stiffness, 1e2, 1e8)?;
                match POINTS.contains(points) {
                    true => Ok(()),
                    false => Err(Error::value(
                        format!("{key}.points"),
                        format!("{} to {}", POINTS.start(), POINTS.end()),
                        points,
                    )),
                }
            }
            Self::Mesh { scale, .. } => within(&format!("{key}.scale"), *scale, 1e-6, 1e3),
        }
    }
}

fn yes() -> bool {
    true
}
