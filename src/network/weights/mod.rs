//! Turns weight files into networks' weights and back: self-describing safetensors, and PyTorch checkpoints.

mod pytorch;
pub(crate) mod tensors;

use std::collections::BTreeMap;
use std::fmt;
use std::path::Path;

use self::tensors::TensorFile;
use super::architecture::Architecture;
use super::model::{Model, Origin};
use super::parameters::{Parameters, TensorValues};
use super::shipped::shipped;
use crate::core::error::{Error, Result};
use crate::io::{self, FloatWidth};

/// What the metadata of a model file calls its format.
pub const FORMAT: &str = "udc-model";

/// The version of the format that this program writes, and the newest that it reads.
const VERSION: u32 = 1;

/// Everything that a weight file says.
#[derive(Clone, Debug)]
pub struct Weights {
    /// The network that the weights belong to.
    pub architecture: Architecture,
    /// The weights.
    pub parameters: Parameters,
    /// Where they come from.
    pub origin: Origin,
}

/// Reads a model file (`.safetensors`) or a PyTorch checkpoint (any other extension); [`shipped`] models by their names.
///
/// # Errors
/// [`Error::Io`] when the file cannot be read; [`Error::Format`] when it is of another kind, damaged, or
/// when weights are missing, left over or of another shape.
pub fn read(path: &Path) -> Result<Weights> {
    match shipped(path) {
        Some(bytes) => interpret(path, tensors::parse(bytes, path)?),
        None => interpret(path, read_file(path, &|_| true)?),
    }
}

/// Takes a model from the bytes of a model file; `name` is what messages call it.
///
/// # Errors
/// Those of [`read`] for such a file.
pub fn parse(bytes: &[u8], name: &str) -> Result<Weights> {
    let name = Path::new(name);
    interpret(name, tensors::parse(bytes, name)?)
}

/// Reads the tensors of any network's weight file whose names are wanted.
///
/// # Errors
/// [`Error::Io`] when the file cannot be read; [`Error::Format`] when it is damaged or holds other than floats.
pub fn read_tensors(path: &Path, wanted: &dyn Fn(&str) -> bool) -> Result<BTreeMap<String, TensorValues>> {
    let mut tensors = read_file(path, wanted)?.tensors;
    tensors.retain(|name, _| wanted(name));
    Ok(tensors)
}

fn read_file(path: &Path, wanted: &dyn Fn(&str) -> bool) -> Result<TensorFile> {
    if path.is_dir() {
        let there = ["best.safetensors", "model.safetensors"].map(|name| path.join(name));
        let there = there.iter().find(|model| model.is_file());
        let one = there.map_or("a .safetensors or .pth".to_owned(), |model| model.display().to_string());
        return Err(Error::format(path, format!("is a folder; name a file of weights, as {one}")));
    }
    let is_safetensors =
        path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("safetensors"));
    if is_safetensors { tensors::read(path) } else { pytorch::read(path, wanted) }
}

/// Makes a model of what a file of this name holds.
fn interpret(name: &Path, file: TensorFile) -> Result<Weights> {
    let in_file = |error: Error| match error {
        Error::Format { .. } | Error::Io { .. } => error,
        other => Error::format(name, other.to_string()),
    };
    weights_of(file).map_err(in_file)
}

fn weights_of(file: TensorFile) -> Result<Weights> {
    let metadata = &file.metadata;
    check_format(metadata)?;
    let architecture = match metadata.get("architecture") {
        Some(text) => serde_json::from_str(text)
            .map_err(|error| Error::Unsupported(format!("cannot understand its architecture: {error}")))?,
        None => pytorch::infer_architecture(&file.tensors)?,
    };
    architecture.validate()?;
    let origin = Origin {
        training: metadata.get("training").and_then(|text| serde_json::from_str(text).ok()),
        kernel_bank_sha256: metadata.get("kernel_bank_sha256").cloned(),
        state_dict: metadata.get("state-dict").cloned(),
    };
    let parameters = Parameters::from_tensors(&architecture, file.tensors)?;
    Ok(Weights { architecture, parameters, origin })
}

/// Refuses files of our own that are no models; a file that does not say what it is may be one.
fn check_format(metadata: &BTreeMap<String, String>) -> Result<()> {
    match metadata.get("format").map(String::as_str) {
        Some(FORMAT) => {}
        Some(other) if other.starts_with("udc-") => {
            let reason = format!("this is a {other}, not a model; name the file that `udc train` wrote");
            return Err(Error::Unsupported(reason));
        }
        _ => return Ok(()),
    }
    let version = metadata.get("version").map(String::as_str).unwrap_or_default();
    match version.parse::<u32>() {
        Ok(1..=VERSION) => Ok(()),
        _ => Err(Error::Unsupported(format!(
            "the model has version {version:?} of the format and this program reads up to {VERSION}; use a newer \
             udc"
        ))),
    }
}

