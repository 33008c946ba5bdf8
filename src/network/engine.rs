//! What computes whole images: the kernels' streamed rows, or the tensors of a device.

use std::fmt::Debug;

use burn::tensor::{Device, Tensor, TensorData};
use ndarray::{Array3, ArrayView3};

use super::backend::{Backend, numbers_of};
use super::inputs::{InputTensors, Inputs};
use super::layers::LayerWeights;
use super::networks::Network;
use super::precision::Precision;
use super::streamed::Streamed;
use super::weights::Weights;
use crate::core::error::Result;
use crate::core::image::CHANNELS;
use crate::core::progress::Progress;
use crate::kernels::Isa;

/// Feature maps as wide as what the widest layer of a resolution reads and writes together that exist at once. Peaks of four
/// networks with the kernels were those of 1 to 2.2; plain operations hold sums and copies of another layout too.
const LIVE_FEATURES: usize = 3;

/// A network ready to restore whole images, one after another or several at once.
pub(super) trait Engine: Debug + Send + Sync {
    /// Restores an image with up to `room` bytes more than the least to use; the result does not depend on `room`. The
    /// inputs are those that the network reads.
    ///
    /// # Errors
    /// Those of [`numbers_of`]; [`Error::Interrupted`](crate::core::error::Error::Interrupted).
    fn restore(&self, inputs: &Inputs<'_>, room: u64, progress: &Progress) -> Result<Array3<f32>>;

    /// Estimates the bytes that restoring an image of height and width takes with `room` bytes more than the least to
    /// use, the weights included, the image's own and the result's not.
    fn bytes(&self, size: [usize; 2], room: u64) -> u64;

    /// Pixels around a tile that its restoration may depend on.
    fn halo(&self) -> usize;
}

/// The engine for a network on a backend: streamed rows where the kernels compute and the network is written for them.
pub(super) fn engine(
    weights: &Weights,
    (backend, precision): (Backend, Precision),
    isa: Isa,
) -> Box<dyn Engine> {
    let (Weights { architecture, parameters, .. }, device) = (weights, backend.device());
    match architecture.family().stream() {
        Some(stream) if backend.is_cpu() => Box::new(Streamed::new(architecture, parameters, stream, isa)),
        _ => {
            let network = Network::new(architecture, parameters, &device).in_precision(precision);
            Box::new(Tensors { network, device })
        }
    }
}

/// The network in Burn on any device, an image or tile at once.
#[derive(Debug)]
struct Tensors {
    network: Network,
    device: Device,
}

impl Tensors {
    fn tensor(&self, planes: ArrayView3<'_, f32>) -> Tensor<4> {
        let (channels, height, width) = planes.dim();
        let data = TensorData::new(planes.iter().copied().collect(), [1, channels, height, width]);
        Tensor::from_data(data, &self.device)
    }
}

impl Engine for Tensors {
    fn restore(&self, inputs: &Inputs<'_>, _room: u64, progress: &Progress) -> Result<Array3<f32>> {
        progress.check()?;
        let plane = |&plane| Some((plane, self.tensor(inputs.planes.get(plane)?.planes())));
        let restored = self.network.forward(InputTensors {
            image: self.tensor(inputs.image.planes()),
            map: inputs.map.map(|map| self.tensor(map)),
            planes: self.network.architecture().planes().iter().filter_map(plane).collect(),
        });
        let shape = (CHANNELS, inputs.image.height(), inputs.image.width());
        let values = numbers_of(restored)
            .map_err(|error| error.while_doing(format!("restoring {} × {} pixels", shape.1, shape.2)))?;
        Ok(Array3::from_shape_vec(shape, values).expect("a restored image has the sides of its input"))
    }

