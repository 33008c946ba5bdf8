//! What restores an image: a network with its code, or a deconvolution with its PSF.

use std::sync::{Mutex, PoisonError};
use std::time::Instant;

use anyhow::{Result, bail};
use clap::error::ErrorKind;
use clap::{ArgMatches, Args, Command, FromArgMatches, ValueEnum};
use serde_json::{Value, json};

use udc::codes::interpolate_code;
use udc::core::bytes::format_bytes;
use udc::core::error::Error;
use udc::core::image::{CHANNELS, ToneMappedImage};
use udc::core::kernel_code::{KernelBank, KernelCode};
use udc::core::progress::Progress;
use udc::core::psf::Psf;
use udc::core::saturation::saturated_from;
use udc::core::tone::ToneCurve;
use udc::io::sha256_of_file;
use udc::network::Model;
use udc::restore::deconvolution::{Border, DeconvolutionConfig, deconvolution_bytes, deconvolve};
use udc::restore::{
    Conditioning, Highlights, NetworkRestorer, Restorer, Tiling, WEAK_LEAD, blend_highlights, code_map,
    restore_tiled, search_angle,
};

use super::RestoreArgs;
use super::code::KnownCode;
use super::field::Field;
use super::files::{Capture, Job};
use crate::commands::method::MethodArg;
use crate::commands::picture::AnyImage;
use crate::commands::{Session, text_of};

/// `--method` with its flags, which have been checked to belong to it.
#[derive(Debug)]
pub(super) struct MethodArgs(MethodFlags);

#[derive(Args, Debug)]
struct MethodFlags {
    /// Deconvolution to restore with
    #[arg(long, value_enum, value_name = "METHOD", requires = "psf")]
    method: Option<MethodArg>,
    /// Weight of smoothness against fidelity (wiener) [default: 0.01]
    #[arg(long, value_name = "B", requires = "method", conflicts_with = "model")]
    balance: Option<f32>,
    /// What lies beyond the frame [default: smooth]
    #[arg(long, value_enum, value_name = "BORDER", requires = "method", conflicts_with = "model")]
    border: Option<BorderArg>,
    /// Largest number of iterations (richardson-lucy, constrained) [default: 30]
    #[arg(long, value_name = "N", requires = "method", conflicts_with = "model")]
    iterations: Option<usize>,
    /// Treat saturated pixels as unknown (wiener, wiener-orieux; the others always do)
    #[arg(long, requires = "method", conflicts_with = "model")]
    mask_saturated: bool,
    /// Seed of the random numbers (wiener-orieux) [default: 0]
    #[arg(long, value_name = "S", requires = "method", conflicts_with = "model")]
    seed: Option<u64>,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum BorderArg {
    /// A scene that goes on: smoothly (wiener, wiener-orieux), or estimated (richardson-lucy, constrained)
    Smooth,
    /// The frame again
    Periodic,
    /// Darkness, as in `udc synth --boundary zero`
    Zero,
}

/// What restores an image, and how much memory it may take.
pub(super) struct Engine {
    kind: Kind,
    /// φ∘C.
    pub(super) curve: ToneCurve,
    max_memory: u64,
    /// Frames that the queue holds meanwhile; none for a single image.
    queued_frames: Option<u64>,
    /// What the kernels take beside the work.
    kernel_bytes: u64,
    highlights: Highlights,
    /// What was said last of the memory that an image takes.
    said: Mutex<String>,
}

/// Frames of 32-bit RGB that the queue holds beside the image in work and the pictures that are read: the file of one of
/// these, and an image that is written, with its file.
const QUEUED_FRAMES: u64 = 3;

/// The program's code and data, and the tables of transforms.
const PROGRAM_BYTES: u64 = 20 << 20;

/// The keys of a description under which the paths of a model and of a PSF stand.
const MODEL: &str = "model";
const PSF: &str = "psf";

/// Stack and working memory of a thread.
const THREAD_BYTES: u64 = 2 << 20;

enum Kind {
    Network { path: String, sha256: String, model: Box<Model>, code: KnownCode, tile: Option<usize> },
    Deconvolution { path: String, psf: Psf, config: DeconvolutionConfig },
}

/// What PSFs take beside the work: a bank that is read whole is there twice, as a file and as kernels, and a PSF that is
/// deconvolved by as the file, the PSF, and what it is prepared to.
fn kernel_bytes(args: &RestoreArgs, kind: &Kind) -> u64 {
    match kind {
        Kind::Network { code, .. } => {
            let reads_all = matches!(code, KnownCode::Search(_)) || args.code.psf.is_some();
            let bank = args.code.bank.as_ref().filter(|_| reads_all);
            bank.and_then(|bank| bank.metadata().ok()).map_or(0, |file| 2 * file.len())
        }
        Kind::Deconvolution { psf, .. } => {
            5 * (CHANNELS * size_of::<f32>() * psf.height() * psf.width()) as u64
        }
    }
}

impl Engine {
    pub(super) fn new(args: &RestoreArgs, jobs: &[Job], session: &Session) -> Result<Self> {
        let mut curve = args.curve(None)?;
        let kind = match (&args.model, args.method.method(), &args.code.psf) {
            (Some(path), ..) => {
                let (model, sha256) =
                    rayon::join(|| args.precision.load(path, session), || sha256_of_file(path));
                let (model, sha256) = (Box::new(model?), sha256?);
                let trained = model.origin().tone_curve();
                curve = args.curve(trained)?;
                if let Some(ToneCurve { alpha, x_max }) = trained.filter(|trained| *trained != curve) {
                    session.warn(format_args!(
                        "the model was trained on images tone-mapped with --alpha {alpha} --x-max {x_max}"
                    ));
                }
                let code = args.code.resolve(&model, &args.psf_file, session)?;
                NetworkRestorer::new(&model, code.example())?;
                Kind::Network { path: text_of(path), sha256, model, code, tile: args.tile }
            }
            (None, Some(method), Some(psf)) => {
                let config = args.method.config(method, curve);
                Kind::Deconvolution { path: text_of(psf), psf: args.psf_file.read(psf, session)?, config }
            }
            _ => bail!("name a --model, or a --method with its --psf"),
        };
        let highlights = args.highlights.into();
        let pictures = jobs.iter().map(|job| job.inputs.len() as u64).max().unwrap_or(0);
        let queued_frames = (jobs.len() > 1).then_some(QUEUED_FRAMES + pictures);
        let said = Mutex::default();
        let kernel_bytes = kernel_bytes(args, &kind);
        Ok(Self { kind, curve, max_memory: args.max_memory, queued_frames, kernel_bytes, highlights, said })
    }

