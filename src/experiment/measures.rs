//! Makes metrics ready to measure: with the weights that they need.

use std::path::Path;

use crate::core::error::{Error, Result};
use crate::core::metrics::{Measure, Metric};
use crate::network::Backend;
use crate::perceptual::Lpips;
use crate::train::ValidationConfig;

/// Makes metrics ready to measure; `lpips` names the files of AlexNet's weights and of the linear layers', whose network computes
/// on `backend`.
///
/// # Errors
/// Those of [`Lpips::load`]; [`Error::Unsupported`] when LPIPS is asked for without these files.
pub fn measures(metrics: &[Metric], lpips: Option<(&Path, &Path)>, backend: Backend) -> Result<Vec<Measure>> {
    let ready = |&metric: &Metric| match (metric, lpips) {
        (Metric::Lpips, Some((alexnet, linear))) => {
            let lpips = Lpips::load(alexnet, linear, backend)?;
            Ok(Measure::new(Metric::Lpips, move |image, ground_truth, definition| {
                lpips.distance(&definition.apply(image)?, &definition.apply(ground_truth)?)
            }))
        }
        (Metric::Lpips, None) => {
            let reason = "lpips needs weights that are not part of this program: AlexNet's (torchvision's \
                          alexnet-owt-7be5be79.pth) and those of its linear layers (lpips/weights/v0.1/alex.pth of \
                          PerceptualSimilarity); name the files with --lpips-alexnet and --lpips-linear, or \
                          validation.lpips-alexnet and validation.lpips-linear in a training";
            Err(Error::Unsupported(reason.to_owned()))
        }
        _ => Ok(Measure::of(metric)),
    };
    metrics.iter().map(ready).collect()
}

/// Makes the metrics of a training's validation ready on a backend, with the weights that its configuration names.
///
/// # Errors
/// As [`measures`].
pub fn validation_measures(config: &ValidationConfig, backend: Backend) -> Result<Vec<Measure>> {
    let files = (Path::new(&config.lpips_alexnet), Path::new(&config.lpips_linear));
    let has_files = !config.lpips_alexnet.is_empty() && !config.lpips_linear.is_empty();
    measures(&config.metrics, has_files.then_some(files), backend)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn says_which_weights_a_metric_lacks_and_how_to_name_them() {
        let measures = measures(&[Metric::Psnr, Metric::Ssim], None, Backend::default()).unwrap();
        assert_eq!(measures.iter().map(Measure::metric).collect::<Vec<_>>(), [Metric::Psnr, Metric::Ssim]);
        let config = ValidationConfig { metrics: vec![Metric::Lpips], ..ValidationConfig::default() };
        let message = validation_measures(&config, Backend::default()).unwrap_err().to_string();
        assert!(
            message.contains("alexnet-owt-7be5be79.pth") && message.contains("--lpips-linear"),
            "{message}"
        );
    }
}
