//! Tensors of CPU backends as slices, and the one way in which operations on slices become Burn operations
//! with gradients.

use std::fmt::Debug;
use std::ops::Deref;
use std::sync::Arc;

use burn::backend::autodiff::checkpoint::base::Checkpointer;
use burn::backend::autodiff::checkpoint::strategy::CheckpointStrategy;
use burn::backend::autodiff::grads::Gradients;
use burn::backend::autodiff::ops::{Backward, Ops, OpsKind};
use burn::backend::flex::{Flex, FlexTensor};
use burn::backend::tensor::FloatTensor;
use burn::backend::{Autodiff, Backend, TensorMetadata};
use burn::tensor::TensorData;

use crate::kernels::Shape;

/// A backend whose tensors lie in main memory.
pub(super) trait Host: Backend {
    /// A tensor's numbers in C order.
    type Floats: Deref<Target = [f32]>;

    /// Gives access to the numbers, copying them only when they are not in C order.
    fn floats(tensor: &FloatTensor<Self>) -> Self::Floats;

    /// Makes a tensor of numbers in C order.
    fn tensor(values: Vec<f32>, shape: Vec<usize>) -> FloatTensor<Self>;
}

/// A contiguous tensor of 32-bit floats.
pub(super) struct FlexFloats(FlexTensor);

impl Deref for FlexFloats {
    type Target = [f32];

    fn deref(&self) -> &[f32] {
        self.0.as_slice().expect("the network computes in contiguous 32-bit floats")
    }
}

impl Host for Flex {
    type Floats = FlexFloats;

    fn floats(tensor: &FlexTensor) -> FlexFloats {
        FlexFloats(tensor.to_contiguous())
    }

    fn tensor(values: Vec<f32>, shape: Vec<usize>) -> FlexTensor {
        FlexTensor::from_data(TensorData::new(values, shape))
    }
}

#[cfg(feature = "ndarray-backend")]
mod ndarray_backend {
    #![expect(deprecated, reason = "burn-flex succeeds it; it is kept for comparison")]

    use burn::backend::NdArray;
    use burn::backend::ndarray::NdArrayTensor;
    use burn::backend::ops::FloatTensorOps;
    use burn::tensor::TensorData;

    use super::Host;

    impl Host for NdArray {
        type Floats = Vec<f32>;

        fn floats(tensor: &NdArrayTensor) -> Vec<f32> {
            let NdArrayTensor::F32(storage) = tensor else { panic!("the network computes in 32-bit floats") };
            storage.view().iter().copied().collect()
        }

        fn tensor(values: Vec<f32>, shape: Vec<usize>) -> NdArrayTensor {
            <Self as FloatTensorOps<Self>>::float_from_data(
                TensorData::new(values, shape),
                &Default::default(),
            )
        }
    }
}

/// An input of an operation.
#[derive(Clone, Copy)]
pub(super) struct View<'a> {
    pub(super) floats: &'a [f32],
    shape: &'a [usize],
}

impl View<'_> {
    /// The extent of a batch `[item, height, width, channel]`.
    pub(super) fn batch(&self) -> Shape {
        let [items, height, width, channels] = *self.shape else { panic!("a batch of {:?}", self.shape) };
        Shape::new(items, height, width, channels)
    }

    /// The extent along an axis.
    pub(super) fn side(&self, axis: usize) -> usize {
        self.shape[axis]
    }
}

/// What an operation computes.
pub(super) struct Computed {
    pub(super) output: Vec<f32>,
    pub(super) shape: Shape,
    /// What else the backward pass needs besides inputs and output.
    pub(super) kept: Vec<Vec<f32>>,
}

/// What the backward pass starts from besides the inputs.
#[derive(Clone, Copy)]
pub(super) struct Passed<'a, const N: usize> {
    /// What [`HostOperation::forward`] returned and kept.
    pub(super) output: &'a [f32],
    pub(super) kept: &'a [Vec<f32>],
    /// The output's gradient.
    pub(super) gradient: &'a [f32],
    /// Which inputs' gradients are wanted: an image that a network is given needs none.
    pub(super) wanted: [bool; N],
}

