//! Flags of a few named values: one parser for all of them.

use std::ffi::OsStr;

use clap::builder::{PossibleValue, PossibleValuesParser, TypedValueParser};
use clap::{Arg, Command};

use udc::dataset::{NoiseConfig, Split};
use udc::experiment::RestorationMethod;
use udc::io::DomainTag;
use udc::network::Precision;
use udc::restore::Highlights;
use udc::restore::deconvolution::Method;
use udc::scenes::natural::NaturalKind;

/// The values that a flag takes: the name of each, the value, and what it means where the name does not tell.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Choices<T: 'static>(pub(crate) &'static [Choice<T>]);

/// A value with its name and what it means.
pub(crate) type Choice<T> = (&'static str, T, &'static str);

/// The formats of files in an output folder, as the extensions that stand for them.
pub(crate) const FORMATS: Choices<&str> =
    Choices(&[("exr", "exr", ""), ("npy", "npy", ""), ("png", "png", ""), ("tif", "tif", "")]);

/// The formats of files that keep every bit of a float, as their extensions.
pub(crate) const FLOAT_FORMATS: Choices<&str> = Choices(&[("exr", "exr", ""), ("npy", "npy", "")]);

const LINEAR: (&str, DomainTag, &str) = ("linear", DomainTag::Linear, "Proportional to light");
const TONE_MAPPED: (&str, DomainTag, &str) = (
    "tone-mapped",
    DomainTag::ToneMapped,
    "After the tone mapping φ, as `udc restore` and `udc tonemap` write it",
);
const SRGB: (&str, DomainTag, &str) = (
    "srgb",
    DomainTag::Srgb,
    "Encoded by the curve of sRGB, as the pictures of most cameras and programs; decoded to linear light",
);

/// What the values of an image are.
pub(crate) const DOMAINS: Choices<DomainTag> = Choices(&[LINEAR, TONE_MAPPED, SRGB]);

/// What they are in commands that need linear light.
pub(crate) const LIGHT_DOMAINS: Choices<DomainTag> = Choices(&[LINEAR, SRGB]);

/// What is written.
pub(crate) const OUTPUT_DOMAINS: Choices<DomainTag> = Choices(&[LINEAR, TONE_MAPPED]);

/// What painted scenes show.
pub(crate) const SCENE_KINDS: Choices<NaturalKind> = Choices(&[
    ("leaves", NaturalKind::Leaves, "Dead leaves of power-law sizes, evenly lit"),
    ("lit-leaves", NaturalKind::LitLeaves, "The same, dark below and light above"),
    ("foliage", NaturalKind::Foliage, "Leaves of trees with gaps of bright sky"),
    ("sky", NaturalKind::Sky, "A landscape, mostly with a sun"),
    ("night", NaturalKind::Night, "A street at night"),
    ("indoor", NaturalKind::Indoor, "A room with windows and lamps"),
    ("page", NaturalKind::Page, "Pages of text and line patterns"),
    ("glints", NaturalKind::Glints, "Many small highlights on gravel or water"),
    ("texture", NaturalKind::Texture, "Stone, cloth, clouds: no outlines; only where named"),
]);

/// The parts of a dataset.
pub(crate) const SPLITS: Choices<Split> =
    Choices(&[("train", Split::Train, ""), ("test", Split::Test, ""), ("val", Split::Val, "")]);

const WIENER: Choice<Method> = ("wiener", Method::Wiener, "Wiener–Hunt filter with Laplacian regularisation");
const WIENER_ORIEUX: Choice<Method> =
    ("wiener-orieux", Method::WienerOrieux, "The same, noise and regularisation estimated by Gibbs sampling");
const RICHARDSON_LUCY: Choice<Method> =
    ("richardson-lucy", Method::RichardsonLucy, "Richardson–Lucy iteration");
const CONSTRAINED: Choice<Method> = (
    "constrained",
    Method::Constrained,
    "Non-negative weighted least squares; light around the frame and saturation modelled",
);
const JOINT: Choice<Method> = (
    "joint",
    Method::Joint,
    "The same for all colours together, with their common edges, and with the light of lamps that their flare tells",
);

