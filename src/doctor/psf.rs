//! Looks at PSFs, and at the sets of them that kernel banks are.

use std::path::Path;

use ndarray::ArrayView2;

use super::Findings;
use crate::core::kernel_code::KernelBank;
use crate::core::psf::Psf;
use crate::io::{PsfFaults, PsfOptions, bank_sha256, inspect_psf, read_bank};

/// Channel sums this close to one are those of a PSF, whose half floats are off by 2⁻¹¹ at most.
const SUM_TOLERANCE: f64 = 1.0 / (1 << 11) as f64;

/// More light than this share, spread evenly at the level of the border, is no tail of a PSF that was cut where it ends.
const PEDESTAL_SHARE: f64 = 0.05;

/// A point of balance further off the centre than this share of the side means light that has no counterpart: a background
/// that slopes, or a reflection.
const BALANCE_SHARE: f64 = 0.02;

const MEND_PEDESTAL: &str = "measure over a larger field (`udc fuse --point-source --size`, `udc psf --size`), or, of a \
                             measurement, subtract more background";

/// Looks at a PSF, and returns it where it can be read.
pub(super) fn look(path: &Path, options: PsfOptions, findings: &mut Findings) -> Option<Psf> {
    let about = path.display();
    let reading = match inspect_psf(path, options) {
        Ok(reading) => reading,
        Err(error) => {
            let mend = "measure it again (`udc fuse --point-source`), or simulate it (`udc psf`)";
            findings.refused(about, "psf-unreadable", &error, mend);
            return None;
        }
    };
    let faults = &reading.faults;
    if faults.shifts.iter().any(|shift| *shift != (0, 0)) {
        let mend =
            "--recenter, where the text says that it helps; else measure again with the peak in the middle";
        let said = faults.describe().unwrap_or_default();
        findings.fail(&about, "psf-off-centre", said, mend);
    }
    if faults.sums.iter().any(|sum| (sum - 1.0).abs() > SUM_TOLERANCE) {
        let [red, green, blue] = faults.sums;
        let what =
            format!("its colours sum to {red:.4}, {green:.4} and {blue:.4}, and each is divided by its sum");
        let mend = "nothing, where the colours were only scaled; a PSF in other units than energy is to be made anew";
        findings.warn(&about, "psf-sum", what, mend);
    }
    look_at_energy(&about.to_string(), faults, findings);
    if let Some(background) = faults.describe_floors() {
        let mend = "subtract the background of the measurement, or measure with `udc fuse --point-source`";
        findings.warn(&about, "psf-background", background, mend);
    }
    for doubt in &reading.doubts {
        findings.warn(&about, "psf-doubt", doubt.clone(), "mend the file, or measure the PSF again");
    }
    if let Some(contradiction) = &reading.contradiction {
        findings.warn(&about, "psf-domain", contradiction.clone(), "say what it holds by --psf-domain");
    }
    let psf = reading.psf;
    if reading.faults.describe().is_none() {
        let what =
            format!("a PSF of {} × {}, its peak in the middle, of unit sum", psf.height(), psf.width());
        findings.ok(&about, "psf", what);
        look_at_light(&about.to_string(), &psf, findings);
    }
    Some(psf)
}

/// Looks at energy that no PSF has: negative, noise, hot pixels.
fn look_at_energy(about: &str, faults: &PsfFaults, findings: &mut Findings) {
    if let Some(noise) = faults.describe_noise() {
        let mend = "nothing, or measure with several exposures by `udc fuse --point-source`";
        findings.warn(about, "psf-noise", noise, mend);
    }
    if (0..3).any(|channel| faults.has_wrong_negatives(channel)) {
        let most = faults.negative_shares.iter().copied().fold(0.0, f64::max);
        let what = format!("up to {:.2} % of a colour's energy is negative, and set to zero", 100.0 * most);
        findings.warn(
            about,
            "psf-negative",
            what,
            "subtract less background, or measure with `udc fuse --point-source`",
        );
    }
    if let Some(pixel) = faults.describe_lone() {
        findings.warn(
            about,
            "psf-hot-pixel",
            pixel,
            "set it to its neighbours' light, or measure with dark frames",
        );
    }
    let exposures = "measure with several exposures by `udc fuse --point-source`";
    if let Some(core) = faults.describe_saturated_cores() {
        findings.warn(about, "psf-saturated", core, exposures);
    }
    if let Some(steps) = faults.describe_steps() {
        findings.warn(about, "psf-steps", steps, exposures);
    }
}

