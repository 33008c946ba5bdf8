//! Looks at what only shows where two things meet: dataset, bank, model, PSF, pose, configuration.

use std::path::Path;

use super::Findings;
use super::images::Sizes;
use super::patient::Opened;
use crate::codes::project;
use crate::core::kernel_code::KernelBank;
use crate::core::psf::Psf;
use crate::dataset::{Dataset, Split};
use crate::network::Model;
use crate::train::{Degradation, TrainConfig, TrainingSet};

/// Digits of a SHA-256 that are told.
const DIGITS: usize = 12;

pub(super) fn look(opened: &Opened, findings: &mut Findings) {
    for (dataset, sizes) in &opened.datasets {
        for (path, bank, sha256) in &opened.banks {
            dataset_and_bank(dataset, (path, bank, sha256), findings);
        }
        for (path, model) in &opened.models {
            dataset_and_model(dataset, (path, model), findings);
        }
        for (path, config) in &opened.configurations {
            dataset_and_configuration((dataset, sizes), (path, config), findings);
        }
        for (path, psf) in &opened.psfs {
            psf_and_images((path, psf), &dataset.root, sizes, findings);
            if let Some(bank) = &dataset.bank {
                psf_and_bank((path, psf), (&dataset.root, bank), findings);
            }
        }
    }
    for (path, bank, sha256) in &opened.banks {
        for (model_path, model) in &opened.models {
            let known_by = (path.as_path(), sha256.as_str());
            model_and_bank((model_path, model), known_by, bank.code_dim(), findings);
        }
        for (psf_path, psf) in &opened.psfs {
            psf_and_bank((psf_path, psf), (path, bank), findings);
        }
    }
    for (path, psf) in &opened.psfs {
        for (image, size) in &opened.images {
            psf_and_images((path, psf), image, &Sizes::from([*size]), findings);
        }
        for (pose_path, pose) in &opened.poses {
            let about = both(path, pose_path);
            if pose.psf_sha256 == psf.sha256() {
                findings.ok(about, "pose-and-psf", "the pose was found for this PSF");
            } else {
                let mend =
                    "find it anew: `udc pose CAPTURES --psf PSF`; or name the PSF that it was found for";
                findings.fail(about, "pose-and-psf", "the pose was found for another PSF", mend);
            }
        }
    }
    for (path, config) in &opened.configurations {
        for (model_path, model) in &opened.models {
            configuration_and_model((path, config), (model_path, model), findings);
        }
        for root in &opened.examples {
            configuration_and_data(root, (path, config), findings);
        }
    }
}

fn both(one: &Path, other: &Path) -> String {
    format!("{} and {}", one.display(), other.display())
}

fn short(sha256: &str) -> &str {
    sha256.get(..DIGITS).unwrap_or(sha256)
}

fn dataset_and_bank(
    dataset: &Dataset,
    (path, bank, sha256): (&Path, &KernelBank, &str),
    findings: &mut Findings,
) {
    let (about, check) = (both(&dataset.root, path), "dataset-and-bank");
    match dataset.bank_sha256() {
        Some(own) if own == sha256 => findings.ok(about, check, "the dataset was made with this bank"),
        Some(own) => {
            let what =
                format!("the dataset was made with another bank ({}, this is {})", short(own), short(sha256));
            let mend = format!(
                "name {}, or make the dataset anew: `udc synth SCENES --bank {}`",
                dataset.root.join("kernels.safetensors").display(),
                path.display()
            );
            findings.fail(about, check, what, mend);
        }
        None if dataset.code_dim() != bank.code_dim() => {
            let what = format!(
                "the dataset has codes of {} numbers, and the bank of {}",
                dataset.code_dim(),
                bank.code_dim()
            );
            findings.fail(about, check, what, "name the bank that the dataset's codes are of");
        }
        None => {}
    }
}

fn dataset_and_model(dataset: &Dataset, (path, model): (&Path, &Model), findings: &mut Findings) {
    let about = both(&dataset.root, path);
    if let Some(sha256) = dataset.bank_sha256() {
        model_and_bank((path, model), (&dataset.root, sha256), dataset.code_dim(), findings);
    } else {
        code_length(&about, model, dataset.code_dim(), findings);
    }
    let (Some(trained), Ok(formed)) = (model.origin().tone_curve(), dataset.formation.curve()) else {
        return;
    };
    if trained == formed {
        findings.ok(about, "tone-curve", format!("both under α {} and x-max {}", formed.alpha, formed.x_max));
    } else if model.architecture().planes().is_empty() {
        let what = format!(
            "the model was trained under α {} and x-max {}, and the dataset was formed under α {} and x-max {}",
            trained.alpha, trained.x_max, formed.alpha, formed.x_max
        );
        let mend = "train on this dataset, or make one on the model's scale: `udc synth --x-max X --alpha A`";
        findings.warn(about, "tone-curve", what, mend);
    }
}

/// Whether a network reads codes of this length; returns whether it does.
fn code_length(about: &str, model: &Model, found: usize, findings: &mut Findings) -> bool {
    match model.architecture().code_len() {
        Some(needed) if needed != found => {
            let what = format!("the model reads codes of {needed} numbers, and these kernels have {found}");
            let mend = format!(
                "make the bank anew with `udc codes --dim {needed}`, or train with architecture.code-dim = {found}"
            );
            findings.fail(about, "code-length", what, mend);
            false
        }
        _ => true,
    }
}

