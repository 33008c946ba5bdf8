//! A network of any kind, with its weights on a device: what is common to all of them.

use burn::module::Module;
use burn::tensor::ops::PadMode;
use burn::tensor::{Device, Tensor, s};

use super::architecture::Architecture;
use super::builder::{Builder, Collect};
use super::family::Layers;
use super::inputs::{InputTensors, Plane};
use super::parameters::{Parameter, Parameters};
use super::precision::Precision;

/// A restoration network with its weights on a device.
#[derive(Module, Debug)]
pub struct Network {
    layers: Layers,
    #[module(skip)]
    architecture: Architecture,
    #[module(skip)]
    precision: Precision,
}

impl Network {
    /// Builds the network with the given weights; on a device with gradients they can be trained.
    ///
    /// # Panics
    /// When the weights are those of another architecture.
    pub fn new(architecture: &Architecture, parameters: &Parameters, device: &Device) -> Self {
        let layers = Layers::build(architecture, &Builder::new(parameters, device));
        Self { layers, architecture: architecture.clone(), precision: Precision::default() }
    }

    /// Builds the network with weights that a device holds one after another, in the order of [`Parameters`].
    pub(crate) fn of_flat(architecture: &Architecture, flat: &Tensor<1>, device: &Device) -> Self {
        let layers = Layers::build(architecture, &Builder::of_flat(architecture, flat, device));
        Self { layers, architecture: architecture.clone(), precision: Precision::default() }
    }

    /// The same network that computes with such numbers: weights are rounded as they are used, and stay 32-bit floats, of
    /// which gradients are.
    #[must_use]
    pub fn in_precision(self, precision: Precision) -> Self {
        Self { precision, ..self }
    }

    /// The configuration that the network was built from.
    pub fn architecture(&self) -> &Architecture {
        &self.architecture
    }

    /// Restores a batch of tone-mapped images; the result is shaped like them.
    ///
    /// # Panics
    /// When the network reads a degradation map or a plane and there is none.
    pub fn forward(&self, inputs: InputTensors) -> Tensor<4> {
        let [items, channels, height, width] = inputs.image.dims();
        let image = self.pad(inputs.image.clone());
        let [_, _, padded_height, padded_width] = image.dims();
        let map = self.architecture.reads_code().then(|| self.stretch(inputs.map(), &image));
        let plane = |&plane: &Plane| (plane, self.pad(inputs.plane(plane)));
        let planes = self.architecture.planes().iter().map(plane).collect();
        let restored = self.layers.forward(InputTensors { image, map, planes }, self.precision);
        if (padded_height, padded_width) == (height, width) {
            return restored;
        }
        restored.slice(s![0..items, 0..channels, 0..height, 0..width])
    }

    /// Copies the weights to main memory.
    ///
    /// # Panics
    /// Never: the network holds every weight of its architecture.
    pub fn parameters(&self) -> Parameters {
        let specs = self.architecture.tensors();
        let mut collect = Collect { parameters: vec![None; specs.len()] };
        self.visit(&mut collect);
        let named = specs.into_iter().zip(collect.parameters).map(|(spec, values)| {
            let values = values.unwrap_or_else(|| panic!("the network holds no {}", spec.name));
            Parameter { name: spec.name, shape: spec.shape, values }
        });
        Parameters::from_list(named.collect())
    }

    /// A degradation map of the image's sides.
    fn stretch(&self, map: Tensor<4>, image: &Tensor<4>) -> Tensor<4> {
        let [items, _, height, width] = image.dims();
        let [_, channels, map_height, map_width] = map.dims();
        let is_uniform = (map_height, map_width) == (1, 1);
        if is_uniform { map.expand([items, channels, height, width]) } else { self.pad(map) }
    }

