//! Reads and writes the committed built-in hand, `egotac-hand-1`.

use std::sync::LazyLock;

use glam::Vec3;
use safetensors::{Dtype, SafeTensors, tensor::TensorView};

use super::{HandModel, N_BETAS, N_JOINTS, N_VERTICES, Side, build, mesh};
use crate::hand::Topology;

/// Output of `egotac hand build`.
static FILE: &[u8] = include_bytes!("builtin.safetensors");

static RIGHT: LazyLock<HandModel> = LazyLock::new(|| {
    // The file is embedded in the program and a test loads it, so a failure means a broken build.
    let mut model = read(FILE).unwrap_or_else(|name| panic!("the embedded hand has no usable tensor {name:?}"));
    model.posedirs = posedirs(&model);
    model
});
static LEFT: LazyLock<HandModel> = LazyLock::new(|| mirrored(&RIGHT));

/// Returns the built-in hand of one side; the left hand is the mirrored right hand.
pub(super) fn hand(side: Side) -> HandModel {
    match side {
        Side::Left => LEFT.clone(),
        Side::Right => RIGHT.clone(),
    }
}

/// Serialises a right hand as the committed safetensors file: all arrays but `posedirs`, which are computed from the
/// weights.
///
/// # Errors
/// If serialisation fails.
pub(crate) fn to_bytes(model: &HandModel) -> Result<Vec<u8>, safetensors::SafeTensorError> {
    let floats = |values: &[f32]| values.iter().flat_map(|value| value.to_le_bytes()).collect::<Vec<u8>>();
    let indices = |values: Vec<u32>| values.iter().flat_map(|value| value.to_le_bytes()).collect::<Vec<u8>>();
    let vertices: Vec<f32> = model.v_template.iter().flat_map(|v| v.to_array()).collect();
    let n = model.v_template.len();
    let tensors = [
        ("v_template", Dtype::F32, vec![n, 3], floats(&vertices)),
        ("faces", Dtype::U32, vec![model.faces.len(), 3], indices(model.faces.concat())),
        ("shapedirs", Dtype::F32, vec![n, 3, N_BETAS], floats(&model.shapedirs)),
        ("j_regressor", Dtype::F32, vec![N_JOINTS, n], floats(&model.j_regressor)),
        ("lbs_weights", Dtype::F32, vec![n, N_JOINTS], floats(&model.lbs_weights)),
        ("tip_vertices", Dtype::U32, vec![5], indices(model.tip_vertices.to_vec())),
    ];
    let views = tensors
        .iter()
        .map(|(name, dtype, shape, data)| Ok((*name, TensorView::new(*dtype, shape.clone(), data)?)))
        .collect::<Result<Vec<_>, safetensors::SafeTensorError>>()?;
    safetensors::serialize(views, None)
}

/// Reads the bytes of [`to_bytes`]; the error is the name of a tensor that is missing or has the wrong shape.
fn read(bytes: &[u8]) -> Result<HandModel, &'static str> {
    let file = SafeTensors::deserialize(bytes).map_err(|_| "(header)")?;
    let words = |name: &'static str| -> Result<Vec<[u8; 4]>, &'static str> {
        Ok(file.tensor(name).map_err(|_| name)?.data().as_chunks::<4>().0.to_vec())
    };
    let floats = |name, length| -> Result<Vec<f32>, &'static str> {
        let words = words(name)?;
        if words.len() == length { Ok(words.into_iter().map(f32::from_le_bytes).collect()) } else { Err(name) }
    };
    let indices =
        |name| -> Result<Vec<u32>, &'static str> { Ok(words(name)?.into_iter().map(u32::from_le_bytes).collect()) };
    Ok(HandModel {
        side: Side::Right,
        topology: Topology::EgotacHand1,
        v_template: floats("v_template", 3 * N_VERTICES)?.as_chunks().0.iter().copied().map(Vec3::from_array).collect(),
        faces: indices("faces")?.as_chunks::<3>().0.to_vec(),
        shapedirs: floats("shapedirs", 3 * N_BETAS * N_VERTICES)?,
        posedirs: Vec::new(),
        j_regressor: floats("j_regressor", N_JOINTS * N_VERTICES)?,
        parents: build::PARENTS,
        lbs_weights: floats("lbs_weights", N_JOINTS * N_VERTICES)?,
        tip_vertices: indices("tip_vertices")?.try_into().map_err(|_| "tip_vertices")?,
    })
}

/// Computes (778, 3, 135) pose blend shapes that keep the back of a bent joint from collapsing.
///
/// Linear blend skinning pulls a vertex with weight w on a joint and 1 - w on its parent towards the joint by w (1 - w)
/// (1 - cos t) of its distance, with joint angle t. The blend shapes undo this on the back of the joint. Inside the
/// bend they do not, because real flesh is compressed there too. Since 1 - cos t = -tr(R - I) / 2, only the diagonal
/// entries of R - I are used.
fn posedirs(model: &HandModel) -> Vec<f32> {
    const N_FEATURES: usize = 9 * (N_JOINTS - 1);
    let normals = mesh::vertex_normals(&model.v_template, &model.faces);
    let joints = super::lbs::rest_joints(model);
    let mut posedirs = vec![0.0; model.v_template.len() * 3 * N_FEATURES];
    for (vertex, weights) in model.lbs_weights.chunks_exact(N_JOINTS).enumerate() {
        for joint in 1..N_JOINTS {
            let blend = weights[joint] * weights[model.parents[joint]];
            let bone = joints[joint] - joints[model.parents[joint]];
            let outward = (model.v_template[vertex] - joints[joint]).reject_from(bone.normalize());
            // 1 on the back of the hand, which faces +y; 0 on the palmar side. The thumb's back faces +y too.
            let back = normals[vertex].y.clamp(0.0, 1.0);
            let offset = outward * (blend * back * -0.5);
            for (axis, value) in offset.to_array().into_iter().enumerate() {
                for diagonal in [0, 4, 8] {
                    posedirs[(vertex * 3 + axis) * N_FEATURES + 9 * (joint - 1) + diagonal] = value;
                }
            }
        }
    }
    posedirs
}

/// Mirrors a hand in x. Vertex indices stay; faces are reversed so that they stay counter-clockwise.
fn mirrored(model: &HandModel) -> HandModel {
    const SIGN: [f32; 3] = [-1.0, 1.0, 1.0];
    let mut other = model.clone();
    other.side = match model.side {
        Side::Left => Side::Right,
        Side::Right => Side::Left,
    };
    other.v_template.iter_mut().for_each(|vertex| vertex.x = -vertex.x);
    other.faces.iter_mut().for_each(|face| face.swap(1, 2));
    for (row, values) in other.shapedirs.chunks_exact_mut(N_BETAS).enumerate() {
        values.iter_mut().for_each(|value| *value *= SIGN[row % 3]);
    }
    // A mirrored rotation is M R M, so entry (i, k) of R - I changes sign with SIGN[i] SIGN[k].
    for (row, values) in other.posedirs.chunks_exact_mut(9 * (N_JOINTS - 1)).enumerate() {
        for (feature, value) in values.iter_mut().enumerate() {
            *value *= SIGN[row % 3] * SIGN[feature % 9 / 3] * SIGN[feature % 3];
        }
    }
    other
}
