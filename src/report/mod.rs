//! Turns results into one self-contained page: text, tables, pictures and charts in a single HTML file that
//! loads nothing from anywhere.

pub mod chart;
pub mod distribution;
mod gather;
pub mod heat_map;
pub mod page;
pub mod picture;
mod plots;
pub mod sections;

pub use gather::{gather, is_bank};
pub use plots::{mismatch_plots, plots};
