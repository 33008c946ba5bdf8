//! Turns an architecture into weights: drawn at random, or taken from a file's tensors after checking that
//! they fit.

use std::borrow::Cow;
use std::collections::BTreeMap;

use rand_distr::{Distribution, StandardNormal, Uniform};
use serde::{Deserialize, Serialize};

use super::architecture::Architecture;
use super::layers::{LayerWeights, Place, TensorSpec};
use crate::core::error::{Error, Result};
use crate::core::image::all_finite;
use crate::core::rng::{self, Rng};
use crate::io::TensorData;

/// The slope that every PReLU starts with.
const INITIAL_SLOPE: f32 = 0.2;

/// Scale of the weights inside residual blocks, which makes the blocks start near the identity.
const RESIDUAL_SCALE: f32 = 0.1;

/// How weights are drawn before training.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Initialisation {
    /// Residual blocks Kaiming normal × 0.1 without bias; the layer that corrects an image (guided) zero, so that it starts
    /// with none; PyTorch's default elsewhere (the training code).
    #[default]
    Released,
    /// Kaiming normal without bias everywhere (the paper's text).
    Paper,
}

impl Initialisation {
    /// Checks that an architecture's signals keep their size under these weights.
    ///
    /// # Errors
    /// [`Error::Config`] for SFTMD and [`Paper`](Self::Paper): its sixteen residual blocks in a row multiply their signals
    /// to some 10⁶.
    pub fn check(self, architecture: &Architecture) -> Result<()> {
        architecture.family().check_initialisation(self)
    }
}

/// A tensor of 32-bit floats with its shape, in C order.
#[derive(Clone, Debug, PartialEq)]
pub struct TensorValues {
    /// The shape.
    pub shape: Vec<usize>,
    /// The numbers.
    pub values: Vec<f32>,
}

/// One named weight tensor.
#[derive(Clone, Debug, PartialEq)]
pub struct Parameter {
    /// The released name.
    pub name: String,
    /// The shape.
    pub shape: Vec<usize>,
    /// The numbers, in C order.
    pub values: Vec<f32>,
}

impl Parameter {
    /// The tensor as files take it.
    pub fn as_tensor(&self) -> TensorData<'_> {
        (self.shape.clone(), Cow::Borrowed(&self.values))
    }
}

/// All weights of an architecture, in its order.
#[derive(Clone, Debug, PartialEq)]
pub struct Parameters(Vec<Parameter>);

impl Parameters {
    /// Draws weights; each tensor has a random stream of its own under `seed`.
    pub fn random(architecture: &Architecture, initialisation: Initialisation, seed: u64) -> Self {
        let draw = |spec: TensorSpec| {
            let mut rng = rng::stream(seed, &format!("weights/{}", spec.name));
            let values = draw_values(&spec, initialisation, &mut rng);
            Parameter { name: spec.name, shape: spec.shape, values }
        };
        Self(architecture.tensors().into_iter().map(draw).collect())
    }

    /// Takes the weights of `architecture` out of named tensors.
    ///
    /// # Errors
    /// [`Error::Unsupported`] naming tensors that are missing, that no layer uses, or that have another
    /// shape.
    pub fn from_tensors(
        architecture: &Architecture,
        mut tensors: BTreeMap<String, TensorValues>,
    ) -> Result<Self> {
        let (mut found, mut missing) = (Vec::new(), Vec::new());
        for spec in architecture.tensors() {
            let Some(tensor) = tensors.remove(&spec.name) else {
                missing.push(spec.name);
                continue;
            };
            if tensor.shape != spec.shape {
                let what = format!("weights {}", spec.name);
                return Err(Error::shape(what, format!("{:?}", spec.shape), format!("{:?}", tensor.shape)));
            }
            if !all_finite(&tensor.values) {
                let reason =
                    format!("weights {} hold a NaN or an infinity; use an earlier checkpoint", spec.name);
                return Err(Error::Unsupported(reason));
            }
            found.push(Parameter { name: spec.name, shape: spec.shape, values: tensor.values });
        }
        if !missing.is_empty() {
            return Err(Error::Unsupported(format!("the network's weights lack {}", list(&missing))));
        }
        if !tensors.is_empty() {
            let unused: Vec<String> = tensors.into_keys().collect();
            let reason = format!("the network has no place for the weights {}", list(&unused));
            return Err(Error::Unsupported(reason));
        }
        Ok(Self(found))
    }

    /// Keeps tensors that are known to be those of one architecture, in its order.
    pub(super) fn from_list(parameters: Vec<Parameter>) -> Self {
        Self(parameters)
    }

    /// The weights in the architecture's order.
    pub fn iter(&self) -> impl ExactSizeIterator<Item = &Parameter> {
        self.0.iter()
    }

