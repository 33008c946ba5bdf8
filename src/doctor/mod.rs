//! Looks at what a user has, each thing by itself and all together, before hours are spent on it: what is found, and what
//! mends it.
//!
//! [`examine`] takes a [`Patient`] and returns its [`Finding`]s. Damage is found by the readers that the stages use; what
//! is looked for beside it is what these take without a word and what only shows where two things meet.

mod configuration;
mod dataset;
mod examples;
mod images;
mod machine;
mod model;
mod patient;
mod psf;
mod resources;
mod together;

use std::fmt;

use serde::Serialize;

use crate::core::error::{Error, Result};
use crate::core::progress::Progress;

use patient::Opened;
pub use patient::{Patient, Role};

/// How much a finding matters.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Level {
    /// It is as it should be.
    Ok,
    /// It may spoil a result, or cost time.
    Warning,
    /// Work with it fails, or its result is wrong.
    Error,
}

impl Level {
    /// Its name.
    pub fn name(self) -> &'static str {
        match self {
            Self::Ok => "ok",
            Self::Warning => "warning",
            Self::Error => "error",
        }
    }
}

/// Something that was looked at, and how it is.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub struct Finding {
    /// How much it matters.
    pub level: Level,
    /// The file or folder, or both of two that do not go together; or `machine`.
    pub about: String,
    /// What was looked at, by a name that stays: `psf-off-centre`.
    pub check: &'static str,
    /// What was found.
    pub what: String,
    /// What mends it: a command or what to do; nothing of what is as it should be.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub mend: Option<String>,
}

impl fmt::Display for Finding {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:<8} {}: {}", self.level.name(), self.about, self.what)?;
        self.mend.as_ref().map_or(Ok(()), |mend| write!(f, "\n         mend: {mend}"))
    }
}

/// Findings as they come.
#[derive(Debug, Default)]
struct Findings(Vec<Finding>);

impl Findings {
    fn ok(&mut self, about: impl fmt::Display, check: &'static str, what: impl Into<String>) {
        self.add(Level::Ok, (about.to_string(), check), what.into(), None);
    }

    /// Says that all is well, unless something was found already that makes work with it fail.
    fn ok_unless_failed(&mut self, about: impl fmt::Display, check: &'static str, what: impl Into<String>) {
        let about = about.to_string();
        if !self.0.iter().any(|finding| finding.level == Level::Error && finding.about == about) {
            self.ok(about, check, what);
        }
    }

    fn warn(
        &mut self,
        about: impl fmt::Display,
        check: &'static str,
        what: impl Into<String>,
        mend: impl Into<String>,
    ) {
        self.add(Level::Warning, (about.to_string(), check), what.into(), Some(mend.into()));
    }

    fn fail(
        &mut self,
        about: impl fmt::Display,
        check: &'static str,
        what: impl Into<String>,
        mend: impl Into<String>,
    ) {
        self.add(Level::Error, (about.to_string(), check), what.into(), Some(mend.into()));
    }

    /// What a reader refuses; its message says what is wrong, and mostly what to do.
    fn refused(&mut self, about: impl fmt::Display, check: &'static str, error: &Error, mend: &str) {
        self.fail(about, check, error.in_full(), mend);
    }

    fn add(
        &mut self,
        level: Level,
        (about, check): (String, &'static str),
        what: String,
        mend: Option<String>,
    ) {
        // A file's reader names it too.
        let what = what.strip_prefix(&format!("{about}: ")).map(str::to_owned).unwrap_or(what);
        self.0.push(Finding { level, about, check, what, mend });
    }
}

/// Looks at everything of a patient, by itself and together, and at the machine.
///
/// # Errors
/// [`Error::Interrupted`] alone: whatever else is wrong is a finding.
pub fn examine(patient: &Patient, progress: &Progress) -> Result<Vec<Finding>> {
    let mut findings = Findings::default();
    machine::look(&mut findings);
    let opened = Opened::of(patient, &mut findings, progress)?;
    together::look(&opened, &mut findings);
    resources::look(patient, &opened, &mut findings);
    Ok(findings.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nothing_is_well_that_has_failed() {
        let mut findings = Findings::default();
        findings.warn("a", "dark", "it is black", "see");
        findings.fail("b", "not-finite", "1 of its values is NaN", "write it anew");
        for about in ["a", "b"] {
            findings.ok_unless_failed(about, "image", "an image");
        }
        let found: Vec<(&str, Level)> =
            findings.0.iter().map(|finding| (finding.about.as_str(), finding.level)).collect();
        assert_eq!(found, [("a", Level::Warning), ("b", Level::Error), ("a", Level::Ok)]);
    }
}
