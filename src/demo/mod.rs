//! The scenes and the settings of `udc demo`: the whole pipeline on input made here.

pub mod scenes;
