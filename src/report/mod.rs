//! Turns results into one self-contained page: text, tables, pictures and charts in a single HTML file that
//! loads nothing from anywhere, with a viewer for pictures.

pub mod chart;
mod compressed;
pub mod distribution;
mod gather;
pub mod heat_map;
mod kept;
mod origins;
pub mod page;
pub mod picture;
mod plots;
pub mod psf_section;
pub mod scatter;
pub mod sections;
mod view;
pub mod viewer;

pub use gather::{Section, folder_of_results, gather, is_bank, told_apart};
pub use kept::KeptScenes;
pub use origins::{Origin, origins};
pub use plots::{mismatch_plots, plots};
pub use view::{OpenedImage, is_psf, view};

use crate::core::error::Result;
use page::{Block, Page};

/// The most that a page of results takes, in bytes: what is sent by mail and opened by phones.
pub const PAGE_BYTES: usize = 25_000_000;

/// What is left of a page's room for the text of its viewers' data.
const SPARE: usize = 400_000;

/// Puts sections together to a page of at most [`PAGE_BYTES`] bytes, as far as that is a matter of the pictures that
/// evaluations kept; `before` and `after` them come blocks of the whole page.
///
/// # Errors
/// Those of [`Section::into_blocks`].
pub fn assemble(
    title: String,
    before: Vec<Block>,
    sections: Vec<Section>,
    after: Vec<Block>,
) -> Result<Page> {
    let of_sections = sections.iter().flat_map(|section| section.blocks.clone());
    let fixed = before.iter().cloned().chain(of_sections).chain(after.iter().cloned()).collect();
    let taken = Page { title: title.clone(), blocks: fixed }.to_html().len();
    let with_pictures = sections.iter().filter(|section| section.pictures.is_some()).count();
    let room = PAGE_BYTES.saturating_sub(taken + SPARE) / with_pictures.max(1);
    let mut page = Page { title, blocks: before };
    for section in sections {
        page.blocks.extend(section.into_blocks(room)?);
    }
    page.blocks.extend(after);
    Ok(page)
}