/// Writes a model file, which PyTorch can load under the released names as well.
///
/// # Errors
/// [`Error::Io`] when the file cannot be written, or exists and may not be replaced.
pub fn write(path: &Path, weights: &Weights, overwrite: bool) -> Result<()> {
    write_as(path, weights, FloatWidth::Single, overwrite)
}

fn write_as(path: &Path, weights: &Weights, width: FloatWidth, overwrite: bool) -> Result<()> {
    let mut metadata = BTreeMap::from([
        ("format", FORMAT.to_owned()),
        ("version", VERSION.to_string()),
        ("architecture", weights.architecture.to_json().to_string()),
    ]);
    let origin = &weights.origin;
    metadata.extend(origin.training.as_ref().map(|training| ("training", training.to_string())));
    metadata.extend(origin.kernel_bank_sha256.clone().map(|hash| ("kernel_bank_sha256", hash)));
    let metadata = metadata.into_iter().map(|(key, value)| (key.to_owned(), value)).collect();
    let tensors = weights.parameters.iter().map(|p| (p.name.clone(), p.as_tensor())).collect();
    io::write_safetensors(path, &tensors, &metadata, width, overwrite)
}

/// Rewrites a weight file of any readable kind as a model file with floats of a width.
///
/// # Errors
/// Those of [`read()`] and [`write()`]; [`Error::Config`] when the output is not named `.safetensors`;
/// [`Error::Unsupported`] naming a tensor whose values half floats do not reach.
pub fn convert(input: &Path, output: &Path, width: FloatWidth, overwrite: bool) -> Result<()> {
    if output.extension().is_none_or(|extension| !extension.eq_ignore_ascii_case("safetensors")) {
        let reason = format!("models are written as .safetensors, which {} is not", output.display());
        return Err(Error::config("output", reason));
    }
    write_as(output, &read(input)?, width, overwrite)
}

/// What a weight file is, for people to read.
#[derive(Clone, Debug)]
pub struct Description {
    /// The network.
    pub architecture: Architecture,
    /// Where the weights come from.
    pub origin: Origin,
}

/// Describes a weight file after checking all of it.
///
/// # Errors
/// Those of [`read`].
pub fn describe(path: &Path) -> Result<Description> {
    let Weights { architecture, origin, .. } = read(path)?;
    Ok(Description { architecture, origin })
}

impl fmt::Display for Description {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "model\n{}", self.architecture.describe())?;
        if let Some(key) = &self.origin.state_dict {
            write!(f, "\n  {:<14}{key}", "weights of")?;
        }
        if let Some(hash) = &self.origin.kernel_bank_sha256 {
            write!(f, "\n  {:<14}{hash}", "kernel bank")?;
        }
        let trained = |key: &str| self.origin.training.as_ref().and_then(|training| training.get(key));
        if let Some(iteration) = trained("iteration") {
            write!(f, "\n  {:<14}{iteration} iterations", "trained for")?;
        }
        if let Some(sets) = trained("instruction-sets").and_then(serde_json::Value::as_str) {
            write!(f, "\n  {:<14}{sets} instructions", "computed with")?;
        }
        Ok(())
    }
}

impl Model {
    /// Writes the model as a file that describes itself.
    ///
    /// # Errors
    /// [`Error::Io`] when the file cannot be written, or exists and may not be replaced.
    pub fn save(&self, path: &Path, overwrite: bool) -> Result<()> {
        write(path, self.weights(), overwrite)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::tone::ToneCurve;
    use crate::network::{Condition, Initialisation, Kind};
    use serde_json::json;

    fn weights() -> Weights {
        let architecture =
            Architecture { features: 1, filter_size: 3, code_dim: 2, ..Architecture::default() };
        let parameters = Parameters::random(&architecture, Initialisation::Released, 5);
        let origin = Origin {
            training: Some(json!({"iteration": 12, "tone-curve": ToneCurve { alpha: 0.3, x_max: 40.0 }})),
            kernel_bank_sha256: Some("ab".to_owned()),
            state_dict: None,
        };
        Weights { architecture, parameters, origin }
    }

    /// Writes tensors with metadata of one's own.
    fn write_raw(path: &Path, weights: &Weights, metadata: &[(&str, &str)]) {
        let own = |(key, value): &(&str, &str)| ((*key).to_owned(), (*value).to_owned());
        let tensors = weights.parameters.iter().map(|p| (p.name.clone(), p.as_tensor())).collect();
        let metadata = metadata.iter().map(own).collect();
        io::write_safetensors(path, &tensors, &metadata, FloatWidth::Single, true).unwrap();
    }

    fn refusal(path: &Path) -> String {
        read(path).unwrap_err().to_string()
    }

    #[test]
    fn a_model_file_returns_everything_and_describes_itself() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("model.safetensors");
        let saved = weights();
        Model::new(saved.clone()).save(&path, false).unwrap();
        let found = read(&path).unwrap();
        assert_eq!((found.architecture, found.parameters), (saved.architecture, saved.parameters));
        assert_eq!(found.origin, saved.origin);
        assert_eq!(found.origin.tone_curve(), Some(ToneCurve { alpha: 0.3, x_max: 40.0 }));
        let text = describe(&path).unwrap().to_string();
        for part in ["condition     image+psf", "filter-size   3", "12 iterations", "kernel bank   ab"] {
            assert!(text.contains(part), "{text}");
        }
    }