    /// Repeats the last row and column until the sides are such as the network can halve.
    fn pad(&self, x: Tensor<4>) -> Tensor<4> {
        let [_, _, height, width] = x.dims();
        let missing = |side: usize| side.next_multiple_of(self.architecture.side_multiple()) - side;
        match (missing(height), missing(width)) {
            (0, 0) => x,
            (bottom, right) => x.pad([(0, bottom), (0, right)], PadMode::Edge),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::image::{CHANNELS, ToneMappedImage};
    use crate::core::kernel_code::KernelCode;
    use crate::network::testing;
    use crate::network::weights::Weights;
    use crate::network::{Backend, Condition, Initialisation, Inputs, Kind, Model, Origin};
    use burn::module::{ModuleVisitor, Param};
    use burn::tensor::{Gradients, TensorData};

    fn architectures() -> [Architecture; 8] {
        let of_kind = |kind, condition| Architecture {
            kind,
            condition,
            // Two channels are too few for twelve ReLUs in a row.
            features: if kind == Kind::Srmdnf { 6 } else { 2 },
            filter_size: 3,
            code_dim: 2,
            ..Architecture::default()
        };
        [
            of_kind(Kind::Discnet, Condition::ImagePsf),
            of_kind(Kind::Unet, Condition::None),
            of_kind(Kind::Srmdnf, Condition::ImagePsf),
            of_kind(Kind::Sftmd, Condition::ImagePsf),
            of_kind(Kind::DeUnet, Condition::Image),
            of_kind(Kind::Guided, Condition::None),
            of_kind(Kind::AllPlanes, Condition::None),
            of_kind(Kind::AllPlanesTensors, Condition::None),
        ]
    }

    const SIDES: [usize; 2] = [10, 13];

    /// Weights under which neither signals nor gradients vanish or explode.
    fn random(architecture: &Architecture) -> Parameters {
        let initialisation = match architecture.kind {
            Kind::Discnet | Kind::Sftmd => Initialisation::Released,
            _ => Initialisation::Paper,
        };
        Parameters::random(architecture, initialisation, 4)
    }

    fn length(values: &[f32]) -> f64 {
        values.iter().map(|v| f64::from(*v).powi(2)).sum::<f64>().sqrt()
    }

    fn values(len: usize) -> Vec<f32> {
        (0..len).map(|i| (i * 2_654_435_761 % 1000) as f32 / 1000.0).collect()
    }

    fn image() -> ToneMappedImage {
        let planes = values(CHANNELS * SIDES[0] * SIDES[1]);
        let planes = ndarray::Array3::from_shape_vec((CHANNELS, SIDES[0], SIDES[1]), planes).unwrap();
        ToneMappedImage::from_planes(planes).unwrap()
    }

    fn forward(network: &Network, device: &Device) -> Tensor<4> {
        let tensor = |image: &ToneMappedImage| {
            let shape = [1, CHANNELS, image.height(), image.width()];
            Tensor::from_data(TensorData::new(image.as_slice().to_vec(), shape), device)
        };
        let code = Tensor::from_data(TensorData::new(vec![0.4_f32, -0.7], [1, 2, 1, 1]), device);
        let planes = testing::planes_of(&image());
        let planes = testing::PLANES.iter().map(|&plane| (plane, tensor(planes.get(plane).unwrap())));
        network.forward(InputTensors { image: tensor(&image()), map: Some(code), planes: planes.collect() })
    }

    /// A loss in double precision whose gradient to the output is not uniform.
    fn weighted_sum(output: &[f32]) -> f64 {
        output.iter().enumerate().map(|(i, v)| f64::from(*v) * weight(i)).sum()
    }

    fn weight(i: usize) -> f64 {
        ((i * 7919 % 13) as f64 - 6.0) / 6.0
    }

    struct Found {
        gradients: Gradients,
        by_id: Vec<Vec<f32>>,
    }

    impl ModuleVisitor for Found {
        fn visit_float<const D: usize>(&mut self, param: &Param<Tensor<D>>) {
            let gradient = param.val().grad(&self.gradients).expect("every weight has a gradient");
            self.by_id[usize::try_from(param.id.val()).unwrap()] = gradient.try_into_vec_as::<f32>().unwrap();
        }
    }

    fn gradients(architecture: &Architecture, parameters: &Parameters) -> Vec<Vec<f32>> {
        let device = Backend::default().device().autodiff();
        let network = Network::new(architecture, parameters, &device);
        let output = forward(&network, &device);
        let weights: Vec<f32> = (0..output.dims().iter().product()).map(|i| weight(i) as f32).collect();
        let weights = Tensor::from_data(TensorData::new(weights, output.dims()), &device);
        let gradients = (output * weights).sum().backward();
        let mut found = Found { gradients, by_id: vec![Vec::new(); parameters.len()] };
        network.visit(&mut found);
        found.by_id
    }

    /// Along its own gradient a loss rises by the gradient's norm, but for rectifiers that switch on the way and the
    /// rounding of the outputs, which the steps of most tensors exceed a hundredfold.
    #[test]
    fn gradients_are_the_differences_of_a_loss() {
        let device = Backend::default().device();
        // DISCNet's filters multiply features, so that its differences tell little; whole training steps of it are
        // compared with PyTorch's instead.
        for architecture in architectures().into_iter().filter(|a| a.kind != Kind::Discnet) {
            let parameters = random(&architecture);
            let outputs = |parameters: &Parameters| {
                let output = forward(&Network::new(&architecture, parameters, &device), &device);
                output.try_into_vec_as::<f32>().unwrap()
            };
            let sizes = outputs(&parameters).into_iter().enumerate();
            let rounding = 1e-7 * sizes.map(|(i, v)| (f64::from(v) * weight(i)).abs()).sum::<f64>();
            // Of networks with many like blocks one tensor in seven: another one of each block.
            let apart = if parameters.len() > 100 { 7 } else { 1 };
            let (mut telling, mut looked_at) = (0, 0);
            for (t, gradient) in gradients(&architecture, &parameters).iter().enumerate().step_by(apart) {
                let norm = length(gradient);
                let parameter = parameters.iter().nth(t).unwrap();
                let largest = 1e-3 * length(&parameter.values).max(1.0);
                let step = (50.0 * rounding / norm.max(1e-9)).min(largest);
                let loss = |sign: f64| {
                    let mut moved = parameters.clone();
                    for (value, g) in moved.iter_mut().nth(t).unwrap().values.iter_mut().zip(gradient) {
                        *value += (sign * step * f64::from(*g) / norm.max(1e-9)) as f32;
                    }
                    weighted_sum(&outputs(&moved))
                };
                let slope = (loss(1.0) - loss(-1.0)) / (2.0 * step);
                let error = (slope - norm).abs();
                let what = format!("{:?} {}: {slope}, expected {norm}", architecture.kind, parameter.name);
                assert!(error <= 5e-2 * norm + rounding / step, "{what}");
                telling += usize::from(rounding / step < 0.1 * norm);
                looked_at += 1;
            }
            assert!(2 * telling > looked_at, "{:?}: {telling} telling of {looked_at}", architecture.kind);
        }
    }

    /// Both compute the same sums in another order; the deepest network has a hundred layers.
    #[test]
    fn streamed_rows_are_those_of_the_trained_network() {
        let device = Backend::default().device();
        for architecture in architectures() {
            let parameters = random(&architecture);
            let network = Network::new(&architecture, &parameters, &device);
            assert_eq!(network.parameters(), parameters);
            let trained = forward(&network, &device).try_into_vec_as::<f32>().unwrap();
            let weights = Weights { architecture, parameters, origin: Origin::default() };
            let (image, planes) = (image(), testing::planes_of(&image()));
            let model = Model::new(weights.clone());
            let code = KernelCode::from_vec(vec![0.4, -0.7]);
            let streamed = model.restore(&Inputs::new(&image, Some(&code)).with_planes(&planes)).unwrap();
            let largest = trained.iter().fold(0.0f32, |m, v| m.max(v.abs()));
            for (a, b) in trained.iter().zip(streamed.as_slice()) {
                assert!((a - b).abs() <= 5e-5 * largest, "{:?}: {a} {b}", weights.architecture.kind);
            }
        }
    }

    /// Features are rounded after every operation, each time by up to 2⁻⁸ of their value: errors of which those of the next
    /// layers are as good as independent, so that they add up as the root of their number, of at most a hundred.
    #[test]
    fn networks_in_bfloat16_differ_by_the_rounding_of_their_features() {
        for architecture in architectures() {
            let parameters = random(&architecture);
            let model = Model::new(Weights { architecture, parameters, origin: Origin::default() });
            let exact = model.with_backend(Backend::AsDevice);
            let rounded = exact.with_bf16_products().unwrap();
            assert!(rounded.has_bf16_products());
            let (image, planes) = (image(), testing::planes_of(&image()));
            let code = KernelCode::from_vec(vec![0.4, -0.7]);
            let inputs = Inputs::new(&image, Some(&code)).with_planes(&planes);
            let [exact, rounded] = [exact, rounded].map(|model| model.restore(&inputs).unwrap());
            let differences = exact.as_slice().iter().zip(rounded.as_slice()).map(|(a, b)| a - b);
            let error = length(&differences.collect::<Vec<_>>()) / length(exact.as_slice());
            assert!((1e-6..10.0 / 256.0).contains(&error), "{:?}: {error:e}", model.architecture().kind);
        }
    }

    /// A pixel that is no number makes every pixel that depends on it none; with one feature no tile of Winograd's does,
    /// whatever vectors the CPU has.
    #[test]
    fn pixels_depend_on_no_others_than_the_halo_says() {
        let device = Backend::default().device();
        for mut architecture in architectures().into_iter().filter(|a| a.side_multiple() == 1) {
            architecture.features = if architecture.kind == Kind::Srmdnf { 1 } else { architecture.features };
            let parameters = random(&architecture);
            let network = Network::new(&architecture, &parameters, &device);
            let width = 2 * architecture.halo() + 9;
            let mut image = vec![0.5_f32; CHANNELS * width];
            image[width / 2] = f32::NAN;
            let image = Tensor::from_data(TensorData::new(image, [1, CHANNELS, 1, width]), &device);
            let code = Tensor::from_data(TensorData::new(vec![0.4_f32, -0.7], [1, 2, 1, 1]), &device);
            let planes = testing::PLANES.iter().map(|&plane| (plane, image.clone())).collect();
            let output = network.forward(InputTensors { image, map: Some(code), planes });
            let output = output.try_into_vec_as::<f32>().unwrap();
            let first = output.iter().position(|v| v.is_nan()).unwrap();
            let reach = width / 2 - first;
            assert_eq!(reach.next_multiple_of(4), architecture.halo(), "{:?}", architecture.kind);
        }
    }
}
