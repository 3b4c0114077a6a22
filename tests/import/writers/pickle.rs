//! Pickles of dictionaries, numpy arrays and PyTorch tensors, as Python writes them.

/// A value to pickle.
pub enum Py {
    Int(i64),
    Text(String),
    List(Vec<Py>),
    Dict(Vec<(Py, Py)>),
    /// A numpy array of f64.
    Array(Vec<usize>, Vec<f64>),
    /// A PyTorch tensor of f32.
    Tensor(Vec<usize>, Vec<f32>),
}

impl Py {
    pub fn text(text: &str) -> Self {
        Self::Text(text.into())
    }

    /// Returns a dictionary with text keys.
    pub fn dict<const N: usize>(entries: [(&str, Py); N]) -> Self {
        Self::Dict(entries.into_iter().map(|(key, value)| (Self::text(key), value)).collect())
    }

    /// Pickles the value by protocol 4.
    pub fn pickle(&self) -> Vec<u8> {
        let mut bytes = vec![0x80, 4];
        self.put(&mut bytes);
        bytes.push(b'.');
        bytes
    }

    /// Returns a `.npy` file with this value, as `numpy.save` writes a dictionary.
    pub fn npy(&self) -> Vec<u8> {
        let mut pickle = vec![0x80, 4];
        object_array(&mut pickle, self);
        pickle.push(b'.');
        super::files::npy(&[], "|O", &pickle)
    }

    fn put(&self, bytes: &mut Vec<u8>) {
        match self {
            Self::Int(value) => {
                bytes.push(b'J');
                bytes.extend((*value as i32).to_le_bytes());
            }
            Self::Text(text) => {
                bytes.push(b'X');
                bytes.extend((text.len() as u32).to_le_bytes());
                bytes.extend(text.as_bytes());
            }
            Self::List(items) => {
                bytes.extend(b"](");
                items.iter().for_each(|item| item.put(bytes));
                bytes.push(b'e');
            }
            Self::Dict(entries) => {
                bytes.extend(b"}(");
                for (key, value) in entries {
                    key.put(bytes);
                    value.put(bytes);
                }
                bytes.push(b'u');
            }
            Self::Array(shape, values) => {
                array_start(bytes);
                bytes.extend(b"(K\x01");
                tuple(bytes, shape);
                dtype(bytes, "f8", b"(K\x03X\x01\0\0\0<NNNJ\xff\xff\xff\xffJ\xff\xff\xff\xffK\0t");
                bytes.push(0x89);
                raw(bytes, &values.iter().flat_map(|value| value.to_le_bytes()).collect::<Vec<_>>());
                bytes.extend(b"tb");
            }
            Self::Tensor(shape, values) => {
                bytes.extend(b"ctorch._utils\n_rebuild_tensor_v2\n(ctorch.storage\n_load_from_bytes\n");
                raw(bytes, &storage(values));
                bytes.extend(b"\x85RK\0");
                tuple(bytes, shape);
                let stride: Vec<usize> = (0..shape.len()).map(|axis| shape[axis + 1..].iter().product()).collect();
                tuple(bytes, &stride);
                bytes.extend(b"\x89ccollections\nOrderedDict\n)RtR");
            }
        }
    }
}

/// Begins an array: `_reconstruct(ndarray, (0,), b'b')`, which a state completes.
fn array_start(bytes: &mut Vec<u8>) {
    bytes.extend(b"cnumpy.core.multiarray\n_reconstruct\ncnumpy\nndarray\nK\0\x85C\x01b\x87R");
}

fn object_array(bytes: &mut Vec<u8>, value: &Py) {
    array_start(bytes);
    bytes.extend(b"(K\x01)");
    dtype(bytes, "O8", b"(K\x03X\x01\0\0\0|NNNJ\xff\xff\xff\xffJ\xff\xff\xff\xffK?t");
    bytes.extend(b"\x89]");
    value.put(bytes);
    bytes.extend(b"atb");
}

fn dtype(bytes: &mut Vec<u8>, code: &str, state: &[u8]) {
    bytes.extend(b"cnumpy\ndtype\nX");
    bytes.extend((code.len() as u32).to_le_bytes());
    bytes.extend(code.as_bytes());
    bytes.extend(b"\x89\x88\x87R");
    bytes.extend(state);
    bytes.push(b'b');
}

fn tuple(bytes: &mut Vec<u8>, numbers: &[usize]) {
    bytes.push(b'(');
    for number in numbers {
        bytes.push(b'J');
        bytes.extend((*number as i32).to_le_bytes());
    }
    bytes.push(b't');
}

fn raw(bytes: &mut Vec<u8>, content: &[u8]) {
    bytes.push(b'B');
    bytes.extend((content.len() as u32).to_le_bytes());
    bytes.extend(content);
}

/// Returns the stream that `torch.save` writes of one storage without a zip file: a magic number, the protocol, properties of
/// the machine, a reference to the storage, the names of the storages, then the number of elements and the elements.
fn storage(values: &[f32]) -> Vec<u8> {
    let mut bytes = b"\x80\x02\x8a\x0al\xfc\x9cF\xf9 j\xa8P\x19.\x80\x02M\xe9\x03.".to_vec();
    bytes.extend(b"\x80\x02}(X\x10\0\0\0protocol_versionM\xe9\x03X\x0d\0\0\0little_endian\x88u.");
    bytes.extend(b"\x80\x02(X\x07\0\0\0storagectorch\nFloatStorage\nX\x01\0\0\x000X\x03\0\0\0cpuJ");
    bytes.extend((values.len() as i32).to_le_bytes());
    bytes.extend(b"NtQ.\x80\x02]X\x01\0\0\x000a.");
    bytes.extend((values.len() as i64).to_le_bytes());
    values.iter().for_each(|value| bytes.extend(value.to_le_bytes()));
    bytes
}
