//! Restores captures by a network or by a deconvolution, with what is known of their kernel.

mod describe;
mod options;
mod plan;

use std::sync::Arc;
use std::sync::atomic::AtomicUsize;

use super::angle::{FoundAngle, find_code};
use super::capture::{Capture, Restored};
use super::deconvolution::{Border, DeconvolutionConfig, Method, NoiseCurve};
use super::empty_lines::EmptyLines;
use super::field::code_map;
use super::floor::{self, Floor};
use super::grey::{grey_kernel, is_grey, made_grey};
use super::guided::GuidedOptions;
use super::highlights::{Highlights, blend_highlights};
use super::kernel::KernelKnowledge;
use super::levels::{curve_of_told, suited_curve};
use super::memory::{MemoryBudget, MemoryPlan, with_threads};
use super::network::{Conditioning, NetworkOperator};
use super::notice::Notice;
use super::precision::in_precision;
use super::resemblance::Unlike;
use super::tiles::restore_halving;
use crate::core::capture::{CaptureInfo, is_level};
use crate::core::error::{Error, Result};
use crate::core::image::{CHANNELS, LinearImage, ToneMappedImage};
use crate::core::progress::Progress;
use crate::core::saturation::saturated_from;
use crate::core::tone::ToneCurve;
use crate::dataset::NoiseConfig;
use crate::io::AnyImage;
use crate::network::{Backend, Kind, Model, Precision, guided_model, guided_sha256};

/// How captures are restored.
#[derive(Clone, Debug)]
pub struct Restoration {
    how: How,
    kernel: KernelKnowledge,
    curve: ToneCurve,
    /// What lies beyond the border of frames.
    border: Border,
    highlights: Highlights,
    memory: MemoryBudget,
    /// Bytes that reading the kernels took.
    kernel_bytes: u64,
    /// Side of the tiles, where it is given.
    tile: Option<usize>,
    /// Identity of the network's file, where it is one.
    model_sha256: Option<String>,
    /// What is done beside the network where it is one for any panel.
    guided: Option<GuidedOptions>,
    /// The noise of captures, where it is told.
    noise: Option<NoiseConfig>,
    /// Whether a deconvolution looks for what saturates a capture that does not say it.
    asks_for_levels: bool,
    /// Whether α is told, so that it stays whatever the units of a capture are.
    tells_alpha: bool,
    /// How often windows were halved for a device that had no memory for them.
    halvings: Arc<AtomicUsize>,
}

#[derive(Clone, Debug)]
enum How {
    Network(Model),
    Deconvolution(Box<DeconvolutionConfig>),
}

impl Restoration {
    /// Restores by a network that is told what it needs of the kernel, and given the planes that it reads, which are made of
    /// the PSF; images are tone-mapped as those that it was trained with. Where it is of the kind for any panel, the pose of
    /// the panel is looked for in each capture, and corrections that contradict it are held back.
    ///
    /// # Errors
    /// [`Error::Config`] when the network needs a code, or the PSF for its planes, and it is not known; [`Error::Shape`] when
    /// the code has another length than the network's.
    pub fn by_network(model: Model, kernel: KernelKnowledge) -> Result<Self> {
        if let (Some(plane), Err(_)) = (model.architecture().planes().first(), kernel.sized_psf()) {
            let reason = format!(
                "the model reads the plane \"{}\" of every image, which is made of its PSF: name the PSF itself (--psf)",
                plane.name()
            );
            return Err(Error::config("planes", reason));
        }
        let example = kernel.example().map_or(Conditioning::None, Conditioning::Code);
        NetworkOperator::new(&model).told(example)?;
        let curve = model.origin().tone_curve().unwrap_or_default();
        let guided = (model.architecture().kind == Kind::Guided).then(GuidedOptions::default);
        Ok(Self { guided, ..Self::new(How::Network(model), kernel, curve) })
    }

