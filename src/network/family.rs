//! What a family of networks is, and the table of all families: a new one is a file of its own and a line here.

use std::fmt::Debug;

use burn::module::Module;
use burn::tensor::Tensor;
use serde::{Deserialize, Serialize};

use super::architecture::{Architecture, Condition};
use super::builder::Builder;
use super::inputs::{InputTensors, Plane};
use super::layers::Layer;
use super::parameters::Initialisation;
use super::precision::Precision;
use super::streamed::StreamBuilder;
#[cfg(test)]
use super::testing;
use super::{de_unet, discnet, guided, sftmd, srmdnf};
use crate::core::error::{Error, Result};

/// Appends the steps of a network to those that the kernels stream.
pub(super) type Stream = fn(&mut StreamBuilder<'_>, &Architecture);

/// Networks of one plan, which differ by the keys of their [`Architecture`].
pub(super) trait Family: Sync {
    /// The weights as Burn computes with them.
    type Network: Forward
    where
        Self: Sized;

    /// Every layer with weights, in the order of the files.
    fn layers(&self, architecture: &Architecture) -> Vec<Layer>;

    /// Pixels around a tile, starting at a multiple of [`side_multiple`](Self::side_multiple), that its restoration may
    /// depend on, rounded up to such a multiple.
    fn halo(&self) -> usize;

    /// What the sides that the network computes are multiples of.
    fn side_multiple(&self) -> usize {
        1
    }

    /// Length of the kernel codes that the network reads; `None` when it reads none.
    fn code_len(&self, architecture: &Architecture) -> Option<usize> {
        architecture.condition.uses_code().then_some(architecture.code_dim)
    }

    /// The planes that the network reads beside the image.
    fn planes(&self) -> &'static [Plane] {
        &[]
    }

    /// Checks the keys that mean something of their own to this family.
    ///
    /// # Errors
    /// [`Error::Config`] naming the key that is out of range.
    fn validate(&self, architecture: &Architecture) -> Result<()>;

    /// Whether the network depends on a key, one of dynamic filters being of no use to most; `code-dim` is that of
    /// [`code_len`](Self::code_len).
    fn reads_key(&self, _architecture: &Architecture, key: &str) -> bool {
        !["scales", "filter-size"].contains(&key)
    }

    /// Checks that signals keep their size under weights that are drawn so.
    ///
    /// # Errors
    /// [`Error::Config`] when they do not.
    fn check_initialisation(&self, _initialisation: Initialisation) -> Result<()> {
        Ok(())
    }

    /// The network as steps of the kernels, where it is written as such: whole images are then restored a few rows at a
    /// time, and as tensors otherwise.
    fn stream(&self) -> Option<Stream> {
        None
    }

    /// Arranges the weights.
    fn build(&self, architecture: &Architecture, build: &Builder<'_>) -> Self::Network
    where
        Self: Sized;
}

/// Weights that compute.
pub(super) trait Forward: Module + Debug {
    /// Restores a batch of images, and what else [`Family`] declares to be read, whose sides are multiples of
    /// [`Family::side_multiple`].
    ///
    /// What is between the image and the last layer is computed with numbers of the precision.
    fn forward(&self, inputs: InputTensors, precision: Precision) -> Tensor<4>;
}

/// Checks the one condition of a family that leaves no choice; the key says so for all who look at it.
pub(super) fn check_condition(architecture: &Architecture, (fixed, name): (Condition, &str)) -> Result<()> {
    if architecture.condition == fixed {
        return Ok(());
    }
    Err(Error::config("condition", format!("must be \"{name}\" for this kind of network; set it so")))
}

/// Makes of the table below the kinds by name, and the weights of a network of any of them.
macro_rules! families {
    ($($(#[doc = $doc:literal])+ $(#[cfg($when:meta)])? $kind:ident: $family:path => $network:ty,)+) => {
        /// The family of networks that a model belongs to.
        #[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
        #[serde(rename_all = "kebab-case")]
        pub enum Kind {
            $($(#[doc = $doc])+ $(#[cfg($when)])? $kind,)+
        }

        impl Kind {
            /// Every kind.
            pub const ALL: &[Self] = &[$($(#[cfg($when)])? Self::$kind,)+];

            pub(super) fn family(self) -> &'static dyn Family {
                match self {
                    $($(#[cfg($when)])? Self::$kind => &$family,)+
                }
            }
        }

        /// The weights, arranged as each kind computes with them.
        #[derive(Module, Debug)]
        #[expect(clippy::large_enum_variant, reason = "a program holds a few networks, not lists of them")]
        pub(super) enum Layers {
            $($(#[cfg($when)])? $kind($network),)+
        }

        impl Layers {
            /// Arranges the weights of a kind.
            pub(super) fn build(architecture: &Architecture, build: &Builder<'_>) -> Self {
                match architecture.kind {
                    $($(#[cfg($when)])? Kind::$kind => Self::$kind($family.build(architecture, build)),)+
                }
            }

            /// That of the kind.
            pub(super) fn forward(&self, inputs: InputTensors, precision: Precision) -> Tensor<4> {
                match self {
                    $($(#[cfg($when)])? Self::$kind(network) => network.forward(inputs, precision),)+
                }
            }
        }
    };
}

families! {
    /// The dynamic skip connection network.
    Discnet: discnet::Discnet => discnet::DiscNet,
    /// Its restoration branch alone: a U-Net with plain skip connections.
    Unet: discnet::Unet => discnet::DiscNet,
    /// SRMD without noise input and without up-sampling: plain convolutions of image and degradation map.
    Srmdnf: srmdnf::Srmdnf => srmdnf::Layers,
    /// SFTMD without up-sampling: residual blocks that the degradation map modulates.
    Sftmd: sftmd::Sftmd => sftmd::Layers,
    /// A U-Net with two image encoders.
    DeUnet: de_unet::DeUnet => de_unet::Layers,
    /// A U-Net that corrects the image deconvolved with its PSF, told how far to trust it.
    Guided: guided::Guided => guided::Layers,
    /// Reads every plane, and is streamed.
    #[cfg(test)]
    AllPlanes: testing::AllPlanes => testing::Layers,
    /// The same, but not written for the kernels.
    #[cfg(test)]
    AllPlanesTensors: testing::AllPlanesTensors => testing::Layers,
}