    #[test]
    fn an_origin_without_a_usable_tone_curve_has_none() {
        let none = json!({"iteration": 12});
        let negative = json!({"tone-curve": {"alpha": -1.0, "x-max": 500.0}});
        for training in [None, Some(none), Some(negative)] {
            assert_eq!(Origin { training, ..Origin::default() }.tone_curve(), None);
        }
    }

    #[test]
    fn models_of_every_kind_return_as_they_were_saved() {
        let folder = tempfile::tempdir().unwrap();
        let kinds = [
            (Kind::Unet, Condition::None),
            (Kind::Srmdnf, Condition::ImagePsf),
            (Kind::Sftmd, Condition::ImagePsf),
            (Kind::DeUnet, Condition::Image),
            (Kind::Guided, Condition::None),
        ];
        for (kind, condition) in kinds {
            let path = folder.path().join(format!("{kind:?}.safetensors"));
            let architecture = Architecture { kind, condition, features: 2, ..Architecture::default() };
            let parameters = Parameters::random(&architecture, Initialisation::Released, 5);
            let saved = Weights { architecture, parameters, origin: Origin::default() };
            Model::new(saved.clone()).save(&path, false).unwrap();
            let found = read(&path).unwrap();
            assert_eq!((found.architecture, found.parameters), (saved.architecture, saved.parameters));
        }
    }

    /// Half floats keep eleven bits, and do not change when they are read and written again.
    #[test]
    fn a_model_of_half_width_differs_by_its_rounding_alone() {
        let folder = tempfile::tempdir().unwrap();
        let paths = ["full", "half", "again"].map(|name| folder.path().join(format!("{name}.safetensors")));
        let mut saved = weights();
        saved.parameters.iter_mut().next().unwrap().values[0] = 65504.0;
        write(&paths[0], &saved, false).unwrap();
        convert(&paths[0], &paths[1], FloatWidth::Half, false).unwrap();
        convert(&paths[1], &paths[2], FloatWidth::Half, false).unwrap();
        let [full, half, again] = paths.each_ref().map(|path| std::fs::read(path).unwrap());
        assert!(half == again);
        // Behind the header's length and the header.
        let [full, half] = [full, half].map(|bytes| {
            bytes.len() as u64 - 8 - u64::from_le_bytes(*bytes.first_chunk().expect("eight bytes and more"))
        });
        assert_eq!((full, half), (4 * saved.architecture.parameters(), 2 * saved.architecture.parameters()));
        let found = read(&paths[1]).unwrap();
        assert_eq!((&found.architecture, &found.origin), (&saved.architecture, &saved.origin));
        assert_ne!(found.parameters, saved.parameters);
        for (found, saved) in found.parameters.iter().zip(saved.parameters.iter()) {
            for (a, b) in found.values.iter().zip(&saved.values) {
                // Below the smallest normal number of half floats the last bit is worth 2⁻²⁴.
                assert!((a - b).abs() <= (b.abs() / 2048.0).max(0.5_f32.powi(25)), "{a} {b}");
            }
        }
    }

    #[test]
    fn weights_beyond_half_floats_are_refused_by_name() {
        let folder = tempfile::tempdir().unwrap();
        let paths = ["full", "half"].map(|name| folder.path().join(format!("{name}.safetensors")));
        let mut large = weights();
        large.parameters.iter_mut().next().unwrap().values[1] = -65520.0;
        write(&paths[0], &large, false).unwrap();
        let message = convert(&paths[0], &paths[1], FloatWidth::Half, false).unwrap_err().to_string();
        assert!(message.contains("conv_11.0.weight holds -65520") && message.contains("65504"), "{message}");
        assert!(!paths[1].exists());
    }