    /// Restores captures of any panel by the network that the program carries, given the PSF, as
    /// [`by_guided_network`](Self::by_guided_network) does.
    ///
    /// # Errors
    /// [`Error::Config`] when the PSF is not known.
    pub fn guided(kernel: KernelKnowledge) -> Result<Self> {
        let model_sha256 = Some(guided_sha256().to_owned());
        Ok(Self { model_sha256, ..Self::by_guided_network(guided_model()?, kernel)? })
    }

    /// Restores captures of any panel by a network of the kind [`Kind::Guided`].
    ///
    /// What saturates a capture is what it says, else what [`with_curve`](Self::with_curve) says, else the light that its
    /// brightest pixels share.
    ///
    /// # Errors
    /// [`Error::Config`] when the PSF is not known.
    pub fn by_guided_network(model: Model, kernel: KernelKnowledge) -> Result<Self> {
        let restoration = Self::by_network(model, kernel)?;
        let curve = ToneCurve { x_max: ToneCurve::default().x_max, ..restoration.curve };
        Ok(Self { curve, ..restoration })
    }

    /// Restores by inverting the convolution with a PSF.
    ///
    /// # Errors
    /// [`Error::Config`] when the PSF is not known.
    pub fn by_deconvolution(config: DeconvolutionConfig, kernel: KernelKnowledge) -> Result<Self> {
        kernel.needed_psf()?;
        let x_max = config.saturation.into_iter().fold(0.0, f32::max);
        let curve = ToneCurve { alpha: config.alpha, x_max };
        let border = config.border;
        Ok(Self { border, ..Self::new(How::Deconvolution(config.into()), kernel, curve) })
    }

    fn new(how: How, kernel: KernelKnowledge, curve: ToneCurve) -> Self {
        Self {
            how,
            kernel,
            curve,
            border: Border::default(),
            highlights: Highlights::default(),
            memory: MemoryBudget::default(),
            kernel_bytes: 0,
            tile: None,
            model_sha256: None,
            guided: None,
            noise: None,
            asks_for_levels: false,
            tells_alpha: false,
            halvings: Arc::default(),
        }
    }

    /// Takes another φ∘C for the mapping of images, and its x_max for the light at which captures saturate.
    #[must_use]
    pub fn with_curve(mut self, curve: ToneCurve) -> Self {
        self.curve = curve;
        if let Some(options) = &mut self.guided {
            options.finds_levels = false;
        }
        if let How::Deconvolution(config) = &mut self.how {
            (config.alpha, config.saturation) = (curve.alpha, [curve.x_max; CHANNELS]);
        }
        self
    }

    /// Looks for what saturates captures that do not say it: [`Method::Joint`] takes it, the other deconvolutions where it is above
    /// x_max, and below it is told of.
    #[must_use]
    pub fn with_levels_of_captures(mut self) -> Self {
        self.asks_for_levels = true;
        self
    }

    /// Takes this α for the mapping of images, in whatever units captures are; what saturates them stays.
    #[must_use]
    pub fn with_alpha(mut self, alpha: f32) -> Self {
        (self.curve.alpha, self.tells_alpha) = (alpha, true);
        if let How::Deconvolution(config) = &mut self.how {
            config.alpha = alpha;
        }
        self
    }

    /// Tells the noise of captures, which is estimated from each otherwise.
    ///
    /// # Errors
    /// [`Error::Config`] for a restoration that does not ask for it: neither by planes nor by [`Method::Joint`].
    pub fn with_noise(mut self, noise: NoiseConfig) -> Result<Self> {
        match &mut self.how {
            How::Deconvolution(config) if config.method == Method::Joint => {
                config.noise = Some(NoiseCurve::of(&noise));
            }
            How::Network(model) if !model.architecture().planes().is_empty() => {}
            _ => {
                let reason = "belongs to the guided restoration and to --method joint; leave it out";
                return Err(Error::config("noise", reason));
            }
        }
        self.noise = Some(noise);
        Ok(self)
    }

