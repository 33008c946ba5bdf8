//! Reads Rust as far as the promises of the module tree need it: what is code, what is a test, what a path leads to.

/// A source with comments, the contents of literals and everything under `#[cfg(test)]` left out: spaces stand for them,
/// so that lines stay where they are.
pub(crate) fn code_of(text: &str) -> String {
    without_tests(&without_words(text))
}

/// The source with spaces for comments and for what strings and characters hold.
fn without_words(text: &str) -> String {
    let letters: Vec<char> = text.chars().collect();
    let mut code = String::with_capacity(text.len());
    let mut at = 0;
    while at < letters.len() {
        let (end, is_code) = match token_end(&letters, at) {
            Some(end) => (end, false),
            None => (at + 1, true),
        };
        for &letter in &letters[at..end] {
            code.push(if is_code || letter == '\n' { letter } else { ' ' });
        }
        at = end;
    }
    code
}

/// Where the comment or literal that begins at a place ends; none where code stands.
fn token_end(letters: &[char], at: usize) -> Option<usize> {
    let rest = &letters[at..];
    let starts = |with: &str| rest.iter().zip(with.chars()).filter(|(a, b)| **a == *b).count() == with.len();
    let line = || rest.iter().position(|&letter| letter == '\n').map_or(letters.len(), |length| at + length);
    let is_in_word = at > 0 && (letters[at - 1].is_alphanumeric() || letters[at - 1] == '_');
    match rest[0] {
        '/' if starts("//") => Some(line()),
        '/' if starts("/*") => Some(block_end(letters, at)),
        '"' => Some(quote_end(letters, at + 1, '"')),
        'r' if !is_in_word || letters[at - 1] == 'b' => raw_end(letters, at),
        // A character, and not a lifetime or a label.
        '\'' if rest.get(1) == Some(&'\\') || rest.get(2) == Some(&'\'') => {
            Some(quote_end(letters, at + 1, '\''))
        }
        _ => None,
    }
}

fn block_end(letters: &[char], start: usize) -> usize {
    let (mut depth, mut at) = (0, start);
    while at + 1 < letters.len() {
        match (letters[at], letters[at + 1]) {
            ('/', '*') => (depth, at) = (depth + 1, at + 2),
            ('*', '/') if depth == 1 => return at + 2,
            ('*', '/') => (depth, at) = (depth - 1, at + 2),
            _ => at += 1,
        }
    }
    letters.len()
}

fn quote_end(letters: &[char], start: usize, quote: char) -> usize {
    let mut at = start;
    while at < letters.len() && letters[at] != quote {
        at += if letters[at] == '\\' { 2 } else { 1 };
    }
    (at + 1).min(letters.len())
}

/// The end of a raw string that begins at an `r`, if one does.
fn raw_end(letters: &[char], start: usize) -> Option<usize> {
    let hashes = letters[start + 1..].iter().take_while(|&&letter| letter == '#').count();
    let open = start + 1 + hashes;
    if letters.get(open) != Some(&'"') {
        return None;
    }
    let closes = |at: &usize| {
        letters[*at] == '"' && letters[at + 1..].iter().take(hashes).filter(|&&l| l == '#').count() == hashes
    };
    Some((open + 1..letters.len()).find(closes).map_or(letters.len(), |at| at + 1 + hashes))
}

const TEST_ATTRIBUTE: &str = "#[cfg(test)]";

/// The source with spaces for each item that is compiled for tests alone.
fn without_tests(code: &str) -> String {
    let mut left = code.to_owned();
    while let Some(start) = left.find(TEST_ATTRIBUTE) {
        let end = item_end(&left, start + TEST_ATTRIBUTE.len());
        let blank: String = left[start..end].chars().map(|c| if c == '\n' { '\n' } else { ' ' }).collect();
        left.replace_range(start..end, &blank);
    }
    left
}

/// The end of the item at a place: its semicolon, the brace that closes it, or the comma of a field.
fn item_end(code: &str, start: usize) -> usize {
    let item = code[start..].trim_start();
    let is_field = !item.starts_with('#') && !KEYWORDS.iter().any(|keyword| item.starts_with(keyword));
    let is_list = item.starts_with("use ") || item.starts_with("pub use ");
    let mut depth = 0_usize;
    for (at, letter) in code[start..].char_indices() {
        match letter {
            '{' | '(' | '[' => depth += 1,
            '}' if depth == 1 && !is_list => return start + at + 1,
            '}' | ')' | ']' if depth > 0 => depth -= 1,
            // The end of what a last field stands in.
            '}' | ')' | ']' => return start + at,
            ';' if depth == 0 => return start + at + 1,
            ',' if depth == 0 && is_field => return start + at + 1,
            _ => {}
        }
    }
    code.len()
}

