//! Objects as a scene writes them.

use std::path::{Path, PathBuf};

use serde::Deserialize;

use super::{TURN, positive, within, zero};
use crate::error::{Error, Result};
use crate::sim::range::Span;

/// An object on the table.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ObjectSpec {
    /// Name.
    pub name: String,
    /// Shape; its frame has the centre of the shape as origin and z up.
    #[serde(with = "serde_yaml::with::singleton_map")]
    pub shape: ShapeSpec,
    /// Mass, kg; of what moves.
    pub mass: Span,
    /// Coefficient of sliding friction.
    pub friction: Span,
    /// Friction against the table where it differs: a cloth that glides under the fingers' press.
    pub table_friction: Option<Span>,
    /// Where on the table, m: x and y; x is mirrored for the left hand.
    pub position: [Span; 2],
    /// Height above its place on the table, m; only for objects that are not solid.
    pub raised: Option<Span>,
    /// Rotation about z, rad, for the right hand; mirrored for the left one.
    #[serde(default = "zero")]
    pub yaw: Span,
    /// Whether it is there at all: without, it is a place to reach, which nothing can touch or see.
    #[serde(default = "yes")]
    pub solid: bool,
    /// Whether its surface has a drawn pattern in place of one colour.
    #[serde(default)]
    pub texture: bool,
}

/// Shapes; lengths in metres. All are symmetric in their frame's y.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(rename_all = "lowercase", deny_unknown_fields)]
pub enum ShapeSpec {
    /// A cuboid with the given edges along x, y and z.
    Box {
        /// Edges.
        size: [Span; 3],
    },
    /// A cuboid with three equal edges.
    Cube {
        /// Edge.
        size: Span,
    },
    /// A ball.
    Ball {
        /// Radius.
        radius: Span,
    },
    /// An upright cylinder.
    Cylinder {
        /// Radius.
        radius: Span,
        /// Height.
        height: Span,
    },
    /// A mug of convex pieces, open above, its handle along +x.
    Mug {
        /// Outer radius.
        radius: Span,
        /// Height.
        height: Span,
        /// Thickness of wall and floor.
        wall: Span,
    },
    /// A round push button on a housing that stands fast; its spring pushes it up.
    Button {
        /// Radius of the button.
        radius: Span,
        /// How far it can be pressed.
        travel: Span,
        /// Stiffness of its spring, N/m.
        stiffness: Span,
    },
    /// A knob on a plate that stands fast; it turns about its upright axis.
    Knob {
        /// Radius.
        radius: Span,
        /// Height.
        height: Span,
        /// Torque that just turns it, N m.
        resistance: Span,
    },
    /// A swing door that faces -y, hinged upright at its -x edge.
    Door {
        /// Width of the leaf along x.
        width: Span,
        /// Height of the leaf.
        height: Span,
        /// Thickness of the leaf.
        thickness: Span,
        /// Torque that just turns it, N m.
        resistance: Span,
    },
    /// An elastic ball.
    Soft {
        /// Radius at rest.
        radius: Span,
        /// Young's modulus, Pa.
        stiffness: Span,
    },
    /// A surface of one's own, taken apart into convex pieces for contact.
    Mesh {
        /// Wavefront OBJ or STL file; a relative path starts at the scene's folder.
        file: PathBuf,
        /// Metres per unit of the file.
        scale: Span,
    },
}

impl ObjectSpec {
    /// Checks ranges; `key` names the object in messages.
    pub(super) fn check(&self, key: &str) -> Result<()> {
        positive(&format!("{key}.mass"), self.mass)?;
        positive(&format!("{key}.friction"), self.friction)?;
        // On the table or near it.
        self.position.iter().try_for_each(|axis| within(&format!("{key}.position"), *axis, -1.0, 1.0))?;
        within(&format!("{key}.yaw"), self.yaw, -TURN, TURN)?;
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

    /// Whether nothing holds it but contact.
    pub fn is_free(&self) -> bool {
        self.solid && !self.shape.is_articulated()
    }
}

impl ShapeSpec {
    /// Whether it hangs on a joint of its own.
    pub fn is_articulated(&self) -> bool {
        matches!(self, Self::Button { .. } | Self::Knob { .. } | Self::Door { .. })
    }

    /// Whether it deforms.
    pub fn is_soft(&self) -> bool {
        matches!(self, Self::Soft { .. })
    }

    /// Makes relative paths start at `folder`.
    pub(super) fn resolve(&mut self, folder: &Path) {
        if let Self::Mesh { file, .. } = self
            && file.is_relative()
        {
            *file = folder.join(&*file);
        }
    }

    fn check(&self, key: &str) -> Result<()> {
        let length = |name: &str, span: Span| within(&format!("{key}.{name}"), span, 1e-3, 10.0);
        let torque = |span: Span| within(&format!("{key}.resistance"), span, 0.0, 100.0);
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
            Self::Soft { radius, stiffness } => {
                within(&format!("{key}.radius"), *radius, 5e-3, 0.2)?;
                within(&format!("{key}.stiffness"), *stiffness, 1e2, 1e8)
            }
            Self::Mesh { scale, .. } => within(&format!("{key}.scale"), *scale, 1e-6, 1e3),
        }
    }
}

fn yes() -> bool {
    true
}
