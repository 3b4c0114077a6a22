//! Triangles of binary glTF files (GLB, version 2).

use glam::{DMat4, DQuat, DVec3};
use serde_json::Value;

use super::Mesh;

/// Result with a message that the caller completes with the path.
type Outcome<T> = std::result::Result<T, String>;

/// Mode of a primitive that is a list of triangles.
const TRIANGLES: u64 = 4;
/// Component types of indices: unsigned byte, short and int, by code.
const UNSIGNED: [(u64, usize); 3] = [(5121, 1), (5123, 2), (5125, 4)];
/// Component type of single-precision numbers.
const FLOAT: u64 = 5126;
/// Largest depth of the tree of nodes; deeper ones may be cycles.
const MAX_DEPTH: usize = 64;
/// Largest number of nodes visited: a node may be a child of many others.
const MAX_VISITS: usize = 100_000;
/// Largest number of triangles of all instances.
const MAX_TRIANGLES: usize = 10_000_000;

/// Reads the triangles of the file's scene, in the frame of the scene. Textures, skins and morphs are ignored.
pub(super) fn read(bytes: &[u8]) -> Outcome<Mesh> {
    let file = GltfFile::open(bytes)?;
    let scene = match file.json["scenes"].as_array() {
        Some(scenes) => {
            let index = file.json["scene"].as_u64().unwrap_or(0) as usize;
            Some(scenes.get(index).ok_or_else(|| format!("GLB scene {index} of {}", scenes.len()))?)
        }
        None => None,
    };
    let roots: Vec<usize> = match scene {
        Some(scene) => indices(&scene["nodes"]),
        // Without a scene, every mesh counts once.
        None => (0..file.json["nodes"].as_array().map_or(0, Vec::len)).collect(),
    };
    let (mut mesh, mut visits) = (Mesh::default(), 0);
    for root in roots {
        file.add_node(root, DMat4::IDENTITY, 0, &mut visits, &mut mesh)?;
    }
    Ok(mesh)
}

/// Header and binary part of a file.
struct GltfFile<'a> {
    json: Value,
    binary: &'a [u8],
}

impl<'a> GltfFile<'a> {
    fn open(bytes: &'a [u8]) -> Outcome<Self> {
        let rest = bytes.strip_prefix(b"glTF\x02\0\0\0").ok_or("expected a GLB file of version 2")?;
        let (_length, mut rest) = rest.split_first_chunk::<4>().ok_or("GLB file that ends early")?;
        let (mut json, mut binary) = (None, &[][..]);
        while let Some(([a, b, c, d, kind @ ..], tail)) = rest.split_first_chunk::<8>() {
            let length = u32::from_le_bytes([*a, *b, *c, *d]) as usize;
            let (chunk, tail) = tail.split_at_checked(length).ok_or("GLB chunk that the file cuts off")?;
            rest = tail;
            match kind {
                b"JSON" if json.is_none() => {
                    json = Some(serde_json::from_slice(chunk).map_err(|error| format!("GLB header: {error}"))?);
                }
                b"BIN\0" if binary.is_empty() => binary = chunk,
                _ => {}
            }
        }
        let json: Value = json.ok_or("GLB file without a header")?;
        match json["extensionsRequired"].as_array().and_then(|names| names.first()) {
            // Extensions compress or move the vertices.
            Some(name) => Err(format!("GLB file that needs the extension {name}, which is not supported")),
            None => Ok(Self { json, binary }),
        }
    }

    /// Adds the triangles of a node and of those below it.
    fn add_node(&self, node: usize, around: DMat4, depth: usize, visits: &mut usize, mesh: &mut Mesh) -> Outcome<()> {
        *visits += 1;
        if depth > MAX_DEPTH || *visits > MAX_VISITS {
            return Err("GLB nodes that contain themselves, or too many".into());
        }
        let value = &self.json["nodes"][node];
        if value.is_null() {
            return Err(format!("GLB node {node} is missing"));
        }
        let scene_from_node = around * transform(value)?;
        if let Some(index) = value["mesh"].as_u64() {
            let primitives = self.json["meshes"][index as usize]["primitives"].as_array();
            for primitive in primitives.ok_or_else(|| format!("GLB mesh {index} is missing"))? {
                self.add_primitive(primitive, scene_from_node, mesh)
                    .map_err(|message| format!("GLB mesh {index}: {message}"))?;
            }
        }
        for child in indices(&value["children"]) {
            self.add_node(child, scene_from_node, depth + 1, visits, mesh)?;
        }
        Ok(())
    }

