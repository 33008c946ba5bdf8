//! From a bracket of exposures or a display layout to a point spread function.
