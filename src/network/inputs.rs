//! What a network is given: the image, what is known of its PSF, and further planes of the image's sides.

use std::borrow::Cow;
use std::collections::BTreeMap;

use burn::tensor::Tensor;
use ndarray::{ArrayView3, Axis};

use super::architecture::Architecture;
use crate::core::error::{Error, Result};
use crate::core::image::ToneMappedImage;
use crate::core::kernel_code::KernelCode;
use crate::core::orientation::Orientation;

/// What a network may read beside the image: three channels of its sides, in the tone-mapped domain.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Plane {
    /// The image after deconvolution with its PSF.
    Deconvolved,
    /// The standard deviation of each value's noise.
    Noise,
    /// 1 where the capture is saturated, 0 elsewhere.
    Saturated,
    /// The light that enters from beyond the border where that is as bright as the frame is on average, tone-mapped.
    Outside,
}

impl Plane {
    /// All of them.
    pub const ALL: [Self; 4] = [Self::Deconvolved, Self::Noise, Self::Saturated, Self::Outside];

    /// The name in messages and files.
    pub fn name(self) -> &'static str {
        match self {
            Self::Deconvolved => "deconvolved",
            Self::Noise => "noise",
            Self::Saturated => "saturated",
            Self::Outside => "outside",
        }
    }
}

/// The planes of one image by name.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Planes(BTreeMap<Plane, ToneMappedImage>);

impl Planes {
    /// No planes, as most networks want.
    pub const NONE: &Self = &Self(BTreeMap::new());

    /// The plane of a name.
    pub fn get(&self, plane: Plane) -> Option<&ToneMappedImage> {
        self.0.get(&plane)
    }

    /// Takes the plane of a name out.
    pub fn take(&mut self, plane: Plane) -> Option<ToneMappedImage> {
        self.0.remove(&plane)
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// Puts every plane upright, as [`Orientation::upright`] does.
    ///
    /// # Errors
    /// Never for planes as tone mapping makes them.
    pub fn upright(self, orientation: Orientation) -> Result<Self> {
        let upright = |(plane, image): (Plane, ToneMappedImage)| {
            Ok((plane, ToneMappedImage::from_planes(orientation.upright(image.into_planes()))?))
        };
        self.0.into_iter().map(upright).collect::<Result<_>>().map(Self)
    }

    /// Copies the same window out of every plane.
    ///
    /// # Panics
    /// When it reaches outside of the planes.
    #[must_use]
    pub fn crop(&self, top: usize, left: usize, height: usize, width: usize) -> Self {
        self.0.iter().map(|(&plane, image)| (plane, image.crop(top, left, height, width))).collect()
    }

    /// A window of every plane, copied unless it is all of them.
    ///
    /// # Panics
    /// When it reaches outside of the planes.
    pub fn window(&self, [top, left]: [usize; 2], [height, width]: [usize; 2]) -> Cow<'_, Self> {
        let is_whole = |image: &ToneMappedImage| (image.height(), image.width()) == (height, width);
        if self.0.values().all(is_whole) {
            return Cow::Borrowed(self);
        }
        Cow::Owned(self.crop(top, left, height, width))
    }

    /// Bytes of all planes.
    pub fn bytes(&self) -> usize {
        self.0.values().map(|image| size_of_val(image.as_slice())).sum()
    }
}

impl FromIterator<(Plane, ToneMappedImage)> for Planes {
    fn from_iter<I: IntoIterator<Item = (Plane, ToneMappedImage)>>(planes: I) -> Self {
        Self(planes.into_iter().collect())
    }
}

/// One image with all that a network may be told about it; each network looks at what it reads.
#[derive(Clone, Copy, Debug)]
pub struct Inputs<'a> {
    pub(super) image: &'a ToneMappedImage,
    /// The degradation map: `[b, height, width]`, or `[b, 1, 1]` of a code that is the same everywhere.
    pub(super) map: Option<ArrayView3<'a, f32>>,
    pub(super) planes: &'a Planes,
}