    fn add_primitive(&self, primitive: &Value, scene_from_node: DMat4, mesh: &mut Mesh) -> Outcome<()> {
        if primitive["mode"].as_u64().unwrap_or(TRIANGLES) != TRIANGLES {
            return Ok(());
        }
        let positions = self.accessor(&primitive["attributes"]["POSITION"], "VEC3", 3)?;
        if positions.component != FLOAT {
            return Err(format!("POSITION of component type {}, expected {FLOAT}", positions.component));
        }
        let first = mesh.0.len() as u32;
        for row in positions.rows() {
            let part = |axis: usize| {
                f32::from_le_bytes([row[4 * axis], row[4 * axis + 1], row[4 * axis + 2], row[4 * axis + 3]])
            };
            let point = DVec3::new(part(0).into(), part(1).into(), part(2).into());
            mesh.0.push(scene_from_node.transform_point3(point).as_vec3());
        }
        let corners: Vec<u32> = match &primitive["indices"] {
            Value::Null => (0..positions.count as u32).collect(),
            accessor => {
                let accessor = self.accessor(accessor, "SCALAR", 1)?;
                let little = |row: &[u8]| row.iter().rev().fold(0u32, |word, byte| word << 8 | u32::from(*byte));
                accessor.rows().map(little).collect()
            }
        };
        if let Some(bad) = corners.iter().find(|index| **index as usize >= positions.count) {
            return Err(format!("index {bad} of {} vertices", positions.count));
        }
        // A node that mirrors turns the triangles inside out.
        let mirrored = scene_from_node.determinant() < 0.0;
        let triangle = |t: &[u32; 3]| if mirrored { [t[0], t[2], t[1]] } else { *t }.map(|index| first + index);
        mesh.1.extend(corners.as_chunks::<3>().0.iter().map(triangle));
        match mesh.1.len() <= MAX_TRIANGLES && mesh.0.len() <= u32::MAX as usize / 2 {
            true => Ok(()),
            false => Err(format!("more than {MAX_TRIANGLES} triangles")),
        }
    }

    /// Finds the numbers of an accessor: rows of `width` components.
    fn accessor(&self, index: &Value, shape: &str, width: usize) -> Outcome<Accessor<'a>> {
        let index = index.as_u64().ok_or("a primitive without a needed accessor")? as usize;
        let accessor = &self.json["accessors"][index];
        let damaged = |what: &str| format!("accessor {index}: {what}");
        if accessor["type"] != shape || !accessor["sparse"].is_null() {
            return Err(damaged(&format!("expected a dense {shape}")));
        }
        let view = &self.json["bufferViews"]
            [accessor["bufferView"].as_u64().ok_or_else(|| damaged("no bufferView"))? as usize];
        if view["buffer"].as_u64() != Some(0) || !self.json["buffers"][0]["uri"].is_null() {
            return Err(damaged("expected numbers in the binary part of the file"));
        }
        let number = |value: &Value| value.as_u64().unwrap_or(0) as usize;
        let component = accessor["componentType"].as_u64().unwrap_or(0);
        let sizes = UNSIGNED.iter().copied().chain([(FLOAT, 4)]);
        let size = sizes.filter(|(code, _)| *code == component).map(|(_, size)| size).next();
        let row = width * size.ok_or_else(|| damaged(&format!("component type {component}")))?;
        let stride = view["byteStride"].as_u64().map_or(row, |stride| stride as usize);
        let start = number(&view["byteOffset"]).checked_add(number(&accessor["byteOffset"]));
        let count = number(&accessor["count"]);
        let length = count.saturating_sub(1).checked_mul(stride).and_then(|length| length.checked_add(row));
        let inside = start.zip(length).and_then(|(start, length)| self.binary.get(start..start.checked_add(length)?));
        match inside {
            _ if count == 0 => Ok(Accessor { bytes: &[], component, count, row, stride }),
            Some(bytes) if stride >= row => Ok(Accessor { bytes, component, count, row, stride }),
            _ => Err(damaged("its numbers lie outside of the file")),
        }
    }
}

/// Rows of numbers in the binary part.
struct Accessor<'a> {
    bytes: &'a [u8],
    component: u64,
    count: usize,
    /// Length of a row, bytes.
    row: usize,
    /// Distance between the beginnings of rows, bytes.
    stride: usize,
}

impl<'a> Accessor<'a> {
    fn rows(&self) -> impl Iterator<Item = &'a [u8]> + '_ {
        (0..self.count).map(|index| &self.bytes[index * self.stride..index * self.stride + self.row])
    }
}

