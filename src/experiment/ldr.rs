//! Shows that flare needs light above a monitor's white: the dataset's scenes beside the same scenes clipped.
//!
//! A display as the source of training scenes, as in setups with a monitor in front of the camera, has nothing
//! brighter than its white, so that what the formation spreads stays below what is seen (the paper's supplement).

use std::collections::BTreeMap;
use std::fmt::Write as _;

use serde::{Deserialize, Serialize};

use super::EvalConfig;
use super::comparison::Comparison;
use super::document::Document;
use super::flare::Flare;
use super::regions::Region;
use super::tables::quoted;
use crate::core::error::{Error, Result};
use crate::core::image::{LinearImage, ToneMappedImage};
use crate::core::kernel_code::KernelBank;
use crate::core::metrics::MetricDefinition;
use crate::core::tone::ToneCurve;
use crate::dataset::{Dataset, Triplet};
use crate::synth::Formation;

/// Brightening is shown this much stronger than it is.
const GAIN: f32 = 4.0;

/// The formation of a dataset's scenes, to be done again with the range of a monitor.
pub struct Ldr<'a> {
    bank: &'a KernelBank,
    formation: Formation,
    white: f32,
}

/// What the formation did to the scenes of a dataset, and to the same with the range of a monitor, as the file `ldr.json`
/// holds it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LdrResults {
    /// The irradiance at which the scenes were clipped.
    pub white: f32,
    /// The means over all images; none without images.
    pub mean: Ranges<Option<Flare>>,
    /// Every image.
    pub images: Vec<LdrImage>,
    /// What the numbers are.
    pub definition: LdrDefinition,
}

/// Something of the scenes as they are, and of the same clipped.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Ranges<T> {
    /// As they are.
    pub hdr: T,
    /// Clipped.
    pub ldr: T,
}

/// What the formation did to one scene.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LdrImage {
    /// The scene.
    pub id: String,
    /// The kernel that degraded it.
    pub kernel: String,
    /// As it is.
    pub hdr: Flare,
    /// Clipped.
    pub ldr: Flare,
}

/// What the numbers of [`LdrResults`] are.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LdrDefinition {
    /// What PSNR is computed of.
    pub metrics: MetricDefinition,
    /// The regions in words, by their names.
    pub regions: BTreeMap<String, String>,
    /// What a clipped scene is, in words.
    pub ldr: String,
}

/// Clean, degraded and added light of a scene.
pub type LdrRow = [ToneMappedImage; 3];

impl<'a> Ldr<'a> {
    /// Checks, before any work, that scenes can be clipped at `white` and formed as the dataset was.
    ///
    /// Of scenes with a margin the frame is left, so that what the clipped ones receive from outside of it is a
    /// continuation of the border; `warn` is told of it.
    ///
    /// # Errors
    /// [`Error::Unsupported`] when nothing would be left of the scenes, or the dataset has no PSFs, or several an image.
    pub fn new(dataset: &'a Dataset, white: f32, warn: &(dyn Fn(&str) + Sync)) -> Result<Self> {
        if !(white > 0.0 && white.is_finite()) {
            return Err(Error::Unsupported(format!(
                "--ldr {white} clips every scene to darkness; name a positive irradiance, such as 1"
            )));
        }
        dataset.check_one_psf()?;
        let (Some(bank), Some(config)) = (&dataset.bank, &dataset.config) else {
            return Err(Error::Unsupported(format!(
                "{} has kernel codes and no PSFs, which --ldr forms images with; name a dataset of `udc synth`",
                dataset.root.display()
            )));
        };
        if dataset.formation.margin > 0 {
            warn(&format!(
                "the scenes of {} had a margin, of which nothing is stored: light from outside of the frame is in its \
                 degraded images, and not in those of --ldr",
                dataset.root.display()
            ));
        }
        let formation = Formation::new(dataset.formation.of_frames(), config.seed)?;
        Ok(Self { bank, formation, white })
    }

    /// Compares the triplets of a comparison's shard with what becomes of their scenes when they are clipped; of the scene with
    /// most flare, and of the same clipped, a row to look at comes along.
    ///
    /// # Errors
    /// Those of reading and forming images; [`Error::Interrupted`].
    pub fn measure(
        &self,
        comparison: &Comparison<'_>,
        measuring: &EvalConfig,
    ) -> Result<(LdrResults, Vec<LdrRow>)> {
        let definition = measuring.definition;
        let Comparison { dataset, listener, .. } = comparison;
        let curve = dataset.formation.curve()?;
        let bar = listener.progress.bar(comparison.own().len() as u64, "scenes");
        let mut images: Vec<LdrImage> = Vec::new();
        let (mut most, mut shown) = (f64::NEG_INFINITY, Vec::new());
        for (_, triplet) in comparison.own() {
            listener.progress.check()?;
            let (clean, degraded) = match comparison.read(triplet) {
                // The evaluation names it.
                Err(error) if measuring.allow_missing && !error.is_interrupt() => continue,
                read => read?,
            };
            let (clipped, formed) = self.form(dataset, triplet, &clean)?;
            let flare = |clean, degraded| Flare::measure(clean, degraded, curve, &definition);
            let (hdr, ldr) = (flare(&clean, &degraded)?, flare(&clipped, &formed)?);
            if hdr.flare_share > most {
                most = hdr.flare_share;
                shown = vec![row_of(&clean, &degraded, curve)?, row_of(&clipped, &formed, curve)?];
            }
            images.push(LdrImage { id: triplet.id.clone(), kernel: triplet.kernel.clone(), hdr, ldr });
            bar.inc(1);
        }
        bar.finish_and_clear();
        Ok((LdrResults::of(self.white, images, definition), shown))
    }

