//! Whole images through the network without Burn's tensors: the kernels' steps, a few rows at a time.

use std::collections::HashMap;
use std::sync::{Mutex, PoisonError};

use ndarray::{Array3, ArrayView3, Axis};

use super::architecture::Architecture;
use super::engine::Engine;
use super::family::Stream;
use super::inputs::{Inputs, Plane};
use super::parameters::Parameters;
use crate::core::error::Result;
use crate::core::image::CHANNELS;
use crate::core::progress::{PIXELS, Progress};
use crate::kernels::stream::{Arena, Graph, Plan, Source, Tensor};
use crate::kernels::{Convolution, Geometry, Isa};

/// Bytes per weight: itself, and Winograd's 36 points for 9 taps.
const WEIGHT_BYTES: u64 = 5 * size_of::<f32>() as u64;

/// The threads that a run needs memory for at least. More of them take more rows at a time, where there is memory for it.
const FEWEST_THREADS: usize = 2;

/// Some channels of a network's input.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Part {
    /// The image.
    Image,
    /// The degradation map, of so many channels.
    Map(usize),
    /// A plane of the image's sides.
    Plane(Plane),
}

impl From<Plane> for Part {
    fn from(plane: Plane) -> Self {
        Self::Plane(plane)
    }
}

impl Part {
    fn channels(self) -> usize {
        match self {
            Self::Image | Self::Plane(_) => CHANNELS,
            Self::Map(channels) => channels,
        }
    }
}

/// A network whose weights are packed for the kernels: the engine of CPUs.
pub(super) struct Streamed {
    architecture: Architecture,
    network: Graph,
    /// What each of the network's inputs is made of.
    inputs: Vec<Vec<Part>>,
    /// Number of weights that were made of the named ones, to be packed in their place.
    derived_weights: usize,
    /// The memory of the last run.
    arena: Mutex<Arena>,
}

impl std::fmt::Debug for Streamed {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Streamed").field("inputs", &self.inputs).finish_non_exhaustive()
    }
}

impl Streamed {
    /// Packs the weights for an instruction set.
    pub(super) fn new(
        architecture: &Architecture,
        parameters: &Parameters,
        stream: Stream,
        isa: Isa,
    ) -> Self {
        let mut build = StreamBuilder {
            values: parameters.iter().map(|p| (p.name.as_str(), p.values.as_slice())).collect(),
            isa,
            network: Graph::default(),
            inputs: Vec::new(),
            derived_weights: 0,
        };
        stream(&mut build, architecture);
        let StreamBuilder { network, inputs, derived_weights, .. } = build;
        Self { architecture: architecture.clone(), network, inputs, derived_weights, arena: Mutex::default() }
    }

    /// The schedule for an image, which is continued by repetition to sides that the network can halve: for all threads,
    /// or as many as take no more than `room` bytes beyond the least. It does not change what is computed.
    fn plan(&self, height: usize, width: usize, room: u64) -> Plan<'_> {
        let padded = |side: usize| side.next_multiple_of(self.architecture.side_multiple());
        let plan = |threads| Plan::new(&self.network, padded(height), padded(width), threads);
        let least = plan(FEWEST_THREADS);
        let most = (least.bytes() as u64).saturating_add(room);
        let fewer = |threads: &usize| Some(threads / 2);
        let fitting = std::iter::successors(Some(rayon::current_num_threads()), fewer)
            .take_while(|threads| *threads > FEWEST_THREADS)
            .map(plan)
            .find(|plan| plan.bytes() as u64 <= most);
        fitting.unwrap_or(least)
    }
}

impl Engine for Streamed {
    fn bytes(&self, [height, width]: [usize; 2], room: u64) -> u64 {
        let rows = self.plan(height, width, room).bytes();
        rows as u64 + (self.architecture.parameters() + self.derived_weights as u64) * WEIGHT_BYTES
    }

    fn halo(&self) -> usize {
        self.architecture.halo()
    }

