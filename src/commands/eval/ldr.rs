//! Shows that flare needs light above a monitor's white: the dataset's scenes beside the same scenes clipped.
//!
//! A display as the source of training scenes, as in setups with a monitor in front of the camera, has nothing
//! brighter than its white, so that what the formation spreads stays below what is seen (the paper's supplement).

use std::fmt::Write as _;

use anyhow::{Result, bail};
use serde_json::{Value, json};

use udc::core::error;
use udc::core::image::{LinearImage, ToneMappedImage};
use udc::core::kernel_code::KernelBank;
use udc::core::metrics::MetricDefinition;
use udc::core::tone::ToneCurve;
use udc::dataset::Triplet;
use udc::experiment::{Flare, Region};
use udc::report::picture;
use udc::synth::Formation;

use super::comparison::Comparison;

/// Brightening is shown this much stronger than it is.
const GAIN: f32 = 4.0;

/// A comparison's scenes, to be formed again with the range of a monitor.
pub(super) struct Ldr<'a> {
    comparison: &'a Comparison<'a>,
    bank: &'a KernelBank,
    formation: Formation,
    white: f32,
}

/// What the formation did to the scenes of a dataset, and to the same with the range of a monitor.
pub(super) struct LdrResults {
    white: f32,
    definition: MetricDefinition,
    rows: Vec<Row>,
    /// Clean, degraded and added light: of the scene with most flare, and of the same clipped.
    picture: Vec<u8>,
}

struct Row {
    id: String,
    kernel: String,
    hdr: Flare,
    ldr: Flare,
}

impl<'a> Ldr<'a> {
    /// Checks, before any work, that scenes can be clipped at `white` and formed as the dataset was.
    ///
    /// Of scenes with a margin the frame is left, so that what the clipped ones receive from outside of it is a
    /// continuation of the border.
    pub(super) fn new(comparison: &'a Comparison<'a>, white: f32) -> Result<Self> {
        if !(white > 0.0 && white.is_finite()) {
            bail!("--ldr {white} clips every scene to darkness; name a positive irradiance, such as 1");
        }
        let dataset = comparison.dataset;
        dataset.check_one_psf()?;
        let (Some(bank), Some(config)) = (&dataset.bank, &dataset.config) else {
            bail!(
                "{} has kernel codes and no PSFs, which --ldr forms images with; name a dataset of `udc synth`",
                dataset.root.display()
            );
        };
        if dataset.formation.margin > 0 {
            comparison.session.warn(format_args!(
                "the scenes of {} had a margin, of which nothing is stored: light from outside of the frame is in its \
                 degraded images, and not in those of --ldr",
                dataset.root.display()
            ));
        }
        let formation = Formation::new(dataset.formation.of_frames(), config.seed)?;
        Ok(Self { comparison, bank, formation, white })
    }

    /// Compares the comparison's triplets with what becomes of their scenes when they are clipped.
    pub(super) fn measure(&self, definition: MetricDefinition) -> Result<LdrResults> {
        let Comparison { dataset, triplets, session, .. } = self.comparison;
        let curve = dataset.formation.curve()?;
        let bar = session.progress.bar(triplets.len() as u64, "scenes");
        let mut rows: Vec<Row> = Vec::new();
        let (mut most, mut picture) = (f64::NEG_INFINITY, Vec::new());
        for triplet in triplets {
            session.progress.check()?;
            let (clean, degraded) = self.comparison.read(triplet)?;
            let (clipped, shown) = self.form(triplet, &clean)?;
            let flare = |clean, degraded| Flare::measure(clean, degraded, curve, &definition);
            let (hdr, ldr) = (flare(&clean, &degraded)?, flare(&clipped, &shown)?);
            if hdr.flare_share > most {
                most = hdr.flare_share;
                picture = picture_of(&[(&clean, &degraded), (&clipped, &shown)], curve)?;
            }
            rows.push(Row { id: triplet.id.clone(), kernel: triplet.kernel.clone(), hdr, ldr });
            bar.inc(1);
        }
        bar.finish_and_clear();
        Ok(LdrResults { white: self.white, definition, rows, picture })
    }

    /// The clipped scene, and what the sensor records of it.
    fn form(&self, triplet: &Triplet, clean: &LinearImage) -> error::Result<(LinearImage, LinearImage)> {
        let clipped: LinearImage = clean.map_values(|x| x.min(self.white));
        let psf = &self.bank.psfs[self.comparison.dataset.kernel_index(triplet)?];
        let label = format!("ldr/{}/{}", triplet.id, triplet.kernel);
        let shown = self.formation.degrade(&clipped, psf, &label)?;
        Ok((clipped, shown))
    }
}

impl LdrResults {
    pub(super) fn to_png(&self) -> &[u8] {
        &self.picture
    }

    /// The means of both ranges, every image, and the definitions.
    pub(super) fn to_json(&self) -> Value {
        let image = |row: &Row| json!({"id": row.id, "kernel": row.kernel, "hdr": row.hdr, "ldr": row.ldr});
        let images: Vec<Value> = self.rows.iter().map(image).collect();
        let mean = |of: fn(&Row) -> &Flare| Flare::mean(self.rows.iter().map(of));
        json!({
            "white": self.white,
            "mean": {"hdr": mean(|row| &row.hdr), "ldr": mean(|row| &row.ldr)},
            "images": images,
            "definition": {
                "metrics": self.definition, "regions": Region::definitions(),
                "ldr": format!("the clean scene clipped at {}, then formed as the dataset was", self.white),
            },
        })
    }

    /// One line an image and range.
    pub(super) fn to_csv(&self) -> String {
        let mut csv = String::from("id,kernel,range,flare_share,highlight_share,largest_brightening,psnr\n");
        for row in &self.rows {
            for (range, flare) in [("hdr", &row.hdr), ("ldr", &row.ldr)] {
                let Flare { flare_share, highlight_share, largest_brightening, psnr } = flare;
                let _ = writeln!(
                    csv,
                    "{},{},{range},{flare_share},{highlight_share},{largest_brightening},{psnr}",
                    row.id, row.kernel
                );
            }
        }
        csv
    }

    /// The means in a sentence.
    pub(super) fn summary(&self) -> String {
        let mean = |of: fn(&Row) -> &Flare| Flare::mean(self.rows.iter().map(of)).unwrap_or_default();
        let (hdr, ldr) = (mean(|row| &row.hdr), mean(|row| &row.ldr));
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

/// Clean, degraded and brightening of each pair, a row each.
fn picture_of(pairs: &[(&LinearImage, &LinearImage)], curve: ToneCurve) -> error::Result<Vec<u8>> {
    let mut rows = Vec::new();
    for (clean, degraded) in pairs {
        let (clean, degraded) = (curve.tone_map(clean), curve.tone_map(degraded));
        let added = (&degraded.planes() - &clean.planes()).mapv(|added| (GAIN * added).clamp(0.0, 1.0));
        rows.push([clean, degraded, ToneMappedImage::from_planes(added)?]);
    }
    Ok(picture::grid(&rows.iter().map(|row| row.iter().collect()).collect::<Vec<_>>()))
}