/// Returns the node's transform to the node around it.
fn transform(node: &Value) -> Outcome<DMat4> {
    fn numbers<const N: usize>(value: &Value, default: [f64; N]) -> Outcome<[f64; N]> {
        let Some(values) = value.as_array() else { return Ok(default) };
        let values: Vec<f64> = values.iter().filter_map(Value::as_f64).collect();
        values.try_into().map_err(|values: Vec<f64>| format!("GLB node with {} of {N} numbers", values.len()))
    }
    if !node["matrix"].is_null() {
        return Ok(DMat4::from_cols_array(&numbers(&node["matrix"], DMat4::IDENTITY.to_cols_array())?));
    }
    let scale = DVec3::from_array(numbers(&node["scale"], [1.0; 3])?);
    let rotation = DQuat::from_array(numbers(&node["rotation"], [0.0, 0.0, 0.0, 1.0])?);
    let translation = DVec3::from_array(numbers(&node["translation"], [0.0; 3])?);
    Ok(DMat4::from_scale_rotation_translation(scale, rotation.normalize(), translation))
}

fn indices(value: &Value) -> Vec<usize> {
    value.as_array().into_iter().flatten().filter_map(Value::as_u64).map(|index| index as usize).collect()
}

#[cfg(test)]
mod tests {
    use glam::Vec3;
    use serde_json::json;

    use super::*;

    /// Returns a file with one triangle, interleaved with other numbers, below a node that scales to millimetres.
    fn file(header: impl FnOnce(&mut Value)) -> Vec<u8> {
        let mut binary: Vec<u8> = [0u16, 1, 2, 0].iter().flat_map(|index| index.to_le_bytes()).collect();
        for vertex in [[0f32, 0.0, 0.0, 7.0], [1000.0, 0.0, 0.0, 7.0], [0.0, 2000.0, 0.0, 7.0]] {
            binary.extend(vertex.iter().flat_map(|x| x.to_le_bytes()));
        }
        let mut json = json!({
            "asset": { "version": "2.0" }, "scene": 0, "scenes": [{ "nodes": [0] }],
            "nodes": [{ "children": [1], "translation": [0, 0, 5] }, { "mesh": 0, "scale": [0.001, 0.001, 0.001] }],
            "meshes": [{ "primitives": [{ "attributes": { "POSITION": 1 }, "indices": 0 }] }],
            "accessors": [
                { "bufferView": 0, "componentType": 5123, "count": 3, "type": "SCALAR" },
                { "bufferView": 1, "componentType": 5126, "count": 3, "type": "VEC3" },
            ],
            "bufferViews": [
                { "buffer": 0, "byteLength": 6 }, { "buffer": 0, "byteOffset": 8, "byteLength": 48, "byteStride": 16 },
            ],
            "buffers": [{ "byteLength": binary.len() }],
        });
        header(&mut json);
        let mut text = json.to_string().into_bytes();
        text.resize(text.len().next_multiple_of(4), b' ');
        let mut bytes = b"glTF\x02\0\0\0".to_vec();
        bytes.extend(((12 + 16 + text.len() + binary.len()) as u32).to_le_bytes());
        for (kind, chunk) in [(b"JSON", text), (b"BIN\0", binary)] {
            bytes.extend((chunk.len() as u32).to_le_bytes());
            bytes.extend(kind);
            bytes.extend(chunk);
        }
        bytes
    }

    #[test]
    fn nodes_scale_and_move_the_triangles_below_them() {
        let (vertices, triangles) = read(&file(|_| ())).unwrap();
        assert_eq!(vertices, [Vec3::new(0.0, 0.0, 5.0), Vec3::new(1.0, 0.0, 5.0), Vec3::new(0.0, 2.0, 5.0)]);
        assert_eq!(triangles, [[0, 1, 2]]);
        let (_, triangles) = read(&file(|json| json["nodes"][1]["scale"] = json!([-1, 1, 1]))).unwrap();
        assert_eq!(triangles, [[0, 2, 1]]);
    }

    #[test]
    fn numbers_outside_of_the_file_and_cycles_are_refused() {
        let refused = |change: fn(&mut Value), word: &str| {
            let error = read(&file(change)).unwrap_err();
            assert!(error.contains(word), "{error}");
        };
        refused(|json| json["accessors"][1]["count"] = json!(4), "outside of the file");
        refused(|json| json["bufferViews"][0]["byteOffset"] = json!(u64::MAX), "outside of the file");
        refused(|json| json["bufferViews"][1]["byteStride"] = json!(2), "outside of the file");
        refused(|json| json["nodes"][1]["children"] = json!([0]), "contain themselves");
        refused(|json| json["meshes"][0]["primitives"][0]["indices"] = json!(9), "accessor 9");
        refused(
            |json| json["extensionsRequired"] = json!(["KHR_draco_mesh_compression"]),
            "KHR_draco_mesh_compression",
        );
        let whole = file(|_| ());
        for cut in 0..whole.len() {
            assert!(read(&whole[..cut]).is_err(), "{cut}");
        }
    }
}