    /// Takes another precision for the products of a network, with what is to be told of it.
    pub(super) fn set_precision(&mut self, precision: Precision) -> Option<Notice> {
        let How::Network(model) = &mut self.how else { return None };
        let (changed, notice) = in_precision(model.clone(), precision);
        *model = changed;
        notice
    }

    /// Takes this to lie beyond the border of frames, where something is deconvolved.
    #[must_use]
    pub fn with_border(mut self, border: Border) -> Self {
        self.border = border;
        if let How::Deconvolution(config) = &mut self.how {
            config.border = border;
        }
        self
    }

    /// Does something else where captures are saturated.
    #[must_use]
    pub fn with_highlights(self, highlights: Highlights) -> Self {
        Self { highlights, ..self }
    }

    /// With something else known of the kernel.
    pub(super) fn with_kernel(&self, kernel: KernelKnowledge) -> Self {
        Self { kernel, ..self.clone() }
    }

    /// Stays under another limit of memory.
    #[must_use]
    pub fn with_memory(self, memory: MemoryBudget) -> Self {
        Self { memory, ..self }
    }

    /// Computes a network on another backend.
    #[must_use]
    pub fn with_backend(self, backend: Backend) -> Self {
        let how = match self.how {
            How::Network(model) => How::Network(model.with_backend(backend)),
            how @ How::Deconvolution(_) => how,
        };
        Self { how, ..self }
    }

    /// What computes.
    pub fn backend(&self) -> Backend {
        match &self.how {
            How::Network(model) => model.backend(),
            How::Deconvolution(_) => Backend::default(),
        }
    }

    /// Restores by a network in tiles of this side, instead of those that the memory allows.
    #[must_use]
    pub fn with_tile(self, tile: Option<usize>) -> Self {
        Self { tile, ..self }
    }

    /// Says which files the network and the kernels were read from: its SHA-256, and the bytes that they take.
    pub(super) fn with_files(self, model_sha256: Option<String>, kernel_bytes: u64) -> Self {
        Self { model_sha256, kernel_bytes, ..self }
    }

    /// φ∘C.
    pub fn curve(&self) -> ToneCurve {
        self.curve
    }

    /// What lies beyond the border.
    pub(super) fn border(&self) -> Border {
        self.border
    }

    /// The memory that there is.
    pub(super) fn memory(&self) -> MemoryBudget {
        self.memory
    }

    /// The noise of captures, where it is told.
    pub(super) fn noise_curve(&self) -> Option<NoiseCurve> {
        self.noise.as_ref().map(NoiseCurve::of)
    }

    /// Whether a deconvolution looks for what saturates a capture that does not say it.
    pub(super) fn asks_for_levels(&self) -> bool {
        self.asks_for_levels
    }

    /// The curve that captures are restored in where this is known of them, be it told or found: its α is told, or suits their units.
    pub(super) fn curve_of(&self, known: ToneCurve, image: &LinearImage, is_told: bool) -> ToneCurve {
        match (self.suits_alpha(), is_told) {
            (false, _) => known,
            (true, true) => curve_of_told(known, image),
            (true, false) => suited_curve(known, image),
        }
    }

    /// Whether α follows the units of a capture.
    fn suits_alpha(&self) -> bool {
        let asks = |config: &DeconvolutionConfig| {
            self.asks_for_levels && matches!(config.method, Method::Joint | Method::Constrained)
        };
        let is_asked = matches!(&self.how, How::Deconvolution(config) if asks(config));
        !self.tells_alpha && (self.reads_planes() || is_asked)
    }

    /// What is done where captures are saturated.
    pub(super) fn highlights(&self) -> Highlights {
        self.highlights
    }

    /// What is known of the kernel.
    pub(super) fn kernel(&self) -> &KernelKnowledge {
        &self.kernel
    }

    /// What is done beside the network for any panel, if it is that.
    pub(super) fn guided_options(&self) -> Option<GuidedOptions> {
        self.guided
    }

