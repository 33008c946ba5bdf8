//! Sorts the channels of an OpenEXR file into groups that belong together, with the names by which users choose them.

use std::collections::BTreeMap;

use ::exr::math::Vec2;
use ::exr::meta::MetaData;
use ::exr::meta::attribute::Text;
use ::exr::meta::header::Header;
use serde::Serialize;

use super::layers::{Layer, all_names, choose_layer};

/// The channel that says how much of each pixel its light covers.
const ALPHA: &str = "A";

/// Luminance Y, between what red and blue have more than it, as shares of it (OpenEXR's luminance/chroma images).
const CHROMA: [&str; 3] = ["RY", "Y", "BY"];

/// Something in an OpenEXR file that can be read as an image.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct ImageLayer {
    /// The name that chooses it, behind the file's and a colon.
    pub name: String,
    /// Its channels.
    pub channels: Vec<String>,
    /// Number of columns that are shown.
    pub width: usize,
    /// Number of rows that are shown.
    pub height: usize,
    /// Whether it is the image where none is named.
    pub is_default: bool,
}

/// The channels of one part that share a prefix.
#[derive(Debug, PartialEq, Eq)]
pub(super) struct Group {
    /// Index of the part.
    pub(super) header: usize,
    /// What stands before the last point of the channels' names.
    pub(super) prefix: String,
    /// The name that chooses it.
    pub(super) name: String,
    /// All names that choose it; an empty one where channels are named alone.
    pub(super) aliases: Vec<String>,
    /// The channels' names behind the prefix in capital letters, and their indices in the part's list; of names that differ in
    /// nothing else, the one in capital letters has its place and others stay as they are.
    pub(super) channels: BTreeMap<String, usize>,
}

impl Group {
    /// The layer of these channels, if they are all there. Beside an X, a Y is a coordinate and no luminance; beside an RY and a BY
    /// it comes with these.
    pub(super) fn pick(&self, wanted: &[&str]) -> Option<Layer> {
        if wanted == ["Y"] && self.channels.contains_key("X") {
            return None;
        }
        let is_chroma = wanted == ["Y"] && CHROMA.iter().all(|name| self.channels.contains_key(*name));
        let wanted = if is_chroma { &CHROMA[..] } else { wanted };
        let channels = wanted.iter().map(|name| self.channels.get(*name).copied()).collect::<Option<_>>()?;
        // Among the photosites of a mosaic, an A is one of them.
        let alpha = self.channels.get(ALPHA).filter(|_| !wanted.contains(&ALPHA)).copied();
        Some(Layer { header: self.header, channels, alpha, is_chroma })
    }

    /// The layer of the one channel, where there is one.
    pub(super) fn only_channel(&self) -> Option<Layer> {
        let [index] = self.channels.values().copied().collect::<Vec<_>>()[..] else { return None };
        Some(Layer::of_channels(self.header, vec![index]))
    }

    /// All ways to name channels of the group.
    pub(super) fn spells<'a>(&'a self, channels: &'a str) -> impl Iterator<Item = String> + 'a {
        self.aliases.iter().map(move |alias| joined(alias, channels))
    }

    /// The way to name a channel of the group that is told to users.
    pub(super) fn name_of(&self, channel: &str) -> String {
        let own = if self.aliases.iter().any(String::is_empty) { "" } else { &self.name };
        joined(own, channel)
    }
}

fn joined(before: &str, name: &str) -> String {
    if before.is_empty() { name.to_owned() } else { format!("{before}.{name}") }
}

/// The groups of all parts.
pub(super) fn groups_of(meta: &MetaData) -> Vec<Group> {
    let has_parts = meta.headers.len() > 1;
    let mut groups = Vec::new();
    for (index, header) in meta.headers.iter().enumerate() {
        let part = text(header.own_attributes.layer_name.as_ref());
        for (prefix, channels) in channels_by_prefix(header) {
            let aliases = aliases(header, &part, &prefix, has_parts);
            let spelled = || {
                ["RGB", "Y"]
                    .into_iter()
                    .find(|name| has_all(&channels, name) && (*name != "Y" || !channels.contains_key("X")))
            };
            let first = aliases.iter().find(|alias| !alias.is_empty());
            // The unnamed group of the only part is named by its channels.
            let name = match (has_parts && !part.is_empty()) || !prefix.is_empty() {
                true => first.cloned(),
                false => spelled().map(str::to_owned).or_else(|| first.cloned()),
            };
            let name = name.unwrap_or_else(|| format!("part {}", index + 1));
            groups.push(Group { header: index, prefix, name, aliases, channels });
        }
    }
    groups
}

/// The channels of a part as [`Group::channels`] has them, by what stands before the last point of their names.
fn channels_by_prefix(header: &Header) -> BTreeMap<String, BTreeMap<String, usize>> {
    let names: Vec<String> = header.channels.list.iter().map(|channel| channel.name.to_string()).collect();
    let split = |index: usize| {
        let name = names[index].as_str();
        (index, name.rsplit_once('.').unwrap_or(("", name)))
    };
    let (capital, other): (Vec<_>, Vec<_>) =
        (0..names.len()).map(split).partition(|(_, (_, name))| *name == name.to_ascii_uppercase());
    let mut groups: BTreeMap<String, BTreeMap<String, usize>> = BTreeMap::new();
    for (index, (prefix, name)) in capital.into_iter().chain(other) {
        let channels = groups.entry(prefix.to_owned()).or_default();
        let folded = name.to_ascii_uppercase();
        let is_taken = channels.contains_key(&folded);
        channels.insert(if is_taken { name.to_owned() } else { folded }, index);
    }
    groups
}

fn has_all(channels: &BTreeMap<String, usize>, letters: &str) -> bool {
    letters.chars().all(|letter| channels.contains_key(&letter.to_string()))
}

/// The names of a group: its part and prefix, the view that it shows, and nothing where its channels need no more.
fn aliases(header: &Header, part: &str, prefix: &str, has_parts: bool) -> Vec<String> {
    let mut names = Vec::new();
    match (part, prefix) {
        ("", "") => {}
        (part, "") => names.push(part.to_owned()),
        (part, prefix) if part.is_empty() || !has_parts || part == prefix => names.push(prefix.to_owned()),
        (part, prefix) => {
            names.extend([format!("{part}.{prefix}"), format!("{part}/{prefix}"), prefix.to_owned()]);
        }
    }
    if prefix.is_empty() {
        // Of a file of several views the first one has no prefix; parts say which one they show.
        let views = header.own_attributes.multi_view_names.as_ref().and_then(|views| views.first());
        let view = text(views.or(header.own_attributes.view_name.as_ref()));
        names.extend((!view.is_empty()).then_some(view));
        names.push(String::new());
    }
    names
}

fn text(text: Option<&Text>) -> String {
    text.map(ToString::to_string).unwrap_or_default()
}

/// What can be read of a file.
pub(super) fn list(meta: &MetaData) -> Vec<ImageLayer> {
    let usual = choose_layer(meta, None, None).ok();
    let names = all_names(&groups_of(meta));
    let described = |name: String| {
        let layer = choose_layer(meta, None, Some(&name)).ok()?;
        let header = &meta.headers[layer.header];
        let Vec2(width, height) = header.shared_attributes.display_window.size;
        let channels = layer.channels.iter().map(|channel| header.channels.list[*channel].name.to_string());
        let is_default = usual.as_ref() == Some(&layer);
        Some(ImageLayer { channels: channels.collect(), width, height, is_default, name })
    };
    names.into_iter().filter_map(described).collect()
}
