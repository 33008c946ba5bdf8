//! Gives the half floats of safetensors files back as they are stored: half as large in memory as floats.

use std::collections::BTreeMap;
use std::path::Path;

use half::f16;
use safetensors::tensor::TensorView;
use safetensors::{Dtype, SafeTensors};

use super::read_bytes;
use crate::core::error::{Error, Result};

/// A tensor of half floats.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct HalfTensor {
    /// Length of each axis.
    pub shape: Vec<usize>,
    /// All values, the last axis running fastest.
    pub values: Vec<f16>,
}

/// Half floats by name.
pub type HalfTensors = BTreeMap<String, HalfTensor>;

/// Reads the half floats of a safetensors file.
///
/// # Errors
/// [`Error::Io`] when it cannot be read; [`Error::Format`] when it is damaged, or holds other numbers than finite half
/// floats.
pub fn read_half_tensors(path: &Path) -> Result<HalfTensors> {
    let bytes = read_bytes(path)?;
    let damaged = |reason: String| Error::format(path, format!("{reason}; make or copy it again"));
    let file = SafeTensors::deserialize(&bytes)
        .map_err(|error| damaged(format!("is no safetensors file: {error}")))?;
    let read = |(name, tensor): (String, TensorView<'_>)| {
        if tensor.dtype() != Dtype::F16 {
            return Err(damaged(format!("tensor {name} holds {:?} and no half floats", tensor.dtype())));
        }
        let values: Vec<f16> =
            tensor.data().as_chunks::<2>().0.iter().map(|&bytes| f16::from_le_bytes(bytes)).collect();
        if !values.iter().all(|value| value.is_finite()) {
            return Err(damaged(format!("tensor {name} holds a NaN or an infinity")));
        }
        Ok((name, HalfTensor { shape: tensor.shape().to_vec(), values }))
    };
    file.tensors().into_iter().map(read).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::io::{FloatWidth, TensorData, write_safetensors};

    fn write(path: &Path, value: f32) {
        let tensor = |shape: &[usize], first: f32| -> TensorData<'static> {
            let count: usize = shape.iter().product();
            (shape.to_vec(), (0..count).map(|i| first + i as f32).collect::<Vec<_>>().into())
        };
        let tensors = [("b".to_owned(), tensor(&[2, 3], 0.5)), ("a".to_owned(), tensor(&[5], value))];
        write_safetensors(path, &tensors.into(), &BTreeMap::new(), FloatWidth::Half, true).unwrap();
    }

    #[test]
    fn halves_return_as_they_are_stored() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("tensors.safetensors");
        write(&path, -2.0);
        let read = read_half_tensors(&path).unwrap();
        let halves =
            |values: &[f32]| -> Vec<f16> { values.iter().map(|&value| f16::from_f32(value)).collect() };
        assert_eq!((&read["a"].shape[..], &read["b"].shape[..]), (&[5][..], &[2, 3][..]));
        assert_eq!(read["a"].values, halves(&[-2.0, -1.0, 0.0, 1.0, 2.0]));
        assert_eq!(read["b"].values, halves(&[0.5, 1.5, 2.5, 3.5, 4.5, 5.5]));
    }

    #[test]
    fn damaged_files_and_other_numbers_are_refused() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("tensors.safetensors");
        let refusal = || read_half_tensors(&path).unwrap_err().to_string();
        write(&path, f32::NAN);
        assert!(refusal().contains("tensor a holds a NaN"));
        let whole = std::fs::read(&path).unwrap();
        std::fs::write(&path, &whole[..whole.len() - 1]).unwrap();
        assert!(refusal().contains("is no safetensors file"));
        let floats = [("a".to_owned(), (vec![1], vec![1.0].into()))].into();
        write_safetensors(&path, &floats, &BTreeMap::new(), FloatWidth::Single, true).unwrap();
        assert!(refusal().contains("no half floats"));
    }
}
