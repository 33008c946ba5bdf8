//! What the texts of descriptions share: lines, and numbers that stay short.

use std::fmt;

use serde_json::Value;

/// Writes lines, without what ends the last one.
pub(super) fn write_lines(
    f: &mut fmt::Formatter<'_>,
    lines: impl FnOnce(&mut String) -> fmt::Result,
) -> fmt::Result {
    let mut text = String::new();
    lines(&mut text)?;
    f.write_str(text.trim_end())
}

/// A value as people read it: a text without its quotes.
pub(super) fn plain(value: &Value) -> String {
    value.as_str().map_or_else(|| value.to_string(), str::to_owned)
}

/// Four significant digits, with an exponent where the number would be long.
pub(super) fn number(value: f64) -> String {
    let size = value.abs();
    if value == 0.0 {
        "0".into()
    } else if !(1e-3..1e5).contains(&size) {
        format!("{value:.3e}")
    } else if size >= 1000.0 {
        format!("{value:.0}")
    } else if size >= 1.0 {
        format!("{value:.3}")
    } else {
        format!("{value:.5}")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_stay_short() {
        let found: Vec<String> = [0.0, 0.25, -3.0, 12345.6, 1e-9, 2e8, f64::NAN].map(number).into();
        assert_eq!(found, ["0", "0.25000", "-3.000", "12346", "1.000e-9", "2.000e8", "NaN"]);
    }
}
