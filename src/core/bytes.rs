//! Numbers of bytes as people write and read them.

use super::error::{Error, Result};

/// Reads a number of bytes with its unit: `2GiB`, `500MB`, `750 MiB`, `1073741824`.
///
/// # Errors
/// [`Error::Unsupported`] when the text is no such number.
pub fn parse_bytes(text: &str) -> Result<u64> {
    let text = text.trim();
    let unit_at = text.find(|c: char| c != '.' && !c.is_ascii_digit()).unwrap_or(text.len());
    let (number, unit) = text.split_at(unit_at);
    let refuse =
        || Error::Unsupported(format!("expected a size such as 2GiB, 500MB or 750MiB, found `{text}`"));
    let factor: u64 = match unit.trim().to_ascii_lowercase().as_str() {
        "" | "b" => 1,
        "k" | "kb" => 1000,
        "m" | "mb" => 1000_u64.pow(2),
        "g" | "gb" => 1000_u64.pow(3),
        "kib" => 1 << 10,
        "mib" => 1 << 20,
        "gib" => 1 << 30,
        _ => return Err(refuse()),
    };
    let number: f64 = number.parse().map_err(|_| refuse())?;
    #[expect(clippy::cast_precision_loss, reason = "units are exact in f64")]
    let bytes = number * factor as f64;
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "checked to be in range")]
    if (1.0..=1e15).contains(&bytes) { Ok(bytes as u64) } else { Err(refuse()) }
}

/// Writes a number of bytes for people: `1.50 GiB`, `640 MiB`; rounded up.
pub fn format_bytes(bytes: u64) -> String {
    let mib = bytes.div_ceil(1 << 20);
    if mib < 1024 {
        return format!("{mib} MiB");
    }
    let hundredths = (mib * 100).div_ceil(1024);
    format!("{}.{:02} GiB", hundredths / 100, hundredths % 100)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn reads_sizes_in_powers_of_ten_and_of_two() {
        let cases = [("2GiB", 2 << 30), ("500MB", 500_000_000), ("1.5 gib", 3 << 29), ("4096", 4096)];
        for (text, bytes) in cases {
            assert_eq!(parse_bytes(text).unwrap(), bytes, "{text}");
        }
        for text in ["", "GiB", "two", "-1GB", "1.2.3GB", "3 apples", "0"] {
            assert!(parse_bytes(text).is_err(), "{text}");
        }
        assert_eq!(format_bytes(3 << 29), "1.50 GiB");
    }
}