    #[test]
    fn a_model_is_taken_from_bytes_as_from_its_file() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("model.safetensors");
        write_as(&path, &weights(), FloatWidth::Half, false).unwrap();
        let bytes = std::fs::read(&path).unwrap();
        let (parsed, read) = (Model::parse(&bytes, "the model").unwrap(), read(&path).unwrap());
        assert_eq!((parsed.architecture(), parsed.origin()), (&read.architecture, &read.origin));
        assert_eq!(parsed.weights().parameters, read.parameters);
        let refusal = |bytes: &[u8]| parse(bytes, "the model").unwrap_err().to_string();
        for len in [0, 7, 8, 100, bytes.len() - 1] {
            let message = refusal(&bytes[..len]);
            assert!(message.starts_with("the model: is no safetensors file"), "{message}");
        }
    }

    /// PyTorch and others keep weights in bfloat16 as well, which has 32-bit floats' range.
    #[test]
    fn tensors_in_bfloat16_are_read() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("model.safetensors");
        let given = [1.5_f32, -3.0e38, 0.007_812_5];
        let bytes: Vec<u8> = given.iter().flat_map(|v| half::bf16::from_f32(*v).to_le_bytes()).collect();
        let header = r#"{"w":{"dtype":"BF16","shape":[3],"data_offsets":[0,6]}}"#;
        let length = (header.len() as u64).to_le_bytes();
        std::fs::write(&path, [&length[..], header.as_bytes(), &bytes].concat()).unwrap();
        let found = read_tensors(&path, &|_| true).unwrap();
        let expected: Vec<f32> = given.iter().map(|v| half::bf16::from_f32(*v).to_f32()).collect();
        assert_eq!(found["w"], TensorValues { shape: vec![3], values: expected });
    }

    #[test]
    fn tensors_that_pytorch_saved_are_recognised_without_metadata() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("state.safetensors");
        let architecture = Architecture { code_dim: 5, ..weights().architecture };
        let parameters = Parameters::random(&architecture, Initialisation::Released, 5);
        let saved = Weights { architecture, parameters, origin: Origin::default() };
        write_raw(&path, &saved, &[("format", "pt")]);
        assert_eq!(read(&path).unwrap().architecture, saved.architecture);
    }

    #[test]
    fn files_of_another_kind_or_version_are_refused_by_name() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("file.safetensors");
        write_raw(&path, &weights(), &[("format", "udc-kernel-bank")]);
        assert!(refusal(&path).contains("this is a udc-kernel-bank, not a model"));
        write_raw(&path, &weights(), &[("format", "udc-model"), ("version", "2")]);
        assert!(refusal(&path).contains("use a newer udc"));
        std::fs::write(&path, "not tensors").unwrap();
        assert!(refusal(&path).contains("is no safetensors file"));
        let path = folder.path().join("file.pth");
        std::fs::write(&path, "not a pickle").unwrap();
        assert!(refusal(&path).contains("not a PyTorch checkpoint"));
        assert!(matches!(read(&folder.path().join("absent.pth")), Err(Error::Io { .. })));
        assert!(matches!(read(&folder.path().join("absent.safetensors")), Err(Error::Io { .. })));
    }

    #[test]
    fn weights_that_do_not_fit_the_declared_network_are_named() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("model.safetensors");
        let declare = |change: fn(&mut Architecture)| {
            let mut architecture = weights().architecture;
            change(&mut architecture);
            let text = architecture.to_json().to_string();
            write_raw(
                &path,
                &weights(),
                &[("format", "udc-model"), ("version", "1"), ("architecture", &text)],
            );
            refusal(&path)
        };
        let message = declare(|a| a.filter_size = 5);
        assert!(message.contains("dynamic_kernel1.3.0.weight: expected [25, 1, 1, 1], found [9, 1, 1, 1]"));
        let message = declare(|a| a.condition = Condition::None);
        assert!(message.contains("no place for the weights dynamic_kernel") && message.contains("more"));
        let mut nan = weights();
        nan.parameters.iter_mut().next().unwrap().values[3] = f32::NAN;
        write(&path, &nan, true).unwrap();
        assert!(refusal(&path).contains("conv_11.0.weight hold a NaN"));
    }

    #[test]
    fn a_network_of_fewer_weights_than_declared_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("model.safetensors");
        let mut plain = weights();
        plain.architecture.condition = Condition::None;
        plain.parameters = Parameters::random(&plain.architecture, Initialisation::Released, 5);
        let text = weights().architecture.to_json().to_string();
        write_raw(&path, &plain, &[("format", "udc-model"), ("version", "1"), ("architecture", &text)]);
        let message = refusal(&path);
        assert!(message.contains("lack kconv_11.0.weight, kconv_11.0.bias") && message.contains("more"));
    }

    #[test]
    fn conversion_wants_a_safetensors_name() {
        let (input, output) = (Path::new("a.pth"), Path::new("b.pth"));
        let message = convert(input, output, FloatWidth::Single, false).unwrap_err().to_string();
        assert!(message.contains(".safetensors"), "{message}");
    }
}
