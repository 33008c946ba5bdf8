//! Turns a reference picture into the means that pictures are scaled to.

use std::path::Path;

use ndarray::Array3;

use super::channel_means;
use crate::core::error::{Error, Result};
use crate::core::image::first_non_finite;

/// The mean of each channel of the picture that was read from `path`.
///
/// # Errors
/// [`Error::Format`] for a picture without three channels, with a value that is not finite, or without any light: whatever is
/// scaled to that is all white or all black.
pub(super) fn means_of(path: &Path, planes: &Array3<f32>) -> Result<[f64; 3]> {
    if planes.dim().0 != 3 {
        return Err(Error::format(path, "is grey; a reference picture has three channels"));
    }
    if let Some(((channel, row, column), value)) = first_non_finite(planes) {
        let reason = format!(
            "the image holds {value} at row {row}, column {column}, channel {channel}; replace such pixels by numbers before \
             using it"
        );
        return Err(Error::format(path, reason));
    }
    let means = channel_means(planes);
    if means.iter().all(|mean| *mean <= 0.0) {
        return Err(Error::format(path, "is black; name a reference picture that shows something"));
    }
    Ok(means)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_pictures_with_light_are_references() {
        let mut planes = Array3::zeros((3, 2, 2));
        let refusal = |planes: &Array3<f32>| means_of(Path::new("a.npy"), planes).unwrap_err().to_string();
        assert!(refusal(&planes).starts_with("a.npy: is black"));
        planes[[1, 0, 1]] = 2.0;
        assert_eq!(means_of(Path::new("a.npy"), &planes).unwrap(), [0.0, 0.5, 0.0]);
        for value in [f32::NAN, f32::INFINITY] {
            planes[[2, 1, 0]] = value;
            let said = refusal(&planes);
            assert!(said.contains(&format!("holds {value} at row 1, column 0, channel 2")), "{said}");
        }
        assert!(refusal(&Array3::ones((1, 2, 2))).contains("is grey"));
    }
}
