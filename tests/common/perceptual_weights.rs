//! Weights of recognition networks that a formula gives, the same in every implementation; see
//! `tests/fixtures/perceptual/case.json`.

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::path::Path;

use udc::io::{self, FloatWidth, TensorData};

/// The finaliser of SplitMix64, of the state after `z`.
fn splitmix64(z: u64) -> u64 {
    let z = z.wrapping_add(0x9e37_79b9_7f4a_7c15);
    let z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    let z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

/// The formula of the fixture: tensor `t`'s values.
fn values(t: u64, shape: &[usize]) -> Vec<f32> {
    let fan_in: usize = shape[1..].iter().product();
    let scale = if shape.len() == 1 { 0.1 } else { (24.0 / fan_in as f64).sqrt() };
    let uniform = |j: u64| (splitmix64((t << 40) + j) >> 40) as f64 / (1u64 << 24) as f64 - 0.5;
    (0..shape.iter().product::<usize>() as u64).map(|j| (scale * uniform(j)) as f32).collect()
}

/// Writes the convolutions of a torchvision network: (place, [outputs, inputs, side, side]).
pub(crate) fn write_convolutions(path: &Path, layers: &[(usize, [usize; 4])]) {
    let mut tensors = BTreeMap::new();
    for (i, (place, shape)) in layers.iter().enumerate() {
        let mut add = |t: usize, part: &str, shape: &[usize]| {
            let data: TensorData<'_> = (shape.to_vec(), Cow::Owned(values(t as u64, shape)));
            tensors.insert(format!("features.{place}.{part}"), data);
        };
        add(2 * i, "weight", shape);
        add(2 * i + 1, "bias", &shape[..1]);
    }
    io::write_safetensors(path, &tensors, &BTreeMap::new(), FloatWidth::Single, false).unwrap();
}

pub(crate) fn write_alexnet(path: &Path) {
    let layers = [
        (0, [64, 3, 11, 11]),
        (3, [192, 64, 5, 5]),
        (6, [384, 192, 3, 3]),
        (8, [256, 384, 3, 3]),
        (10, [256, 256, 3, 3]),
    ];
    write_convolutions(path, &layers);
}

pub(crate) fn write_linear(path: &Path) {
    let mut tensors = BTreeMap::new();
    for (i, channels) in [64, 192, 384, 256, 256].into_iter().enumerate() {
        let weights = (0..channels).map(|j| (0.5 + 0.5 * ((j + i) as f64).sin()) as f32).collect();
        let data: TensorData<'_> = (vec![1, channels, 1, 1], Cow::Owned(weights));
        tensors.insert(format!("lin{i}.model.1.weight"), data);
    }
    io::write_safetensors(path, &tensors, &BTreeMap::new(), FloatWidth::Single, false).unwrap();
}