    /// The clipped scene, and what the sensor records of it.
    fn form(
        &self,
        dataset: &Dataset,
        triplet: &Triplet,
        clean: &LinearImage,
    ) -> Result<(LinearImage, LinearImage)> {
        let clipped: LinearImage = clean.map_values(|x| x.min(self.white));
        let psf = &self.bank.psfs[dataset.kernel_index(triplet)?];
        let label = format!("ldr/{}/{}", triplet.id, triplet.kernel);
        let formed = self.formation.degrade(&clipped, psf, &label)?;
        Ok((clipped, formed))
    }
}

impl Document for LdrResults {
    const FORMAT: &'static str = "udc-ldr";
    const COMMAND: &'static str = "udc eval --ldr";
}

impl LdrResults {
    pub(super) fn of(white: f32, images: Vec<LdrImage>, metrics: MetricDefinition) -> Self {
        let mean = |of: fn(&LdrImage) -> &Flare| Flare::mean(images.iter().map(of));
        let mean = Ranges { hdr: mean(|image| &image.hdr), ldr: mean(|image| &image.ldr) };
        let ldr = format!("the clean scene clipped at {white}, then formed as the dataset was");
        let definition = LdrDefinition { metrics, regions: Region::definitions(), ldr };
        Self { white, mean, images, definition }
    }

    /// One line an image and range.
    pub fn to_csv(&self) -> String {
        let mut csv = String::from("id,kernel,range,flare_share,highlight_share,largest_brightening,psnr\n");
        for LdrImage { id, kernel, hdr, ldr } in &self.images {
            for (range, flare) in [("hdr", hdr), ("ldr", ldr)] {
                let Flare { flare_share, highlight_share, largest_brightening, psnr } = flare;
                let _ = writeln!(
                    csv,
                    "{},{},{range},{flare_share},{highlight_share},{largest_brightening},{psnr}",
                    quoted(id),
                    quoted(kernel)
                );
            }
        }
        csv
    }

    /// The means in a sentence.
    pub fn summary(&self) -> String {
        let (hdr, ldr) = (self.mean.hdr.unwrap_or_default(), self.mean.ldr.unwrap_or_default());
        format!(
            "flare, mean of the images: {:.2} % of the pixels, largest brightening outside of highlights {:.3}; with scenes \
             clipped at {}: {:.2} %, {:.3}",
            100.0 * hdr.flare_share,
            hdr.largest_brightening,
            self.white,
            100.0 * ldr.flare_share,
            ldr.largest_brightening
        )
    }
}

fn row_of(clean: &LinearImage, degraded: &LinearImage, curve: ToneCurve) -> Result<LdrRow> {
    let (clean, degraded) = (curve.tone_map(clean), curve.tone_map(degraded));
    let added = (&degraded.planes() - &clean.planes()).mapv(|added| (GAIN * added).clamp(0.0, 1.0));
    Ok([clean, degraded, ToneMappedImage::from_planes(added)?])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_file_holds_means_and_images_and_is_read_as_it_was_written() {
        let flare = |flare_share: f64, psnr: f64| Flare { flare_share, psnr, ..Flare::default() };
        let image = |id: &str, hdr, ldr| LdrImage { id: id.to_owned(), kernel: "r+00".to_owned(), hdr, ldr };
        let images = vec![
            image("lamp", flare(0.5, 20.0), flare(0.0, f64::INFINITY)),
            image("street", flare(0.25, 30.0), flare(0.0, 40.0)),
        ];
        let results = LdrResults::of(1.0, images, MetricDefinition::float());
        assert_eq!(results.mean.hdr, Some(flare(0.375, 25.0)));
        let scratch = tempfile::tempdir().unwrap();
        let path = scratch.path().join("ldr.json");
        std::fs::write(&path, results.to_json()).unwrap();
        assert_eq!(LdrResults::read(&path).unwrap(), results);
        assert!(results.to_csv().ends_with("street,r+00,ldr,0,0,0,40\n"));
        assert!(results.summary().contains("37.50 % of the pixels"));
    }
}