/// Whether the codes of a bank, that of a file or of a dataset, are those that a model was trained with.
fn model_and_bank(
    (path, model): (&Path, &Model),
    (bank, sha256): (&Path, &str),
    code_dim: usize,
    findings: &mut Findings,
) {
    let about = both(path, bank);
    if !code_length(&about, model, code_dim, findings) || !model.architecture().reads_code() {
        return;
    }
    match &model.origin().kernel_bank_sha256 {
        Some(own) if own == sha256 => {
            findings.ok(about, "model-and-bank", "the model was trained with these codes");
        }
        Some(own) => {
            let what = format!(
                "the model was trained with the codes of another bank ({}, these are of {})",
                short(own),
                short(sha256)
            );
            let mend =
                "name the bank that it was trained with; codes of another basis mean something else to it";
            findings.fail(about, "model-and-bank", what, mend);
        }
        None => {}
    }
}

fn psf_and_bank(
    (path, psf): (&Path, &Psf),
    (bank_path, bank): (&Path, &KernelBank),
    findings: &mut Findings,
) {
    let (about, check) = (both(path, bank_path), "psf-and-bank");
    let sha256 = psf.sha256();
    if let Some(index) = bank.psfs.iter().position(|kernel| kernel.sha256() == sha256) {
        return findings.ok(
            about,
            check,
            format!("the PSF is the bank's kernel {}", bank.kernel_name(index)),
        );
    }
    let mend = format!("make a bank of this PSF: `udc codes {} -o bank.safetensors`", path.display());
    match project(bank, psf) {
        Ok(projection) if projection.fits() => {
            let nearest = bank.kernel_name(projection.nearest);
            findings.ok(
                about,
                check,
                format!("the bank can describe the PSF, which is nearest to its kernel {nearest}"),
            );
        }
        Ok(_) => {
            let what =
                "the bank cannot describe the PSF: it is further off than any of its kernels from the others";
            findings.fail(about, check, what, mend);
        }
        Err(error) => findings.refused(about, check, &error, &mend),
    }
}

fn psf_and_images((path, psf): (&Path, &Psf), images: &Path, sizes: &Sizes, findings: &mut Findings) {
    let Some([height, width]) = sizes.iter().copied().max_by_key(|[height, width]| height * width) else {
        return;
    };
    let (about, check) = (both(path, images), "psf-and-images");
    let (reach, needed) = ([psf.height(), psf.width()], [2 * height - 1, 2 * width - 1]);
    let said = format!("a PSF of {} × {} and images of up to {height} × {width}", reach[0], reach[1]);
    if reach[0] > needed[0] || reach[1] > needed[1] {
        let mend = format!(
            "crop it to {} × {} around its middle: what lies further out never meets two pixels of an image, and takes memory \
             and time",
            needed[0].min(reach[0]),
            needed[1].min(reach[1])
        );
        findings.warn(about, check, said, mend);
    } else {
        findings.ok(about, check, said);
    }
}

fn dataset_and_configuration(
    (dataset, sizes): (&Dataset, &Sizes),
    (path, config): (&Path, &TrainConfig),
    findings: &mut Findings,
) {
    let about = both(&dataset.root, path);
    let least = sizes.iter().flatten().min();
    if let Some(side) = least.filter(|side| **side < config.data.crop) {
        let what = format!("crops of {} pixels are larger than images of {side}", config.data.crop);
        findings.fail(&about, "crop-too-large", what, format!("--set data.crop={side}, or less"));
    }
    if config.data.degradation == Degradation::Stored
        && !dataset.triplets.iter().any(|t| t.split == Split::Train)
    {
        return;
    }
    configuration_and_data(&dataset.root, (path, config), findings);
}

/// Whether a training can begin with a configuration and data.
fn configuration_and_data(data: &Path, (path, config): (&Path, &TrainConfig), findings: &mut Findings) {
    let (about, check) = (both(data, path), "configuration-and-data");
    let begun = TrainingSet::open(data, None, config).and_then(|set| {
        set.check_codes(config)?;
        set.samples(config, &|_| {})?;
        set.validation(config)?;
        Ok(set.warnings(config))
    });
    match begun {
        Ok(warnings) if warnings.is_empty() => {
            findings.ok_unless_failed(about, check, "a training of these can begin");
        }
        Ok(warnings) => findings.warn(about, check, warnings.join("; "), "see what the text says"),
        Err(error) => {
            findings.refused(about, check, &error, "change the key that the text names, by --set KEY=VALUE");
        }
    }
}

fn configuration_and_model(
    (path, config): (&Path, &TrainConfig),
    (model_path, model): (&Path, &Model),
    findings: &mut Findings,
) {
    let (about, check) = (both(path, model_path), "configuration-and-model");
    if *model.architecture() == config.architecture {
        findings.ok(
            about,
            check,
            "the network of the configuration is the model's: it can begin with it (--init)",
        );
    } else {
        let what = "the configuration asks for another network than the model is: it cannot begin with it (--init), nor go on";
        let mend = format!("set [architecture] to {}", model.architecture().to_json());
        findings.warn(about, check, what, mend);
    }
}
