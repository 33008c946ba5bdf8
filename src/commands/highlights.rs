//! The flag that says what becomes of saturated pixels, shared by `udc restore` and `udc eval`.

use clap::ValueEnum;

use udc::restore::Highlights;

#[derive(Clone, Copy, Debug, ValueEnum)]
pub(crate) enum HighlightsArg {
    /// Leave what the network or the deconvolution makes of them
    Network,
    /// Keep the capture's values in every saturated pixel
    Keep,
    /// Keep them inside of large saturated areas, fading to the restored values at their edges
    Blend,
}

impl From<HighlightsArg> for Highlights {
    fn from(highlights: HighlightsArg) -> Self {
        match highlights {
            HighlightsArg::Network => Self::Network,
            HighlightsArg::Keep => Self::Keep,
            HighlightsArg::Blend => Self::Blend,
        }
    }
}
