//! Turns a camera's colours into those of a display by a matrix, and reads such matrices.

use std::path::Path;

use ndarray::{Array3, Axis, azip};
use serde::Serialize;

use crate::core::config::parse_toml;
use crate::core::error::{Error, Result};
use crate::core::matrix3::{Matrix3, is_singular};
use crate::io::{read_array, read_text};

/// A colour correction matrix: row i holds what output channel i takes of red, green and blue.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct ColorMatrix(pub [[f32; 3]; 3]);

impl ColorMatrix {
    /// Multiplies every pixel of `[3, height, width]`; values may become negative.
    ///
    /// # Panics
    /// When there are not three planes.
    pub fn apply(&self, planes: &mut Array3<f32>) {
        assert_eq!(planes.dim().0, 3, "a colour matrix is for RGB");
        let [red, green, blue] = self.0;
        let (mut r, rest) = planes.view_mut().split_at(Axis(0), 1);
        let (mut g, mut b) = rest.split_at(Axis(0), 1);
        azip!((r in &mut r, g in &mut g, b in &mut b) {
            let pixel = [*r, *g, *b];
            let dot = |row: [f32; 3]| row[0] * pixel[0] + row[1] * pixel[1] + row[2] * pixel[2];
            (*r, *g, *b) = (dot(red), dot(green), dot(blue));
        });
    }

    /// Multiplies one pixel.
    pub(super) fn apply_to(&self, pixel: [f32; 3]) -> [f32; 3] {
        self.0.map(|row| row[0] * pixel[0] + row[1] * pixel[1] + row[2] * pixel[2])
    }

    /// The matrix in single precision.
    #[expect(clippy::cast_possible_truncation, reason = "images are 32-bit floats")]
    pub fn of(matrix: Matrix3) -> Self {
        Self(matrix.map(|row| row.map(|value| value as f32)))
    }

    /// Whether it keeps grey only when it is transposed: rows of a matrix that keeps white sum to one.
    pub fn looks_transposed(&self) -> bool {
        let m = &self.0;
        let off = |sum: fn(&[[f32; 3]; 3], usize) -> f32| {
            (0..3).map(|i| (sum(m, i) - 1.0).abs()).fold(0.0, f32::max)
        };
        let rows = off(|m, i| m[i][0] + m[i][1] + m[i][2]);
        let columns = off(|m, i| m[0][i] + m[1][i] + m[2][i]);
        columns < 0.02 && rows > 0.1
    }
}

/// Reads a colour matrix: `.npy` of 3 × 3 or 9 numbers, `.toml` with one array of them, or text of the form
/// `key: nine numbers`, row by row.
///
/// # Errors
/// [`Error::Io`] when the file cannot be read; [`Error::Format`] when it does not hold nine numbers, or those of a singular
/// matrix, which takes colours away that nothing brings back.
pub fn read_color_matrix(path: &Path) -> Result<ColorMatrix> {
    let extension = path.extension().map(|extension| extension.to_string_lossy().to_ascii_lowercase());
    let numbers = match extension.as_deref() {
        Some("npy") => Ok(read_array(path)?.into_iter().collect()),
        Some("toml") => numbers_of_toml(&read_text(path)?),
        _ => numbers_of_text(&read_text(path)?),
    };
    let numbers: Vec<f64> = numbers.map_err(|reason| Error::format(path, reason))?;
    let count = numbers.len();
    let nine: [f64; 9] = numbers.try_into().map_err(|_| {
        let reason =
            format!("holds {count} numbers; a colour matrix has nine, row by row: `ccm: 1 0 0 0 1 0 0 0 1`");
        Error::format(path, reason)
    })?;
    if let Some(bad) = nine.iter().find(|v| !v.is_finite() || v.abs() > 1e3) {
        return Err(Error::format(path, format!("holds {bad}, which is no coefficient of a colour matrix")));
    }
    let matrix: Matrix3 = [0, 1, 2].map(|i| [0, 1, 2].map(|j| nine[3 * i + j]));
    if is_singular(&matrix) {
        let reason = "holds a singular matrix: its rows depend on one another, so that colours are lost; a colour matrix has \
                      an inverse, and rows that sum to about one";
        return Err(Error::format(path, reason));
    }
    Ok(ColorMatrix::of(matrix))
}

/// The numbers behind the key that has nine, on its line or below it; text without keys is read as a whole.
fn numbers_of_text(text: &str) -> std::result::Result<Vec<f64>, String> {
    let mut groups: Vec<(&str, Vec<f64>)> = Vec::new();
    for line in text.lines() {
        let values = match line.split_once(':') {
            Some((key, values)) => {
                groups.push((key.trim(), Vec::new()));
                values
            }
            None => line,
        };
        let numbers = numbers_of(values)?;
        match groups.last_mut() {
            Some((_, group)) => group.extend(numbers),
            None => groups.push(("", numbers)),
        }
    }
    if groups.len() > 1 {
        groups.retain(|(_, numbers)| numbers.len() == 9);
    }
    let named = groups.iter().position(|(key, _)| key.eq_ignore_ascii_case("ccm"));
    match (groups.len(), named) {
        (0, _) => Err("holds no key with nine numbers, as in `ccm: 1 0 0 0 1 0 0 0 1`".to_owned()),
        (1, _) => Ok(groups.remove(0).1),
        (_, Some(index)) => Ok(groups.swap_remove(index).1),
        _ => {
            let names: Vec<&str> = groups.iter().map(|(key, _)| *key).collect();
            let names = names.join(", ");
            Err(format!("holds several matrices ({names}); keep the one that is meant, or call it `ccm`"))
        }
    }
}

