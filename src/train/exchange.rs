//! Averages gradients in main memory, for tests of what devices do together.

use std::sync::{Barrier, Mutex};

use burn::tensor::{Tensor, TensorData};

use crate::network::numbers_of;

/// Where devices leave their gradients for each other.
#[derive(Debug)]
pub(super) struct Exchange {
    given: Mutex<Vec<Vec<f32>>>,
    barrier: Barrier,
}

impl Exchange {
    pub(super) fn among(count: usize) -> Self {
        Self { given: Mutex::new(vec![Vec::new(); count]), barrier: Barrier::new(count) }
    }

    /// The mean of what all give, in the order of their places.
    pub(super) fn average(&self, place: usize, gradients: Tensor<1>) -> Tensor<1> {
        let device = gradients.device();
        self.given.lock().unwrap()[place] = numbers_of(gradients).unwrap();
        self.barrier.wait();
        let mean = {
            let given = self.given.lock().unwrap();
            let mean = |at: usize| given.iter().map(|values| values[at]).sum::<f32>() / given.len() as f32;
            (0..given[0].len()).map(mean).collect::<Vec<f32>>()
        };
        // Nobody gives anew before all have read.
        self.barrier.wait();
        let count = mean.len();
        Tensor::from_data(TensorData::new(mean, [count]), &device)
    }
}
