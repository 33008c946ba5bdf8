//! Sums and largest values of many numbers on a device, over short axes only.
//!
//! Mesa's software device, which takes a GPU's place in tests, ends every loop after 65 535 rounds: of one axis of 600 000 gradients
//! it leaves more than half out.

use burn::tensor::Tensor;

/// The longest axis that is reduced at once.
const LONGEST: usize = 1024;

/// The sum, `[1]`.
pub(crate) fn sum_of_all(numbers: Tensor<1>) -> Tensor<1> {
    reduce(numbers, |rows| rows.sum_dim(1))
}

/// The largest number, `[1]`, of numbers that are not negative.
pub(crate) fn largest_of_all(numbers: Tensor<1>) -> Tensor<1> {
    reduce(numbers, |rows| rows.max_dim(1))
}

/// Reduces rows, again and again; the last row is filled with zeros.
fn reduce(mut numbers: Tensor<1>, of_rows: impl Fn(Tensor<2>) -> Tensor<2>) -> Tensor<1> {
    loop {
        let [count] = numbers.dims();
        let width = count.clamp(1, LONGEST);
        let rows = count.div_ceil(width).max(1);
        let missing = rows * width - count;
        if missing > 0 {
            let zeros = Tensor::zeros([missing], &numbers.device());
            numbers = Tensor::cat(vec![numbers, zeros], 0);
        }
        numbers = of_rows(numbers.reshape([rows, width])).reshape([rows]);
        if rows == 1 {
            return numbers;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use burn::tensor::{Device, TensorData};

    #[test]
    fn sums_and_largest_values_are_of_all_numbers() {
        for count in [0, 1, 2, 1023, 1024, 1025, 5189, 1024 * 1024 + 1] {
            let values: Vec<f32> = (0..count).map(|i| (i % 7) as f32).collect();
            let (sum, largest) = (values.iter().sum::<f32>(), values.iter().copied().fold(0.0, f32::max));
            let tensor = Tensor::<1>::from_data(TensorData::new(values, [count]), &Device::flex());
            let number = |of: Tensor<1>| of.try_into_vec_as::<f32>().expect("one number");
            assert_eq!(number(sum_of_all(tensor.clone())), [sum], "{count}");
            assert_eq!(number(largest_of_all(tensor)), [largest], "{count}");
        }
    }
}
