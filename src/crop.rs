//! From equirectangular panoramas to perspective views.
