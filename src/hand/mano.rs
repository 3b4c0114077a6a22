//! Reads MANO files: the published pickle and the `.npz` variants.

use std::path::Path;

use glam::Vec3;

use super::{HandModel, N_BETAS, N_JOINTS, N_VERTICES, Side};
use crate::error::{Error, Result};
use crate::file::{input, limits};
use crate::hand::Topology;
use crate::numpy::{Array, Npz, Outcome, Pickle, expand_indptr, triplets};

/// Names listed in the message about an absent array.
const MAX_NAMED: usize = 32;
/// Columns of the pose blend shapes: 15 rotations of 9 entries.
const N_POSE: usize = 9 * (N_JOINTS - 1);
/// Numbers of a hand pose: 15 rotations as axis-angle.
const N_ANGLES: usize = 3 * (N_JOINTS - 1);
/// Fingertip vertices, thumb to little, as in the smplx package.
const TIP_VERTICES: [u32; 5] = [744, 320, 443, 554, 671];

/// Loads a MANO file; the format follows from the content, not from the name.
pub(super) fn load(path: &Path, side: Side) -> Result<HandModel> {
    ManoFile::open(path, &input::read(path, limits::FILE)?)?.model(side)
}

/// Loads mean and components of the hand pose, (45) and (45, 45) row-major, rad.
pub(super) fn load_basis(path: &Path) -> Result<(Vec<f32>, Vec<f32>)> {
    let bytes = input::read(path, limits::FILE)?;
    let mut file = ManoFile::open(path, &bytes)?;
    Ok((file.shaped("hands_mean", &[N_ANGLES])?, file.shaped("hands_components", &[N_ANGLES, N_ANGLES])?))
}

/// Named arrays of either format.
enum Arrays<'a> {
    Pickle(Pickle<'a>),
    Npz(Npz<std::io::Cursor<&'a [u8]>>),
}

/// Arrays of a file, and its path for error messages.
struct ManoFile<'a> {
    path: &'a Path,
    arrays: Arrays<'a>,
}

impl<'a> ManoFile<'a> {
    /// Finds the arrays of the file at `path` in its `bytes`.
    fn open(path: &'a Path, bytes: &'a [u8]) -> Result<Self> {
        let arrays = if bytes.starts_with(b"PK") {
            Npz::open(bytes).map(Arrays::Npz)
        } else {
            Pickle::read(bytes).map(Arrays::Pickle)
        };
        let arrays = arrays.map_err(|message| Error::file(path, format!("not a MANO pickle or .npz: {message}")))?;
        Ok(Self { path, arrays })
    }

    /// Reads all arrays and checks their shapes.
    fn model(mut self, side: Side) -> Result<HandModel> {
        let v_template = self.shaped("v_template", &[N_VERTICES, 3])?;
        let model = HandModel {
            side,
            topology: Topology::Mano,
            v_template: v_template.as_chunks().0.iter().copied().map(Vec3::from_array).collect(),
            faces: self.faces()?,
            shapedirs: self.shapedirs()?,
            posedirs: self.posedirs()?,
            j_regressor: self.j_regressor()?,
            parents: self.parents()?,
            lbs_weights: self.shaped("weights", &[N_VERTICES, N_JOINTS])?,
            tip_vertices: TIP_VERTICES,
        };
        Ok(model)
    }

    fn faces(&mut self) -> Result<Vec<[u32; 3]>> {
        let array = self.required("f")?;
        if array.shape.len() != 2 || array.shape[1] != 3 {
            return Err(self.misshapen("f", "[faces, 3]", &array.shape));
        }
        let indices = array.indices().map_err(|message| self.damaged("f", message))?;
        if let Some(index) = indices.iter().find(|&&index| index >= N_VERTICES) {
            return Err(self.damaged("f", format!("a face has vertex index {index}, expected below {N_VERTICES}")));
        }
        let indices: Vec<u32> = indices.into_iter().map(|index| index as u32).collect();
        Ok(indices.as_chunks().0.to_vec())
    }

    /// Reads the first ten shape directions; files of other model families have more.
    fn shapedirs(&mut self) -> Result<Vec<f32>> {
        let array = self.required("shapedirs")?;
        let columns = match array.shape[..] {
            [N_VERTICES, 3, columns] if columns >= N_BETAS => columns,
            _ => return Err(self.misshapen("shapedirs", "[778, 3, at least 10]", &array.shape)),
        };
        let cut: Vec<f64> = array.data.chunks_exact(columns).flat_map(|row| &row[..N_BETAS]).copied().collect();
        self.finite("shapedirs", &cut)
    }

    /// Reads pose blend shapes in any of three layouts: (778, 3, 135), the first two axes flattened, or its transpose.
    fn posedirs(&mut self) -> Result<Vec<f32>> {
        let array = self.required("posedirs")?;
        match array.shape[..] {
            [N_VERTICES, 3, N_POSE] => self.finite("posedirs", &array.data),
            [rows, N_POSE] if rows == 3 * N_VERTICES => self.finite("posedirs", &array.data),
            // Layout of the smplx package in memory.
            [N_POSE, columns] if columns == 3 * N_VERTICES => {
                let transposed = (0..columns).flat_map(|c| array.data.iter().skip(c).step_by(columns));
                let transposed: Vec<f64> = transposed.copied().collect();
                self.finite("posedirs", &transposed)
            }
            _ => Err(self.misshapen("posedirs", "[778, 3, 135]", &array.shape)),
        }
    }

