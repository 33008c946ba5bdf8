//! From one PSF to a rotated set, its PCA basis and its kernel codes.