/// An operation on slices with its gradient.
pub(super) trait HostOperation<const N: usize>: Copy + Debug + Send + 'static {
    /// Computes the output.
    fn forward(&self, inputs: [View<'_>; N]) -> Computed;

    /// Takes the output's gradient back to those of the inputs; one that is not wanted may be left empty.
    fn backward(&self, inputs: [View<'_>; N], passed: Passed<'_, N>) -> [Vec<f32>; N];
}

/// Lends the numbers and shapes of tensors to `task`.
fn with_views<B: Host, T, const N: usize>(
    tensors: &[FloatTensor<B>; N],
    task: impl FnOnce([View<'_>; N]) -> T,
) -> T {
    let floats = tensors.each_ref().map(|t| B::floats(t));
    let shapes: [Vec<usize>; N] = tensors.each_ref().map(|t| t.shape().to_vec());
    task(std::array::from_fn(|i| View { floats: &floats[i], shape: &shapes[i] }))
}

/// Runs an operation without gradients.
pub(super) fn run<B: Host, const N: usize>(
    operation: impl HostOperation<N>,
    inputs: [FloatTensor<B>; N],
) -> FloatTensor<B> {
    compute::<B, N>(operation, &inputs).0
}

fn compute<B: Host, const N: usize>(
    operation: impl HostOperation<N>,
    inputs: &[FloatTensor<B>; N],
) -> (FloatTensor<B>, Vec<Vec<f32>>) {
    let Computed { output, shape, kept } = with_views::<B, _, N>(inputs, |views| operation.forward(views));
    (B::tensor(output, vec![shape.images, shape.height, shape.width, shape.channels]), kept)
}

/// What the backward pass of an operation starts from.
#[derive(Clone, Debug)]
struct State<B: Backend, O, const N: usize> {
    operation: O,
    inputs: [FloatTensor<B>; N],
    output: FloatTensor<B>,
    kept: Arc<Vec<Vec<f32>>>,
}

/// The backward pass of any operation on slices.
#[derive(Debug)]
struct HostBackward<O>(std::marker::PhantomData<O>);

impl<B: Host, O: HostOperation<N>, const N: usize> Backward<B, N> for HostBackward<O> {
    type State = State<B, O, N>;

    fn backward(self, ops: Ops<Self::State, N>, grads: &mut Gradients, _checkpointer: &mut Checkpointer) {
        let gradient = grads.consume::<B>(&ops.node);
        let State { operation, inputs, output, kept } = ops.state;
        let shapes = inputs.each_ref().map(|t| t.shape().to_vec());
        let wanted = ops.parents.each_ref().map(Option::is_some);
        let results = with_views::<B, _, N>(&inputs, |views| {
            let (output, gradient) = (B::floats(&output), B::floats(&gradient));
            let passed = Passed { output: &output, kept: &kept, gradient: &gradient, wanted };
            operation.backward(views, passed)
        });
        for ((parent, values), shape) in ops.parents.into_iter().zip(results).zip(shapes) {
            if let Some(node) = parent {
                grads.register::<B>(node.id, B::tensor(values, shape));
            }
        }
    }
}

/// Runs an operation so that gradients flow back through it.
pub(super) fn run_tracked<B: Host, C: CheckpointStrategy, O: HostOperation<N>, const N: usize>(
    operation: O,
    inputs: [FloatTensor<Autodiff<B, C>>; N],
) -> FloatTensor<Autodiff<B, C>> {
    let mut nodes = Vec::with_capacity(N);
    let inputs = inputs.map(|input| {
        let (primitive, node) = input.into_parts();
        nodes.push(node);
        primitive
    });
    let nodes = nodes.try_into().unwrap_or_else(|_| unreachable!("one node per input"));
    let backward = HostBackward::<O>(std::marker::PhantomData);
    let (output, kept) = compute::<B, N>(operation, &inputs);
    match Backward::<B, N>::prepare::<C>(backward, nodes).compute_bound().stateful() {
        OpsKind::Tracked(prep) => {
            let state = State { operation, inputs, output: output.clone(), kept: Arc::new(kept) };
            prep.finish(state, output)
        }
        OpsKind::UnTracked(prep) => prep.finish(output),
    }
}
