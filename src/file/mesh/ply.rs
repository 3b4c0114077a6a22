//! PLY files: text or binary, of either byte order.

use glam::Vec3;

use super::Mesh;

/// Result with a message that the caller completes with the path.
type Outcome<T> = std::result::Result<T, String>;

/// Largest number of lines of a header.
const MAX_HEADER: usize = 1000;
/// Largest number of corners of a polygon.
const MAX_CORNERS: usize = 256;

/// Encoding of the elements.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Encoding {
    Text,
    Little,
    Big,
}

/// A property of an element: its type, and the type of the length before a list.
struct Property {
    name: String,
    kind: Kind,
    length: Option<Kind>,
}

/// Elements of one kind, in order.
struct Element {
    name: String,
    count: usize,
    properties: Vec<Property>,
}

/// Type of a number: its kind and size in bytes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Kind {
    Signed(usize),
    Unsigned(usize),
    Float(usize),
}

impl Kind {
    fn parse(name: &str) -> Outcome<Self> {
        match name {
            "char" | "int8" => Ok(Self::Signed(1)),
            "short" | "int16" => Ok(Self::Signed(2)),
            "int" | "int32" => Ok(Self::Signed(4)),
            "uchar" | "uint8" => Ok(Self::Unsigned(1)),
            "ushort" | "uint16" => Ok(Self::Unsigned(2)),
            "uint" | "uint32" => Ok(Self::Unsigned(4)),
            "float" | "float32" => Ok(Self::Float(4)),
            "double" | "float64" => Ok(Self::Float(8)),
            _ => Err(format!("PLY property of type {name:?}, expected char to double")),
        }
    }
}

/// Reads vertices and faces; polygons become fans of triangles.
pub(super) fn read(bytes: &[u8]) -> Outcome<Mesh> {
    let (encoding, elements, body) = header(bytes)?;
    let mut numbers = Numbers { encoding, rest: body };
    let mut mesh = Mesh::default();
    for element in &elements {
        // Every element takes at least one byte, unless it has no property.
        if element.count > body.len() && !element.properties.is_empty() {
            return Err(format!("PLY element {}: {} of them do not fit the file", element.name, element.count));
        }
        match element.name.as_str() {
            "vertex" => vertices(element, &mut numbers, &mut mesh)?,
            "face" => faces(element, &mut numbers, &mut mesh)?,
            _ if element.properties.is_empty() => {}
            _ => {
                for _ in 0..element.count {
                    element.properties.iter().try_for_each(|property| numbers.values(property).map(drop))?;
                }
            }
        }
    }
    Ok(mesh)
}

fn vertices(element: &Element, numbers: &mut Numbers, mesh: &mut Mesh) -> Outcome<()> {
    let place = |name: &str| {
        let place = element.properties.iter().position(|property| property.name == name && property.length.is_none());
        place.ok_or_else(|| format!("PLY vertices without the property {name}"))
    };
    let [x, y, z] = [place("x")?, place("y")?, place("z")?];
    for _ in 0..element.count {
        let mut vertex = Vec3::ZERO;
        for (index, property) in element.properties.iter().enumerate() {
            let values = numbers.values(property)?;
            for (axis, at) in [x, y, z].into_iter().enumerate() {
                if at == index {
                    vertex[axis] = values.first().copied().unwrap_or_default() as f32;
                }
            }
        }
        mesh.0.push(vertex);
    }
    Ok(())
}

fn faces(element: &Element, numbers: &mut Numbers, mesh: &mut Mesh) -> Outcome<()> {
    let is_corners = |property: &Property| {
        property.length.is_some() && ["vertex_indices", "vertex_index"].contains(&property.name.as_str())
    };
    if element.count > 0 && !element.properties.iter().any(is_corners) {
        return Err("PLY faces without the property vertex_indices".into());
    }
    for _ in 0..element.count {
        for property in &element.properties {
            let values = numbers.values(property)?;
            if !is_corners(property) {
                continue;
            }
            let index = |value: &f64| match *value {
                value if value >= 0.0 && value < f64::from(u32::MAX) => Ok(value as u32),
                value => Err(format!("PLY face with the vertex index {value}")),
            };
            let corners: Vec<u32> = values.iter().map(index).collect::<Outcome<_>>()?;
            if let [first, rest @ ..] = corners.as_slice() {
                mesh.1.extend(rest.windows(2).map(|pair| [*first, pair[0], pair[1]]));
            }
        }
    }
    Ok(())
}

/// Numbers of the body in order.
struct Numbers<'a> {
    encoding: Encoding,
    rest: &'a [u8],
}

