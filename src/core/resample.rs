//! Samples images between their pixels.
