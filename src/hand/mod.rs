//! Hand model: maps MANO parameters to vertices and joints.
//!
//! Units are metres and radians. The frame is MANO's: in the flat rest pose the right hand's fingers point along -x,
//! the palm faces -y and the thumb points towards +z; the left hand is the mirror image in x.

#[doc(hidden)]
pub mod build;
mod builtin;
mod field_map;
mod fit;
mod hinges;
mod lbs;
mod mano;
mod mesh;
mod pose_basis;
mod region;
mod strength;
mod topology;
mod transfer;

use std::path::Path;

use glam::{Mat3, Vec3};
use serde::{Deserialize, Serialize};

use crate::error::Result;

pub(crate) use builtin::to_bytes as builtin_bytes;
pub use field_map::FieldMap;
pub use fit::Fit;
pub(crate) use fit::{FitCosts, refine};
pub use mesh::{edges, vertex_areas, vertex_normals};
pub use pose_basis::PoseBasis;
pub use region::Region;
pub use strength::{FINGER_LIMIT, PALM_LIMIT, link_limit};
pub use topology::Topology;
pub use transfer::{HandMap, Transfer};

/// Number of vertices of one hand.
pub const N_VERTICES: usize = 778;
/// Number of vertices of both hands in one array: left 0..777, right 778..1555.
pub const N_FIELD: usize = 2 * N_VERTICES;
/// Number of joints of one hand, in MANO order: wrist, index 1-3, middle 1-3, little 1-3, ring 1-3, thumb 1-3.
pub const N_JOINTS: usize = 16;
/// Names of the joints, and of the links that they move, in MANO order.
pub const JOINT_NAMES: [&str; N_JOINTS] = [
    "wrist", "index1", "index2", "index3", "middle1", "middle2", "middle3", "little1", "little2", "little3", "ring1",
    "ring2", "ring3", "thumb1", "thumb2", "thumb3",
];
/// Number of shape coefficients.
pub const N_BETAS: usize = 10;
/// Number of keypoints of one hand: wrist, then thumb, index, middle, ring, little, each from base to tip.
pub const N_KEYPOINTS: usize = 21;

/// Side of a hand.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize, PartialOrd, Ord)]
#[serde(rename_all = "lowercase")]
pub enum Side {
    /// The left hand: vertices 0..777 of a field.
    Left,
    /// The right hand: vertices 778..1555 of a field.
    Right,
}

impl Side {
    /// Both sides in the order of every two-hand array: left first.
    pub const BOTH: [Side; 2] = [Side::Left, Side::Right];

    /// Returns this hand's vertices in a two-hand array of 1556.
    pub fn range(self) -> std::ops::Range<usize> {
        match self {
            Side::Left => 0..N_VERTICES,
            Side::Right => N_VERTICES..2 * N_VERTICES,
        }
    }

    /// Returns `left` or `right`.
    pub fn name(self) -> &'static str {
        match self {
            Side::Left => "left",
            Side::Right => "right",
        }
    }
}

/// MANO parameters of one hand: full axis-angle pose (no PCA), flat hand mean.
#[derive(Debug, Clone, PartialEq)]
pub struct HandParams {
    /// Shape coefficients.
    pub betas: [f32; N_BETAS],
    /// Rotation of the wrist about the wrist joint, axis-angle, rad.
    pub global_orient: Vec3,
    /// Rotations of joints 1 to 15 relative to their parents, axis-angle, rad.
    pub hand_pose: [Vec3; N_JOINTS - 1],
    /// Translation added after posing, m: the posed wrist joint lies at J0(betas) + transl.
    pub transl: Vec3,
}

impl Default for HandParams {
    fn default() -> Self {
        Self {
            betas: [0.0; N_BETAS],
            global_orient: Vec3::ZERO,
            hand_pose: [Vec3::ZERO; N_JOINTS - 1],
            transl: Vec3::ZERO,
        }
    }
}

impl HandParams {
    /// Returns the 61 numbers that stores hold: transl 3, global_orient 3, hand_pose 45, betas 10.
    pub fn to_array(&self) -> [f32; 61] {
        let mut array = [0.0; 61];
        array[..3].copy_from_slice(&self.transl.to_array());
        array[3..6].copy_from_slice(&self.global_orient.to_array());
        for (chunk, joint) in array[6..51].chunks_exact_mut(3).zip(&self.hand_pose) {
            chunk.copy_from_slice(&joint.to_array());
        }
        array[51..].copy_from_slice(&self.betas);
        array
    }

    /// Creates parameters from the array of [`Self::to_array`].
    pub fn from_array(array: &[f32; 61]) -> Self {
        let vec3 = |at: usize| Vec3::new(array[at], array[at + 1], array[at + 2]);
        Self {
            transl: vec3(0),
            global_orient: vec3(3),
            hand_pose: std::array::from_fn(|joint| vec3(6 + 3 * joint)),
            betas: std::array::from_fn(|i| array[51 + i]),
        }
    }
}

/// A posed hand.
#[derive(Debug, Clone)]
pub struct PosedHand {
    /// 778 vertices, m.
    pub vertices: Vec<Vec3>,
    /// 16 joints in MANO order, m.
    pub joints: [Vec3; N_JOINTS],
    /// Rotation of each joint from its rest orientation, in the frame of the vertices.
    pub rotations: [Mat3; N_JOINTS],
}

