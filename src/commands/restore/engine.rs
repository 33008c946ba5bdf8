//! What restores an image: a network with its code, or a deconvolution with its PSF.

use anyhow::{Result, bail};
use clap::{Args, ValueEnum};
use serde_json::{Value, json};

use udc::core::io::read_psf;
use udc::core::psf::Psf;
use udc::core::tone::ToneCurve;
use udc::network::Model;
use udc::restore::deconvolution::{Border, DeconvolutionConfig, deconvolution_bytes, deconvolve};
use udc::restore::{Conditioning, NetworkRestorer, Tiling, format_bytes, restore_tiled};

use super::files::AnyImage;
use super::{RestoreArgs, text};
use crate::commands::Session;
use crate::commands::method::MethodArg;

#[derive(Args, Debug)]
pub(super) struct MethodArgs {
    /// Deconvolution to restore with
    #[arg(long, value_enum, value_name = "METHOD", requires = "psf")]
    method: Option<MethodArg>,
    /// Weight of smoothness against fidelity (wiener) [default: 0.01]
    #[arg(long, value_name = "B", requires = "method")]
    balance: Option<f32>,
    /// What lies beyond the frame (wiener, wiener-orieux) [default: smooth]
    #[arg(long, value_enum, value_name = "BORDER", requires = "method")]
    border: Option<BorderArg>,
    /// Largest number of iterations (richardson-lucy, constrained) [default: 30]
    #[arg(long, value_name = "N", requires = "method")]
    iterations: Option<usize>,
    /// Treat saturated pixels as unknown (wiener, wiener-orieux; the others always do)
    #[arg(long, requires = "method")]
    mask_saturated: bool,
    /// Seed of the random numbers (wiener-orieux) [default: 0]
    #[arg(long, value_name = "S", requires = "method")]
    seed: Option<u64>,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum BorderArg {
    /// Continue the frame smoothly
    Smooth,
    /// Repeat the frame
    Periodic,
}

/// What restores an image, and how much memory it may take.
pub(super) struct Engine {
    kind: Kind,
    max_memory: u64,
}

enum Kind {
    Network { path: String, model: Box<Model>, conditioning: Conditioning, tile: Option<usize> },
    Deconvolution { path: String, psf: Psf, config: DeconvolutionConfig },
}

impl Engine {
    pub(super) fn new(args: &RestoreArgs, curve: ToneCurve, session: &Session) -> Result<Self> {
        let kind = match (&args.model, args.method.method, &args.code.psf) {
            (Some(path), ..) => {
                let model = Box::new(Model::load(path)?);
                let conditioning = args.code.resolve(&model, session)?;
                NetworkRestorer::new(&model, conditioning.clone())?;
                Kind::Network { path: text(path), model, conditioning, tile: args.tile }
            }
            (None, Some(method), Some(psf)) => {
                let config = args.method.config(method, curve);
                Kind::Deconvolution { path: text(psf), psf: read_psf(psf)?, config }
            }
            _ => bail!("name a --model, or a --method with its --psf"),
        };
        Ok(Self { kind, max_memory: args.max_memory })
    }

    /// Restores one image; says beforehand what memory that takes.
    pub(super) fn restore(
        &self,
        image: AnyImage,
        curve: ToneCurve,
        saturation: f32,
        session: &Session,
    ) -> Result<AnyImage> {
        match &self.kind {
            Kind::Network { model, conditioning, tile, .. } => {
                let restorer = NetworkRestorer::new(model, conditioning.clone())?;
                let image = image.into_tone_mapped(curve);
                let tiling = self.tiling(image.height(), image.width(), *tile, &restorer)?;
                let (height, width) = tiling.window();
                session.detail(format_args!(
                    "{} × {}: {} windows of up to {height} × {width}, {}",
                    image.height(),
                    image.width(),
                    tiling.len(),
                    format_bytes(tiling.bytes(&restorer))
                ));
                Ok(AnyImage::ToneMapped(restore_tiled(&image, &tiling, &restorer, &session.progress)?))
            }
            Kind::Deconvolution { psf, config, .. } => {
                let image = image.into_linear(curve);
                let (size, of_psf) = ([image.height(), image.width()], [psf.height(), psf.width()]);
                let bytes = deconvolution_bytes(size, of_psf, config);
                session.detail(format_args!("{} × {}: {}", size[0], size[1], format_bytes(bytes)));
                self.require(bytes, size)?;
                let config = DeconvolutionConfig { saturation, ..*config };
                Ok(AnyImage::Linear(deconvolve(&image, psf, &config, &session.progress)?))
            }
        }
    }

    /// The method with every setting resolved, for provenance.
    pub(super) fn describe(&self) -> Value {
        match &self.kind {
            Kind::Network { path, conditioning, tile, .. } => {
                let code = match conditioning {
                    Conditioning::Code(code) => Some(code.to_vec()),
                    Conditioning::None | Conditioning::Map(_) => None,
                };
                json!({"model": path, "code": code, "tile": tile, "max-memory": self.max_memory})
            }
            Kind::Deconvolution { path, config, .. } => json!({"psf": path, "deconvolution": config}),
        }
    }

    fn tiling(
        &self,
        height: usize,
        width: usize,
        tile: Option<usize>,
        restorer: &NetworkRestorer<'_>,
    ) -> Result<Tiling> {
        let Some(tile) = tile else {
            return Ok(Tiling::within(height, width, self.max_memory, restorer)?);
        };
        let tiling = Tiling::with_tile(height, width, tile, restorer)?;
        self.require(tiling.bytes(restorer), [height, width])?;
        Ok(tiling)
    }

    fn require(&self, bytes: u64, [height, width]: [usize; 2]) -> Result<()> {
        if bytes > self.max_memory {
            bail!(
                "{height} × {width} pixels take {}, more than the {} of --max-memory; allow at least {}",
                format_bytes(bytes),
                format_bytes(self.max_memory),
                format_bytes(bytes)
            );
        }
        Ok(())
    }
}

impl MethodArgs {
    fn config(&self, method: MethodArg, curve: ToneCurve) -> DeconvolutionConfig {
        let default = DeconvolutionConfig::of_method(method.into());
        DeconvolutionConfig {
            balance: self.balance.unwrap_or(default.balance),
            border: self.border.map_or(default.border, Border::from),
            iterations: self.iterations.unwrap_or(default.iterations),
            mask_saturated: self.mask_saturated,
            seed: self.seed.unwrap_or(default.seed),
            alpha: curve.alpha,
            saturation: curve.x_max,
            ..default
        }
    }
}

impl From<BorderArg> for Border {
    fn from(border: BorderArg) -> Self {
        match border {
            BorderArg::Smooth => Self::Smooth,
            BorderArg::Periodic => Self::Periodic,
        }
    }
}
