//! Keeps the transforms of a bank's PSFs for the size of scenes at hand, as far as memory allows.

use std::borrow::Cow;

use crate::core::error::{Error, Result};
use crate::core::fft::{Convolver, Otf};
use crate::core::field::PsfField;
use crate::core::image::CHANNELS;
use crate::core::kernel_code::KernelBank;
use crate::core::psf::Psf;

use super::Formation;

/// The PSFs that scenes are convolved with, and what is in memory beside them.
#[derive(Clone, Copy)]
pub(super) struct KernelSet<'a> {
    psfs: &'a [Psf],
    /// Images that a scene becomes.
    images: usize,
    /// Bytes of all PSFs, components and means.
    held_bytes: usize,
    /// Images beside the planes and the file of each degraded image.
    beside: usize,
    /// Pixels by which scenes are larger than the frame on each side.
    margin: usize,
}

impl<'a> KernelSet<'a> {
    /// One image for each kernel of a bank.
    pub(super) fn of_bank(bank: &'a KernelBank) -> Self {
        let psf = size_of_val(bank.psfs[0].as_slice());
        let held_bytes = psf * (bank.len() + bank.code_dim() + 1);
        Self { psfs: &bank.psfs, images: bank.len(), held_bytes, beside: 0, margin: 0 }
    }

    /// One image by all PSFs of a field; the bank holds the PSF in its middle.
    pub(super) fn of_field(field: &'a PsfField, bank: &KernelBank) -> Self {
        let psfs = field.psfs();
        let held_bytes = KernelSet::of_bank(bank).held_bytes + psfs.len() * size_of_val(psfs[0].as_slice());
        // The weighted scene, its weights, and the sum.
        Self { psfs, images: 1, held_bytes, beside: 3, margin: 0 }
    }

    /// The same for scenes with a margin around the frame.
    pub(super) fn with_margin(self, margin: usize) -> Self {
        Self { margin, ..self }
    }
}

/// How the work on scenes of one size fits into memory.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MemoryNeeds {
    /// OTFs that are computed once and kept; the others are computed for every scene.
    pub cached_otfs: usize,
    /// Degraded images that are made at the same time.
    pub at_once: usize,
    /// Bytes that are held at most.
    pub bytes: u64,
}

impl MemoryNeeds {
    /// Plans the work on scenes of the convolver's size with K kernels, under `max_bytes`.
    ///
    /// Keeping OTFs saves more time than making more images at once than there are threads, so memory goes
    /// first to one image for each thread, then to OTFs, then to a second image for each thread, which fills
    /// the gaps of the first.
    ///
    /// # Errors
    /// [`Error::Config`] with the memory that is needed, when one image at a time does not fit.
    pub(super) fn new(
        convolver: &Convolver,
        set: KernelSet<'_>,
        threads: usize,
        max_bytes: u64,
    ) -> Result<Self> {
        let (kernels, images) = (set.psfs.len(), set.images);
        let bytes = |cached, at_once| bytes_needed(convolver, set, cached, at_once);
        let fits = |cached, at_once| bytes(cached, at_once) <= max_bytes;
        if !fits(0, 1) {
            let [height, width] = convolver.image_size();
            let needed = bytes(0, 1).div_ceil(1 << 20);
            let reason = format!("scenes of {height} × {width} need {needed} MiB at least");
            return Err(Error::config("max-memory", reason));
        }
        let at_once = (1..=threads.min(images)).rev().find(|&n| fits(0, n)).unwrap_or(1);
        let cached_otfs = (0..=kernels).rev().find(|&n| fits(n, at_once)).unwrap_or(0);
        let most = images.min(2 * threads);
        let at_once = (at_once..=most).rev().find(|&n| fits(cached_otfs, n)).unwrap_or(at_once);
        // The same number of rounds with equal shares.
        let at_once = images.div_ceil(images.div_ceil(at_once));
        Ok(Self { cached_otfs, at_once, bytes: bytes(cached_otfs, at_once) })
    }
}

