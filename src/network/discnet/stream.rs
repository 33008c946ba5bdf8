//! DISCNet as the streamed steps of the kernels.

use super::layers::{LEVELS, condition_channels, filter_generator_name, has_filters};
use crate::kernels::stream::Tensor;
use crate::kernels::{Convolution, DynamicFilter};
use crate::network::architecture::Architecture;
use crate::network::operations::LEAKY_SLOPE;
use crate::network::streamed::{Part, StreamBuilder};

/// Appends all steps.
pub(super) fn stream(build: &mut StreamBuilder<'_>, architecture: &Architecture) {
    let image = build.input(&[Part::Image]);
    let condition_input = condition_channels(architecture).map(|condition| match condition {
        (0, _) => build.input(&[Part::Image]),
        (code, 0) => build.input(&[Part::Map(code)]),
        (code, _) => build.input(&[Part::Map(code), Part::Image]),
    });
    let skips = encoder(build, "conv", image);
    let conditions = condition_input.map(|input| encoder(build, "kconv", input));
    let mut filtered = skips.clone();
    for (level, conditions) in conditions.iter().flatten().enumerate() {
        if has_filters(architecture, level) {
            filtered[level] = filter(build, (level, architecture.filter_size), *conditions, skips[level]);
        }
    }
    let mut x = filtered[LEVELS - 1];
    for scale in (1..LEVELS).rev() {
        x = up_convolution(build, &format!("upconv_{scale}1.0"), x, filtered[scale - 1]);
        x = res_blocks(build, &[format!("upconv_{scale}2"), format!("upconv_{scale}3")], x);
    }
    build.convolution("final_conv.0", x, LEAKY_SLOPE, Some(image));
}

fn up_convolution(build: &mut StreamBuilder<'_>, name: &str, input: Tensor, skip: Tensor) -> Tensor {
    let (weight, bias) = build.layer(name);
    let packed = Convolution::up(build.isa, weight.len() / bias.len() / 9, weight, bias);
    build.network.convolution(input, packed, LEAKY_SLOPE, Some(skip))
}

fn res_blocks(build: &mut StreamBuilder<'_>, names: &[String; 2], input: Tensor) -> Tensor {
    names.iter().fold(input, |x, name| {
        let [first, second] = ["conv1", "conv2"].map(|part| build.pack(&format!("{name}.{part}"), 1));
        build.network.res_block(x, first, second, LEAKY_SLOPE)
    })
}

/// The features of every resolution, finest first.
fn encoder(build: &mut StreamBuilder<'_>, prefix: &str, input: Tensor) -> Vec<Tensor> {
    let mut x = input;
    let scale = |scale: usize| {
        let packed = build.pack(&format!("{prefix}_{scale}1.0"), if scale == 1 { 1 } else { 2 });
        x = build.network.convolution(x, packed, LEAKY_SLOPE, None);
        x = res_blocks(build, &[format!("{prefix}_{scale}2"), format!("{prefix}_{scale}3")], x);
        x
    };
    (1..=LEVELS).map(scale).collect()
}

fn filter(
    build: &mut StreamBuilder<'_>,
    (level, size): (usize, usize),
    condition: Tensor,
    features: Tensor,
) -> Tensor {
    let name = filter_generator_name(level);
    let slope = build.values(&format!("{name}.0.1.weight"))[0];
    let x = build.convolution(&format!("{name}.0.0"), condition, slope, None);
    let x = res_blocks(build, &[format!("{name}.1"), format!("{name}.2")], x);
    let (weight, bias) = build.layer(&format!("{name}.3.0"));
    let slope = build.values(&format!("{name}.3.1.weight"))[0];
    let head = DynamicFilter::new(build.isa, size, weight, bias, slope);
    build.network.dynamic_filter(x, features, head)
}