    /// Packs a network's weights.
    pub(super) fn prepare(&self) {
        if let Kind::Network { model, .. } = &self.kind {
            model.prepare();
        }
    }

    /// Restores one capture; says beforehand what memory that takes.
    pub(super) fn restore(&self, name: &str, capture: Capture, session: &Session) -> Result<AnyImage> {
        let curve = self.curve;
        let levels = capture.info.and_then(|info| info.saturation).unwrap_or([curve.x_max; CHANNELS]);
        let saturation = levels.map(|white| white.min(curve.x_max));
        let image = capture.pixels;
        let progress = if self.queued_frames.is_some() {
            session.progress.without_bars()
        } else {
            session.progress.clone()
        };
        match &self.kind {
            Kind::Network { model, code, tile, .. } => {
                let image = image.into_tone_mapped(curve);
                let seen = saturation.map(|x_max| ToneCurve { x_max, ..curve });
                let conditioning = match code {
                    KnownCode::Fixed(conditioning) => conditioning.clone(),
                    KnownCode::Search(bank) => {
                        Conditioning::Code(find_code(name, &image, bank, seen, session)?)
                    }
                    KnownCode::Field(Field { codes, grid }) => {
                        Conditioning::Map(code_map(codes, grid, [image.height(), image.width()])?)
                    }
                };
                let map = match &conditioning {
                    Conditioning::Map(map) => (map.len() * size_of::<f32>()) as u64,
                    Conditioning::None | Conditioning::Code(_) => 0,
                };
                // Tiles are chosen by what one thread takes: they, and results with them, do not depend on how many there
                // are.
                let others = map + self.other_bytes([image.height(), image.width()], 1);
                let mut restorer =
                    Beside { restorer: NetworkRestorer::new(model, conditioning)?, bytes: others };
                let tiling = self.tiling(image.height(), image.width(), *tile, &restorer)?;
                let least = tiling.bytes(&restorer);
                let room = self.max_memory.saturating_sub(least);
                let affordable = usize::try_from(room / THREAD_BYTES).unwrap_or(usize::MAX);
                let more_threads = affordable.min(rayon::current_num_threads() - 1);
                let thread_bytes = more_threads as u64 * THREAD_BYTES;
                restorer.restorer = restorer.restorer.with_room(room - thread_bytes);
                let (height, width) = tiling.window();
                let windows = if tiling.len() == 1 { "window" } else { "windows" };
                let tiles = format!("{} {windows} of up to {height} × {width}, ", tiling.len());
                let bytes = least + thread_bytes + restorer.restorer.bytes_beyond_least(height, width);
                self.say_memory([image.height(), image.width()], &tiles, bytes, session);
                let restored = with_threads(1 + more_threads, || {
                    Ok(restore_tiled(&image, &tiling, &restorer, &progress)?)
                })?;
                let level = saturation.map(|white| curve.compress(saturated_from(white)));
                Ok(AnyImage::ToneMapped(blend_highlights(restored, &image, level, self.highlights)?))
            }
            Kind::Deconvolution { psf, config, .. } => {
                let image = image.into_linear(curve);
                let (size, of_psf) = ([image.height(), image.width()], [psf.height(), psf.width()]);
                let others = self.other_bytes(size, rayon::current_num_threads());
                let bytes = deconvolution_bytes(size, of_psf, config) + others;
                self.say_memory(size, "", bytes, session);
                self.require(bytes, size)?;
                let config = DeconvolutionConfig { saturation, ..*config };
                let restored = deconvolve(&image, psf, &config, &progress)?;
                let level = saturation.map(saturated_from);
                Ok(AnyImage::Linear(blend_highlights(restored, &image, level, self.highlights)?))
            }
        }
    }