    /// Packs a network's weights; the first capture that is restored or planned does it otherwise.
    pub fn prepare(&self) {
        if let How::Network(model) = &self.how {
            model.prepare();
        }
    }

    /// Restores a capture, as [`plan`](Self::plan) says. One whose colours are equal everywhere is restored with the PSF of grey
    /// light, and stays grey.
    ///
    /// # Errors
    /// Those of [`plan`](Self::plan) and of the method; [`Error::Unsupported`] when an angle cannot be found;
    /// [`Error::Interrupted`].
    pub fn restore(&self, capture: Capture, progress: &Progress) -> Result<Restored> {
        // On a thread of the pool, which begins each of thousands of small operations at once instead of waking another.
        rayon::scope(|_| {
            let empty_lines = EmptyLines::of(&capture.image);
            Ok(Restored { empty_lines, ..self.restore_here(capture, progress)? })
        })
    }

    fn restore_here(&self, capture: Capture, progress: &Progress) -> Result<Restored> {
        let capture = self.cut(capture);
        if !is_grey(&capture.image) {
            let brightest = floor::brightest(&capture.image, self.curve);
            let restored = self.restore_colors(capture, progress)?;
            let floor = Floor::of(&restored.image, brightest, restored.curve);
            return Ok(Restored { floor, ..restored });
        }
        let is_told_by_code = self.is_network() && !self.reads_planes();
        if self.kernel.sized_psf().is_err() || is_told_by_code {
            return self.restore_colors(capture, progress);
        }
        // Of one colour, and its PSF tells of three: it is seen through all of them at once.
        let grey = grey_kernel(&self.kernel)?;
        let through_grey = grey.is_some();
        let restored = match grey {
            Some(kernel) => self.with_kernel(kernel).restore_colors(capture, progress)?,
            None => self.restore_colors(capture, progress)?,
        };
        Ok(Restored { image: made_grey(restored.image)?, through_grey, ..restored })
    }

    /// The capture, said to saturate no higher than its light is cut: a tone-mapped file holds none above its own x_max, and of what a
    /// file says, a user who tells less is believed.
    fn cut(&self, Capture { image, info }: Capture) -> Capture {
        let of_file = image.curve().map_or(f32::INFINITY, |own| own.x_max);
        let is_untold = self.guided.map_or(self.asks_for_levels, |guided| guided.finds_levels);
        let most = if is_untold { of_file } else { of_file.min(self.curve.x_max) };
        let info = info.map(|info| info.cut_at(most));
        let is_said = info.as_ref().is_some_and(|info| info.saturation.is_some());
        // A network of one PSF family is given the x_max of its training.
        let is_of_capture = !is_untold && (self.reads_planes() || !self.is_network());
        if is_said || !is_of_capture || !is_level(most) {
            return Capture { image, info };
        }
        // Else whoever develops the result would not know it.
        Capture {
            image,
            info: Some(CaptureInfo { saturation: Some([most; CHANNELS]), ..info.unwrap_or_default() }),
        }
    }

    fn is_network(&self) -> bool {
        matches!(self.how, How::Network(_))
    }

    /// Whether it is a network that reads planes, which are made of the PSF.
    fn reads_planes(&self) -> bool {
        matches!(&self.how, How::Network(model) if !model.architecture().planes().is_empty())
    }

    /// Restores a capture of three colours, or of one behind the PSF of grey light.
    fn restore_colors(&self, capture: Capture, progress: &Progress) -> Result<Restored> {
        if let (KernelKnowledge::Search { bank, .. }, true) = (&self.kernel, self.reads_planes()) {
            let (turned, angle) = self.at_angle_of(&capture, bank, progress)?;
            return Ok(Restored { angle: Some(angle), ..turned.restore_colors(capture, progress)? });
        }
        // What is left of a JPEG's finest detail tells nothing of a PSF.
        let is_coded = capture.info.as_ref().is_some_and(|info| info.coding_error.is_some());
        let psf = self.kernel.psf().filter(|_| !is_coded && (self.reads_planes() || !self.is_network()));
        let unlike = psf.map(|psf| Unlike::of(&capture.image, psf, self.curve, progress)).transpose()?;
        Ok(Restored { unlike: unlike.flatten(), ..self.restore_through(capture, progress)? })
    }

