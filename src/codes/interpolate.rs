//! Turns an angle between the rotations of a bank into a kernel code.

use crate::core::error::{Error, Result};
use crate::core::kernel_code::{BankCodes, KernelCode};

/// Interpolates the code of a panel angle linearly between the two neighbouring rotations of the bank.
///
/// # Errors
/// [`Error::Unsupported`] when the bank was not made by rotation; [`Error::Config`] when the angle lies
/// outside of the bank's range.
///
/// # Panics
/// Never: the angle was found to lie within the bank's range.
pub fn interpolate_code(bank: &BankCodes, angle_deg: f64) -> Result<KernelCode> {
    let Some(angles) = bank.angles_deg() else {
        return Err(Error::Unsupported(
            "the kernel bank was not made by rotating one PSF and knows no angles; give a code or a PSF instead"
                .to_owned(),
        ));
    };
    let mut order: Vec<usize> = (0..angles.len()).collect();
    order.sort_by(|&a, &b| angles[a].total_cmp(&angles[b]));
    let (first, last) = (angles[order[0]], angles[order[order.len() - 1]]);
    if !(angle_deg >= first && angle_deg <= last) {
        let reason = format!("{angle_deg} is outside of the bank's range, {first} to {last} degrees");
        return Err(Error::config("angle", reason));
    }
    let above = order.iter().position(|&k| angles[k] >= angle_deg).expect("the last angle is not below");
    let (low, high) = (order[above.saturating_sub(1)], order[above]);
    let span = angles[high] - angles[low];
    let share = if span > 0.0 { (angle_deg - angles[low]) / span } else { 1.0 };
    let code = |k: usize| bank.code(k).mapv(f64::from);
    Ok((code(low) * (1.0 - share) + code(high) * share).mapv(super::pca::to_f32))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::codes::make_bank;
    use crate::core::psf::Psf;
    use ndarray::Array3;

    fn bank(angles: Option<Vec<f64>>) -> BankCodes {
        let psf = |slope: f32| {
            let energy = Array3::from_shape_fn((3, 4, 4), |(_, y, x)| {
                1.0 + slope * y as f32 + slope * slope * x as f32
            });
            Psf::from_energy(energy).unwrap()
        };
        make_bank([0.1, 0.5, 2.0].map(psf).to_vec(), angles, 2).unwrap().to_codes()
    }

    #[test]
    fn gives_the_codes_at_the_rotations_and_means_between_them() {
        let bank = bank(Some(vec![6.0, 0.0, 3.0]));
        for (k, angle) in [6.0, 0.0, 3.0].into_iter().enumerate() {
            assert_eq!(interpolate_code(&bank, angle).unwrap(), bank.code(k));
        }
        let between = interpolate_code(&bank, 1.0).unwrap();
        for (j, found) in between.iter().enumerate() {
            let expected = bank.code(1)[j] * (2.0 / 3.0) + bank.code(2)[j] / 3.0;
            assert!(
                (found - expected).abs() <= f32::EPSILON * bank.code(1)[j].abs().max(bank.code(2)[j].abs())
            );
        }
    }

    #[test]
    fn refuses_angles_that_the_bank_does_not_span() {
        let spanned = bank(Some(vec![6.0, 0.0, 3.0]));
        for angle in [-0.1, 6.1, f64::NAN] {
            let message = interpolate_code(&spanned, angle).unwrap_err().to_string();
            assert!(message.contains("0 to 6 degrees"), "{message}");
        }
        assert!(interpolate_code(&bank(None), 0.0).is_err());
    }
}
