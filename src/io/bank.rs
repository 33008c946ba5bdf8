//! Reads and writes kernel banks: safetensors, and the layout of the published dataset.

use std::borrow::Cow;
use std::collections::{BTreeMap, HashMap};
use std::fs::File;
use std::io::{Cursor, Read, Seek, SeekFrom};
use std::path::Path;

use ndarray::{Array, Array1, Array2, Array3, Dimension};
use safetensors::tensor::Metadata;
use safetensors::{Dtype, SafeTensors};
use serde_json::Value;
use sha2::{Digest, Sha256};

use super::array::write_array;
use super::atomic::check_output;
use super::container::{
    FloatWidth, TensorData, encode_safetensors, floats, le_bytes, metadata_of, write_safetensors,
};
use super::format::{Format, read_all};
use super::plain::sha256_of_file;
use super::{WriteOptions, write_psf};
use crate::core::error::{Error, Result};
use crate::core::image::all_finite;
use crate::core::kernel_code::{BankCodes, CodeBasis, KernelBank};
use crate::core::psf::{Psf, hex};

/// What the metadata of a kernel bank calls it.
pub const FORMAT: &str = "udc-kernel-bank";
const VERSION: &str = "1";
/// The metadata that says how the kernels were made.
const ORIGIN: &str = "origin";
const SIGN_RULE: &str = "the first kernel has non-negative coefficients";

/// What an image, or anything else, is that is taken for a bank.
const NO_BANK: &str = "is no kernel bank; `udc codes` makes one of a PSF";

/// Reads a kernel bank (`*.safetensors`).
///
/// # Errors
/// [`Error::Io`] when the file cannot be read; [`Error::Format`] when it is damaged, of another kind or
/// version, or its parts do not fit together.
pub fn read_bank(path: &Path) -> Result<KernelBank> {
    let bytes = read_all(path)?;
    if Format::of_contents(&bytes).is_some() {
        return Err(Error::format(path, NO_BANK));
    }
    parse(&bytes).map_err(|reason| Error::format(path, reason))
}

/// Writes a kernel bank (`*.safetensors`).
///
/// # Errors
/// [`Error::Io`] when the file cannot be written, or exists without `overwrite`.
pub fn write_bank(path: &Path, bank: &KernelBank, overwrite: bool) -> Result<()> {
    let tensors = tensors_of(bank);
    let psf_sha256 = hex(&Sha256::digest(le_bytes(&tensors["psfs"].1)));
    let metadata = metadata_of_bank(bank, psf_sha256);
    write_safetensors(path, &tensors, &metadata, FloatWidth::Single, overwrite)
}

/// The bytes of a kernel bank's file.
///
/// # Panics
/// Never: memory takes all bytes.
pub fn encode_bank(bank: &KernelBank) -> Vec<u8> {
    let tensors = tensors_of(bank);
    let psf_sha256 = hex(&Sha256::digest(le_bytes(&tensors["psfs"].1)));
    let mut bytes = Vec::new();
    encode_safetensors(&mut bytes, &tensors, &metadata_of_bank(bank, psf_sha256), FloatWidth::Single)
        .expect("memory takes all bytes");
    bytes
}

/// Writes a kernel bank as the published dataset is laid out: `<name>_psf_<i>.npy` `[H, W, 3]` and
/// `<name>_code_<i>.npy` `[b]`, i from 1.
///
/// # Errors
/// [`Error::Io`] when a file cannot be written, or one exists without `overwrite`; nothing is written then.
pub fn write_published_bank(folder: &Path, name: &str, bank: &KernelBank, overwrite: bool) -> Result<()> {
    std::fs::create_dir_all(folder).map_err(|source| Error::io("create", folder, source))?;
    let file = |what: &str, index: usize| folder.join(format!("{name}_{what}_{}.npy", index + 1));
    for index in 0..bank.len() {
        check_output(&file("psf", index), overwrite)?;
        check_output(&file("code", index), overwrite)?;
    }
    let options = WriteOptions { overwrite, ..WriteOptions::default() };
    for (index, psf) in bank.psfs.iter().enumerate() {
        write_psf(&file("psf", index), psf, &options)?;
        write_array(&file("code", index), &bank.code(index).to_owned().into_dyn(), overwrite)?;
    }
    Ok(())
}

/// The identity of a bank, by which other files refer to it: SHA-256 of its header and codes, in hexadecimal.
/// The header holds the PSFs' own hash, so that a large bank is identified without being read.
///
/// This is not the SHA-256 of the file; see [`is_bank_of_sha256`].
///
/// # Errors
/// [`Error::Io`] when the file cannot be read; [`Error::Format`] when it is no bank, or not as long as its header says.
pub fn bank_sha256(path: &Path) -> Result<String> {
    let head = open(path).and_then(|file| Head::read(file).map_err(|reason| Error::format(path, reason)))?;
    Ok(head.sha256())
}

