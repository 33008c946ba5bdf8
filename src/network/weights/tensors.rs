//! Turns safetensors files of floats of any width into named 32-bit tensors.
//!
//! The tensors are read and converted on all threads, each from its place in the file: no copy of the whole file is made.

use std::collections::BTreeMap;
use std::path::Path;

use half::{bf16, f16};
use rayon::prelude::*;
use safetensors::Dtype;
use safetensors::tensor::{Metadata, TensorInfo};

use crate::core::error::{Error, Result};
use crate::io::SharedInput;
use crate::network::parameters::TensorValues;

/// The bytes in front of the header: its length.
const LENGTH_BYTES: usize = size_of::<u64>();

/// Longer headers are not believed, as in other programs.
const LONGEST_HEADER: u64 = 100_000_000;

/// Bytes read at once, which the second-level cache holds.
const CHUNK: usize = 1 << 16;

/// Tensors and metadata of a file.
#[derive(Clone, Debug, Default)]
pub(crate) struct TensorFile {
    /// The tensors by name, converted to 32-bit floats.
    pub(crate) tensors: BTreeMap<String, TensorValues>,
    /// The metadata.
    pub(crate) metadata: BTreeMap<String, String>,
}

/// Bytes of which any thread can read any part.
trait Source: Sync {
    fn size(&self) -> u64;

    /// Fills `to` with the bytes from `offset` on.
    fn read_at(&self, offset: u64, to: &mut [u8]) -> Result<()>;
}

impl Source for SharedInput {
    fn size(&self) -> u64 {
        self.size()
    }

    fn read_at(&self, offset: u64, to: &mut [u8]) -> Result<()> {
        self.read_at(offset, to)
    }
}

/// Bytes in memory.
struct InMemory<'a>(&'a [u8]);

impl Source for InMemory<'_> {
    fn size(&self) -> u64 {
        self.0.len() as u64
    }

    fn read_at(&self, offset: u64, to: &mut [u8]) -> Result<()> {
        let offset = usize::try_from(offset).expect("within what is in memory");
        to.copy_from_slice(&self.0[offset..offset + to.len()]);
        Ok(())
    }
}

/// Reads a safetensors file.
///
/// # Errors
/// [`Error::Io`] when it cannot be read; [`Error::Format`] when it is damaged or holds other than floats.
pub(crate) fn read(path: &Path) -> Result<TensorFile> {
    read_source(&SharedInput::open(path)?, path)
}

/// Takes tensors from the bytes of a safetensors file; `name` is what messages call it.
///
/// # Errors
/// [`Error::Format`] when it is damaged or holds other than floats.
pub(crate) fn parse(bytes: &[u8], name: &Path) -> Result<TensorFile> {
    read_source(&InMemory(bytes), name)
}

fn read_source(file: &impl Source, path: &Path) -> Result<TensorFile> {
    let damaged = |reason: &str| {
        Error::format(path, format!("is no safetensors file, or is damaged: {reason}; copy it again"))
    };
    let mut length = [0; LENGTH_BYTES];
    if file.size() < LENGTH_BYTES as u64 {
        return Err(damaged("it is too short"));
    }
    file.read_at(0, &mut length)?;
    let length = u64::from_le_bytes(length);
    let data = length.saturating_add(LENGTH_BYTES as u64);
    if length > LONGEST_HEADER || data > file.size() {
        return Err(damaged("it has no whole header"));
    }
    #[expect(clippy::cast_possible_truncation, reason = "at most LONGEST_HEADER")]
    let mut header = vec![0; length as usize];
    file.read_at(LENGTH_BYTES as u64, &mut header)?;
    let header: Metadata = serde_json::from_slice(&header).map_err(|error| damaged(&error.to_string()))?;
    if data + header.data_len() as u64 != file.size() {
        return Err(damaged("its tensors are cut off, or something follows them"));
    }
    let metadata = header.metadata().clone().unwrap_or_default().into_iter().collect();
    let convert = |chunk: &mut Vec<u8>, (name, info): (String, &TensorInfo)| {
        let Some(append) = converter(info.dtype) else {
            let reason = format!("tensor {name} holds {:?}; expected floats", info.dtype);
            return Err(Error::format(path, reason));
        };
        let values = read_values(file, data, info, append, chunk)?;
        Ok((name, TensorValues { shape: info.shape.clone(), values }))
    };
    let tensors: Vec<_> = header.tensors().into_iter().collect();
    let tensors = tensors.into_par_iter().map_init(|| vec![0; CHUNK], convert).collect::<Result<_>>()?;
    Ok(TensorFile { tensors, metadata })
}

/// Reads the values of a tensor, whose place is counted from `data`, a chunk at a time.
fn read_values(
    file: &impl Source,
    data: u64,
    info: &TensorInfo,
    append: Append,
    chunk: &mut [u8],
) -> Result<Vec<f32>> {
    let (start, end) = info.data_offsets;
    let mut values = Vec::with_capacity(info.shape.iter().product());
    for at in (start..end).step_by(chunk.len()) {
        let len = chunk.len().min(end - at);
        let bytes = &mut chunk[..len];
        file.read_at(data + at as u64, bytes)?;
        append(&mut values, bytes);
    }
    Ok(values)
}

/// Converts little-endian floats of one width and appends them.
pub(super) type Append = fn(&mut Vec<f32>, &[u8]);

/// What converts floats of a type; `None` for other types.
pub(super) fn converter(dtype: Dtype) -> Option<Append> {
    Some(match dtype {
        Dtype::F32 => |to, bytes| to.extend(bytes.as_chunks().0.iter().map(|b| f32::from_le_bytes(*b))),
        Dtype::F16 => {
            |to, bytes| to.extend(bytes.as_chunks().0.iter().map(|b| f16::from_le_bytes(*b).to_f32()))
        }
        Dtype::BF16 => {
            |to, bytes| to.extend(bytes.as_chunks().0.iter().map(|b| bf16::from_le_bytes(*b).to_f32()))
        }
        #[expect(clippy::cast_possible_truncation, reason = "weights are computed with as 32-bit floats")]
        Dtype::F64 => {
            |to, bytes| to.extend(bytes.as_chunks().0.iter().map(|b| f64::from_le_bytes(*b) as f32))
        }
        _ => return None,
    })
}
