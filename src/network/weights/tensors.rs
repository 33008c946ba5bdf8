//! Turns safetensors files of floats of any width into named 32-bit tensors.

use std::collections::BTreeMap;
use std::path::Path;

use half::{bf16, f16};
use rayon::prelude::*;
use safetensors::tensor::TensorView;
use safetensors::{Dtype, SafeTensors};

use crate::core::error::{Error, Result};
use crate::core::io;
use crate::network::parameters::Values;

/// Tensors and metadata of a file.
#[derive(Clone, Debug, Default)]
pub(crate) struct TensorFile {
    /// The tensors by name, converted to 32-bit floats.
    pub(crate) tensors: BTreeMap<String, Values>,
    /// The metadata.
    pub(crate) metadata: BTreeMap<String, String>,
}

/// Reads a safetensors file.
///
/// # Errors
/// [`Error::Io`] when it cannot be read; [`Error::Format`] when it is damaged or holds other than floats.
pub(crate) fn read(path: &Path) -> Result<TensorFile> {
    let bytes = io::read_bytes(path)?;
    let damaged = |error| Error::format(path, format!("is no safetensors file, or is damaged: {error}"));
    let file = SafeTensors::deserialize(&bytes).map_err(damaged)?;
    let (_, header) = SafeTensors::read_metadata(&bytes).map_err(damaged)?;
    let metadata = header.metadata().clone().unwrap_or_default().into_iter().collect();
    let convert = |(name, view): (&str, TensorView<'_>)| {
        let Some(values) = to_f32(view.dtype(), view.data()) else {
            let reason = format!("tensor {name} holds {:?}; expected floats", view.dtype());
            return Err(Error::format(path, reason));
        };
        Ok((name.to_owned(), Values { shape: view.shape().to_vec(), values }))
    };
    let views: Vec<_> = file.iter().collect();
    let tensors = views.into_par_iter().map(convert).collect::<Result<_>>()?;
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
