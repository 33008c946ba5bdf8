//! The GPUs that the program can compute on, in builds with the feature `gpu` (Vulkan, Metal, DX12) or `cuda`.

use std::fmt;

use burn::tensor::Device;

use crate::core::error::{Error, Result};

/// Whether this build can compute on GPUs.
pub const IS_BUILT: bool = cfg!(any(feature = "gpu", feature = "cuda"));

/// Whether this build reaches devices by CUDA.
pub(super) const HAS_CUDA: bool = cfg!(feature = "cuda");

/// What NVIDIA's devices are reached by.
const CUDA: &str = "CUDA";

/// What to do where a device does not compute in bfloat16.
pub(super) const BFLOAT16_ELSEWHERE: &str = if cfg!(feature = "cuda") {
    ""
} else {
    " (Vulkan, Metal and DX12 are given their programs in WGSL, which has no such numbers; a build with `--features cuda` has \
     them on NVIDIA's cards)"
};

/// A device of [`list`], by its number.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Gpu(usize);

/// A device as it names itself.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct GpuInfo {
    /// Its number, for `gpu:N`.
    pub number: usize,
    /// Its name.
    pub name: String,
    /// What it is reached by.
    pub interface: &'static str,
    /// Whether it is a card, and no program that computes as one on the CPU.
    pub is_card: bool,
}

impl fmt::Display for GpuInfo {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { number, name, interface, is_card } = self;
        let kind = if *is_card { "" } else { ", no card: a program on the CPU" };
        write!(f, "gpu:{number}: {name} ({interface}{kind})")
    }
}

impl Gpu {
    /// Whether CUDA reaches it.
    pub(super) fn is_cuda(self) -> bool {
        list()[self.0].interface == CUDA
    }

    /// Whether it is a card, and no program that computes as one.
    pub(super) fn is_card(self) -> bool {
        list()[self.0].is_card
    }

    /// The device that computes without gradients.
    #[cfg_attr(
        not(any(feature = "gpu", feature = "cuda")),
        expect(clippy::unused_self, reason = "there are none")
    )]
    pub(super) fn device(self) -> Device {
        #[cfg(any(feature = "gpu", feature = "cuda"))]
        return built::DEVICES[self.0].0.clone();
        #[cfg(not(any(feature = "gpu", feature = "cuda")))]
        unreachable!("builds without a GPU backend find no GPU")
    }
}

impl fmt::Display for Gpu {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        list()[self.0].fmt(f)
    }
}

/// All devices that this build reaches; cards first.
pub fn list() -> &'static [GpuInfo] {
    #[cfg(any(feature = "gpu", feature = "cuda"))]
    return &built::INFOS;
    #[cfg(not(any(feature = "gpu", feature = "cuda")))]
    &[]
}

/// The first card.
pub(super) fn first() -> Option<Gpu> {
    list().iter().find(|gpu| gpu.is_card).map(|gpu| Gpu(gpu.number))
}

/// The first card, or why there is none.
pub(super) fn require_first() -> Result<Gpu> {
    first().ok_or_else(|| {
        let looked_for = match list() {
            _ if !IS_BUILT => return unbuilt(),
            [] => format!("no GPU was found: looked for {}; ", interfaces()),
            [software, ..] => format!(
                "no GPU was found by {}, only {}, which --device gpu:{} uses for tests; ",
                interfaces(),
                software.name,
                software.number
            ),
        };
        Error::Unsupported(format!(
            "{looked_for}check the driver (vulkaninfo, nvidia-smi), or use --device cpu"
        ))
    })
}

/// The device of a number, or why there is none.
pub(super) fn require(number: usize) -> Result<Gpu> {
    match list().len() {
        _ if !IS_BUILT => Err(unbuilt()),
        count if number < count => Ok(Gpu(number)),
        count => Err(Error::Unsupported(format!(
            "there is no gpu:{number}: {count} were found by {}; `udc info --devices` lists them",
            interfaces()
        ))),
    }
}

fn unbuilt() -> Error {
    Error::Unsupported(
        "this build computes on the CPU alone; build with `cargo build --release --features gpu` (Vulkan, Metal, DX12) or \
         `--features cuda`, or use --device cpu"
            .to_owned(),
    )
}

/// What devices are looked for by.
fn interfaces() -> &'static str {
    match (cfg!(feature = "gpu"), cfg!(feature = "cuda")) {
        (true, true) => "CUDA, Vulkan, Metal and DX12",
        (false, true) => "CUDA",
        _ => "Vulkan, Metal and DX12",
    }
}

#[cfg(any(feature = "gpu", feature = "cuda"))]
mod built {
    use std::panic;
    use std::sync::LazyLock;

    use burn::tensor::{Device, DeviceType};

    use super::GpuInfo;

    /// Finds the devices of an interface.
    type Enumerate = fn() -> Vec<Device>;

    /// The interfaces of this build; what computes fastest first.
    const INTERFACES: &[(&str, Enumerate)] = &[
        #[cfg(feature = "cuda")]
        (super::CUDA, || Device::enumerate(DeviceType::Cuda).into_iter().collect()),
        #[cfg(feature = "gpu")]
        ("Vulkan, Metal or DX12", || Device::enumerate(DeviceType::Wgpu).into_iter().collect()),
    ];

    /// Every device with its description but the number, cards first.
    pub(super) static DEVICES: LazyLock<Vec<(Device, GpuInfo)>> = LazyLock::new(|| {
        let mut devices: Vec<(Device, GpuInfo)> = INTERFACES
            .iter()
            // A driver that is not there is no fault of the program's, and some backends panic over it.
            .flat_map(|(interface, enumerate)| {
                let found = panic::catch_unwind(enumerate).unwrap_or_default();
                found.into_iter().filter_map(|device| described(device, interface))
            })
            .collect();
        devices.sort_by_key(|(_, info)| !info.is_card);
        for (number, (_, info)) in devices.iter_mut().enumerate() {
            info.number = number;
        }
        devices
    });

    pub(super) static INFOS: LazyLock<Vec<GpuInfo>> =
        LazyLock::new(|| DEVICES.iter().map(|(_, info)| info.clone()).collect());

    fn described(device: Device, interface: &'static str) -> Option<(Device, GpuInfo)> {
        let opened = panic::catch_unwind(panic::AssertUnwindSafe(|| device.identity()));
        let identity = opened.ok().flatten()?;
        let is_card = identity.physical.is_some();
        Some((device, GpuInfo { number: 0, name: identity.name, interface, is_card }))
    }
}