    fn restore_through(&self, capture: Capture, progress: &Progress) -> Result<Restored> {
        let plan = self.plan(capture.image.size())?;
        if let (How::Network(model), true) = (&self.how, self.reads_planes()) {
            return self.restore_by_planes(model, &plan, capture, progress);
        }
        let saturation = self.saturation(&capture);
        let brightest = saturation.into_iter().fold(self.curve.x_max, f32::max);
        let curve = ToneCurve { x_max: brightest, ..self.curve };
        match &self.how {
            How::Network(model) => {
                let Capture { image, info } = capture;
                let image = image.into_tone_mapped(curve);
                let (conditioning, angle) = self.conditioning(model, &image, saturation, progress)?;
                let operator = NetworkOperator::new(model).told(conditioning)?;
                let (restored, smaller_windows) = self.restore_windows(&image, &plan, operator, progress)?;
                let level = saturation.map(|white| curve.compress(saturated_from(white)));
                let restored = blend_highlights(restored, &image, level, self.highlights)?;
                let restored = Restored::new(AnyImage::ToneMapped(restored, Some(curve)), info, curve);
                Ok(Restored { angle, smaller_windows, ..restored })
            }
            How::Deconvolution(config) => {
                self.restore_by_deconvolution(config, capture, (curve, saturation), progress)
            }
        }
    }

    /// What a network is told of the kernel, and the angle where it is searched in the image.
    pub(super) fn conditioning(
        &self,
        model: &Model,
        image: &ToneMappedImage,
        saturation: [f32; CHANNELS],
        progress: &Progress,
    ) -> Result<(Conditioning, Option<FoundAngle>)> {
        let seen = saturation.map(|x_max| ToneCurve { x_max, ..self.curve });
        Ok(match &self.kernel {
            _ if !model.architecture().reads_code() => (Conditioning::None, None),
            KernelKnowledge::Search { bank, .. } => {
                let (code, angle) = find_code(image, bank, seen, progress)?;
                (Conditioning::Code(code), Some(angle))
            }
            KernelKnowledge::Field { codes, grid } => {
                (Conditioning::Map(code_map(codes, grid, [image.height(), image.width()])?), None)
            }
            known => (known.example().map_or(Conditioning::None, Conditioning::Code), None),
        })
    }

    /// The irradiance at which each channel of a capture is saturated.
    fn saturation(&self, capture: &Capture) -> [f32; CHANNELS] {
        let usual = match &self.how {
            How::Network(_) => [self.curve.x_max; CHANNELS],
            How::Deconvolution(config) => config.saturation,
        };
        // A tone-mapped file holds no light above its own x_max.
        let usual = capture.image.curve().map_or(usual, |own| [own.x_max; CHANNELS]);
        let levels = capture.info.as_ref().and_then(|info| info.saturation).unwrap_or(usual);
        if self.asks_for_levels { levels } else { levels.map(|white| white.min(self.curve.x_max)) }
    }

    /// Restores an image window by window; says the sides of windows where a device had no memory for those of the plan.
    pub(super) fn restore_windows(
        &self,
        image: &ToneMappedImage,
        plan: &MemoryPlan,
        operator: NetworkOperator<'_>,
        progress: &Progress,
    ) -> Result<(ToneMappedImage, Option<[usize; 2]>)> {
        let operator = operator.with_room(plan.room);
        let tiling = plan.tiling.as_ref().expect("a network's plan has windows");
        let shared = (&*self.halvings, progress);
        with_threads(plan.threads, || restore_halving(image, tiling, &operator, shared))
    }
}