    /// Reads the joint regressor: a dense array, a sparse matrix object, or (in `.npz` variants) the arrays of one.
    fn j_regressor(&mut self) -> Result<Vec<f32>> {
        const NAME: &str = "J_regressor";
        let shape = [N_JOINTS, N_VERTICES];
        let array = match self.triplets(NAME)? {
            Some(triplets) => Array::from_triplets(shape, triplets).map_err(|message| self.damaged(NAME, message))?,
            None => self.required(NAME)?,
        };
        let array = match array.shape[..] {
            // Rows of (joint, vertex, weight).
            [n, 3] if n != N_JOINTS => {
                let column = |k: usize| array.data.iter().skip(k).step_by(3).copied().collect::<Vec<f64>>();
                let indices = |k: usize| Array { shape: vec![n], data: column(k) }.indices();
                indices(0)
                    .and_then(|joints| triplets(joints, indices(1)?, column(2)))
                    .and_then(|entries| Array::from_triplets(shape, entries))
                    .map_err(|message| self.damaged(NAME, message))?
            }
            _ => array,
        };
        if array.shape != shape {
            return Err(self.misshapen(NAME, "[16, 778]", &array.shape));
        }
        self.finite(NAME, &array.data)
    }

    /// Reads a sparse matrix from `NAME_data` with `NAME_indices` and `NAME_indptr` (compressed columns), or with
    /// `NAME_row` and `NAME_col`; `None` if there is no `NAME_data`.
    fn triplets(&mut self, name: &str) -> Result<Option<Vec<(usize, usize, f64)>>> {
        let Some(data) = self.array(&format!("{name}_data"))? else { return Ok(None) };
        let indices = |file: &mut Self, part: &str| {
            let name = format!("{name}_{part}");
            let array = file.required(&name)?;
            array.indices().map_err(|message| file.damaged(&name, message))
        };
        let entries = if self.array(&format!("{name}_indptr"))?.is_some() {
            let (rows, indptr) = (indices(self, "indices")?, indices(self, "indptr")?);
            expand_indptr(&indptr, data.data.len()).and_then(|columns| triplets(rows, columns, data.data))
        } else {
            let (rows, columns) = (indices(self, "row")?, indices(self, "col")?);
            triplets(rows, columns, data.data)
        };
        entries.map(Some).map_err(|message| self.damaged(name, message))
    }

    /// Reads the parents from the first row of `kintree_table`. The root's entry (-1 or the largest integer) is
    /// ignored.
    fn parents(&mut self) -> Result<[usize; N_JOINTS]> {
        let array = self.required("kintree_table")?;
        if array.shape != [2, N_JOINTS] {
            return Err(self.misshapen("kintree_table", "[2, 16]", &array.shape));
        }
        let mut parents = [0; N_JOINTS];
        for (joint, slot) in parents.iter_mut().enumerate().skip(1) {
            let parent = array.data[joint];
            if !(0.0..joint as f64).contains(&parent) {
                return Err(
                    self.damaged("kintree_table", format!("joint {joint} has parent {parent}, not an earlier joint"))
                );
            }
            *slot = parent as usize;
        }
        Ok(parents)
    }

    /// Reads an array of an exact shape.
    fn shaped(&mut self, name: &str, shape: &[usize]) -> Result<Vec<f32>> {
        let array = self.required(name)?;
        if array.shape != shape {
            return Err(self.misshapen(name, &format!("{shape:?}"), &array.shape));
        }
        self.finite(name, &array.data)
    }

    /// Reads an array that must be present; the error lists the names that are.
    fn required(&mut self, name: &str) -> Result<Array> {
        if let Some(array) = self.array(name)? {
            return Ok(array);
        }
        let mut present = match &self.arrays {
            Arrays::Pickle(pickle) => pickle.keys(),
            Arrays::Npz(npz) => npz.keys(),
        };
        present.sort();
        present.truncate(MAX_NAMED);
        let present = if present.is_empty() { "nothing".to_string() } else { present.join(", ") };
        Err(Error::Missing { name: name.into(), place: self.path.display().to_string(), present })
    }

    fn array(&mut self, name: &str) -> Result<Option<Array>> {
        let array: Outcome<Option<Array>> = match &mut self.arrays {
            Arrays::Pickle(pickle) => pickle.array(name),
            Arrays::Npz(npz) => npz.array(name),
        };
        array.map_err(|message| self.damaged(name, message))
    }

    /// Converts to single precision and checks that all entries are finite.
    fn finite(&self, name: &str, data: &[f64]) -> Result<Vec<f32>> {
        let single: Vec<f32> = data.iter().map(|&value| value as f32).collect();
        match single.iter().position(|value| !value.is_finite()) {
            Some(index) => {
                Err(self.damaged(name, format!("expected finite numbers, entry {index} is {}", data[index])))
            }
            None => Ok(single),
        }
    }

    fn damaged(&self, name: &str, message: impl std::fmt::Display) -> Error {
        Error::file(self.path, format!("{name}: {message}"))
    }

    fn misshapen(&self, name: &str, expected: &str, got: &[usize]) -> Error {
        Error::shape(format!("{}: {name}", self.path.display()), expected, got)
    }
}