fn numbers_of(text: &str) -> std::result::Result<Vec<f64>, String> {
    text.split(|c: char| c.is_whitespace() || matches!(c, ',' | ';' | '[' | ']' | '(' | ')'))
        .filter(|word| !word.is_empty())
        .map(|word| word.parse().map_err(|_| format!("holds `{word}` where a number is needed")))
        .collect()
}

fn numbers_of_toml(text: &str) -> std::result::Result<Vec<f64>, String> {
    let table: toml::Table = parse_toml(text)?;
    let mut arrays = table.iter().filter(|(_, value)| value.is_array());
    match (arrays.next(), arrays.next()) {
        (Some((_, value)), None) => {
            let mut numbers = Vec::new();
            flatten(value, &mut numbers)?;
            Ok(numbers)
        }
        (None, _) => Err("holds no array; write ccm = [[1, 0, 0], [0, 1, 0], [0, 0, 1]]".to_owned()),
        (Some((a, _)), Some((b, _))) => Err(format!("holds several arrays, {a} and {b}; keep one of them")),
    }
}

fn flatten(value: &toml::Value, numbers: &mut Vec<f64>) -> std::result::Result<(), String> {
    match value {
        toml::Value::Array(values) => values.iter().try_for_each(|value| flatten(value, numbers)),
        toml::Value::Float(number) => {
            numbers.push(*number);
            Ok(())
        }
        toml::Value::Integer(number) => {
            numbers.push(*number as f64);
            Ok(())
        }
        other => Err(format!("holds `{other}` where a number is needed")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ndarray::{ArrayD, IxDyn};

    const NINE: [f32; 9] = [1.5, -0.5, 0.0, -0.25, 1.5, -0.25, 0.0, -0.5, 1.5];

    fn read(name: &str, text: &str) -> Result<ColorMatrix> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join(name);
        std::fs::write(&path, text).unwrap();
        read_color_matrix(&path)
    }

    #[test]
    fn reads_every_form() {
        let row = |i: usize| [NINE[3 * i], NINE[3 * i + 1], NINE[3 * i + 2]];
        let expected = ColorMatrix([row(0), row(1), row(2)]);
        let rows = "1.5 -0.5 0\n-0.25 1.5 -0.25\n0 -0.5 1.5\n";
        for text in [
            "ccm: 1.5 -0.5 0 -0.25 1.5 -0.25 0 -0.5 1.5",
            &format!("CCM:\n{rows}"),
            rows,
            "awb: 1 2\nccm: [1.5, -0.5, 0], [-0.25, 1.5, -0.25], [0, -0.5, 1.5]\n",
            "d65: 1 0 0 0 1 0 0 0 1\nccm: 1.5 -0.5 0 -0.25 1.5 -0.25 0 -0.5 1.5",
        ] {
            assert_eq!(read("a.txt", text).unwrap(), expected, "{text}");
        }
        let toml = "name = \"day\"\nccm = [[1.5, -0.5, 0], [-0.25, 1.5, -0.25], [0, -0.5, 1.5]]";
        assert_eq!(read("a.toml", toml).unwrap(), expected);
        let folder = tempfile::tempdir().unwrap();
        for shape in [&[3, 3][..], &[9]] {
            let path = folder.path().join("a.npy");
            let array = ArrayD::from_shape_vec(IxDyn(shape), NINE.to_vec()).unwrap();
            crate::io::write_array(&path, &array, true).unwrap();
            assert_eq!(read_color_matrix(&path).unwrap(), expected);
        }
    }

    #[test]
    fn says_what_is_wrong_with_a_file() {
        let message = |name, text| read(name, text).unwrap_err().to_string();
        assert!(message("a.txt", "ccm: 1 2 3").contains("holds 3 numbers"));
        assert!(message("a.txt", "ccm: 1 2 x").contains("`x`"));
        assert!(
            message("a.txt", "a: 1 0 0 0 1 0 0 0 1\nb: 1 0 0 0 1 0 0 0 1")
                .contains("several matrices (a, b)")
        );
        assert!(message("a.toml", "ccm = 3").contains("no array"));
        assert!(message("a.toml", "ccm = [1,").contains("line 1"));
        assert!(message("a.txt", "ccm: nan 0 0 0 1 0 0 0 1").contains("NaN"));
        for singular in ["0 0 0 0 0 0 0 0 0", "1 2 3 2 4 6 0 1 1", "1e-3 0 0 0 1e-3 0 0 0 0"] {
            let said = read("a.txt", &format!("ccm: {singular}")).unwrap_err().to_string();
            assert!(said.contains("a.txt") && said.contains("singular"), "{said}");
        }
    }

    #[test]
    fn keeps_grey_when_its_rows_sum_to_one() {
        let matrix = ColorMatrix([[1.5, -0.5, 0.0], [-0.25, 1.5, -0.25], [0.1, -0.6, 1.5]]);
        let mut grey = Array3::from_elem((3, 4, 5), 0.4);
        matrix.apply(&mut grey);
        assert!(grey.iter().all(|v| (v - 0.4).abs() < 1e-6));
        let [a, b, c] = matrix.0;
        let transposed = ColorMatrix([[a[0], b[0], c[0]], [a[1], b[1], c[1]], [a[2], b[2], c[2]]]);
        assert!(transposed.looks_transposed() && !matrix.looks_transposed());
    }
}