/// A skinned hand: template, shape and pose blend shapes, joint regressor, skinning weights.
///
/// The model is MANO's (Romero et al. 2017, eq. 2-4), and its arrays have MANO's names. Lengths are metres, angles
/// radians, in the frame of the [module](self).
///
/// ```
/// use egotac::hand::{HandModel, HandParams, N_JOINTS, N_VERTICES, Side};
/// use glam::Vec3;
///
/// let model = HandModel::builtin(Side::Right);
/// let mut params = HandParams::default();
/// params.hand_pose[0] = Vec3::new(0.0, 0.0, 1.2); // bends the index finger at its base, rad
/// params.transl = Vec3::new(0.0, 0.0, 0.5);
///
/// let posed = model.forward(&params);
/// assert_eq!((posed.vertices.len(), posed.joints.len()), (N_VERTICES, N_JOINTS));
/// let keypoints = model.keypoints(&posed); // 21: wrist, then each finger from base to tip
/// assert_eq!(keypoints[0], posed.joints[0]);
/// assert_eq!(model.joints(&params), posed.joints); // without skinning the vertices
/// ```
#[derive(Debug, Clone)]
pub struct HandModel {
    /// Side of the hand.
    pub side: Side,
    /// Numbering of its vertices.
    pub topology: Topology,
    /// (778, 3) vertices at rest with zero betas, m.
    pub v_template: Vec<Vec3>,
    /// Triangles, counter-clockwise seen from outside.
    pub faces: Vec<[u32; 3]>,
    /// (778, 3, 10) row-major displacement per unit of each beta, m.
    pub shapedirs: Vec<f32>,
    /// (778, 3, 135) row-major displacement per entry of (R - I) of joints 1 to 15, m; empty if the model has none.
    pub posedirs: Vec<f32>,
    /// (16, 778) row-major weights: joints = j_regressor x shaped vertices.
    pub j_regressor: Vec<f32>,
    /// Index of each joint's parent; the wrist is its own parent.
    pub parents: [usize; N_JOINTS],
    /// (778, 16) row-major skinning weights; rows sum to 1.
    pub lbs_weights: Vec<f32>,
    /// Index of the vertex at the tip of each finger, thumb to little.
    pub tip_vertices: [u32; 5],
}

impl HandModel {
    /// Returns the built-in hand, `egotac-hand-1`.
    pub fn builtin(side: Side) -> Self {
        builtin::hand(side)
    }

    /// Loads a MANO file: the published pickle or an `.npz` variant. The pickle is read as data; no code in it runs.
    ///
    /// # Errors
    /// If the file can't be read, has another format, or an array is missing or has the wrong shape.
    pub fn load(path: &Path, side: Side) -> Result<Self> {
        mano::load(path, side)
    }

    /// Negates x of a left hand's `shapedirs`, which has the wrong sign in the published MANO_LEFT.
    ///
    /// [`Self::load`] does not apply this fix, because some data sets were labelled with it and others without.
    pub fn fix_left_shapedirs(&mut self) {
        for row in self.shapedirs.chunks_exact_mut(3 * N_BETAS) {
            row[..N_BETAS].iter_mut().for_each(|x| *x = -*x);
        }
    }

    /// Poses the hand: blend shapes, rigid chain, linear blend skinning (MANO, eq. 2-4).
    pub fn forward(&self, params: &HandParams) -> PosedHand {
        lbs::forward(self, params)
    }

    /// Computes the 16 joints of the posed hand, m: bit-equal to those of [`Self::forward`], without skinning.
    pub fn joints(&self, params: &HandParams) -> [Vec3; N_JOINTS] {
        lbs::joints(self, params)
    }

    /// Returns the 21 keypoints of a hand posed by this model, m: wrist, then thumb, index, middle, ring, little, each
    /// from base to tip. Tips are vertices, the others are joints.
    pub fn keypoints(&self, posed: &PosedHand) -> [Vec3; N_KEYPOINTS] {
        // First joint of thumb, index, middle, ring, little in MANO's joint order.
        const FIRST_JOINT: [usize; 5] = [13, 1, 4, 10, 7];
        std::array::from_fn(|keypoint| match keypoint {
            0 => posed.joints[0],
            _ => match ((keypoint - 1) / 4, (keypoint - 1) % 4) {
                (finger, 3) => posed.vertices[self.tip_vertices[finger] as usize],
                (finger, phalanx) => posed.joints[FIRST_JOINT[finger] + phalanx],
            },
        })
    }

    /// Returns the joint with the largest skinning weight of each vertex, (778); the first one if weights are equal.
    pub fn strongest_joints(&self) -> Vec<usize> {
        let strongest = |weights: &[f32]| {
            let stronger = |best: usize, joint: usize| if weights[joint] > weights[best] { joint } else { best };
            (1..N_JOINTS).fold(0, stronger)
        };
        self.lbs_weights.chunks_exact(N_JOINTS).map(strongest).collect()
    }

    /// Returns the region of each vertex, (778).
    pub fn regions(&self) -> Vec<Region> {
        region::of_vertices(self)
    }
}
