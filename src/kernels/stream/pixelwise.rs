//! Steps that look at one pixel at a time: a row of each input to a row of output.

/// What becomes of a pixel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Pixelwise {
    /// The channels of the first input, then those of the second.
    Concatenate,
    /// The sum of two inputs.
    Add,
    /// `leak(x · sigmoid(scale) + offset)` of three inputs.
    Modulate { slope: f32 },
}

impl Pixelwise {
    /// Computes an output row of rows of the inputs, which have so many channels each.
    pub(super) fn apply(self, inputs: &[&[f32]], channels: &[usize], output: &mut [f32]) {
        match (self, inputs) {
            (Self::Concatenate, [first, second]) => {
                let pixels = first.chunks_exact(channels[0]).zip(second.chunks_exact(channels[1]));
                for (to, (first, second)) in output.chunks_exact_mut(channels[0] + channels[1]).zip(pixels) {
                    to[..channels[0]].copy_from_slice(first);
                    to[channels[0]..].copy_from_slice(second);
                }
            }
            (Self::Add, [first, second]) => {
                for ((to, first), second) in output.iter_mut().zip(*first).zip(*second) {
                    *to = first + second;
                }
            }
            (Self::Modulate { slope }, [x, scale, offset]) => {
                for (i, to) in output.iter_mut().enumerate() {
                    let v = x[i] / (1.0 + (-scale[i]).exp()) + offset[i];
                    *to = if v > 0.0 { v } else { slope * v };
                }
            }
            (function, inputs) => unreachable!("{function:?} of {} inputs", inputs.len()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pixels_are_joined_added_and_modulated() {
        let (a, b) = ([1.0, 2.0, 3.0, 4.0], [5.0, 6.0]);
        let mut joined = [0.0; 6];
        Pixelwise::Concatenate.apply(&[&a, &b], &[2, 1], &mut joined);
        assert_eq!(joined, [1.0, 2.0, 5.0, 3.0, 4.0, 6.0]);
        let mut sums = [0.0; 2];
        Pixelwise::Add.apply(&[&a[..2], &b], &[2, 2], &mut sums);
        assert_eq!(sums, [6.0, 8.0]);
        // sigmoid(0) = 1/2, and sigmoid(ln 3) = 3/4.
        let (scale, offset) = ([0.0, 3.0_f32.ln()], [1.0, -8.0]);
        let mut modulated = [0.0; 2];
        Pixelwise::Modulate { slope: 0.5 }.apply(&[&a[..2], &scale, &offset], &[2, 2, 2], &mut modulated);
        assert!((modulated[0] - 1.5).abs() < 1e-6 && (modulated[1] + 3.25).abs() < 1e-6, "{modulated:?}");
    }
}
