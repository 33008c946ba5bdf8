//! Describes a dataset folder: what was made of which scene by which kernel.