impl Numbers<'_> {
    /// Reads a property: one number, or a list.
    fn values(&mut self, property: &Property) -> Outcome<Vec<f64>> {
        let count = match property.length {
            None => 1,
            Some(kind) => match self.number(kind)? {
                count if count >= 0.0 && count <= MAX_CORNERS as f64 => count as usize,
                count => return Err(format!("PLY list of {count} numbers, expected at most {MAX_CORNERS}")),
            },
        };
        (0..count).map(|_| self.number(property.kind)).collect()
    }

    fn number(&mut self, kind: Kind) -> Outcome<f64> {
        if self.encoding == Encoding::Text {
            let start =
                self.rest.iter().position(|byte| !byte.is_ascii_whitespace()).ok_or("PLY file that ends early")?;
            let word = &self.rest[start..];
            let end = word.iter().position(u8::is_ascii_whitespace).unwrap_or(word.len());
            self.rest = &word[end..];
            let word = String::from_utf8_lossy(&word[..end]);
            return word.parse().map_err(|_| format!("PLY number {word:?}"));
        }
        let (Kind::Signed(size) | Kind::Unsigned(size) | Kind::Float(size)) = kind;
        let (bytes, rest) = self.rest.split_at_checked(size).ok_or("PLY file that ends early")?;
        self.rest = rest;
        let mut word = [0; 8];
        for (index, slot) in word[..size].iter_mut().enumerate() {
            *slot = bytes[if self.encoding == Encoding::Big { size - 1 - index } else { index }];
        }
        let word = u64::from_le_bytes(word);
        let unused = 64 - 8 * size as u32;
        Ok(match kind {
            Kind::Signed(_) => (((word << unused) as i64) >> unused) as f64,
            Kind::Unsigned(_) => word as f64,
            Kind::Float(4) => f64::from(f32::from_bits(word as u32)),
            Kind::Float(_) => f64::from_bits(word),
        })
    }
}

/// Reads the header: encoding, elements, and the bytes that follow.
fn header(bytes: &[u8]) -> Outcome<(Encoding, Vec<Element>, &[u8])> {
    let (mut rest, mut encoding, mut elements) = (bytes, None, Vec::<Element>::new());
    for number in 0..MAX_HEADER {
        let end = rest.iter().position(|byte| *byte == b'\n').ok_or("PLY header that does not end")?;
        let line = std::str::from_utf8(&rest[..end]).map_err(|_| "PLY header that is not text")?.trim();
        rest = &rest[end + 1..];
        let words: Vec<&str> = line.split_ascii_whitespace().collect();
        match words.as_slice() {
            ["ply"] if number == 0 => {}
            _ if number == 0 => return Err("expected a PLY file".into()),
            ["comment" | "obj_info", ..] | [] => {}
            ["format", name, _] => {
                encoding = Some(match *name {
                    "ascii" => Encoding::Text,
                    "binary_little_endian" => Encoding::Little,
                    "binary_big_endian" => Encoding::Big,
                    other => return Err(format!("PLY format {other:?}")),
                });
            }
            ["element", name, count] => {
                let count = count.parse().map_err(|_| format!("PLY element {name}: count {count:?}"))?;
                elements.push(Element { name: (*name).into(), count, properties: Vec::new() });
            }
            ["property", kind @ .., name] => {
                let (length, kind) = match kind {
                    ["list", length, kind] => (Some(Kind::parse(length)?), Kind::parse(kind)?),
                    [kind] => (None, Kind::parse(kind)?),
                    _ => return Err(format!("PLY header line {line:?}")),
                };
                let element = elements.last_mut().ok_or("PLY property before the first element")?;
                element.properties.push(Property { name: (*name).into(), kind, length });
            }
            ["end_header"] => return Ok((encoding.ok_or("PLY header without a format")?, elements, rest)),
            _ => return Err(format!("PLY header line {line:?}")),
        }
    }
    Err(format!("PLY header of more than {MAX_HEADER} lines"))
}

#[cfg(test)]
mod tests {
    use super::*;

    const HEADER: &str = "element vertex 4\nproperty float x\nproperty float y\nproperty float z\nproperty uchar red\n\
        element face 1\nproperty list uchar int vertex_indices\nend_header\n";

    fn expected() -> Mesh {
        (vec![Vec3::ZERO, Vec3::X, Vec3::new(1.0, 1.0, -2.5), Vec3::Y], vec![[0, 1, 2], [0, 2, 3]])
    }

    #[test]
    fn text_and_binary_of_both_byte_orders_read_the_same_mesh() {
        let text =
            format!("ply\nformat ascii 1.0\ncomment none\n{HEADER}0 0 0 9\n1 0 0 9\n1 1 -2.5 9\n0 1 0 9\n4 0 1 2 3\n");
        assert_eq!(read(text.as_bytes()).unwrap(), expected());
        for (name, big) in [("binary_little_endian", false), ("binary_big_endian", true)] {
            let mut bytes = format!("ply\nformat {name} 1.0\n{HEADER}").into_bytes();
            for vertex in expected().0 {
                for x in vertex.to_array() {
                    bytes.extend(if big { x.to_be_bytes() } else { x.to_le_bytes() });
                }
                bytes.push(9);
            }
            bytes.push(4);
            for index in 0..4i32 {
                bytes.extend(if big { index.to_be_bytes() } else { index.to_le_bytes() });
            }
            assert_eq!(read(&bytes).unwrap(), expected());
            for cut in 0..bytes.len() {
                assert!(read(&bytes[..cut]).is_err(), "{cut}");
            }
        }
    }

    #[test]
    fn a_promise_of_more_vertices_than_bytes_is_refused_before_reading() {
        let text = format!("ply\nformat binary_little_endian 1.0\n{}", HEADER.replace("vertex 4", "vertex 4000000000"));
        assert!(read(text.as_bytes()).unwrap_err().contains("4000000000"));
    }
}