    /// Ends with [`Error::Interrupted`](crate::core::error::Error::Interrupted) between portions of rows.
    fn restore(&self, inputs: &Inputs<'_>, room: u64, progress: &Progress) -> Result<Array3<f32>> {
        let (height, width) = (inputs.image.height(), inputs.image.width());
        let of_part = |part: Part| match part {
            Part::Image => inputs.image.planes(),
            Part::Map(_) => inputs.map.expect("a network that reads kernel codes is given a degradation map"),
            Part::Plane(plane) => {
                inputs.planes.get(plane).expect("a network that reads planes is given them").planes()
            }
        };
        let source = |parts: &Vec<Part>| {
            let planes: Vec<_> = parts.iter().map(|&part| of_part(part)).collect();
            move |y: usize, row: &mut [f32]| fill_row(&planes, y, row)
        };
        let sources: Vec<_> = self.inputs.iter().map(source).collect();
        let sources: Vec<Source<'_>> = sources.iter().map(|source| source as Source<'_>).collect();
        let mut restored = Array3::zeros((CHANNELS, height, width));
        let sink = |y: usize, row: &[f32]| {
            if y < height {
                for (c, mut plane) in restored.axis_iter_mut(Axis(0)).enumerate() {
                    let pixels = row.chunks_exact(CHANNELS);
                    plane.row_mut(y).iter_mut().zip(pixels).for_each(|(to, pixel)| *to = pixel[c]);
                }
            }
        };
        // Who restores at the same time finds none, and makes another.
        let kept = || self.arena.lock().unwrap_or_else(PoisonError::into_inner);
        let mut arena = std::mem::take(&mut *kept());
        let plan = self.plan(height, width, room);
        let bar = progress.bar((height * width) as u64, PIXELS);
        let mut rows_done = 0;
        let proceed = |rows: usize| {
            let rows = rows.min(height);
            bar.inc(((rows - rows_done) * width) as u64);
            rows_done = rows;
            progress.check()
        };
        let outcome = plan.run(&mut arena, &sources, sink, proceed);
        bar.inc(((height - rows_done) * width) as u64);
        *kept() = arena;
        outcome.map(|()| restored)
    }
}

/// Writes row `y` of planes after planes, pixel by pixel, continued by repetition past their last row and
/// column.
fn fill_row(parts: &[ArrayView3<'_, f32>], y: usize, row: &mut [f32]) {
    let channels = parts.iter().map(|planes| planes.dim().0).sum();
    let planes = parts.iter().flat_map(|planes| planes.axis_iter(Axis(0)));
    for (c, plane) in planes.enumerate() {
        let (height, width) = plane.dim();
        let from = plane.row(y.min(height - 1));
        for (x, pixel) in row.chunks_exact_mut(channels).enumerate() {
            pixel[c] = from[x.min(width - 1)];
        }
    }
}

/// Appends layers of named weights.
pub(super) struct StreamBuilder<'a> {
    values: HashMap<&'a str, &'a [f32]>,
    pub(super) isa: Isa,
    pub(super) network: Graph,
    inputs: Vec<Vec<Part>>,
    /// Number of weights that were made of the named ones.
    pub(super) derived_weights: usize,
}

impl<'a> StreamBuilder<'a> {
    /// Declares an input made of these parts, one after another.
    pub(super) fn input(&mut self, parts: &[Part]) -> Tensor {
        self.inputs.push(parts.to_vec());
        self.network.input(parts.iter().map(|part| part.channels()).sum())
    }

    /// The weight tensor of a name.
    pub(super) fn values(&self, name: &str) -> &'a [f32] {
        self.values.get(name).unwrap_or_else(|| panic!("there is no weight {name}"))
    }

    /// Weight and bias of a layer.
    pub(super) fn layer(&self, name: &str) -> (&'a [f32], &'a [f32]) {
        (self.values(&format!("{name}.weight")), self.values(&format!("{name}.bias")))
    }

    /// Packs a 3 × 3 convolution.
    pub(super) fn pack(&self, name: &str, stride: usize) -> Convolution {
        self.pack_sized(name, 3, stride)
    }

    /// Packs a convolution.
    pub(super) fn pack_sized(&self, name: &str, side: usize, stride: usize) -> Convolution {
        let (weight, bias) = self.layer(name);
        let inputs = weight.len() / bias.len() / (side * side);
        let geometry = Geometry { inputs, outputs: bias.len(), side, stride };
        Convolution::for_isa(self.isa, geometry, weight, bias)
    }

    /// Appends a 3 × 3 convolution of stride 1, a leaky rectifier, and the addition of a tensor.
    pub(super) fn convolution(
        &mut self,
        name: &str,
        input: Tensor,
        slope: f32,
        add: Option<Tensor>,
    ) -> Tensor {
        let packed = self.pack(name, 1);
        self.network.convolution(input, packed, slope, add)
    }
}