impl<'a> Inputs<'a> {
    /// An image alone, or with the code of its one PSF.
    pub fn new(image: &'a ToneMappedImage, code: Option<&'a KernelCode>) -> Self {
        Self { image, map: code.map(map_of_code), planes: Planes::NONE }
    }

    /// The same with a code for every pixel, `[b, height, width]`.
    #[must_use]
    pub fn with_map(self, map: ArrayView3<'a, f32>) -> Self {
        Self { map: Some(map), ..self }
    }

    /// The same with further planes of the image.
    #[must_use]
    pub fn with_planes(self, planes: &'a Planes) -> Self {
        Self { planes, ..self }
    }

    /// What the network looks at, once that is there and fits image and network.
    pub(super) fn checked(self, architecture: &Architecture) -> Result<Self> {
        let map = architecture.code_len().map(|expected| self.check_map(expected)).transpose()?;
        for &plane in architecture.planes() {
            let Some(given) = self.planes.get(plane) else {
                let reason = format!(
                    "the model reads the plane \"{}\" of every image and was given none; restore with the image's PSF, of \
                     which it is made",
                    plane.name()
                );
                return Err(Error::config("planes", reason));
            };
            self.check_sides(&format!("plane \"{}\"", plane.name()), (given.height(), given.width()))?;
        }
        Ok(Self { map, ..self })
    }

    fn check_map(&self, expected: usize) -> Result<ArrayView3<'a, f32>> {
        let Some(map) = self.map else {
            return Err(Error::config(
                "kernel code",
                format!(
                    "the model needs a code of {expected} numbers; give --bank BANK --angle A, --code FILE or \
                     --psf PSF"
                ),
            ));
        };
        let (dim, height, width) = map.dim();
        if dim != expected {
            let found = format!("{dim}; use the bank that the model was trained with");
            return Err(Error::shape("kernel code", format!("{expected} numbers"), found));
        }
        if (height, width) != (1, 1) {
            self.check_sides("degradation map", (height, width))?;
        }
        Ok(map)
    }

    fn check_sides(&self, what: &str, (height, width): (usize, usize)) -> Result<()> {
        if (height, width) == (self.image.height(), self.image.width()) {
            return Ok(());
        }
        let expected = format!("{} × {} as the image has", self.image.height(), self.image.width());
        Err(Error::shape(what, expected, format!("{height} × {width}")))
    }
}

/// A code as the degradation map of an image of one pixel.
fn map_of_code(code: &KernelCode) -> ArrayView3<'_, f32> {
    code.view().insert_axis(Axis(1)).insert_axis(Axis(2))
}

/// A batch of [`Inputs`] as tensors.
#[derive(Clone, Debug)]
pub struct InputTensors {
    /// Tone-mapped images, `[item, 3, height, width]` of any sides.
    pub image: Tensor<4>,
    /// Their degradation maps, `[item, b, height, width]`, or `[item, b, 1, 1]` for codes that are the same everywhere.
    pub map: Option<Tensor<4>>,
    /// Their planes, `[item, 3, height, width]` each.
    pub planes: BTreeMap<Plane, Tensor<4>>,
}

impl InputTensors {
    /// Images, with the codes of their PSFs where the network reads them.
    pub fn new(image: Tensor<4>, map: Option<Tensor<4>>) -> Self {
        Self { image, map, planes: BTreeMap::new() }
    }

    /// The degradation map that the network was declared to read.
    pub(super) fn map(&self) -> Tensor<4> {
        self.map.clone().expect("a network that reads kernel codes is given a degradation map")
    }

    /// A plane that the network was declared to read.
    pub(super) fn plane(&self, plane: Plane) -> Tensor<4> {
        let given = self.planes.get(&plane);
        given.unwrap_or_else(|| panic!("a network that reads {plane:?} is given it")).clone()
    }
}
