//! Describes an OpenEXR file of several layers of which none is the image by itself.

use std::fmt::{self, Write as _};
use std::path::Path;

use serde::Serialize;

use super::text::write_lines;
use crate::io::{ImageLayer, read_layers};

/// A file of several layers, of which one must be named.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct LayersDescription {
    /// What can be read of it.
    pub layers: Vec<ImageLayer>,
}

impl LayersDescription {
    /// Describes a file without an image of its own; none where it has no layers, or one is the image.
    pub(super) fn read(path: &Path) -> Option<Self> {
        let layers = read_layers(path).ok()?;
        let must_be_named = !layers.is_empty() && layers.iter().all(|layer| !layer.is_default);
        must_be_named.then_some(Self { layers })
    }
}

impl fmt::Display for LayersDescription {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write_lines(f, |text| {
            writeln!(
                text,
                "OpenEXR file of several layers, none of which is the image by itself: name one behind a colon"
            )?;
            write_layers(text, &self.layers)
        })
    }
}

/// A line for each layer.
pub(super) fn write_layers(text: &mut String, layers: &[ImageLayer]) -> fmt::Result {
    let width = layers.iter().map(|layer| layer.name.chars().count()).max().unwrap_or(0);
    for layer in layers {
        let ImageLayer { name, channels, width: columns, height: rows, is_default } = layer;
        let usual = if *is_default { ", read where none is named" } else { "" };
        writeln!(text, "  layer     :{name:<width$}  {columns} × {rows}, {}{usual}", channels.join(" "))?;
    }
    Ok(())
}