/// Looks at where the light of a PSF lies that is as it should be otherwise.
fn look_at_light(about: &str, psf: &Psf, findings: &mut Findings) {
    let (height, width) = (psf.height(), psf.width());
    if height.min(width) < 3 {
        let what = "it is one pixel wide: an image through it is as sharp as before";
        return findings.warn(about, "psf-trivial", what, "name the PSF of the panel");
    }
    let pedestal = (0..3).map(|channel| pedestal(&psf.channel(channel))).fold(0.0, f64::max);
    if pedestal > PEDESTAL_SHARE {
        let what = format!(
            "it does not end at its border: light as at the border makes {:.0} % of it, so that haze was cut off or a \
             background was left",
            100.0 * pedestal
        );
        findings.warn(about, "psf-cut-off", what, MEND_PEDESTAL);
    }
    let off = (0..3).map(|channel| off_balance(&psf.channel(channel), psf.centre())).fold(0.0, f64::max);
    let side = height.min(width) as f64;
    if off > (BALANCE_SHARE * side).max(1.0) {
        let what = format!("its light balances {off:.1} px from its centre, where its peak is");
        let mend = "look at it (`udc info --picture`): a reflection or a sloping background belongs out of it; a panel's \
                    own PSF may be lopsided";
        findings.warn(about, "psf-lopsided", what, mend);
    }
}

/// The share of a channel's light that lies evenly at the mean level of its border.
fn pedestal(plane: &ArrayView2<'_, f32>) -> f64 {
    let (height, width) = plane.dim();
    let is_border = |y: usize, x: usize| y == 0 || x == 0 || y + 1 == height || x + 1 == width;
    let border = plane.indexed_iter().filter(|((y, x), _)| is_border(*y, *x)).map(|(_, v)| f64::from(*v));
    let (sum, count) = border.fold((0.0, 0.0), |(sum, count), value| (sum + value, count + 1.0));
    sum / count * (height * width) as f64
}

/// How far the point of balance of a channel of unit sum is from the centre.
fn off_balance(plane: &ArrayView2<'_, f32>, (centre_y, centre_x): (usize, usize)) -> f64 {
    let moment = |place: fn((usize, usize)) -> usize| -> f64 {
        plane.indexed_iter().map(|(at, value)| place(at) as f64 * f64::from(*value)).sum()
    };
    (moment(|at| at.0) - centre_y as f64).hypot(moment(|at| at.1) - centre_x as f64)
}

/// Looks at a kernel bank, and returns it with its identity where it can be read.
pub(super) fn look_at_bank(path: &Path, findings: &mut Findings) -> Option<(KernelBank, String)> {
    let about = path.display();
    let opened = read_bank(path).and_then(|bank| Ok((bank, bank_sha256(path)?)));
    let (bank, sha256) = match opened {
        Ok(opened) => opened,
        Err(error) => {
            let mend = "copy it again, or make it anew with `udc codes`";
            findings.refused(about, "bank-unreadable", &error, mend);
            return None;
        }
    };
    let first = &bank.psfs[0];
    let what = format!(
        "a kernel bank of {} PSFs of {} × {}, codes of {}, {}",
        bank.len(),
        first.height(),
        first.width(),
        bank.code_dim(),
        &sha256[..12]
    );
    findings.ok(&about, "bank", what);
    let codes: Vec<Vec<f32>> = bank.codes.rows().into_iter().map(|code| code.to_vec()).collect();
    let same = |(index, code): (usize, &Vec<f32>)| {
        codes[..index].iter().position(|earlier| earlier == code).map(|e| (e, index))
    };
    if let Some((one, other)) = codes.iter().enumerate().find_map(same).filter(|_| bank.code_dim() > 0) {
        let what = format!(
            "the kernels {} and {} have one code: a network cannot tell them apart",
            bank.kernel_name(one),
            bank.kernel_name(other)
        );
        findings.warn(&about, "bank-codes", what, "make it anew with angles, or PSFs, that differ");
    }
    let moved =
        bank.psfs.iter().position(|psf| (0..3).any(|c| !has_peak_in_middle(&psf.channel(c), psf.centre())));
    if let Some(kernel) = moved {
        let what = format!("the peak of the kernel {} is off its centre", bank.kernel_name(kernel));
        findings.warn(
            &about,
            "bank-off-centre",
            what,
            "make it anew of PSFs that are in their place: `udc codes --recenter`",
        );
    }
    Some((bank, sha256))
}

/// Whether no pixel further than one from the centre is brighter than all that are nearer.
fn has_peak_in_middle(plane: &ArrayView2<'_, f32>, (centre_y, centre_x): (usize, usize)) -> bool {
    let is_near = |y: usize, x: usize| y.abs_diff(centre_y) <= 1 && x.abs_diff(centre_x) <= 1;
    let most = |near: bool| {
        let of_kind = plane.indexed_iter().filter(|((y, x), _)| is_near(*y, *x) == near);
        of_kind.map(|(_, value)| *value).fold(0.0, f32::max)
    };
    most(true) >= most(false)
}
