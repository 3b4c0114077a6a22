//! Numeric arrays in numpy's encoding: raw bytes, a type code and a shape.

/// Result with an error message that the caller completes with the path.
pub(crate) type Outcome<T> = Result<T, String>;

/// Largest number of elements of an array; MANO's largest array has 315 090.
const MAX_ELEMENTS: usize = 1 << 24;
/// Largest number of dimensions of an array, that of numpy 1.
const MAX_RANK: usize = 32;

/// A dense array in row-major order, converted from any numeric type.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Array {
    pub shape: Vec<usize>,
    pub data: Vec<f64>,
}

/// Element type of an array: byte order, kind and size, spelled e.g. `<f8`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Dtype {
    big_endian: bool,
    kind: u8,
    size: usize,
}

impl Dtype {
    /// Parses a code such as `<f8`, `f8`, `|u1`, `>i4`.
    pub fn parse(code: &str) -> Outcome<Self> {
        let unknown = || format!("arrays of type {code:?} are not supported (numbers of 1 to 8 bytes are)");
        let (big_endian, rest) = match code.as_bytes() {
            [b'>', rest @ ..] => (true, rest),
            [b'<' | b'=' | b'|', rest @ ..] | rest => (false, rest),
        };
        let [kind, size @ ..] = rest else { return Err(unknown()) };
        let size = std::str::from_utf8(size).ok().and_then(|size| size.parse().ok()).ok_or_else(unknown)?;
        match (kind, size) {
            (b'f', 2 | 4 | 8) | (b'i' | b'u', 1 | 2 | 4 | 8) | (b'b', 1) => Ok(Self { big_endian, kind: *kind, size }),
            _ => Err(unknown()),
        }
    }

    /// Returns the same type in the byte order of numpy's dtype state.
    pub fn with_order(self, order: &str) -> Self {
        Self { big_endian: order == ">", ..self }
    }

    /// Decodes one element.
    fn element(self, bytes: &[u8]) -> f64 {
        let mut word = [0; 8];
        for (k, slot) in word[..self.size].iter_mut().enumerate() {
            *slot = bytes[if self.big_endian { self.size - 1 - k } else { k }];
        }
        let unsigned = u64::from_le_bytes(word);
        // A shift up and an arithmetic shift down extend the sign.
        let shift = 64 - 8 * self.size as u32;
        match (self.kind, self.size) {
            (b'f', 2) => half::f16::from_bits(unsigned as u16).to_f64(),
            (b'f', 4) => f64::from(f32::from_bits(unsigned as u32)),
            (b'f', _) => f64::from_bits(unsigned),
            (b'i', _) => (((unsigned << shift) as i64) >> shift) as f64,
            _ => unsigned as f64,
        }
    }
}

impl Array {
    /// Decodes raw bytes; Fortran order becomes row-major.
    pub fn from_bytes(bytes: &[u8], dtype: Dtype, shape: Vec<usize>, fortran: bool) -> Outcome<Self> {
        let count = n_elements(&shape)?;
        if bytes.len() != count * dtype.size {
            let (got, size) = (bytes.len(), dtype.size);
            return Err(format!("an array of shape {shape:?} with {size} bytes per element has {got} bytes"));
        }
        let data: Vec<f64> = bytes.chunks_exact(dtype.size).map(|bytes| dtype.element(bytes)).collect();
        let array = Self { shape, data };
        Ok(if fortran { array.row_major() } else { array })
    }

    /// Creates a dense matrix from (row, column, value) triplets; values at the same place are added.
    pub fn from_triplets(shape: [usize; 2], triplets: impl IntoIterator<Item = (usize, usize, f64)>) -> Outcome<Self> {
        let mut data = vec![0.0; n_elements(&shape)?];
        for (row, column, value) in triplets {
            if row >= shape[0] || column >= shape[1] {
                return Err(format!("a sparse matrix of shape {shape:?} has an entry at ({row}, {column})"));
            }
            data[row * shape[1] + column] += value;
        }
        Ok(Self { shape: shape.to_vec(), data })
    }

    /// Returns the elements as indices.
    pub fn indices(&self) -> Outcome<Vec<usize>> {
        let index = |&value: &f64| {
            let whole = value >= 0.0 && value.fract() == 0.0 && value < u32::MAX as f64;
            if whole { Ok(value as usize) } else { Err(format!("{value} is not an index")) }
        };
        self.data.iter().map(index).collect()
    }

    /// Converts Fortran order, in which the first axis varies fastest, to row-major order.
    fn row_major(self) -> Self {
        let mut data = vec![0.0; self.data.len()];
        let mut index = vec![0; self.shape.len()];
        for &value in &self.data {
            let slot = index.iter().zip(&self.shape).fold(0, |slot, (i, n)| slot * n + i);
            data[slot] = value;
            for (i, &n) in index.iter_mut().zip(&self.shape) {
                *i += 1;
                if *i < n {
                    break;
                }
                *i = 0;
            }
        }
        Self { data, ..self }
    }
}

/// Checks the number of dimensions of an array.
///
/// # Errors
/// If it exceeds [`MAX_RANK`].
pub(crate) fn check_rank(rank: usize) -> Outcome<()> {
    if rank <= MAX_RANK {
        Ok(())
    } else {
        Err(format!("expected an array of at most {MAX_RANK} dimensions, got {rank}"))
    }
}

/// Returns the number of elements of a shape.
///
/// # Errors
/// If it exceeds [`MAX_ELEMENTS`], or the shape has too many dimensions.
fn n_elements(shape: &[usize]) -> Outcome<usize> {
    check_rank(shape.len())?;
    let count = shape.iter().try_fold(1usize, |count, &n| count.checked_mul(n)).filter(|&count| count <= MAX_ELEMENTS);
    count.ok_or_else(|| format!("an array of shape {shape:?} is too large for a hand model"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn types_of_both_byte_orders_read_the_same_numbers() {
        let read = |code: &str, bytes: &[u8]| {
            Array::from_bytes(bytes, Dtype::parse(code).unwrap(), vec![1], false).unwrap().data[0]
        };
        assert_eq!(read("<i2", &[0xfe, 0xff]), -2.0);
        assert_eq!(read(">i2", &[0xff, 0xfe]), -2.0);
        assert_eq!(read("<u4", &[0xff; 4]), 4294967295.0);
        assert_eq!(read("|i1", &[0x80]), -128.0);
        assert_eq!(read(">f4", &1.5f32.to_be_bytes()), 1.5);
        assert_eq!(read("f8", &(-2.25f64).to_le_bytes()), -2.25);
        assert!(Dtype::parse("O").unwrap_err().contains("\"O\""));
    }

    #[test]
    fn fortran_order_becomes_row_major() {
        let bytes: Vec<u8> = (0..6u8).collect();
        let array = Array::from_bytes(&bytes, Dtype::parse("|u1").unwrap(), vec![2, 3], true).unwrap();
        assert_eq!(array.data, [0.0, 2.0, 4.0, 1.0, 3.0, 5.0]);
    }

    #[test]
    fn shapes_that_overflow_are_refused() {
        let dtype = Dtype::parse("<f8").unwrap();
        assert!(Array::from_bytes(&[], dtype, vec![usize::MAX, 2], false).is_err());
        assert!(Array::from_bytes(&[0; 8], dtype, vec![2], false).unwrap_err().contains("8 bytes"));
    }
}
