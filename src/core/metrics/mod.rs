//! Measures how far two images are apart.