/// The deconvolutions.
pub(crate) const METHODS: Choices<Method> =
    Choices(&[WIENER, WIENER_ORIEUX, RICHARDSON_LUCY, CONSTRAINED, JOINT]);

/// What restores with nothing but the PSF.
pub(crate) const RESTORATIONS: Choices<RestorationMethod> = Choices(&[
    measured(WIENER),
    measured(WIENER_ORIEUX),
    measured(RICHARDSON_LUCY),
    measured(CONSTRAINED),
    measured(JOINT),
    (
        "guided",
        RestorationMethod::Guided,
        "What `udc restore` does: joint, corrected by the network for any panel",
    ),
    (
        "oracle",
        RestorationMethod::Oracle,
        "A bound, no method: a filter that is told the scene's spectrum everywhere and the light of its lamps",
    ),
]);

const fn measured((name, method, help): Choice<Method>) -> Choice<RestorationMethod> {
    (name, RestorationMethod::Deconvolution(method), help)
}

/// What becomes of saturated pixels.
pub(crate) const HIGHLIGHTS: Choices<Highlights> = Choices(&[
    ("restored", Highlights::Restored, "What the network or the deconvolution makes of them"),
    ("keep", Highlights::Keep, "The capture's values in every saturated pixel, of the channels that are"),
    (
        "blend",
        Highlights::Blend,
        "The capture's values inside of large saturated areas, fading to the restored ones at their edges",
    ),
]);

/// How a network multiplies.
pub(crate) const PRECISIONS: Choices<Precision> = Choices(&[
    ("f32", Precision::F32, "32-bit floats"),
    (
        "bf16",
        Precision::Bf16,
        "Rounded to bfloat16 and added up in 32 bits: faster where the CPU has instructions for it (AVX-512 BF16), and off \
         by up to 0.3 % of white; features too on a GPU that computes with such numbers; elsewhere as f32",
    ),
]);

/// The numbers that a network is trained with.
pub(crate) const TRAINING_PRECISIONS: Choices<Precision> = Choices(&[
    ("f32", Precision::F32, "32-bit floats"),
    (
        "bf16",
        Precision::Bf16,
        "Features and products in bfloat16, on a GPU that computes with such numbers; weights, their gradients and the loss \
         in 32-bit floats",
    ),
]);

impl<T> Choices<T> {
    fn possible(self) -> impl Iterator<Item = PossibleValue> {
        self.0.iter().map(|(name, _, meaning)| match *meaning {
            "" => PossibleValue::new(*name),
            meaning => PossibleValue::new(*name).help(meaning),
        })
    }
}

impl<T: Copy + Send + Sync> TypedValueParser for Choices<T> {
    type Value = T;

    fn parse_ref(&self, command: &Command, flag: Option<&Arg>, text: &OsStr) -> Result<T, clap::Error> {
        let chosen = PossibleValuesParser::new(self.possible()).parse_ref(command, flag, text)?;
        let found = self.0.iter().find(|(name, ..)| *name == chosen);
        Ok(found.expect("clap lets through what is listed").1)
    }

    fn possible_values(&self) -> Option<Box<dyn Iterator<Item = PossibleValue> + '_>> {
        Some(Box::new(self.possible()))
    }
}

/// Reads noise as flags name it; an error says all that is known of it.
pub(super) fn parse_noise(text: &str) -> Result<NoiseConfig, String> {
    NoiseConfig::parse(text).map_err(|error| format!("{:#}", anyhow::Error::from(error)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::Parser;

    const SIZES: Choices<u32> = Choices(&[("small", 1, "fits a pocket"), ("large", 9, "")]);

    #[derive(Debug, Parser)]
    struct Flags {
        #[arg(long, value_delimiter = ',', value_parser = SIZES)]
        sizes: Vec<u32>,
    }

    #[test]
    fn names_become_values() {
        assert_eq!(Flags::parse_from(["udc", "--sizes", "large,small"]).sizes, [9, 1]);
    }

    #[test]
    fn other_names_are_refused_with_the_list_and_the_nearest() {
        let message = Flags::try_parse_from(["udc", "--sizes", "smal"]).unwrap_err().to_string();
        assert!(message.contains("small, large") && message.contains("exists: 'small'"), "{message}");
    }
}
