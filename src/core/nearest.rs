//! Finds the known name that is nearest to a misspelt one, to be suggested in its place.

use strsim::levenshtein;

/// The known name that takes the fewest insertions, deletions and replacements, the earliest of equals; none among none.
pub fn nearest<'a>(name: &str, known: &'a [String]) -> Option<&'a str> {
    known.iter().min_by_key(|known| levenshtein(name, known)).map(String::as_str)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_name_of_the_fewest_edits_is_nearest() {
        let known = ["r-03", "r+00", "r+03"].map(str::to_owned);
        assert_eq!((nearest("r00", &known), nearest("r3", &known)), (Some("r+00"), Some("r-03")));
        assert_eq!(nearest("r00", &[]), None);
    }
}