fn bytes_needed(convolver: &Convolver, set: KernelSet<'_>, cached: usize, at_once: usize) -> u64 {
    let float = size_of::<f32>();
    let [height, width] = convolver.image_size();
    let image = CHANNELS * height * width * float;
    let inner = |side: usize| side.saturating_sub(2 * set.margin);
    let frame = CHANNELS * inner(height) * inner(width) * float;
    let spectrum = convolver.spectrum_bytes();
    // The scene as it was read and decoded, and its clipped copy.
    let scene = 3 * image;
    // The forward transform works on all channels at once.
    let forward = CHANNELS * convolver.intermediate_bytes();
    let transient_otf = if cached < set.psfs.len() { spectrum } else { 0 };
    // The planes, and the file made of them.
    let each = convolver.intermediate_bytes() + 2 * frame + set.beside * image + transient_otf;
    (set.held_bytes + scene + spectrum + forward + cached * spectrum + at_once * each) as u64
}

/// The kernels of a set, ready for scenes of one size.
pub(super) struct Kernels<'a> {
    pub(super) convolver: Convolver,
    pub(super) plan: MemoryNeeds,
    psfs: &'a [Psf],
    cached: Vec<Otf>,
}

impl<'a> Kernels<'a> {
    pub(super) fn new(
        formation: &Formation,
        set: KernelSet<'a>,
        size: [usize; 2],
        max_bytes: u64,
    ) -> Result<Self> {
        let convolver = formation.convolver(size, [set.psfs[0].height(), set.psfs[0].width()])?;
        let plan = MemoryNeeds::new(&convolver, set, rayon::current_num_threads(), max_bytes)?;
        let psfs = set.psfs;
        let cached = psfs[..plan.cached_otfs].iter().map(|psf| convolver.otf(psf)).collect::<Result<_>>()?;
        Ok(Self { convolver, plan, psfs, cached })
    }

    pub(super) fn otf(&self, index: usize) -> Result<Cow<'_, Otf>> {
        match self.cached.get(index) {
            Some(otf) => Ok(Cow::Borrowed(otf)),
            None => Ok(Cow::Owned(self.convolver.otf(&self.psfs[index])?)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::fft::Boundary;
    use crate::core::kernel_code::CodeBasis;
    use ndarray::{Array1, Array2, Array3};

    fn bank(kernels: usize, size: usize) -> KernelBank {
        let psf = Psf::from_energy(Array3::ones((3, size, size))).unwrap();
        let values = 3 * size * size;
        let basis = CodeBasis {
            mean: Array1::zeros(values),
            components: Array2::zeros((0, values)),
            explained_variance: Array1::zeros(0),
        };
        KernelBank::new(vec![psf; kernels], Array2::zeros((kernels, 0)), basis, None).unwrap()
    }

    #[test]
    fn less_memory_means_fewer_kept_transforms_then_an_error() {
        let bank = bank(9, 64);
        let convolver: Convolver = Convolver::new([100, 100], [64, 64], Boundary::Zero).unwrap();
        let set = KernelSet::of_bank(&bank);
        let plan = |max_bytes| MemoryNeeds::new(&convolver, set, 2, max_bytes);
        let all = plan(u64::MAX).unwrap();
        assert_eq!((all.cached_otfs, all.at_once), (9, 3));
        let less = plan(all.bytes * 2 / 3).unwrap();
        assert!((1..9).contains(&less.cached_otfs), "{less:?}");
        assert!(less.bytes <= all.bytes * 2 / 3);
        let least = plan(bytes_needed(&convolver, set, 0, 1)).unwrap();
        assert_eq!((least.cached_otfs, least.at_once), (0, 1));
        let message = plan(1 << 20).unwrap_err().to_string();
        assert!(message.contains("max-memory") && message.contains("MiB"), "{message}");
    }
}
