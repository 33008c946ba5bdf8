//! The whole pipeline on scenes made here.
