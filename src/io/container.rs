//! Lays `f32` tensors and metadata out as a safetensors file, the same bytes every time, in full or half width.
//!
//! The format: the header's length (8 bytes), the header in JSON, the tensors. The `safetensors` crate writes
//! metadata in the random order of its hash map; here it is sorted.

use std::borrow::Cow;
use std::collections::{BTreeMap, HashMap};
use std::io::Write;
use std::path::Path;

use half::f16;
use safetensors::{Dtype, SafeTensors};
use serde_json::{Map, Value, json};

use super::atomic::{check_output, write_atomically};
use crate::core::error::{Error, Result};
use crate::core::image::all_finite;

/// Shape and values of one tensor, borrowed where the caller has them in one piece.
pub type TensorData<'a> = (Vec<usize>, Cow<'a, [f32]>);

/// How wide the floats of a file are.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum FloatWidth {
    /// 32 bits.
    #[default]
    Single,
    /// 16 bits, rounded to nearest: 2⁻¹¹ of a value, and 65504 at most.
    Half,
}

/// Writes tensors and metadata as a safetensors file, the same bytes every time.
///
/// # Errors
/// [`Error::Io`] when the file cannot be written, or exists without `overwrite`; [`Error::Unsupported`] naming a tensor
/// whose values half floats do not reach.
///
/// # Panics
/// When a tensor's values do not fill its shape: a broken invariant of the caller.
pub fn write_safetensors(
    path: &Path,
    tensors: &BTreeMap<String, TensorData<'_>>,
    metadata: &BTreeMap<String, String>,
    width: FloatWidth,
    overwrite: bool,
) -> Result<()> {
    check_output(path, overwrite)?;
    if width == FloatWidth::Half {
        tensors.iter().try_for_each(|(name, (_, values))| check_half(name, values))?;
    }
    write_atomically(path, overwrite, |file| encode_safetensors(file, tensors, metadata, width))
}

/// Refuses values that half floats would turn into infinities.
fn check_half(name: &str, values: &[f32]) -> Result<()> {
    let overflows = |value: &&f32| value.is_finite() && !f16::from_f32(**value).is_finite();
    match values.iter().find(overflows) {
        None => Ok(()),
        Some(value) => Err(Error::Unsupported(format!(
            "half floats end at 65504 and tensor {name} holds {value}; write it in full width"
        ))),
    }
}

pub(super) fn encode_safetensors(
    file: &mut dyn Write,
    tensors: &BTreeMap<String, TensorData<'_>>,
    metadata: &BTreeMap<String, String>,
    width: FloatWidth,
) -> std::io::Result<()> {
    let header = header_of(tensors, metadata, width);
    file.write_all(&(header.len() as u64).to_le_bytes())?;
    file.write_all(&header)?;
    for (_, values) in tensors.values() {
        let bytes = match width {
            FloatWidth::Single => le_bytes(values),
            FloatWidth::Half => values.iter().flat_map(|v| f16::from_f32(*v).to_le_bytes()).collect(),
        };
        file.write_all(&bytes)?;
    }
    Ok(())
}

fn header_of(
    tensors: &BTreeMap<String, TensorData<'_>>,
    metadata: &BTreeMap<String, String>,
    width: FloatWidth,
) -> Vec<u8> {
    let (dtype, value_bytes) = match width {
        FloatWidth::Single => ("F32", size_of::<f32>()),
        FloatWidth::Half => ("F16", size_of::<f16>()),
    };
    let mut header = Map::from_iter([("__metadata__".to_owned(), json!(metadata))]);
    let mut start = 0;
    for (name, (shape, values)) in tensors {
        assert_eq!(shape.iter().product::<usize>(), values.len(), "tensor `{name}` must fill its shape");
        let end = start + values.len() * value_bytes;
        header.insert(name.clone(), json!({"dtype": dtype, "shape": shape, "data_offsets": [start, end]}));
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
