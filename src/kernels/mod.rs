//! The network's inner loops: slices in, slices out; the only module with unsafe code.
