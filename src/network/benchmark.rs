//! Times the whole network on one image: what `udc bench` shows beside the single operations.

use std::fmt;
use std::time::Duration;

use ndarray::Array3;

use super::weights::Weights;
use super::{Architecture, Backend, Initialisation, Inputs, Model, Origin, Parameters};
use crate::core::error::Error;
use crate::core::image::ToneMappedImage;
use crate::core::kernel_code::KernelCode;
use crate::core::progress::Progress;
use crate::kernels::benchmark::best_time;

/// A network's best time for one image.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NetworkTiming {
    /// Side of the square image in pixels.
    pub side: usize,
    /// Whether products were taken of numbers in bfloat16.
    pub has_bf16_products: bool,
    /// Floating-point operations of all convolutions, multiplications and additions.
    pub operations: f64,
    /// Wall-clock time.
    pub seconds: f64,
    /// Memory that the network works in.
    pub bytes: u64,
}

/// Times the published network, with random weights, for about `patience` on an image; once more with products in bfloat16
/// where the processor has them. Each timing is handed out as it is known.
///
/// # Errors
/// Those of [`Model::restore`], and of `report`, which end it; [`Error::Interrupted`] after an interrupt.
///
/// # Panics
/// Never: the same image was restored before.
pub fn time_network<E: From<Error>>(
    backend: Backend,
    side: usize,
    patience: Duration,
    progress: &Progress,
    mut report: impl FnMut(NetworkTiming) -> Result<(), E>,
) -> Result<(), E> {
    let architecture = Architecture::default();
    let parameters = Parameters::random(&architecture, Initialisation::Released, 0);
    let operations = 2.0 * architecture.macs(side, side) as f64;
    let code = KernelCode::zeros(architecture.code_dim);
    let model =
        Model::new(Weights { architecture, parameters, origin: Origin::default() }).with_backend(backend);
    let image = ToneMappedImage::from_planes(Array3::from_elem((3, side, side), 0.5))?;
    let rounded = model.with_bf16_products();
    for model in std::iter::once(model).chain(rounded) {
        progress.check()?;
        model.restore(&Inputs::new(&image, Some(&code)))?;
        progress.check()?;
        let seconds = best_time(patience, &|| progress.check().is_err(), || {
            model.restore(&Inputs::new(&image, Some(&code))).expect("the same image was restored before");
        });
        progress.check()?;
        let (has_bf16_products, bytes) = (model.has_bf16_products(), model.working_bytes(side, side));
        report(NetworkTiming { side, has_bf16_products, operations, seconds, bytes })?;
    }
    Ok(())
}

impl fmt::Display for NetworkTiming {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let products = if self.has_bf16_products { " --precision bf16" } else { "" };
        write!(
            f,
            "network @{}²{products}: {:.1} ms, {:.0} GFLOP/s, {} MiB",
            self.side,
            self.seconds * 1e3,
            self.operations / self.seconds / 1e9,
            self.bytes >> 20
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn timings_are_told_in_the_units_of_operations() {
        let timing = NetworkTiming {
            side: 256,
            has_bf16_products: true,
            operations: 3e9,
            seconds: 0.0125,
            bytes: 5 << 20,
        };
        let text = "network @256² --precision bf16: 12.5 ms, 240 GFLOP/s, 5 MiB";
        assert_eq!(timing.to_string(), text);
    }

    #[test]
    fn what_nobody_listens_to_ends() {
        let mut told = 0;
        let refuse = |_| {
            told += 1;
            Err(Error::Interrupted)
        };
        assert!(time_network(Backend::default(), 4, Duration::ZERO, &Progress::default(), refuse).is_err());
        assert_eq!(told, 1);
    }
}
