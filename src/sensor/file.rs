//! Files of a taxel map: YAML with the layout, safetensors with the weights.

use std::collections::BTreeMap;
use std::path::Path;

use glam::Vec3;
use safetensors::tensor::{Dtype, SafeTensors, TensorView};
use serde::{Deserialize, Serialize};

use super::layout::Layout;
use super::map::{HandTaxels, TaxelMap};
use crate::dataset::tensors::numbers;
use crate::error::{Error, Result};
use crate::file::{self, input, limits};
use crate::hand::{N_VERTICES, Side, Topology};
use crate::text::parse_yaml;

/// Entry of a sparse matrix: row, column and weight.
type Entry = (u32, (u32, f32));

/// Number of values per place.
const PLACE: usize = 3;

/// A map as written in YAML.
#[derive(Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Written {
    /// Numbering of the vertices: `egotac-hand-1` (the built-in hand) or `mano`.
    topology: Topology,
    /// Name of the safetensors file of the weights, beside this file.
    weights: String,
    /// SHA-256 of the file of the weights.
    weights_sha256: String,
    /// Layout that the map was built from.
    layout: Layout,
}

/// Either form of YAML.
#[derive(Deserialize)]
#[serde(untagged)]
enum LayoutOrMap {
    Map(Written),
    Layout(Layout),
}

impl Layout {
    /// Reads a layout, or that of a taxel map.
    ///
    /// # Errors
    /// If the file is neither, or not valid.
    pub fn read(path: &Path) -> Result<Self> {
        let text = input::read_text(path, limits::TEXT)?;
        let layout = match parse_yaml(&text) {
            Ok(LayoutOrMap::Map(map)) => map.layout,
            Ok(LayoutOrMap::Layout(layout)) => layout,
            // Reading it once more as a layout gives an error that names the key.
            Err(_) => parse_yaml(&text).map_err(|error| Error::file(path, error))?,
        };
        layout.check().map_err(|error| Error::file(path, error))?;
        Ok(layout)
    }
}

impl TaxelMap {
    /// Reads a map from its YAML file and the weights beside it.
    ///
    /// # Errors
    /// If a file can't be read, they don't belong together, or a value is out of range.
    pub fn read(path: &Path) -> Result<Self> {
        let text = input::read_text(path, limits::TEXT)?;
        let written: Written = parse_yaml(&text).map_err(|error| Error::file(path, error))?;
        written.layout.check().map_err(|error| Error::file(path, error))?;
        if written.weights.contains(['/', '\\']) {
            return Err(Error::file(path, Error::value("weights", "a file name without folders", &written.weights)));
        }
        let at = path.with_file_name(&written.weights);
        let bytes = input::read(&at, limits::FILE)?;
        let sha256 = file::sha256(&bytes);
        if sha256 != written.weights_sha256 {
            let expected = format!("the file with SHA-256 {}, as {} says", written.weights_sha256, path.display());
            return Err(Error::file(&at, format!("expected {expected}, got {sha256}")));
        }
        let Written { topology, layout, .. } = written;
        let hands = Side::BOTH.map(|side| read_hand(&bytes, side, layout.channels).map_err(|e| Error::file(&at, e)));
        let [left, right] = hands;
        Ok(Self { layout, topology, hands: [left?, right?] })
    }

