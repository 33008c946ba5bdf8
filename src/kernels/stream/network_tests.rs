//! Networks drawn at random, run row by row, against the same networks evaluated plainly: tensor by tensor, in f64.

use super::{Arena, Graph, Plan, Tensor};
use crate::kernels::testing::{Values, assert_close, naive};
use crate::kernels::{Convolution, DynamicFilter, Epilogue, Geometry, Isa, Shape};

/// Draws small numbers, the same on every machine.
struct Dice(u64);

impl Dice {
    fn below(&mut self, faces: usize) -> usize {
        // Knuth's linear congruential generator, of whose bits the upper ones are good.
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 33) as usize % faces
    }

    fn pick<T: Copy>(&mut self, from: &[T]) -> T {
        from[self.below(from.len())]
    }
}

/// One step with its weights; tensors are named by their number, those of the inputs first.
enum Layer {
    Convolution {
        geometry: Geometry,
        weight: Vec<f32>,
        bias: Vec<f32>,
        slope: f32,
        add: Option<usize>,
        is_up: bool,
    },
    Filter {
        size: usize,
        weight: Vec<f32>,
        bias: Vec<f32>,
        slope: f32,
        features: usize,
    },
    Concatenate(usize),
    Add(usize),
    Modulate(usize, usize, f32),
}

/// Channels, and sides of the input per side.
type Spec = (usize, usize);

struct Drawn {
    inputs: usize,
    specs: Vec<Spec>,
    /// Each layer with the tensor that it reads first.
    layers: Vec<(usize, Layer)>,
    dice: Dice,
    values: Values,
}

impl Drawn {
    fn new(seed: u64) -> Self {
        let mut dice = Dice(seed);
        let inputs = dice.pick(&[1, 1, 2]);
        let specs = (0..inputs).map(|_| (dice.pick(&[1, 3, 8]), 1)).collect();
        let mut drawn = Self { inputs, specs, layers: Vec::new(), dice, values: Values::new(seed) };
        for _ in 0..4 + drawn.dice.below(9) {
            drawn.append();
        }
        drawn
    }

    /// A tensor of those that are like `wanted`.
    fn like(&mut self, wanted: impl Fn(Spec) -> bool) -> Option<usize> {
        let candidates: Vec<usize> = (0..self.specs.len()).filter(|&t| wanted(self.specs[t])).collect();
        (!candidates.is_empty()).then(|| self.dice.pick(&candidates))
    }

    fn append(&mut self) {
        // Mostly of what was computed last, so that networks get deep; sometimes of what has waited for long.
        let back = self.dice.pick(&[0, 0, 0, 1, 2, 5]).min(self.specs.len() - 1);
        let input = self.specs.len() - 1 - back;
        let (channels, reduction) = self.specs[input];
        let same = move |spec: Spec| spec == (channels, reduction);
        match self.dice.below(12) {
            0 | 1 if reduction > 1 => self.convolve(input, true),
            2 if channels <= 8 => {
                let size = self.dice.pick(&[3, 5]);
                let taps = size * size;
                let weight = self.values.take_scaled(taps * channels * channels, taps * channels);
                let bias = self.values.take_scaled(taps * channels, taps);
                let features = self.like(same).expect("the input is like itself");
                let layer = Layer::Filter { size, weight, bias, slope: 0.3, features };
                self.push(input, (channels, reduction), layer);
            }
            3 => {
                let other = self.like(move |(more, sides)| sides == reduction && more + channels <= 24);
                let Some(other) = other else { return };
                self.push(input, (channels + self.specs[other].0, reduction), Layer::Concatenate(other));
            }
            4 => {
                let other = self.like(same).expect("the input is like itself");
                self.push(input, (channels, reduction), Layer::Add(other));
            }
            5 => {
                let [scale, offset] = [(); 2].map(|()| self.like(same).expect("the input is like itself"));
                self.push(input, (channels, reduction), Layer::Modulate(scale, offset, 0.2));
            }
            _ => self.convolve(input, false),
        }
    }

    fn convolve(&mut self, input: usize, is_up: bool) {
        let (inputs, reduction) = self.specs[input];
        let factor = if is_up { 2 } else { 1 };
        let side = if is_up { 3 } else { self.dice.pick(&[1, 3, 3, 3, 3, 5, 7]) };
        let stride = if !is_up && reduction < 4 { self.dice.pick(&[1, 1, 1, 2]) } else { 1 };
        let reduction = reduction * stride / factor;
        let wants_skip = self.dice.below(2) == 0;
        let add = if wants_skip { self.like(move |(_, sides)| sides == reduction) } else { None };
        let channels = add.map_or_else(|| self.dice.pick(&[1, 3, 4, 8, 16, 20]), |add| self.specs[add].0);
        let geometry = Geometry { inputs, outputs: channels * factor * factor, side, stride };
        let weight = self.values.take_scaled(geometry.weight_len(), side * side * inputs);
        let bias = self.values.take(geometry.outputs);
        let slope = self.dice.pick(&[1.0, 0.2, 0.0, -0.5]);
        let layer = Layer::Convolution { geometry, weight, bias, slope, add, is_up };
        self.push(input, (channels, reduction), layer);
    }

    fn push(&mut self, input: usize, spec: Spec, layer: Layer) {
        self.specs.push(spec);
        self.layers.push((input, layer));
    }

    fn shape(&self, tensor: usize, (height, width): (usize, usize)) -> Shape {
        let (channels, reduction) = self.specs[tensor];
        Shape::new(1, height / reduction, width / reduction, channels)
    }

