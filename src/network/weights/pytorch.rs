//! Reads the weights of a PyTorch checkpoint (`.pth`) and recognises the network that they belong to.

use std::collections::BTreeMap;
use std::path::Path;

use burn::store::pytorch_reader::{DType, PytorchError, PytorchReader};
use safetensors::Dtype;

use super::tensors::{TensorFile, converter};
use crate::core::error::{Error, Result};
use crate::core::image::CHANNELS;
use crate::network::architecture::{Architecture, Condition, Scales};
use crate::network::parameters::TensorValues;

/// Where checkpoints keep their weights, the preferred place first: averaged weights before the last ones.
const TOP_LEVEL_KEYS: [&str; 4] = ["params_ema", "params", "state_dict", "model"];

/// What `torch.nn.DataParallel` puts before every name.
const WRAPPER_PREFIX: &str = "module.";

/// Reads the wanted tensors of the checkpoint's preferred state dict.
///
/// # Errors
/// [`Error::Io`] when the file cannot be read; [`Error::Format`] when it is no checkpoint of floats.
pub(super) fn read(path: &Path, wanted: &dyn Fn(&str) -> bool) -> Result<TensorFile> {
    let reader = PytorchReader::new(path).map_err(|error| match error {
        PytorchError::Io(source) if source.kind() != std::io::ErrorKind::InvalidData => {
            Error::io("read", path, source)
        }
        other => Error::format(path, format!("not a PyTorch checkpoint ({other})")),
    })?;
    let all = reader.into_tensors();
    let is_below =
        |key: &str| all.keys().any(|name| name.strip_prefix(key).is_some_and(|rest| rest.starts_with('.')));
    let key = TOP_LEVEL_KEYS.into_iter().find(|key| is_below(key));
    let mut file = TensorFile::default();
    for (name, tensor) in all.into_iter().collect::<BTreeMap<_, _>>() {
        let Some(name) = strip(&name, key).filter(|name| wanted(name)) else { continue };
        let Some(dtype) = float_type(tensor.dtype()) else {
            let reason = format!("tensor {name} holds {:?}, expected floats", tensor.dtype());
            return Err(Error::format(path, reason));
        };
        let bytes = tensor.read().map_err(|error| Error::format(path, error.to_string()))?;
        let mut values = Vec::with_capacity(tensor.shape().iter().product());
        converter(dtype).expect("every float type converts")(&mut values, &bytes);
        file.tensors.insert(name.to_owned(), TensorValues { shape: tensor.shape().to_vec(), values });
    }
    if let Some(key) = key {
        file.metadata.insert("state-dict".to_owned(), key.to_owned());
    }
    Ok(file)
}

/// The name within the chosen state dict; `None` for tensors of others.
fn strip<'a>(name: &'a str, key: Option<&str>) -> Option<&'a str> {
    let name = match key {
        Some(key) => name.strip_prefix(key)?.strip_prefix('.')?,
        None => name,
    };
    Some(name.strip_prefix(WRAPPER_PREFIX).unwrap_or(name))
}

fn float_type(dtype: DType) -> Option<Dtype> {
    Some(match dtype {
        DType::F64 => Dtype::F64,
        DType::F32 => Dtype::F32,
        DType::F16 => Dtype::F16,
        DType::BF16 => Dtype::BF16,
        _ => return None,
    })
}

/// Recognises an architecture by the shapes of a few telling tensors.
///
/// A condition encoder of three inputs reads the image, one of five the code, one of eight or more both:
/// codes of the published length. Any other is for a model file to say.
///
/// # Errors
/// [`Error::Unsupported`] when the tensors are not those of a DISCNet.
pub(super) fn infer_architecture(tensors: &BTreeMap<String, TensorValues>) -> Result<Architecture> {
    let shape = |name: &str| tensors.get(name).map(|tensor| tensor.shape.as_slice());
    let Some(&[features, CHANNELS, 3, 3]) = shape("conv_11.0.weight") else {
        let names: Vec<&str> = tensors.keys().take(3).map(String::as_str).collect();
        return Err(Error::Unsupported(format!(
            "no weights of a DISCNet: expected conv_11.0.weight of shape [n, 3, 3, 3] among them, found {}",
            if names.is_empty() { "no tensors".to_owned() } else { names.join(", ") }
        )));
    };
    let default = Architecture::default();
    let (condition, code_dim) = match shape("kconv_11.0.weight") {
        None => (Condition::None, default.code_dim),
        Some(&[_, CHANNELS, _, _]) => (Condition::Image, default.code_dim),
        Some(&[_, inputs, _, _]) if inputs == default.code_dim => (Condition::Psf, inputs),
        Some(&[_, inputs, _, _]) if inputs >= CHANNELS + default.code_dim => {
            (Condition::ImagePsf, inputs - CHANNELS)
        }
        Some(other) => {
            let reason = format!("cannot tell what a condition encoder with weights {other:?} reads");
            return Err(Error::Unsupported(reason));
        }
    };
    let filter_size = match shape("dynamic_kernel.3.0.weight") {
        None => default.filter_size,
        Some(&[filters, ..]) => (filters / (4 * features).max(1)).isqrt(),
        Some([]) => {
            let reason =
                "dynamic_kernel.3.0.weight is a single number, expected the weights of a convolution";
            return Err(Error::Unsupported(reason.to_owned()));
        }
    };
    let is_multi = condition == Condition::None || tensors.contains_key("dynamic_kernel1.3.0.weight");
    let scales = if is_multi { Scales::Multi } else { Scales::Single };
    let architecture = Architecture { features, condition, scales, filter_size, code_dim, ..default };
    architecture.validate()?;
    Ok(architecture)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn weights_without_axes_are_no_network() {
        let tensor = |shape: &[usize]| TensorValues {
            shape: shape.to_vec(),
            values: vec![0.0; shape.iter().product()],
        };
        let mut tensors = BTreeMap::from([
            ("conv_11.0.weight".to_owned(), tensor(&[4, CHANNELS, 3, 3])),
            ("dynamic_kernel.3.0.weight".to_owned(), tensor(&[])),
        ]);
        let message = infer_architecture(&tensors).unwrap_err().to_string();
        assert!(message.contains("dynamic_kernel.3.0.weight is a single number"), "{message}");
        tensors.insert("conv_11.0.weight".to_owned(), tensor(&[]));
        assert!(infer_architecture(&tensors).is_err());
    }
}