    /// Burn does not say what it takes: counted are [`LIVE_FEATURES`] of every resolution, and all that the network is
    /// given.
    fn bytes(&self, [height, width]: [usize; 2], _room: u64) -> u64 {
        let architecture = self.network.architecture();
        let padded = |side: usize| side.next_multiple_of(architecture.side_multiple());
        let mut widest = Vec::new();
        for layer in architecture.layers() {
            let LayerWeights::Convolution { inputs, outputs, .. } = layer.weights else { continue };
            widest.resize(widest.len().max(layer.level + 1), 0);
            widest[layer.level] = widest[layer.level].max(inputs + outputs);
        }
        let pixels = |level: usize| (padded(height) >> level) * (padded(width) >> level);
        let features: usize =
            widest.iter().enumerate().map(|(level, widest)| LIVE_FEATURES * widest * pixels(level)).sum();
        let given = CHANNELS * (1 + architecture.planes().len()) + architecture.code_len().unwrap_or(0);
        let floats = (features + given * pixels(0)) as u64 + architecture.parameters();
        floats * size_of::<f32>() as u64
    }

    fn halo(&self) -> usize {
        self.network.architecture().halo()
    }
}

#[cfg(test)]
mod tests {
    use crate::core::error::Error;
    use crate::core::image::ToneMappedImage;
    use crate::core::kernel_code::KernelCode;
    use crate::network::testing::planes_of;
    use crate::network::weights::Weights;
    use crate::network::{
        Architecture, Condition, Initialisation, Inputs, Kind, Model, Origin, Parameters, Planes,
    };
    use ndarray::Array3;

    fn model(kind: Kind) -> Model {
        let architecture =
            Architecture { kind, condition: Condition::None, features: 4, ..Architecture::default() };
        let parameters = Parameters::random(&architecture, Initialisation::Paper, 8);
        Model::new(Weights { architecture, parameters, origin: Origin::default() })
    }

    fn image(height: usize, width: usize) -> ToneMappedImage {
        let value = |(c, y, x)| ((c * 7919 + y * 104_729 + x * 1299) % 1000) as f32 / 1000.0;
        ToneMappedImage::from_planes(Array3::from_shape_fn((3, height, width), value)).unwrap()
    }

    /// Sums of a hundred products in another order.
    #[test]
    fn both_engines_restore_the_same_of_image_and_planes() {
        let (image, planes) = (image(21, 34), planes_of(&image(21, 34)));
        let restore = |kind| model(kind).restore(&Inputs::new(&image, None).with_planes(&planes)).unwrap();
        let (streamed, tensors) = (restore(Kind::AllPlanes), restore(Kind::AllPlanesTensors));
        let pairs = streamed.as_slice().iter().zip(tensors.as_slice());
        let error = pairs.map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
        assert!(error < 1e-5, "{error:e}");
        let others = planes_of(&streamed);
        let other = model(Kind::AllPlanes).restore(&Inputs::new(&image, None).with_planes(&others)).unwrap();
        assert_ne!(other, streamed);
    }

    #[test]
    fn a_plane_that_lacks_or_has_other_sides_is_named() {
        let image = image(8, 9);
        for kind in [Kind::AllPlanes, Kind::AllPlanesTensors] {
            let model = model(kind);
            let refusal =
                |planes: &Planes| model.restore(&Inputs::new(&image, None).with_planes(planes)).unwrap_err();
            let lacking = refusal(&Planes::default());
            assert!(matches!(lacking, Error::Config { .. }), "{lacking:?}");
            assert!(lacking.to_string().contains("the plane \"deconvolved\""), "{lacking}");
            let small = refusal(&planes_of(&image).crop(0, 0, 8, 8)).to_string();
            assert!(small.contains("plane \"deconvolved\"") && small.contains("expected 8 × 9"), "{small}");
        }
    }

    #[test]
    fn networks_that_read_no_planes_do_not_look_at_them() {
        let (image, code) = (image(8, 9), KernelCode::zeros(5));
        let inputs = Inputs::new(&image, Some(&code));
        let model = model(Kind::Unet);
        let planes = planes_of(&image).crop(0, 0, 2, 2);
        assert_eq!(model.restore(&inputs).unwrap(), model.restore(&inputs.with_planes(&planes)).unwrap());
    }

    #[test]
    fn whole_images_as_tensors_take_more_memory_than_rows() {
        let [streamed, tensors] =
            [Kind::AllPlanes, Kind::AllPlanesTensors].map(|kind| model(kind).working_bytes(400, 600));
        let features = 4 * 4 * 400 * 600;
        assert!(streamed < features && features < tensors, "{streamed} {tensors}");
        assert!(model(Kind::AllPlanesTensors).with_bf16_products().is_none());
    }
}