    /// The method with every setting resolved, for provenance; its files are told by their contents.
    pub(super) fn describe(&self) -> Value {
        match &self.kind {
            Kind::Network { sha256, model, code, tile, .. } => {
                let code = match code {
                    KnownCode::Fixed(Conditioning::Code(code)) => Some(json!(code.to_vec())),
                    KnownCode::Fixed(Conditioning::None | Conditioning::Map(_)) => None,
                    KnownCode::Search(_) => Some(json!("auto")),
                    KnownCode::Field(field) => {
                        Some(json!(field.codes.iter().map(|code| code.to_vec()).collect::<Vec<_>>()))
                    }
                };
                json!({
                    "model-sha256": sha256, "code": code, "tile": tile,
                    "precision": if model.has_bf16_products() { "bf16" } else { "f32" },
                    "highlights": self.highlights,
                })
            }
            Kind::Deconvolution { psf, config, .. } => {
                json!({
                    "psf-sha256": psf.sha256(), "deconvolution": config, "highlights": self.highlights,
                })
            }
        }
    }

    /// The method as [`describe`](Self::describe) has it, and where its file lay.
    pub(super) fn describe_with_place(&self) -> Value {
        let (key, path) = match &self.kind {
            Kind::Network { path, .. } => (MODEL, path),
            Kind::Deconvolution { path, .. } => (PSF, path),
        };
        let mut described = self.describe();
        described[key] = json!(path);
        described
    }

    /// Takes out of a description where its file lay.
    pub(super) fn forget_place(described: &mut Value) {
        if let Some(keys) = described.as_object_mut() {
            keys.retain(|key, _| ![MODEL, PSF].contains(&key.as_str()));
        }
    }

    fn tiling(
        &self,
        height: usize,
        width: usize,
        tile: Option<usize>,
        restorer: &dyn Restorer,
    ) -> Result<Tiling> {
        let Some(tile) = tile else {
            return Ok(Tiling::within(height, width, self.max_memory, restorer)?);
        };
        let tiling = Tiling::with_tile(height, width, tile, restorer)?;
        self.require(tiling.bytes(restorer), [height, width])?;
        Ok(tiling)
    }

    /// What the program and the queue hold meanwhile with so many threads, if all images are of this size.
    fn other_bytes(&self, [height, width]: [usize; 2], threads: usize) -> u64 {
        let frame = (CHANNELS * size_of::<f32>() * height * width) as u64;
        let own = PROGRAM_BYTES + self.kernel_bytes + threads as u64 * THREAD_BYTES;
        own + self.queued_frames.unwrap_or(0) * frame
    }

