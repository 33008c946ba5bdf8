//! DISCNet's layers under their released names.

use crate::core::image::CHANNELS;
use crate::network::architecture::{Architecture, Condition, Scales};
use crate::network::layers::{Layer, LayerList};

/// Number of resolutions of the network; each has half the sides of the one before.
pub(super) const LEVELS: usize = 3;

/// Channels at a level: n, 2n, 4n.
fn channels(architecture: &Architecture, level: usize) -> usize {
    architecture.features << level
}

/// Channels that the condition encoder reads: of the code's map, then of the image; `None` when there is no
/// such encoder.
pub(super) fn condition_channels(architecture: &Architecture) -> Option<(usize, usize)> {
    let condition = architecture.condition;
    let code = if condition.uses_code() { architecture.code_dim } else { 0 };
    let image = if condition.uses_image() { CHANNELS } else { 0 };
    (image + code > 0).then_some((code, image))
}

/// Whether the skip connection of a level has dynamic filters.
pub(super) fn has_filters(architecture: &Architecture, level: usize) -> bool {
    architecture.condition != Condition::None && (architecture.scales == Scales::Multi || level == LEVELS - 1)
}

/// The released name of a level's filter generator; the coarsest has no digit.
pub(super) fn filter_generator_name(level: usize) -> String {
    if level == LEVELS - 1 { "dynamic_kernel".to_owned() } else { format!("dynamic_kernel{}", level + 1) }
}

/// Every layer with weights, in a fixed order.
pub(super) fn layers(architecture: &Architecture) -> Vec<Layer> {
    let mut list = LayerList::default();
    encoder(&mut list, architecture, "conv", CHANNELS);
    if let Some((code, image)) = condition_channels(architecture) {
        encoder(&mut list, architecture, "kconv", code + image);
    }
    for level in (0..LEVELS).filter(|&level| has_filters(architecture, level)) {
        filter_generator(&mut list, architecture, level);
    }
    for level in (0..LEVELS - 1).rev() {
        let (fine, coarse) = (channels(architecture, level), channels(architecture, level + 1));
        let scale = level + 1;
        list.convolution(format!("upconv_{scale}1.0"), [coarse, 4 * fine, 3], level + 1);
        list.res_block(&format!("upconv_{scale}2"), fine, level);
        list.res_block(&format!("upconv_{scale}3"), fine, level);
    }
    list.convolution("final_conv.0", [architecture.features, CHANNELS, 3], 0);
    list.0
}

fn encoder(list: &mut LayerList, architecture: &Architecture, prefix: &str, inputs: usize) {
    for level in 0..LEVELS {
        let (outputs, scale) = (channels(architecture, level), level + 1);
        let inputs = if level == 0 { inputs } else { channels(architecture, level - 1) };
        list.convolution(format!("{prefix}_{scale}1.0"), [inputs, outputs, 3], level);
        list.res_block(&format!("{prefix}_{scale}2"), outputs, level);
        list.res_block(&format!("{prefix}_{scale}3"), outputs, level);
    }
}

fn filter_generator(list: &mut LayerList, architecture: &Architecture, level: usize) {
    let (name, channels) = (filter_generator_name(level), channels(architecture, level));
    list.convolution(format!("{name}.0.0"), [channels, channels, 3], level);
    list.slope(format!("{name}.0.1"), level);
    list.res_block(&format!("{name}.1"), channels, level);
    list.res_block(&format!("{name}.2"), channels, level);
    let filters = channels * architecture.filter_size * architecture.filter_size;
    list.convolution(format!("{name}.3.0"), [channels, filters, 1], level);
    list.slope(format!("{name}.3.1"), level);
}
