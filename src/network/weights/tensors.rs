//! Turns named tensors and their metadata into safetensors files and back, with the same bytes every time.

use std::collections::BTreeMap;
use std::io::Write;
use std::path::Path;

use half::{bf16, f16};
use safetensors::{Dtype, SafeTensors};
use serde_json::json;

use crate::core::error::{Error, Result};
use crate::core::io;
use crate::network::parameters::Values;

/// Headers are padded so that the numbers begin on such a boundary.
const ALIGNMENT: usize = 8;

/// A borrowed tensor of 32-bit floats on its way to a file.
#[derive(Clone, Copy, Debug)]
pub(crate) struct NamedValues<'a> {
    /// The name in the file.
    pub(crate) name: &'a str,
    /// The shape.
    pub(crate) shape: &'a [usize],
    /// The numbers, in C order.
    pub(crate) values: &'a [f32],
}

/// Tensors and metadata of a file.
#[derive(Clone, Debug, Default)]
pub(crate) struct TensorFile {
    /// The tensors by name, converted to 32-bit floats.
    pub(crate) tensors: BTreeMap<String, Values>,
    /// The metadata.
    pub(crate) metadata: BTreeMap<String, String>,
}

/// Writes tensors in the given order, and metadata sorted by key.
///
/// # Errors
/// [`Error::Io`] when the file cannot be written, or exists and may not be replaced.
pub(crate) fn write(
    path: &Path,
    metadata: &BTreeMap<&str, String>,
    tensors: &[NamedValues<'_>],
    overwrite: bool,
) -> Result<()> {
    let header = header(metadata, tensors);
    io::write_atomically(path, overwrite, |out| {
        out.write_all(&(header.len() as u64).to_le_bytes())?;
        out.write_all(header.as_bytes())?;
        tensors.iter().try_for_each(|tensor| write_values(out, tensor.values))
    })
}

/// The safetensors crate keeps metadata in a hash map, whose order changes from run to run; hence this.
fn header(metadata: &BTreeMap<&str, String>, tensors: &[NamedValues<'_>]) -> String {
    let mut entries = serde_json::Map::new();
    entries.insert("__metadata__".to_owned(), json!(metadata));
    let mut start = 0;
    for tensor in tensors {
        let end = start + size_of_val(tensor.values);
        let entry = json!({"dtype": "F32", "shape": tensor.shape, "data_offsets": [start, end]});
        entries.insert(tensor.name.to_owned(), entry);
        start = end;
    }
    let mut text = serde_json::Value::Object(entries).to_string();
    text.extend(std::iter::repeat_n(' ', text.len().next_multiple_of(ALIGNMENT) - text.len()));
    text
}

fn write_values(out: &mut dyn Write, values: &[f32]) -> std::io::Result<()> {
    let bytes: Vec<u8> = values.iter().flat_map(|value| value.to_le_bytes()).collect();
    out.write_all(&bytes)
}

/// Reads a safetensors file.
///
/// # Errors
/// [`Error::Io`] when it cannot be read; [`Error::Format`] when it is damaged or holds other than floats.
pub(crate) fn read(path: &Path) -> Result<TensorFile> {
    let bytes = std::fs::read(path).map_err(|source| Error::io("read", path, source))?;
    let damaged =
        |error: &dyn std::fmt::Display| Error::format(path, format!("not a safetensors file ({error})"));
    let file = SafeTensors::deserialize(&bytes).map_err(|error| damaged(&error))?;
    let (_, header) = SafeTensors::read_metadata(&bytes).map_err(|error| damaged(&error))?;
    let metadata = header.metadata().clone().unwrap_or_default().into_iter().collect();
    let mut tensors = BTreeMap::new();
    for (name, view) in file.iter() {
        let Some(values) = to_f32(view.dtype(), view.data()) else {
            let reason = format!("tensor {name} holds {:?}, expected floats", view.dtype());
            return Err(Error::format(path, reason));
        };
        tensors.insert(name.to_owned(), Values { shape: view.shape().to_vec(), values });
    }
    Ok(TensorFile { tensors, metadata })
}

/// Converts little-endian floats of any width; `None` for other types.
pub(super) fn to_f32(dtype: Dtype, bytes: &[u8]) -> Option<Vec<f32>> {
    Some(match dtype {
        Dtype::F32 => bytes.as_chunks().0.iter().map(|b| f32::from_le_bytes(*b)).collect(),
        Dtype::F16 => bytes.as_chunks().0.iter().map(|b| f16::from_le_bytes(*b).to_f32()).collect(),
        Dtype::BF16 => bytes.as_chunks().0.iter().map(|b| bf16::from_le_bytes(*b).to_f32()).collect(),
        #[expect(clippy::cast_possible_truncation, reason = "weights are computed with as 32-bit floats")]
        Dtype::F64 => bytes.as_chunks().0.iter().map(|b| f64::from_le_bytes(*b) as f32).collect(),
        _ => return None,
    })
}