/// Whether a bank is the one that a file recorded by `sha256`: its identity ([`bank_sha256`]), or, as other software
/// may have recorded it, the SHA-256 of the whole file, which is read only where the identity is another.
///
/// # Errors
/// As [`bank_sha256`].
pub fn is_bank_of_sha256(path: &Path, sha256: &str) -> Result<bool> {
    Ok(bank_sha256(path)? == sha256 || sha256_of_file(path)? == sha256)
}

/// As [`bank_sha256`], of a bank's bytes.
///
/// # Panics
/// When the bytes are none of [`encode_bank`].
pub fn bank_sha256_of(bytes: &[u8]) -> String {
    Head::read(Cursor::new(bytes)).expect("encoded banks have a head").sha256()
}

/// Reads the codes of a bank without its PSFs.
///
/// # Errors
/// Those of [`read_bank`], as far as they concern what is read.
pub fn read_bank_codes(path: &Path) -> Result<BankCodes> {
    let parse = |head: Head| {
        check_kind(&head.metadata)?;
        let codes = Array2::from_shape_vec((head.shape[0], head.shape[1]), head.values()?)
            .map_err(|error| error.to_string())?;
        BankCodes::new(codes, angles(&head.metadata)?).map_err(|error| error.to_string())
    };
    let head = Head::read(open(path)?);
    head.and_then(parse).map_err(|reason| Error::format(path, reason))
}

fn open(path: &Path) -> Result<File> {
    File::open(path).map_err(|source| Error::io("open", path, source))
}

/// The header of a bank and the bytes of its codes.
struct Head {
    header: Vec<u8>,
    metadata: HashMap<String, String>,
    shape: [usize; 2],
    codes: Vec<u8>,
}

/// The most bytes that a header may declare, far above what a bank needs.
const LONGEST_HEADER: u64 = 1 << 20;

/// The most numbers that codes may have.
const MOST_CODES: usize = 1 << 20;

impl Head {
    fn read(mut file: impl Read + Seek) -> Result<Self, String> {
        let mut length = [0; 8];
        let unreadable = |error: std::io::Error| format!("is no kernel bank: {error}");
        file.read_exact(&mut length).map_err(unreadable)?;
        let declared = u64::from_le_bytes(length);
        if declared > LONGEST_HEADER {
            return Err(format!("{NO_BANK}: its header is too long"));
        }
        let mut header = length.to_vec();
        file.by_ref().take(declared).read_to_end(&mut header).map_err(unreadable)?;
        let table: Metadata = serde_json::from_slice(&header[length.len()..])
            .map_err(|error| format!("is no safetensors file: {error}"))?;
        let metadata = table.metadata().clone().unwrap_or_default();
        let length = file.seek(SeekFrom::End(0)).map_err(unreadable)?;
        let tensors = length.saturating_sub(header.len() as u64);
        if tensors != table.data_len() as u64 {
            let declared = table.data_len();
            return Err(format!("is damaged: its tensors take {declared} bytes, and {tensors} are there"));
        }
        let codes = table.info("codes").ok_or("has no tensor `codes`")?;
        let [count, dim] = codes.shape[..] else {
            return Err(format!("tensor `codes` has shape {:?}; expected two axes", codes.shape));
        };
        if codes.dtype != Dtype::F32 || count.saturating_mul(dim) > MOST_CODES {
            return Err(format!(
                "tensor `codes` is {:?} of {:?}; expected codes in F32",
                codes.shape, codes.dtype
            ));
        }
        let start = (header.len() as u64).saturating_add(codes.data_offsets.0 as u64);
        file.seek(SeekFrom::Start(start)).map_err(unreadable)?;
        let mut bytes = vec![0; count * dim * size_of::<f32>()];
        file.read_exact(&mut bytes).map_err(|_| "is damaged: it ends within its codes")?;
        Ok(Self { header, metadata, shape: [count, dim], codes: bytes })
    }

    fn sha256(&self) -> String {
        let mut hash = Sha256::new();
        hash.update(&self.header);
        hash.update(&self.codes);
        hex(&hash.finalize())
    }

    fn values(&self) -> Result<Vec<f32>, String> {
        let (elements, _) = self.codes.as_chunks::<4>();
        let values: Vec<f32> = elements.iter().map(|&bytes| f32::from_le_bytes(bytes)).collect();
        if !all_finite(&values) {
            return Err("tensor `codes` holds a NaN or an infinity".into());
        }
        Ok(values)
    }
}

fn parse(bytes: &[u8]) -> Result<KernelBank, String> {
    let metadata = metadata_of(bytes)?;
    check_kind(&metadata)?;
    let tensors = SafeTensors::deserialize(bytes).map_err(|error| format!("is damaged: {error}"))?;
    let (shape, values) = floats(&tensors, "psfs")?;
    let [count, 3, height, width] = shape[..] else {
        return Err(format!("tensor `psfs` has shape {shape:?}; expected [K, 3, H, W]"));
    };
    if count == 0 || height == 0 || width == 0 {
        return Err(format!("tensor `psfs` has shape {shape:?}: it is empty"));
    }
    check_hash(&metadata, &tensors)?;
    let psfs = values
        .chunks_exact(3 * height * width)
        .map(|values| psf_of(values, height, width))
        .collect::<Result<_, String>>()?;
    let basis = CodeBasis {
        mean: vector(&tensors, "mean")?,
        components: matrix(&tensors, "components")?,
        explained_variance: vector(&tensors, "explained_variance")?,
    };
    let codes = matrix(&tensors, "codes")?;
    let bank = KernelBank::new(psfs, codes, basis, angles(&metadata)?).map_err(|error| error.to_string())?;
    Ok(KernelBank { origin: origin(&metadata)?, ..bank })
}