/// What items begin with; anything else under an attribute is a field, a variant or a statement.
const KEYWORDS: [&str; 15] = [
    "pub",
    "fn ",
    "impl",
    "mod ",
    "use ",
    "struct ",
    "enum ",
    "const ",
    "static ",
    "type ",
    "trait ",
    "unsafe ",
    "extern ",
    "macro_rules!",
    "async ",
];

/// A piece of a path: a name, or a sign that parts names.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Piece<'a> {
    Name(&'a str),
    Colons,
    Sign(char),
}

fn pieces(code: &str) -> Vec<Piece<'_>> {
    let mut found = Vec::new();
    let mut rest = code.trim_start();
    while let Some(first) = rest.chars().next() {
        let word = rest.find(|c: char| !c.is_alphanumeric() && c != '_').unwrap_or(rest.len());
        let (piece, length) = match word {
            0 if rest.starts_with("::") => (Piece::Colons, 2),
            0 => (Piece::Sign(first), first.len_utf8()),
            _ => (Piece::Name(&rest[..word]), word),
        };
        found.push(piece);
        rest = rest[length..].trim_start();
    }
    found
}

/// The top-level modules of the crate that code names by a path, whatever its form: `crate::a`, `crate::{a, b::c}`, or
/// enough `super::` to leave its own; `place` is the module that the code stands in.
pub(crate) fn named_modules(code: &str, place: &[&str]) -> Vec<String> {
    let pieces = pieces(code);
    // Modules within the file, with the depth of braces that each is left at.
    let (mut inner, mut depth): (Vec<(&str, usize)>, usize) = (Vec::new(), 0);
    let (mut found, mut at) = (Vec::new(), 0);
    while at < pieces.len() {
        let mut length = 1;
        match pieces[at] {
            Piece::Sign('{') => {
                if let Some([Piece::Name("mod"), Piece::Name(name)]) =
                    at.checked_sub(2).map(|b| &pieces[b..at])
                {
                    inner.push((*name, depth));
                }
                depth += 1;
            }
            Piece::Sign('}') => {
                depth = depth.saturating_sub(1);
                inner.pop_if(|(_, outside)| *outside == depth);
            }
            Piece::Name("crate" | "super" | "self") if pieces.get(at + 1) == Some(&Piece::Colons) => {
                let here: Vec<&str> =
                    place.iter().copied().chain(inner.iter().map(|(name, _)| *name)).collect();
                length = follow(&pieces[at..], &here, &mut found);
            }
            _ => {}
        }
        at += length;
    }
    found
}

/// Follows a path, or each path of a list in braces, from the module `here` to the first name below the crate's root;
/// returns how many pieces it took.
fn follow(pieces: &[Piece<'_>], here: &[&str], found: &mut Vec<String>) -> usize {
    let is_path = pieces.get(1) == Some(&Piece::Colons);
    match pieces.first() {
        Some(Piece::Name("crate")) if is_path => 2 + follow(&pieces[2..], &[], found),
        Some(Piece::Name("self")) if is_path => 2 + follow(&pieces[2..], here, found),
        Some(Piece::Name("super")) if is_path => {
            2 + follow(&pieces[2..], &here[..here.len().saturating_sub(1)], found)
        }
        Some(Piece::Name(name)) => {
            found.push((*here.first().unwrap_or(name)).to_owned());
            1 + if is_path {
                1 + follow(&pieces[2..], &[here.first().unwrap_or(name)], &mut Vec::new())
            } else {
                0
            }
        }
        Some(Piece::Sign('{')) => {
            let mut at = 1;
            while at < pieces.len() && pieces[at] != Piece::Sign('}') {
                let is_renamed = pieces[at] == Piece::Name("as");
                at += if is_renamed { 2 } else { follow(&pieces[at..], here, found).max(1) };
            }
            at + 1
        }
        _ => 0,
    }
}
