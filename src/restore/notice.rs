//! What there is to tell of a restoration that does not stop it.

use std::fmt;

use crate::io::PsfReading;

/// A sentence for the user, by how much it matters.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Notice {
    /// What was found, for who wants to know.
    Detail(String),
    /// What was done on the way.
    Note(String),
    /// What may spoil the result.
    Warning(String),
}

impl Notice {
    /// What was found in the file of a PSF.
    pub fn of_psf(reading: &PsfReading) -> Vec<Self> {
        let mut notices = Vec::new();
        if let Some((how, lost)) = reading.describe_move() {
            notices.push(Self::Note(how));
            notices.extend(lost.map(Self::Warning));
        }
        notices.extend(reading.describe_grey().map(Self::Note));
        notices.extend(reading.warnings().into_iter().map(Self::Warning));
        notices
    }
}

impl fmt::Display for Notice {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (Self::Detail(text) | Self::Note(text) | Self::Warning(text)) = self;
        f.write_str(text)
    }
}