fn check_kind(metadata: &HashMap<String, String>) -> Result<(), String> {
    match metadata.get("format").map(String::as_str) {
        Some(FORMAT) => {}
        Some(other) => return Err(format!("is a {other}, not a kernel bank; make one with `udc codes`")),
        None => return Err("does not say that it is a kernel bank; make one with `udc codes`".into()),
    }
    match metadata.get("version").map(String::as_str) {
        Some(VERSION) => Ok(()),
        other => Err(format!(
            "is a kernel bank of version {}; version {VERSION} is read",
            other.unwrap_or("unknown")
        )),
    }
}

fn check_hash(metadata: &HashMap<String, String>, tensors: &SafeTensors<'_>) -> Result<(), String> {
    let found = tensors.tensor("psfs").map(|psfs| hex(&Sha256::digest(psfs.data())));
    match (metadata.get("psf_sha256"), found) {
        (Some(declared), Ok(found)) if *declared == found => Ok(()),
        (None, _) => Err("has no psf_sha256; it is damaged or not made by `udc codes`".into()),
        _ => Err("is damaged: its PSFs do not have the hash that it declares".into()),
    }
}

fn angles(metadata: &HashMap<String, String>) -> Result<Option<Vec<f64>>, String> {
    let parse = |text: &String| serde_json::from_str(text).map_err(|error| format!("angles_deg: {error}"));
    metadata.get("angles_deg").map(parse).transpose().map(Option::flatten)
}

fn origin(metadata: &HashMap<String, String>) -> Result<Option<Value>, String> {
    let parse = |text: &String| serde_json::from_str(text).map_err(|error| format!("{ORIGIN}: {error}"));
    metadata.get(ORIGIN).map(parse).transpose()
}

fn psf_of(values: &[f32], height: usize, width: usize) -> Result<Psf, String> {
    let planes =
        Array3::from_shape_vec((3, height, width), values.to_vec()).map_err(|error| error.to_string())?;
    Psf::from_energy(planes).map_err(|error| error.to_string())
}

fn vector(tensors: &SafeTensors<'_>, name: &str) -> Result<Array1<f32>, String> {
    match floats(tensors, name)? {
        (shape, values) if shape.len() == 1 => Ok(Array1::from_vec(values)),
        (shape, _) => Err(format!("tensor `{name}` has shape {shape:?}; expected one axis")),
    }
}

fn matrix(tensors: &SafeTensors<'_>, name: &str) -> Result<Array2<f32>, String> {
    match floats(tensors, name)? {
        (shape, values) if shape.len() == 2 => {
            Array2::from_shape_vec((shape[0], shape[1]), values).map_err(|error| error.to_string())
        }
        (shape, _) => Err(format!("tensor `{name}` has shape {shape:?}; expected two axes")),
    }
}

fn tensors_of(bank: &KernelBank) -> BTreeMap<String, TensorData<'_>> {
    let (height, width) = (bank.psfs[0].height(), bank.psfs[0].width());
    let psfs = bank.psfs.iter().flat_map(Psf::as_slice).copied().collect();
    let basis = &bank.basis;
    let tensors = [
        ("psfs", (vec![bank.len(), 3, height, width], Cow::Owned(psfs))),
        ("codes", (bank.codes.shape().to_vec(), contiguous(&bank.codes))),
        ("mean", (basis.mean.shape().to_vec(), contiguous(&basis.mean))),
        ("components", (basis.components.shape().to_vec(), contiguous(&basis.components))),
        (
            "explained_variance",
            (basis.explained_variance.shape().to_vec(), contiguous(&basis.explained_variance)),
        ),
    ];
    tensors.into_iter().map(|(name, tensor)| (name.to_owned(), tensor)).collect()
}

fn contiguous<D: Dimension>(array: &Array<f32, D>) -> Cow<'_, [f32]> {
    array.as_slice().map_or_else(|| Cow::Owned(array.iter().copied().collect()), Cow::Borrowed)
}

fn metadata_of_bank(bank: &KernelBank, psf_sha256: String) -> BTreeMap<String, String> {
    let mut metadata = BTreeMap::from([
        ("format", FORMAT.to_owned()),
        ("version", VERSION.to_owned()),
        ("psf_sha256", psf_sha256),
        ("sign_rule", SIGN_RULE.to_owned()),
    ]);
    if let Some(angles) = &bank.angles_deg {
        metadata.insert("angles_deg", serde_json::json!(angles).to_string());
    }
    if let Some(origin) = &bank.origin {
        metadata.insert(ORIGIN, origin.to_string());
    }
    metadata.into_iter().map(|(key, value)| (key.to_owned(), value)).collect()
}
