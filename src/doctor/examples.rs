//! Looks at a folder of examples: whether all were made, and whether those that are read are whole.

use std::path::Path;
use std::sync::{Mutex, PoisonError};

use rayon::prelude::*;

use super::Findings;
use super::dataset::{evenly, tell_of_unfinished};
use crate::core::error::{Error, Result};
use crate::core::progress::Progress;
use crate::dataset::Split;
use crate::examples::{CAPTURE, ExamplesFolder, GROUND_TRUTH};

/// Whether a folder holds examples.
pub(super) fn is_one(folder: &Path) -> bool {
    ExamplesFolder::is_one(folder)
}

/// Looks at a folder of examples, of which at most `limit` are read; whether it can be opened.
pub(super) fn look(
    root: &Path,
    limit: Option<usize>,
    (findings, progress): (&mut Findings, &Progress),
) -> Result<bool> {
    let about = root.display();
    tell_of_unfinished(root, &[root.to_owned(), root.join("panels")], findings);
    let folder = match ExamplesFolder::open(root) {
        Ok(folder) => folder,
        Err(error) => {
            let mend = "finish it with the flags of its `udc examples` and --resume, or make it anew";
            findings.refused(about, "examples-unreadable", &error, mend);
            return Ok(false);
        }
    };
    let (made, wanted) = (folder.records.len(), folder.file.examples.count);
    if made < wanted {
        let what = format!("{made} of {wanted} examples are there");
        let mend =
            "finish it with the flags of its `udc examples` and --resume; a training takes what there is";
        findings.warn(&about, "examples-incomplete", what, mend);
    }
    if !folder.records.iter().any(|record| record.split == Split::Val) {
        let mend = "give examples.validation-share more, or make more examples";
        findings.warn(&about, "no-test-split", "none is for validation: trainings are not validated", mend);
    }
    let chosen = evenly(&folder.records, limit);
    let bar = progress.bar(chosen.len() as u64, "examples");
    let bad = Mutex::new(Vec::new());
    chosen.par_iter().try_for_each(|record| {
        progress.check()?;
        let fault = match folder.read(record) {
            Err(error) => Some(error.in_full()),
            Ok(tensors) => [CAPTURE, GROUND_TRUTH]
                .iter()
                .map(|name| (*name).to_owned())
                .chain(folder.file.planes.iter().cloned())
                .find(|name| !tensors.contains_key(name))
                .map(|name| format!("{} has no {name}", record.file_name())),
        };
        bad.lock().unwrap_or_else(PoisonError::into_inner).extend(fault);
        bar.inc(1);
        Ok::<_, Error>(())
    })?;
    let bad = bad.into_inner().unwrap_or_else(PoisonError::into_inner);
    match bad.first() {
        Some(first) => {
            let what = format!("{} of {} examples looked at are damaged: {first}", bad.len(), chosen.len());
            let mend = "remove these files and give `udc examples` its flags with --resume";
            findings.fail(&about, "example-damaged", what, mend);
        }
        None => findings.ok(
            &about,
            "examples",
            format!("{made} examples; {} were read, and are whole", chosen.len()),
        ),
    }
    Ok(true)
}
