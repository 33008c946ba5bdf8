//! Describes files of tensors: kernel banks, and tensors of unknown use.

use std::collections::BTreeMap;
use std::fmt::{self, Write as _};
use std::path::Path;

use safetensors::SafeTensors;
use serde::Serialize;
use serde_json::Value;

use super::text::{number, plain, write_lines};
use super::{Inspection, ModelDescription};
use crate::core::error::{Error, Result};
use crate::core::kernel_code::KernelBank;
use crate::core::psf::Psf;
use crate::io::{BANK_FORMAT, bank_sha256, read_bank, read_bytes};
use crate::network::weights;

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
pub struct TensorsDescription {
    /// Number of tensors.
    pub tensors: usize,
    /// Number of values in all of them.
    pub parameters: usize,
    /// What the file says about itself; JSON where a value is JSON.
    pub metadata: BTreeMap<String, Value>,
}

/// Looks at a file of tensors, told by the format that its metadata names.
pub(super) fn inspect_tensors(path: &Path) -> Result<Inspection> {
    let found = TensorsDescription::read(path)?;
    match found.metadata.get("format").and_then(Value::as_str) {
        Some(BANK_FORMAT) => BankDescription::read(path).map(Inspection::KernelBank),
        Some(weights::FORMAT) => ModelDescription::read(path).map(Inspection::Model),
        _ => Ok(Inspection::Tensors(found)),
    }
}

impl TensorsDescription {
    /// Describes any file of tensors by its header.
    pub(super) fn read(path: &Path) -> Result<Self> {
        let bytes = read_bytes(path)?;
        let (_, header) = SafeTensors::read_metadata(&bytes)
            .map_err(|error| Error::format(path, format!("is no safetensors file: {error}")))?;
        let tensors = header.tensors();
        let values = |name: &String| tensors[name].shape.iter().product::<usize>();
        let as_json = |text: String| serde_json::from_str(&text).unwrap_or(Value::String(text));
        let metadata = header.metadata().clone().unwrap_or_default();
        Ok(Self {
            tensors: tensors.len(),
            parameters: header.offset_keys().iter().map(values).sum(),
            metadata: metadata.into_iter().map(|(key, text)| (key, as_json(text))).collect(),
        })
    }
}

impl BankDescription {
    fn read(path: &Path) -> Result<Self> {
        let bank = read_bank(path)?;
        let total = total_variance(&bank);
        Ok(Self {
            kernels: bank.len(),
            width: bank.psfs[0].width(),
            height: bank.psfs[0].height(),
            code_dim: bank.code_dim(),
            explained_share: bank.basis.explained_variance.iter().map(|&v| f64::from(v) / total).collect(),
            codes: bank.codes.rows().into_iter().map(|code| code.to_vec()).collect(),
            angles_deg: bank.angles_deg,
            origin: bank.origin,
            sha256: bank_sha256(path)?,
        })
    }

    fn write(&self, text: &mut String) -> fmt::Result {
        writeln!(
            text,
            "kernel bank, {} PSFs of {} × {} (width × height), codes of {}",
            self.kernels, self.width, self.height, self.code_dim
        )?;
        let shares: Vec<String> =
            self.explained_share.iter().map(|share| format!("{:.2} %", share * 100.0)).collect();
        // A bank of one PSF has none, and the sum of nothing is −0.
        let sum = self.explained_share.iter().fold(0.0, |sum, share| sum + share);
        writeln!(text, "  variance  {} ({:.2} % together)", shares.join(", "), sum * 100.0)?;
        for (index, code) in self.codes.iter().enumerate() {
            let name = match &self.angles_deg {
                Some(angles) => format!("{:+}°", angles[index]),
                None => format!("#{}", index + 1),
            };
            let code: Vec<String> =
                code.iter().map(|&value| format!("{:>10}", number(f64::from(value)))).collect();
            writeln!(text, "  code {name:<5}{}", code.join(" "))?;
        }
        if let Some(rotation) = self.origin.as_ref().and_then(|origin| origin["rotation"].as_str()) {
            writeln!(text, "  rotation  by {rotation}")?;
        }
        writeln!(text, "  sha256    {}", self.sha256)
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

impl fmt::Display for BankDescription {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write_lines(f, |text| self.write(text))
    }
}

impl fmt::Display for TensorsDescription {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write_lines(f, |text| {
            writeln!(text, "safetensors, {} tensors, {} parameters", self.tensors, self.parameters)?;
            self.metadata.iter().try_for_each(|(key, value)| writeln!(text, "  {key:<9} {}", plain(value)))
        })
    }
}
