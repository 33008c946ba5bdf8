//! Configuration files: TOML, with mistakes told in one line.

use serde::de::DeserializeOwned;

/// Reads a value from TOML.
///
/// # Errors
/// One line: where the mistake is, what it is, and which keys or values would be right.
pub fn parse_toml<T: DeserializeOwned>(text: &str) -> Result<T, String> {
    toml::from_str(text).map_err(|error| {
        let message = one_line(error.message());
        let Some(before) = error.span().and_then(|span| text.get(..span.start)) else { return message };
        let line = before.matches('\n').count() + 1;
        let column = before.chars().rev().take_while(|&c| c != '\n').count() + 1;
        format!("line {line}, column {column}: {message}")
    })
}

fn one_line(text: &str) -> String {
    text.split_whitespace().collect::<Vec<_>>().join(" ")
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde::Deserialize;

    #[derive(Debug, Deserialize)]
    #[serde(deny_unknown_fields)]
    struct Sensor {
        #[expect(dead_code, reason = "read only to be refused")]
        gain: f64,
    }

    #[test]
    fn mistakes_are_told_in_one_line_with_their_place() {
        for (text, expected) in [
            ("gain = 1.0\n\n  gian = 2.0", "line 3, column 3: unknown field `gian`, expected `gain`"),
            ("gain = \"high\"", "line 1, column 8: invalid type"),
            ("# ä\ngain = = 2", "line 2, column 8"),
            ("", "missing field `gain`"),
        ] {
            let message = parse_toml::<Sensor>(text).unwrap_err();
            assert!(message.contains(expected) && !message.contains('\n'), "{text}: {message}");
        }
    }
}
