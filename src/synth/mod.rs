//! From clean scenes and kernels to degraded ones: the image formation model, Eq. 1.
