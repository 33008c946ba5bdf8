//! Describes files of tensors: kernel banks and models.

use std::collections::BTreeMap;
use std::path::Path;

use safetensors::SafeTensors;
use serde::Serialize;
use serde_json::Value;

use super::FileDescription;
use crate::core::error::{Error, Result};
use crate::core::kernel_code::KernelBank;
use crate::core::psf::Psf;
use crate::io::bank::{self, bank_sha256, read_bank};
use crate::io::format::read_all;

/// A kernel bank.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct BankDescription {
    /// Number of kernels, K.
    pub kernels: usize,
    /// Number of columns of each.
    pub width: usize,
    /// Number of rows of each.
    pub height: usize,
    /// Rotation of each, in degrees.
    pub angles_deg: Option<Vec<f64>>,
    /// Length of a code, b.
    pub code_dim: usize,
    /// The share of the set's variance along each component.
    pub explained_share: Vec<f64>,
    /// The code of each kernel.
    pub codes: Vec<Vec<f32>>,
    /// How the kernels were made, where the bank says it.
    pub origin: Option<Value>,
    /// How other files refer to the bank.
    pub sha256: String,
}

/// A file of tensors.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ModelDescription {
    /// Number of tensors.
    pub tensors: usize,
    /// Number of values in all of them.
    pub parameters: usize,
    /// What the file says about itself; JSON where a value is JSON.
    pub metadata: BTreeMap<String, Value>,
}

pub(super) fn describe_tensors(path: &Path) -> Result<FileDescription> {
    let bytes = read_all(path)?;
    let damaged =
        |error: safetensors::SafeTensorError| Error::format(path, format!("is no safetensors file: {error}"));
    let (_, header) = SafeTensors::read_metadata(&bytes).map_err(damaged)?;
    let metadata = header.metadata().clone().unwrap_or_default();
    if metadata.get("format").is_some_and(|format| format == bank::FORMAT) {
        return Ok(FileDescription::KernelBank(describe_bank(&read_bank(path)?, bank_sha256(path)?)));
    }
    let tensors = header.tensors();
    let parameters =
        header.offset_keys().iter().map(|name| tensors[name].shape.iter().product::<usize>()).sum();
    let as_json = |text: String| serde_json::from_str(&text).unwrap_or(Value::String(text));
    let metadata: BTreeMap<String, String> = metadata.into_iter().collect();
    Ok(FileDescription::Model(ModelDescription {
        tensors: tensors.len(),
        parameters,
        metadata: metadata.into_iter().map(|(key, text)| (key, as_json(text))).collect(),
    }))
}

fn describe_bank(bank: &KernelBank, sha256: String) -> BankDescription {
    let total = total_variance(bank);
    BankDescription {
        kernels: bank.len(),
        width: bank.psfs[0].width(),
        height: bank.psfs[0].height(),
        angles_deg: bank.angles_deg.clone(),
        code_dim: bank.code_dim(),
        explained_share: bank.basis.explained_variance.iter().map(|&v| f64::from(v) / total).collect(),
        codes: bank.codes.rows().into_iter().map(|code| code.to_vec()).collect(),
        origin: bank.origin.clone(),
        sha256,
    }
}

/// The variance of the set over all directions, with K − 1 in the denominator as in the bank.
fn total_variance(bank: &KernelBank) -> f64 {
    let mean = bank.basis.mean.iter();
    let distance = |psf: &Psf| -> f64 {
        psf.as_slice().iter().zip(mean.clone()).map(|(&v, &m)| (f64::from(v) - f64::from(m)).powi(2)).sum()
    };
    bank.psfs.iter().map(distance).sum::<f64>() / (bank.len().max(2) - 1) as f64
}
