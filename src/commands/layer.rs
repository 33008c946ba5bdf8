//! The flag that names a layer of all inputs.

use std::path::PathBuf;

use clap::Args;

use udc::io::with_layer;

#[derive(Args, Debug)]
pub(super) struct LayerArgs {
    /// Layer or part to read of every input, as `udc info` lists them; the same as IN:NAME
    #[arg(long, value_name = "NAME")]
    layer: Option<String>,
}

impl LayerArgs {
    /// The inputs, with the layer that is meant of each.
    pub(super) fn of(&self, inputs: &[PathBuf]) -> Vec<PathBuf> {
        let with = |input: &PathBuf| {
            self.layer.as_ref().map_or_else(|| input.clone(), |layer| with_layer(input, layer))
        };
        inputs.iter().map(with).collect()
    }
}
