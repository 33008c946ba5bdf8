//! Turns what files say of their making into the last section of a page.

use std::path::Path;

use super::page::Block;
use crate::core::error::Result;
use crate::core::provenance::Provenance;
use crate::io;

/// Where an input of the page comes from.
#[derive(Clone, Debug)]
pub struct Origin {
    /// Its name.
    pub name: String,
    /// The SHA-256 of its file; none of a folder.
    pub sha256: Option<String>,
    /// What its file says.
    pub provenance: Option<Provenance>,
}

impl Origin {
    /// Looks at an input; what a folder says of its making stands in its own section.
    ///
    /// # Errors
    /// [`Error::Io`](crate::core::error::Error::Io) when a file cannot be read.
    pub fn of(name: &str, path: &Path) -> Result<Self> {
        if path.is_dir() {
            return Ok(Self { name: name.to_owned(), sha256: None, provenance: None });
        }
        let (sha256, provenance) = (io::sha256_of_file(path)?, io::read_provenance(path)?);
        Ok(Self { name: name.to_owned(), sha256: Some(sha256), provenance })
    }
}

/// A table of the inputs, and the configuration that each was made with as far as its file says it.
pub fn origins(origins: &[Origin]) -> Vec<Block> {
    let head = ["input", "made by", "SHA-256"].map(str::to_owned).to_vec();
    let made_by = |origin: &Origin| match &origin.provenance {
        Some(provenance) => format!("{} {}", provenance.program, provenance.command),
        None => "–".to_owned(),
    };
    let row = |origin: &Origin| {
        vec![origin.name.clone(), made_by(origin), origin.sha256.clone().unwrap_or("–".to_owned())]
    };
    let mut blocks =
        vec![Block::Heading("Provenance".to_owned()), Block::Table(head, origins.iter().map(row).collect())];
    for origin in origins {
        if let Some(provenance) = &origin.provenance {
            // Through a value, so that the keys are in the order of their names.
            let said = serde_json::to_value(provenance).unwrap_or_default();
            let summary = format!("How {} was made", origin.name);
            blocks.push(Block::Fold(summary, vec![Block::Listing(format!("{said:#}"))]));
        }
    }
    blocks
}
