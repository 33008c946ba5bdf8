//! Convolutions as they are written down: 3 × 3 of any stride, 1 × 1, any number of channels.
//!
//! # Method
//! In NHWC the three (or one) pixels that an output sees in one input row are one run of `3 · inputs` floats.
//! A register tile takes several neighbouring outputs of a row; each of its rows walks such a run, `stride`
//! pixels from its neighbour's, against weights packed `[panel][row][column · input][output of the panel]`.
//! [`forward`] does that, [`few_outputs`] with vectors of inputs where outputs would not fill one; [`weight_gradient`] multiplies the same runs with the outputs' gradients;
//! [`input_gradient`] is the transposed convolution of stride 2, sorted by the parity of rows and columns.
//!
//! # Borders
//! Rows outside of the image are left out of the sum. Register tiles that reach over the left or right end
//! take their runs from a small copy with zeros around it.
//!
//! # Error
//! Sums of `9 · inputs` products in order: about 1e-6 of the largest output at 32 inputs.

pub(crate) mod few_outputs;
pub(crate) mod forward;
pub(crate) mod input_gradient;
pub(crate) mod weight_gradient;