    fn network(&self) -> Graph {
        let mut network = Graph::default();
        let mut tensors: Vec<Tensor> = self.specs[..self.inputs].iter().map(|s| network.input(s.0)).collect();
        for (input, layer) in &self.layers {
            let x = tensors[*input];
            tensors.push(match layer {
                Layer::Convolution { geometry, weight, bias, slope, add, is_up } => {
                    let convolution = if *is_up {
                        Convolution::up(Isa::current(), geometry.inputs, weight, bias)
                    } else {
                        Convolution::new(*geometry, weight, bias)
                    };
                    network.convolution(x, convolution, *slope, add.map(|add| tensors[add]))
                }
                Layer::Filter { size, weight, bias, slope, features } => {
                    let filter = DynamicFilter::new(Isa::current(), *size, weight, bias, *slope);
                    network.dynamic_filter(x, tensors[*features], filter)
                }
                Layer::Concatenate(other) => network.concatenate(x, tensors[*other]),
                Layer::Add(other) => network.add(x, tensors[*other]),
                Layer::Modulate(scale, offset, slope) => {
                    network.modulate(x, tensors[*scale], tensors[*offset], *slope)
                }
            });
        }
        network
    }

    /// The last tensor, all tensors being whole.
    fn evaluate(&self, inputs: &[Vec<f32>], sides: (usize, usize)) -> Vec<f64> {
        let widened = |input: &Vec<f32>| input.iter().map(|v| f64::from(*v)).collect::<Vec<f64>>();
        let mut tensors: Vec<Vec<f64>> = inputs.iter().map(widened).collect();
        for (input, layer) in &self.layers {
            let (x, shape) = (&tensors[*input], self.shape(*input, sides));
            let result = match layer {
                Layer::Convolution { geometry, weight, bias, slope, add, is_up } => {
                    let mut sums = naive::convolution(*geometry, weight, bias, x, shape);
                    if *is_up {
                        sums = naive::pixel_shuffle(&sums, shape.with_channels(geometry.outputs));
                    }
                    let mut result = naive::epilogue(Epilogue::Leak(*slope), &sums);
                    if let Some(add) = add {
                        result.iter_mut().zip(&tensors[*add]).for_each(|(to, other)| *to += other);
                    }
                    result
                }
                Layer::Filter { size, weight, bias, slope, features } => {
                    let head = naive::FilterHead { size: *size, weight, bias, slope: *slope };
                    head.apply(x, &tensors[*features], shape)
                }
                Layer::Concatenate(other) => {
                    let more = self.specs[*other].0;
                    let pixels = x.chunks(shape.channels).zip(tensors[*other].chunks(more));
                    pixels.flat_map(|(first, second)| [first, second].concat()).collect()
                }
                Layer::Add(other) => x.iter().zip(&tensors[*other]).map(|(a, b)| a + b).collect(),
                Layer::Modulate(scale, offset, slope) => {
                    let others = tensors[*scale].iter().zip(&tensors[*offset]);
                    let one =
                        |(x, (scale, offset)): (&f64, (&f64, &f64))| x / (1.0 + (-scale).exp()) + offset;
                    let sums: Vec<f64> = x.iter().zip(others).map(one).collect();
                    naive::epilogue(Epilogue::Leak(*slope), &sums)
                }
            };
            tensors.push(result);
        }
        tensors.pop().expect("a network has a step")
    }
}

fn run(plan: &Plan<'_>, rows: &[(&Vec<f32>, usize)], threads: usize) -> Vec<f32> {
    let mut output = Vec::new();
    let fill = |(input, len): (&Vec<f32>, usize), y: usize, row: &mut [f32]| {
        row.copy_from_slice(&input[y * len..][..len]);
    };
    let sources: Vec<_> = rows.iter().map(|&of| move |y: usize, row: &mut [f32]| fill(of, y, row)).collect();
    let sources: Vec<super::Source<'_>> = sources.iter().map(|source| source as super::Source<'_>).collect();
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
    let sink = |_: usize, row: &[f32]| output.extend_from_slice(row);
    pool.install(|| plan.run(&mut Arena::default(), &sources, sink, |_| Ok::<(), ()>(()))).unwrap();
    output
}

/// Each layer errs by 4e-6 of its largest output at most, and hardly makes errors of those before it larger; rows that
/// were not there yet, or were there no more, err by as much as there is.
#[test]
fn random_networks_compute_row_by_row_what_they_are_on_any_number_of_threads() {
    for seed in 1..=120 {
        let drawn = Drawn::new(seed);
        let network = drawn.network();
        let mut dice = Dice(seed ^ 0xd1ce);
        let mut side = |most: usize| (1 + dice.below(most / network.reduction())) * network.reduction();
        let sides = (side(96), side(24));
        let mut values = Values::new(seed ^ 0xf00d);
        let inputs: Vec<Vec<f32>> =
            (0..drawn.inputs).map(|input| values.take(drawn.shape(input, sides).len())).collect();
        let rows: Vec<_> =
            inputs.iter().zip(&drawn.specs).map(|(input, spec)| (input, spec.0 * sides.1)).collect();
        let expected = drawn.evaluate(&inputs, sides);
        let mut first = None;
        for (portion, threads) in [(4, 2), (8, 5), (20, 3), (96, 1)] {
            let what = format!("network {seed} of {sides:?}, portions of {portion}, {threads} threads");
            let plan = Plan::with_portion(&network, sides.0, sides.1, portion);
            let found = run(&plan, &rows, threads);
            assert_close(&found, &expected, 8e-6 * drawn.layers.len() as f64, &what);
            assert!(*first.get_or_insert_with(|| found.clone()) == found, "{what}: other bits");
        }
    }
}
