//! Safetensors files with equal bytes for equal content.

use std::collections::BTreeMap;
use std::path::Path;

use safetensors::SafeTensorError;
use safetensors::tensor::TensorView;

use crate::error::{Error, Result};

/// Returns the bytes of a safetensors file. `path` is the file that errors name.
///
/// The metadata is written here in the order of its keys, because the library writes it in random order.
///
/// # Errors
/// If the header is too large for the format.
pub fn to_bytes<'a>(
    path: &Path,
    views: impl IntoIterator<Item = (&'a str, TensorView<'a>)>,
    metadata: &BTreeMap<String, String>,
) -> Result<Vec<u8>> {
    let failed = |error: SafeTensorError| Error::file(path, format!("not saved: {error}"));
    let plain = safetensors::serialize(views, None).map_err(failed)?;
    // Layout: header length (8 bytes, little endian), header (JSON, padded with spaces to 8 bytes), data.
    let (length, rest) = plain.split_at(8);
    let length = length.iter().rev().fold(0, |sum, byte| sum << 8 | usize::from(*byte));
    let (header, data) = rest.split_at(length);
    let tensors = header[1..].trim_ascii();
    let comma: &[u8] = if tensors == b"}" { b"" } else { b"," };
    let metadata = serde_json::to_vec(metadata).map_err(|error| failed(error.into()))?;
    let mut header = [br#"{"__metadata__":"#, metadata.as_slice(), comma, tensors].concat();
    header.resize(header.len().next_multiple_of(8), b' ');
    Ok([&(header.len() as u64).to_le_bytes(), header.as_slice(), data].concat())
}

#[cfg(test)]
mod tests {
    use safetensors::{Dtype, SafeTensors};

    use super::*;

    #[test]
    fn metadata_is_written_in_the_order_of_its_keys() {
        let metadata: BTreeMap<_, _> = ["c", "a", "b"].map(|key| (key.to_string(), format!("{key} \"1\""))).into();
        let numbers = [1u8, 2, 3, 4];
        for n_tensors in 0..2 {
            let view = || TensorView::new(Dtype::U8, vec![4], &numbers).unwrap();
            let views: Vec<_> = (0..n_tensors).map(|_| ("x", view())).collect();
            let bytes = to_bytes(Path::new("x"), views, &metadata).unwrap();
            let (_, header) = SafeTensors::read_metadata(&bytes).unwrap();
            assert_eq!(header.metadata().clone().unwrap().into_iter().collect::<BTreeMap<_, _>>(), metadata);
            assert_eq!(SafeTensors::deserialize(&bytes).unwrap().len(), n_tensors);
            let text = String::from_utf8_lossy(&bytes);
            let places = ["\"a\"", "\"b\"", "\"c\""].map(|key| text.find(key).unwrap());
            assert!(places.is_sorted(), "{text}");
        }
    }
}
