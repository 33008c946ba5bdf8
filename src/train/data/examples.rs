//! Samples from a folder of examples: capture, ground truth and planes of an example, cut at one place and turned together.

use half::f16;
use half::slice::HalfFloatSliceExt as _;
use ndarray::Array3;
use rand::RngExt as _;

use super::cache::{Cache, Kept};
use super::{Patch, TrainingData, Window};
use crate::core::error::{Error, Result};
use crate::core::image::{CHANNELS, ToneMappedImage};
use crate::core::orientation::Orientation;
use crate::core::rng::Rng;
use crate::dataset::Split;
use crate::examples::{CAPTURE, ExampleRecord, ExamplesFolder, GROUND_TRUTH};
use crate::io::{HalfTensor, HalfTensors};
use crate::network::{Plane, Planes};

/// The examples of one split.
#[derive(Debug)]
pub struct ExampleData<'a> {
    folder: &'a ExamplesFolder,
    items: Vec<&'a ExampleRecord>,
    cache: Cache<HalfTensors>,
    /// The planes that samples carry.
    planes: &'static [Plane],
    /// Whether samples are turned and mirrored at random.
    turns: bool,
}

impl Kept for HalfTensors {
    fn bytes(&self) -> usize {
        self.values().map(|tensor| size_of_val(&tensor.values[..])).sum()
    }
}

impl<'a> ExampleData<'a> {
    /// Opens a split, whose samples carry some planes; at most `cache_mib` of examples stay in memory, in half precision.
    /// Those to learn from are turned by quarters and mirrored at random: a panel may be mounted in any way.
    ///
    /// # Errors
    /// [`Error::Format`] when the split is empty, or the examples were made without one of the planes.
    pub fn new(
        folder: &'a ExamplesFolder,
        split: Split,
        planes: &'static [Plane],
        cache_mib: usize,
    ) -> Result<Self> {
        let items: Vec<_> = folder.records.iter().filter(|record| record.split == split).collect();
        if items.is_empty() {
            return Err(Error::format(
                &folder.root,
                format!("holds no example of the {} split", split.name()),
            ));
        }
        let has = |plane: &Plane| folder.file.planes.iter().any(|name| name == plane.name());
        if let Some(plane) = planes.iter().find(|plane| !has(plane)) {
            let reason = format!("its examples lack the plane \"{}\"; make them anew", plane.name());
            return Err(Error::format(&folder.root, reason));
        }
        Ok(Self { folder, items, cache: Cache::new(cache_mib), planes, turns: split == Split::Train })
    }
}

impl TrainingData for ExampleData<'_> {
    fn len(&self) -> usize {
        self.items.len()
    }

    fn patch(&self, item: usize, side: usize, rng: &mut Rng) -> Result<Patch> {
        let record = self.items[item];
        let tensors = self.cache.get(&record.id, || self.folder.read(record))?;
        let in_file = |error: Error| error.while_doing(format!("reading example {}", record.id));
        let tensor =
            |name: &str| tensors.get(name).ok_or_else(|| Error::format(&self.folder.root, lacks(name)));
        let capture = tensor(CAPTURE)?;
        let [height, width] = sides(capture)?;
        let window = Window::draw(side, height, width, rng)?;
        let turn = if self.turns { Orientation::ALL[rng.random_range(0..8)] } else { Orientation::default() };
        let cut = |name: &str| cut(tensor(name)?, [height, width], window, turn);
        let planes = self.planes.iter().map(|&plane| Ok((plane, cut(plane.name())?)));
        Ok(Patch {
            degraded: cut(CAPTURE).map_err(in_file)?,
            ground_truth: cut(GROUND_TRUTH).map_err(in_file)?,
            code: None,
            planes: planes.collect::<Result<Planes>>().map_err(in_file)?,
        })
    }

    /// All of an example's tensors, in half precision.
    fn kept_bytes(&self) -> Result<u64> {
        let images = 2 + self.folder.file.planes.len();
        let side = self.folder.file.examples.side_px;
        Ok((self.items.len() * images * CHANNELS * side * side * size_of::<f16>()) as u64)
    }

    fn check_size(&self, side: usize) -> Result<()> {
        let doing = |error: Error| error.while_doing(format!("checking {}", self.folder.root.display()));
        Window::check_fits(side, [self.folder.file.examples.side_px; 2]).map_err(doing)
    }

    fn tags(&self, item: usize) -> &[String] {
        &self.items[item].tags
    }
}

fn lacks(name: &str) -> String {
    format!("an example lacks the tensor {name}; make it anew")
}

