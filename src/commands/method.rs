//! `--method`: the deconvolutions to choose from.

use clap::ValueEnum;

use udc::restore::deconvolution::Method;

/// A deconvolution.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(super) enum MethodArg {
    /// Wiener–Hunt filter with Laplacian regularisation
    Wiener,
    /// The same, noise and regularisation estimated by Gibbs sampling
    WienerOrieux,
    /// Richardson–Lucy iteration
    RichardsonLucy,
    /// Non-negative weighted least squares, light around the frame and saturation modelled
    Constrained,
}

impl MethodArg {
    /// The name on the command line and in tables.
    pub(super) fn name(self) -> &'static str {
        Method::from(self).name()
    }
}

impl From<MethodArg> for Method {
    fn from(method: MethodArg) -> Self {
        match method {
            MethodArg::Wiener => Self::Wiener,
            MethodArg::WienerOrieux => Self::WienerOrieux,
            MethodArg::RichardsonLucy => Self::RichardsonLucy,
            MethodArg::Constrained => Self::Constrained,
        }
    }
}