    /// The weights in the architecture's order, to be changed in place.
    pub fn iter_mut(&mut self) -> impl ExactSizeIterator<Item = &mut Parameter> {
        self.0.iter_mut()
    }

    /// Number of tensors.
    pub fn len(&self) -> usize {
        self.0.len()
    }

    /// Whether there are none; an architecture always has some.
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }
}

impl IntoIterator for Parameters {
    type Item = Parameter;
    type IntoIter = std::vec::IntoIter<Parameter>;

    fn into_iter(self) -> Self::IntoIter {
        self.0.into_iter()
    }
}

/// Names at most three of many.
fn list(names: &[String]) -> String {
    let shown = names.iter().take(3).map(String::as_str).collect::<Vec<_>>().join(", ");
    if names.len() > 3 { format!("{shown} and {} more", names.len() - 3) } else { shown }
}

/// # Equation
/// With fan = inputs · size²: Kaiming normal N(0, 2/fan); PyTorch's default U(−1/√fan, 1/√fan) for weights
/// and biases.
fn draw_values(spec: &TensorSpec, initialisation: Initialisation, rng: &mut Rng) -> Vec<f32> {
    let count = spec.shape.iter().product();
    let LayerWeights::Convolution { inputs, size, place, .. } = spec.weights else {
        return vec![INITIAL_SLOPE; count];
    };
    let is_bias = spec.shape.len() == 1;
    #[expect(clippy::cast_precision_loss, reason = "a fan is far below 2²⁴")]
    let fan = (inputs * size * size) as f32;
    match initialisation {
        Initialisation::Released if place == Place::Plain => uniform(rng, 1.0 / fan.sqrt(), count),
        Initialisation::Released if place == Place::Correction => vec![0.0; count],
        _ if is_bias => vec![0.0; count],
        Initialisation::Released => normal(rng, RESIDUAL_SCALE * (2.0 / fan).sqrt(), count),
        Initialisation::Paper => normal(rng, (2.0 / fan).sqrt(), count),
    }
}

fn normal(rng: &mut Rng, deviation: f32, count: usize) -> Vec<f32> {
    let draw = |z: f32| z * deviation;
    StandardNormal.sample_iter(rng).take(count).map(draw).collect()
}

fn uniform(rng: &mut Rng, bound: f32, count: usize) -> Vec<f32> {
    let distribution = Uniform::new(-bound, bound).expect("the bound is positive and finite");
    distribution.sample_iter(rng).take(count).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Mean and standard deviation of a named weight of the published network.
    fn statistics(initialisation: Initialisation, name: &str) -> (f32, f32) {
        let all = Parameters::random(&Architecture::default(), initialisation, 9);
        let values = &all.iter().find(|p| p.name == name).unwrap().values;
        let count = values.len() as f32;
        let mean = values.iter().sum::<f32>() / count;
        (mean, (values.iter().map(|v| (v - mean).powi(2)).sum::<f32>() / count).sqrt())
    }

    /// Deviations of 9216 and more draws are within 3 % of their distribution's.
    #[test]
    fn weights_have_the_deviation_of_their_layer() {
        let expect = |initialisation, name: &str, deviation: f32| {
            let (mean, found) = statistics(initialisation, name);
            assert!(mean.abs() < 0.05 * deviation, "{name}: mean {mean}");
            assert!((found / deviation - 1.0).abs() < 0.03, "{name}: {found}, expected {deviation}");
        };
        let normal = |fan: f32| (2.0 / fan).sqrt();
        let uniform = |fan: f32| (1.0 / (3.0 * fan)).sqrt();
        expect(Initialisation::Released, "conv_12.conv1.weight", 0.1 * normal(288.0));
        expect(Initialisation::Released, "conv_21.0.weight", uniform(288.0));
        expect(Initialisation::Released, "dynamic_kernel.3.0.weight", uniform(128.0));
        expect(Initialisation::Paper, "conv_12.conv1.weight", normal(288.0));
        expect(Initialisation::Paper, "conv_21.0.weight", normal(288.0));
    }

    #[test]
    fn biases_of_residual_blocks_are_zero_and_slopes_a_fifth() {
        let all = Parameters::random(&Architecture::default(), Initialisation::Released, 9);
        let values = |name: &str| all.iter().find(|p| p.name == name).unwrap().values.clone();
        assert!(values("upconv_22.conv2.bias").iter().all(|&v| v == 0.0));
        assert!(values("upconv_21.0.bias").iter().any(|&v| v != 0.0));
        assert_eq!(values("dynamic_kernel1.3.1.weight"), [0.2]);
    }

    #[test]
    fn draws_repeat_by_seed() {
        let draw = |seed| Parameters::random(&Architecture::default(), Initialisation::Released, seed);
        assert_eq!(draw(1), draw(1));
        assert_ne!(draw(1), draw(2));
    }
}