/// Height and width of an image.
fn sides(tensor: &HalfTensor) -> Result<[usize; 2]> {
    match tensor.shape[..] {
        [CHANNELS, height, width] => Ok([height, width]),
        _ => Err(Error::shape("tensor of an example", "three planes", format!("{:?}", tensor.shape))),
    }
}

/// The part of an image in a window, turned; the other tensors of an example are as large as its capture.
fn cut(tensor: &HalfTensor, size: [usize; 2], window: Window, turn: Orientation) -> Result<ToneMappedImage> {
    let found = sides(tensor)?;
    if found != size {
        return Err(Error::shape(
            "tensor of an example",
            format!("{size:?} as the capture"),
            format!("{found:?}"),
        ));
    }
    let [height, width] = size;
    let Window { top, left, side } = window;
    let mut values = vec![0.0; CHANNELS * side * side];
    for (row, to) in values.chunks_exact_mut(side).enumerate() {
        let start = (row / side * height + top + row % side) * width + left;
        let from: &[f16] = &tensor.values[start..start + side];
        from.convert_to_f32_slice(to);
    }
    let planes = Array3::from_shape_vec((CHANNELS, side, side), values).expect("as many as were converted");
    ToneMappedImage::from_planes(turn.upright(planes))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::progress::Progress;
    use crate::core::rng;
    use crate::core::shard::Shard;
    use crate::examples::{ExampleSet, ExamplesConfig};
    use crate::synth::Existing;

    /// Eight examples of 40 pixels, four of which are for validation.
    fn examples(root: &std::path::Path) -> ExamplesFolder {
        let mut config =
            ExamplesConfig { count: 8, validation_share: 0.5, side_px: 40, ..ExamplesConfig::default() };
        config.scenes.procedural_share = 1.0;
        config.panels.psf_side_px = 15;
        (config.panels.count, config.panels.validation) = (2, 1);
        let set = ExampleSet { config, shard: Shard::WHOLE };
        set.make(root, Existing::Refuse, &Progress::default(), |_| {}).unwrap();
        ExamplesFolder::open(root).unwrap()
    }

    /// Each sample is one of the eight turns of the same window of every tensor.
    #[test]
    fn what_belongs_together_is_cut_and_turned_together() {
        let root = tempfile::tempdir().unwrap();
        let folder = examples(root.path());
        let data = ExampleData::new(&folder, Split::Train, &Plane::ALL, 16).unwrap();
        let tensors = folder.read(data.items[0]).unwrap();
        let mut turned = std::collections::BTreeSet::new();
        for position in 0..24 {
            let mut rng = rng::stream(1, &position.to_string());
            let patch = data.patch(0, 24, &mut rng.clone()).unwrap();
            let window = Window::draw(24, 40, 40, &mut rng).unwrap();
            let expected = |name: &str, turn| cut(&tensors[name], [40, 40], window, turn).unwrap();
            let mut turns = Orientation::ALL.into_iter();
            let turn = turns.find(|&turn| expected(CAPTURE, turn) == patch.degraded).expect("one of eight");
            assert_eq!(expected(GROUND_TRUTH, turn), patch.ground_truth);
            for plane in Plane::ALL {
                assert_eq!(Some(&expected(plane.name(), turn)), patch.planes.get(plane));
            }
            turned.insert(turn.exif());
        }
        assert!(turned.len() > 4, "{turned:?}");
    }

    #[test]
    fn validation_shows_examples_as_they_are_and_names_their_tags() {
        let root = tempfile::tempdir().unwrap();
        let folder = examples(root.path());
        let data = ExampleData::new(&folder, Split::Val, &[Plane::Noise], 0).unwrap();
        let patch = data.patch(2, 40, &mut rng::stream(1, "validation/2")).unwrap();
        let record = data.items[2];
        let tensors = folder.read(record).unwrap();
        assert_eq!(patch.degraded.planes()[[1, 3, 5]], tensors[CAPTURE].values[(40 + 3) * 40 + 5].to_f32());
        assert!(patch.planes.get(Plane::Noise).is_some() && patch.planes.get(Plane::Deconvolved).is_none());
        assert_eq!(data.tags(2), record.tags);
        assert!(data.patch(2, 41, &mut rng::stream(1, "")).unwrap_err().to_string().contains("40 × 40"));
        data.check_size(40).unwrap();
        assert!(data.check_size(41).unwrap_err().in_full().contains("40 × 40"));
        let none = ExampleData::new(&folder, Split::Test, &[], 0).unwrap_err().to_string();
        assert!(none.contains("no example of the test split"), "{none}");
    }
}
