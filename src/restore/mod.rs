//! From a degraded image to a restored one.
