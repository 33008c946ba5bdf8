//! Chooses which channels of an OpenEXR file are the image: by the name that the user gives, else by OpenEXR's rules.

use ::exr::meta::MetaData;

use super::groups::{Group, groups_of};
use crate::core::bayer::BayerPattern;
use crate::core::nearest::nearest;

/// The channels of an image inside of a file: red, green, blue, or luminance with chroma, or one alone.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Layer {
    /// Index of the part.
    pub(super) header: usize,
    /// Indices of the channels in the part's list.
    pub(super) channels: Vec<usize>,
    /// That of the alpha which stands beside colours or luminance.
    pub(super) alpha: Option<usize>,
    /// Whether the channels are RY, Y and BY in place of red, green and blue.
    pub(super) is_chroma: bool,
}

impl Layer {
    /// The layer of channels that have no alpha.
    pub(super) fn of_channels(header: usize, channels: Vec<usize>) -> Self {
        Self { header, channels, alpha: None, is_chroma: false }
    }
}

/// What is read of a group of channels, the first that is there; four photosites come before these.
const PICTURES: [&[&str]; 2] = [&["R", "G", "B"], &["Y"]];

/// Chooses the image of a file: the layer of a name, or the one that is the image by itself.
///
/// Without a name it is R, G, B, or where no layer has these Y, with RY and BY beside it in colour. A file of a single channel is that
/// channel, whatever its name: mosaics are stored so. Among several layers the one without a channel prefix is the image, as OpenEXR
/// defines it, when there is only one such. With a pattern, four channels are the photosites of a packed mosaic.
pub(super) fn choose_layer(
    meta: &MetaData,
    packed: Option<BayerPattern>,
    name: Option<&str>,
) -> Result<Layer, String> {
    let packed = packed.map(names_of_sites).unwrap_or_default();
    let pictures: Vec<&[&str]> = packed.iter().map(<[&str; 4]>::as_slice).chain(PICTURES).collect();
    let groups = groups_of(meta);
    match name {
        Some(name) => named(&groups, &pictures, name),
        None => usual(&groups, &pictures),
    }
}

fn usual(groups: &[Group], pictures: &[&[&str]]) -> Result<Layer, String> {
    for wanted in pictures {
        let mut found: Vec<(&Group, Layer)> =
            groups.iter().filter_map(|group| Some((group, group.pick(wanted)?))).collect();
        if found.iter().filter(|(group, _)| group.prefix.is_empty()).count() == 1 {
            found.retain(|(group, _)| group.prefix.is_empty());
        }
        if found.len() > 1 {
            let names: Vec<&str> = found.iter().map(|(group, _)| group.name.as_str()).collect();
            return Err(format!(
                "has several layers ({}); name the one you mean behind a colon, as in file.exr:{}",
                names.join(", "),
                names[0]
            ));
        }
        if let Some((_, layer)) = found.pop() {
            return Ok(layer);
        }
    }
    let channels: Vec<(&Group, &String, usize)> = groups
        .iter()
        .flat_map(|group| group.channels.iter().map(move |(name, index)| (group, name, *index)))
        .collect();
    if let [(group, _, index)] = channels[..] {
        return Ok(Layer::of_channels(group.header, vec![index]));
    }
    let names: Vec<String> = channels.iter().map(|(group, name, _)| group.name_of(name)).collect();
    let Some(first) = names.first() else { return Err("has no channel".to_owned()) };
    Err(format!(
        "has no R, G, B channels and no Y channel; it has {}: name one behind a colon, as in file.exr:{first}",
        names.join(", ")
    ))
}

/// The layer of a name, in capital or small letters where that makes no difference.
fn named(groups: &[Group], pictures: &[&[&str]], name: &str) -> Result<Layer, String> {
    let exact = |known: &str| known == name;
    let folded = |known: &str| known.to_lowercase() == name.to_lowercase();
    let mut found = matches(groups, pictures, exact);
    if found.is_empty() {
        found = matches(groups, pictures, folded);
    }
    // Several names of one layer may be the same.
    found.dedup();
    match &found[..] {
        [Ok(layer)] => Ok(layer.clone()),
        [Err(group)] => {
            let names: Vec<String> = group.channels.keys().map(|channel| group.name_of(channel)).collect();
            Err(format!(
                "`{name}` is no picture of R, G, B or Y; name one of its channels: {}",
                names.join(", ")
            ))
        }
        [] => {
            let names = all_names(groups);
            let meant =
                nearest(name, &names).map_or(String::new(), |known| format!("; did you mean `{known}`?"));
            Err(format!("has no layer `{name}`, but {}{meant}", names.join(", ")))
        }
        _ => Err(format!("has several layers `{name}`; name one of {}", all_names(groups).join(", "))),
    }
}

/// The layers that a name stands for, or the group of channels that is no picture.
fn matches<'a>(
    groups: &'a [Group],
    pictures: &[&[&str]],
    is_meant: impl Fn(&str) -> bool,
) -> Vec<Result<Layer, &'a Group>> {
    let mut found = Vec::new();
    for group in groups {
        let picture = || pictures.iter().find_map(|wanted| group.pick(wanted));
        if group.aliases.iter().any(|alias| !alias.is_empty() && is_meant(alias)) {
            found.push(picture().or_else(|| group.only_channel()).ok_or(group));
            continue;
        }
        for spelled in PICTURES.iter().filter(|wanted| group.pick(wanted).is_some()) {
            let ends = [spelled.concat(), format!("{}A", spelled.concat())];
            if ends.iter().any(|end| group.spells(end).any(|name| is_meant(&name))) {
                found.extend(group.pick(spelled).map(Ok));
            }
        }
        let is_luminance = group.pick(&["Y"]).is_some();
        for (channel, index) in &group.channels {
            if is_luminance && channel == "Y" {
                continue;
            }
            if group.spells(channel).any(|name| is_meant(&name)) {
                found.push(Ok(Layer::of_channels(group.header, vec![*index])));
            }
        }
    }
    found
}

/// What can be named: layers that are pictures, and the channels of others.
pub(super) fn all_names(groups: &[Group]) -> Vec<String> {
    let names = |group: &Group| match PICTURES.iter().any(|wanted| group.pick(wanted).is_some()) {
        true => vec![group.name.clone()],
        false => group.channels.keys().map(|channel| group.name_of(channel)).collect(),
    };
    groups.iter().flat_map(names).collect()
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
