//! Lays `f32` tensors and metadata out as a safetensors file, the same bytes every time.
//!
//! The format: the header's length (8 bytes), the header in JSON, the tensors. The `safetensors` crate writes
//! metadata in the random order of its hash map; here it is sorted.

use std::borrow::Cow;
use std::collections::{BTreeMap, HashMap};
use std::io::Write;
use std::path::Path;

use safetensors::{Dtype, SafeTensors};
use serde_json::{Map, Value, json};

use super::atomic::{check_output, write_atomically};
use crate::core::error::Result;
use crate::core::image::all_finite;

/// Shape and values of one tensor, borrowed where the caller has them in one piece.
pub type TensorData<'a> = (Vec<usize>, Cow<'a, [f32]>);

/// Writes tensors and metadata as a safetensors file, the same bytes every time.
///
/// # Errors
/// [`Error::Io`](crate::core::error::Error::Io) when the file cannot be written, or exists without `overwrite`.
///
/// # Panics
/// When a tensor's values do not fill its shape: a broken invariant of the caller.
pub fn write_safetensors(
    path: &Path,
    tensors: &BTreeMap<String, TensorData<'_>>,
    metadata: &BTreeMap<String, String>,
    overwrite: bool,
) -> Result<()> {
    check_output(path, overwrite)?;
    write_atomically(path, overwrite, |file| encode_safetensors(file, tensors, metadata))
}

pub(super) fn encode_safetensors(
    file: &mut dyn Write,
    tensors: &BTreeMap<String, TensorData<'_>>,
    metadata: &BTreeMap<String, String>,
) -> std::io::Result<()> {
    let header = header_of(tensors, metadata);
    file.write_all(&(header.len() as u64).to_le_bytes())?;
    file.write_all(&header)?;
    for (_, values) in tensors.values() {
        file.write_all(&le_bytes(values))?;
    }
    Ok(())
}

fn header_of(tensors: &BTreeMap<String, TensorData<'_>>, metadata: &BTreeMap<String, String>) -> Vec<u8> {
    let mut header = Map::from_iter([("__metadata__".to_owned(), json!(metadata))]);
    let mut start = 0;
    for (name, (shape, values)) in tensors {
        assert_eq!(shape.iter().product::<usize>(), values.len(), "tensor `{name}` must fill its shape");
        let end = start + size_of_val(&values[..]);
        header.insert(name.clone(), json!({"dtype": "F32", "shape": shape, "data_offsets": [start, end]}));
        start = end;
    }
    let mut text = Value::Object(header).to_string().into_bytes();
    // The tensors start on a multiple of 8 bytes.
    text.resize(text.len().next_multiple_of(8), b' ');
    text
}

/// The little-endian bytes of values.
pub(super) fn le_bytes(values: &[f32]) -> Vec<u8> {
    let mut bytes = Vec::with_capacity(size_of_val(values));
    bytes.extend(values.iter().flat_map(|value| value.to_le_bytes()));
    bytes
}

/// The metadata of a safetensors file; empty when it has none.
pub(super) fn metadata_of(bytes: &[u8]) -> Result<HashMap<String, String>, String> {
    let (_, header) =
        SafeTensors::read_metadata(bytes).map_err(|error| format!("is no safetensors file: {error}"))?;
    Ok(header.metadata().clone().unwrap_or_default())
}

/// Shape and values of one finite `f32` tensor.
pub(super) fn floats(tensors: &SafeTensors<'_>, name: &str) -> Result<(Vec<usize>, Vec<f32>), String> {
    let tensor = tensors.tensor(name).map_err(|_| format!("has no tensor `{name}`"))?;
    if tensor.dtype() != Dtype::F32 {
        return Err(format!("tensor `{name}` is of type {:?}; expected F32", tensor.dtype()));
    }
    let (elements, _) = tensor.data().as_chunks::<4>();
    let values: Vec<f32> = elements.iter().map(|&bytes| f32::from_le_bytes(bytes)).collect();
    if !all_finite(&values) {
        return Err(format!("tensor `{name}` holds a NaN or an infinity"));
    }
    Ok((tensor.shape().to_vec(), values))
}
