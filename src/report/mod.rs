//! Turns results into one self-contained page: text, tables, pictures and charts in a single HTML file that
//! loads nothing from anywhere.

pub mod chart;
pub mod distribution;
pub mod heat_map;
pub mod page;
pub mod picture;
pub mod sections;
