//! Chooses which channels of an OpenEXR file are the image.

use std::collections::BTreeMap;

use ::exr::meta::MetaData;
use ::exr::meta::header::Header;

use crate::core::bayer::BayerPattern;

/// The channels of an image inside of a file: red, green, blue, or luminance alone.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Layer {
    /// Index of the part.
    pub(super) header: usize,
    /// Indices of the channels in the part's list.
    pub(super) channels: Vec<usize>,
    /// Part name and channel prefix, for messages.
    name: String,
    /// Whether the layer has neither a prefix nor, among several parts, a name.
    unnamed: bool,
}

/// Chooses the one layer that is an image: R, G, B by name, or Y where no layer has colours.
///
/// A file of a single channel is that channel, whatever its name: mosaics are stored so.
///
/// Among several layers the one without a channel prefix is the image, as OpenEXR defines it, when there is
/// only one such. With a pattern, four channels are the photosites of a packed mosaic.
pub(super) fn choose_layer(meta: &MetaData, packed: Option<BayerPattern>) -> Result<Layer, String> {
    let parts = || meta.headers.iter().enumerate().flat_map(|(index, header)| layers_of_part(index, header));
    let packed = packed.map(names_of_sites).unwrap_or_default();
    let wanted = packed.iter().map(<[&str; 4]>::as_slice).chain([&["R", "G", "B"][..], &["Y"][..]]);
    for wanted in wanted {
        let mut found: Vec<Layer> = parts().filter_map(|part| part.pick(wanted)).collect();
        let unnamed = found.iter().filter(|layer| layer.unnamed).count();
        if unnamed == 1 {
            found.retain(|layer| layer.unnamed);
        }
        match found.len() {
            0 => {}
            1 => return Ok(found.remove(0)),
            _ => {
                let names: Vec<String> = found.into_iter().map(|layer| layer.name).collect();
                return Err(format!(
                    "has several layers ({}); write the one you mean to a file of its own",
                    names.join(", ")
                ));
            }
        }
    }
    if let [header] = &meta.headers[..]
        && let [channel] = &header.channels.list[..]
    {
        let name = channel.name.to_string();
        return Ok(Layer { header: 0, channels: vec![0], name, unnamed: true });
    }
    let names: Vec<String> = meta
        .headers
        .iter()
        .flat_map(|header| &header.channels.list)
        .map(|channel| channel.name.to_string())
        .collect();
    Err(format!("has no R, G, B channels and no Y channel; it has {}", names.join(", ")))
}

/// What the four photosites of a pattern, in reading order, are called in files: the greens counted in reading order, or
/// told apart by the colour that they share a row with; or all four called as the channels of a picture with alpha.
fn names_of_sites(pattern: BayerPattern) -> Vec<[&'static str; 4]> {
    let sites = pattern.sites();
    let green_of_row = |row: usize| if sites[2 * row..2 * row + 2].contains(&0) { "GR" } else { "GB" };
    let name = |site: usize, greens: [&'static str; 2]| match sites[site] {
        0 => "R",
        1 => greens[site / 2],
        _ => "B",
    };
    let named = |greens| [0, 1, 2, 3].map(|site| name(site, greens));
    vec![named(["G1", "G2"]), named([green_of_row(0), green_of_row(1)]), ["R", "G", "B", "A"]]
}

/// The channels of one part that share a prefix.
struct Group {
    header: usize,
    part: String,
    prefix: String,
    channels: BTreeMap<String, usize>,
}

fn layers_of_part(index: usize, header: &Header) -> Vec<Group> {
    let part = header.own_attributes.layer_name.as_ref().map(ToString::to_string).unwrap_or_default();
    let mut groups: BTreeMap<String, BTreeMap<String, usize>> = BTreeMap::new();
    for (channel, description) in header.channels.list.iter().enumerate() {
        let name = description.name.to_string();
        let (prefix, name) = name.rsplit_once('.').map_or(("", name.as_str()), |split| split);
        groups.entry(prefix.to_owned()).or_default().insert(name.to_ascii_uppercase(), channel);
    }
    let group = |(prefix, channels)| Group { header: index, part: part.clone(), prefix, channels };
    groups.into_iter().map(group).collect()
}

impl Group {
    fn pick(self, wanted: &[&str]) -> Option<Layer> {
        let channels: Vec<usize> =
            wanted.iter().map(|name| self.channels.get(*name).copied()).collect::<Option<_>>()?;
        let name = match (self.part.as_str(), self.prefix.as_str()) {
            ("", "") => "unnamed".to_owned(),
            ("", name) | (name, "") => name.to_owned(),
            (part, prefix) => format!("{part}/{prefix}"),
        };
        Some(Layer { header: self.header, channels, unnamed: self.prefix.is_empty(), name })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn greens_are_told_apart_by_order_or_by_row() {
        let names = |pattern| names_of_sites(pattern)[..2].to_vec();
        assert_eq!(names(BayerPattern::Rggb), [["R", "G1", "G2", "B"], ["R", "GR", "GB", "B"]]);
        assert_eq!(names(BayerPattern::Bggr), [["B", "G1", "G2", "R"], ["B", "GB", "GR", "R"]]);
        assert_eq!(names(BayerPattern::Gbrg), [["G1", "B", "R", "G2"], ["GB", "B", "R", "GR"]]);
    }
}