    /// Says what an image of this size takes, unless the image before took the same.
    fn say_memory(&self, [height, width]: [usize; 2], tiles: &str, bytes: u64, session: &Session) {
        let line = format!("{height} × {width}: {tiles}memory up to {}", format_bytes(bytes));
        let mut said = self.said.lock().unwrap_or_else(PoisonError::into_inner);
        if *said != line {
            session.note(&line);
            *said = line;
        }
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

/// Runs work on so many threads, where there are more.
fn with_threads<T: Send>(threads: usize, work: impl FnOnce() -> Result<T> + Send) -> Result<T> {
    if threads >= rayon::current_num_threads() {
        return work();
    }
    rayon::ThreadPoolBuilder::new().num_threads(threads).build()?.install(work)
}

/// The code of the angle that explains a capture best; says what was found.
fn find_code(
    name: &str,
    image: &ToneMappedImage,
    bank: &KernelBank,
    curves: [ToneCurve; CHANNELS],
    session: &Session,
) -> Result<KernelCode> {
    let started = Instant::now();
    let found = search_angle(image, bank, curves, &session.progress)?;
    session.tell(format_args!(
        "{name}: the panel is turned by {:+.1}° (nearest kernel {}, {:.0} nats ahead of all but its neighbours; found in \
         {:.1} s)",
        found.angle_deg,
        bank.kernel_name(found.best),
        found.lead,
        started.elapsed().as_secs_f64()
    ));
    if found.lead < WEAK_LEAD {
        session.warn(format_args!(
            "{name}: the capture hardly tells the angle of the panel; lamps or texture in view would, or give --angle a \
             number found in another capture of the same device"
        ));
    }
    Ok(interpolate_code(&bank.to_codes(), found.angle_deg)?)
}

/// A restorer that shares the memory with something else.
struct Beside<'a> {
    restorer: NetworkRestorer<'a>,
    bytes: u64,
}

impl Restorer for Beside<'_> {
    fn window_bytes(&self, height: usize, width: usize) -> u64 {
        self.restorer.window_bytes(height, width) + self.bytes
    }

    fn halo(&self) -> usize {
        self.restorer.halo()
    }

    fn alignment(&self) -> usize {
        self.restorer.alignment()
    }

    fn restore(
        &self,
        image: &ToneMappedImage,
        top: usize,
        left: usize,
        progress: &Progress,
    ) -> Result<ToneMappedImage, Error> {
        self.restorer.restore(image, top, left, progress)
    }
}

impl Args for MethodArgs {
    fn augment_args(command: Command) -> Command {
        MethodFlags::augment_args(command)
    }

    fn augment_args_for_update(command: Command) -> Command {
        MethodFlags::augment_args_for_update(command)
    }
}

impl FromArgMatches for MethodArgs {
    fn from_arg_matches(matches: &ArgMatches) -> Result<Self, clap::Error> {
        let flags = MethodFlags::from_arg_matches(matches)?;
        flags.check()?;
        Ok(Self(flags))
    }

    fn update_from_arg_matches(&mut self, matches: &ArgMatches) -> Result<(), clap::Error> {
        self.0.update_from_arg_matches(matches)?;
        self.0.check()
    }
}

impl MethodFlags {
    /// Refuses flags that the method would ignore.
    fn check(&self) -> Result<(), clap::Error> {
        use MethodArg::{Constrained, RichardsonLucy, Wiener, WienerOrieux};
        let Some(method) = self.method else { return Ok(()) };
        let belongings: [(&str, bool, &[MethodArg]); 4] = [
            ("balance", self.balance.is_some(), &[Wiener]),
            ("iterations", self.iterations.is_some(), &[RichardsonLucy, Constrained]),
            ("mask-saturated", self.mask_saturated, &[Wiener, WienerOrieux]),
            ("seed", self.seed.is_some(), &[WienerOrieux]),
        ];
        for (flag, is_given, methods) in belongings {
            if is_given && !methods.contains(&method) {
                let names: Vec<_> = methods.iter().map(|method| method.name()).collect();
                let reason = format!(
                    "--{flag} belongs to --method {}, and --method {} would ignore it: leave it out\n",
                    names.join(" and "),
                    method.name()
                );
                return Err(clap::Error::raw(ErrorKind::ArgumentConflict, reason));
            }
        }
        Ok(())
    }
}

impl MethodArgs {
    fn method(&self) -> Option<MethodArg> {
        self.0.method
    }

    fn config(&self, method: MethodArg, curve: ToneCurve) -> DeconvolutionConfig {
        let flags = &self.0;
        let default = DeconvolutionConfig::of_method(method.into());
        DeconvolutionConfig {
            balance: flags.balance.unwrap_or(default.balance),
            border: flags.border.map_or(default.border, Border::from),
            iterations: flags.iterations.unwrap_or(default.iterations),
            mask_saturated: flags.mask_saturated,
            seed: flags.seed.unwrap_or(default.seed),
            alpha: curve.alpha,
            saturation: [curve.x_max; CHANNELS],
            ..default
        }
    }
}

impl From<BorderArg> for Border {
    fn from(border: BorderArg) -> Self {
        match border {
            BorderArg::Smooth => Self::Smooth,
            BorderArg::Periodic => Self::Periodic,
            BorderArg::Zero => Self::Zero,
        }
    }
}