    /// Writes the map: `path`, a YAML file, and its weights beside it.
    ///
    /// # Errors
    /// If a file can't be written.
    pub fn write(&self, path: &Path) -> Result<()> {
        let at = path.with_extension("safetensors");
        let name = at.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
        let mut tensors: Vec<(String, Dtype, Vec<usize>, Vec<u8>)> = Vec::new();
        for (side, hand) in Side::BOTH.iter().zip(&self.hands) {
            let name = |part: &str| format!("{}.{part}", side.name());
            for (kind, lists) in [("reading", &hand.reading), ("spread", &hand.spread)] {
                let entries =
                    || lists.iter().enumerate().flat_map(|(row, list)| list.iter().map(move |e| (row as u32, *e)));
                let count = vec![entries().count()];
                let words = |get: fn(Entry) -> [u8; 4]| entries().flat_map(get).collect::<Vec<u8>>();
                let [rows, columns] = if kind == "reading" { ["vertex", "taxel"] } else { ["taxel", "vertex"] };
                let full = |part: &str| name(&format!("{kind}.{part}"));
                tensors.push((full(rows), Dtype::U32, count.clone(), words(|e| e.0.to_le_bytes())));
                tensors.push((full(columns), Dtype::U32, count.clone(), words(|e| e.1.0.to_le_bytes())));
                tensors.push((full("weight"), Dtype::F32, count, words(|e| e.1.1.to_le_bytes())));
            }
            let floats = |values: Vec<f32>| values.into_iter().flat_map(f32::to_le_bytes).collect::<Vec<u8>>();
            tensors.push((name("factor"), Dtype::F32, vec![N_VERTICES], floats(hand.factors.clone())));
            let places = hand.positions.iter().flat_map(|place| place.to_array()).collect();
            tensors.push((name("position"), Dtype::F32, vec![hand.positions.len(), PLACE], floats(places)));
        }
        let mut views = Vec::new();
        for (name, dtype, shape, data) in &tensors {
            let view = TensorView::new(*dtype, shape.clone(), data).map_err(|e| Error::file(&at, e))?;
            views.push((name.as_str(), view));
        }
        let metadata = BTreeMap::from([
            ("sensor".to_string(), self.layout.name.clone()),
            ("topology".into(), self.topology.id().into()),
        ]);
        let bytes = file::tensors::to_bytes(&at, views, &metadata)?;
        file::write(&at, &bytes)?;
        let written = Written {
            topology: self.topology,
            weights: name,
            weights_sha256: file::sha256(&bytes),
            layout: self.layout.clone(),
        };
        let text = serde_yaml::to_string(&written).map_err(|error| Error::file(path, error))?;
        file::write(path, text.as_bytes())
    }
}

fn read_hand(bytes: &[u8], side: Side, channels: usize) -> Result<HandTaxels> {
    let file = SafeTensors::deserialize(bytes).map_err(|e| Error::value("weights", "a safetensors file", e))?;
    let tensor = |part: &str| {
        let name = format!("{}.{part}", side.name());
        let present = || file.names().join(", ");
        let found = file.tensor(&name);
        let found =
            found.map_err(|_| Error::Missing { name: name.clone(), place: "the weights".into(), present: present() });
        found.map(|tensor| (name, tensor))
    };
    let floats = |part: &str, shape: &[usize]| -> Result<Vec<f32>> {
        let (name, tensor) = tensor(part)?;
        Ok(numbers(&name, &tensor, shape)?.into_iter().map(|value| value as f32).collect())
    };
    let lists = |kind: &str,
                 [rows, columns]: [&str; 2],
                 [n_rows, n_columns]: [usize; 2]|
     -> Result<Vec<Vec<(u32, f32)>>> {
        let (name, first) = tensor(&format!("{kind}.{rows}"))?;
        let shape = [first.shape().iter().product()];
        let row = numbers(&name, &first, &shape)?;
        let (column_name, column) = tensor(&format!("{kind}.{columns}"))?;
        let column = numbers(&column_name, &column, &shape)?;
        let weight = floats(&format!("{kind}.weight"), &shape)?;
        let mut found = vec![Vec::new(); n_rows];
        for ((row, column), weight) in row.into_iter().zip(column).zip(weight) {
            for (name, value, most) in [(&name, row, n_rows), (&column_name, column, n_columns)] {
                if !(value >= 0.0 && value < most as f64) {
                    return Err(Error::value(name, format!("indices below {most}"), value));
                }
            }
            if !(0.0..=1.0 + 1e-5).contains(&weight) {
                return Err(Error::value(format!("{kind}.weight"), "weights from 0 to 1", weight));
            }
            found[row as usize].push((column as u32, weight));
        }
        let sum = |list: &Vec<(u32, f32)>| list.iter().map(|entry| entry.1).sum::<f32>();
        match found.iter().filter(|list| !list.is_empty()).map(sum).find(|sum| (sum - 1.0).abs() > 1e-4) {
            Some(sum) => {
                Err(Error::value(format!("{}.{kind}", side.name()), format!("weights that sum to 1 per {rows}"), sum))
            }
            None => Ok(found),
        }
    };
    let places = floats("position", &[channels, PLACE])?;
    let factors = floats("factor", &[N_VERTICES])?;
    if let Some(bad) = factors.iter().find(|factor| !(**factor >= 0.0 && factor.is_finite())) {
        return Err(Error::value(format!("{}.factor", side.name()), "numbers from 0 on", bad));
    }
    Ok(HandTaxels {
        reading: lists("reading", ["vertex", "taxel"], [N_VERTICES, channels])?,
        spread: lists("spread", ["taxel", "vertex"], [channels, N_VERTICES])?,
        factors,
        positions: places.chunks_exact(PLACE).map(Vec3::from_slice).collect(),
    })
}
