//! The devices beside a training's first: each computes the gradients of its share of every batch, and all average them.
//!
//! # Method
//! A thread for each peer waits for shares. The first device keeps the weights; each peer copies them, and computes loss and
//! gradients of its share as the first does of its own. Where all have succeeded, all are told to go on, and average the
//! gradients together: an exchange that one of them did not come to would keep the others waiting. Shares are of the same
//! number of samples, so that the mean of their gradients is that of the batch.

use std::any::Any;
use std::panic::{self, AssertUnwindSafe};
#[cfg(test)]
use std::sync::Arc;
use std::sync::mpsc::{self, Receiver, Sender};
use std::sync::{Mutex, PoisonError};
use std::thread;

use burn::tensor::distributed::{ReduceOperation, all_reduce};
use burn::tensor::{Device, Tensor, s};

use super::config::TrainConfig;
use super::data::Patch;
#[cfg(test)]
use super::exchange::Exchange;
use super::worker::Worker;
use crate::core::error::{Error, Result};
use crate::network::{Backend, Backends, Network, Parameters, numbers_of};

/// The devices beside the first.
#[derive(Debug)]
pub(super) struct Peers {
    peers: Mutex<Vec<Peer>>,
    averaging: Averaging,
}

/// A device beside the first, seen from there.
#[derive(Debug)]
struct Peer {
    name: String,
    shares: Sender<Share>,
    /// The loss of a share, once its gradients are computed too.
    losses: Receiver<Result<f64>>,
}

/// What a peer is given to compute.
struct Share {
    /// On the first device.
    weights: Tensor<1>,
    patches: Vec<Patch>,
    /// Says that all devices have their gradients; ends without a word where one has none.
    go: Receiver<()>,
}

/// How a device takes part in averaging gradients.
#[derive(Debug)]
enum Averaging {
    /// By Burn's collective operation on these devices.
    AllReduce(Vec<Device>),
    /// In main memory, at a place of its own.
    #[cfg(test)]
    InMainMemory(Arc<Exchange>, usize),
}

impl Averaging {
    /// That of each device.
    fn among(backends: &Backends) -> Vec<Self> {
        #[cfg(test)]
        if backends.first() == Backend::AsDevice {
            let count = backends.all().len();
            let exchange = Arc::new(Exchange::among(count));
            return (0..count).map(|place| Self::InMainMemory(Arc::clone(&exchange), place)).collect();
        }
        let devices: Vec<Device> = backends.all().iter().map(|backend| backend.device()).collect();
        devices.iter().map(|_| Self::AllReduce(devices.clone())).collect()
    }

    /// The mean of what all devices give, each from a thread of its own.
    fn average(&self, gradients: Tensor<1>) -> Tensor<1> {
        match self {
            Self::AllReduce(devices) => {
                all_reduce(gradients, ReduceOperation::Mean, devices.clone()).resolve()
            }
            #[cfg(test)]
            Self::InMainMemory(exchange, place) => exchange.average(*place, gradients),
        }
    }
}

impl Peers {
    /// Makes the devices after the first ready, and tries their exchange; none where there is one alone.
    ///
    /// # Errors
    /// [`Error::Config`] for a batch that they cannot share evenly; those of [`Worker::new`]; [`Error::Unsupported`] when they
    /// do not exchange anything.
    pub(super) fn beside(
        config: &TrainConfig,
        parameters: &Parameters,
        backends: &Backends,
    ) -> Result<Option<Self>> {
        let count = backends.all().len();
        if count == 1 {
            return Ok(None);
        }
        check_batch(config, count)?;
        let mut averaging = Averaging::among(backends);
        rehearse(&averaging, backends).map_err(|reason| {
            Error::Unsupported(format!(
                "{backends} do not exchange gradients: {reason}; that takes NVIDIA's NCCL (libnccl.so.2) beside CUDA: install \
                 it, or name one device"
            ))
        })?;
        let first = averaging.remove(0);
        let others = backends.all()[1..].iter().zip(averaging);
        let peers = others
            .map(|(&backend, averaging)| {
                Ok(Peer::begin(Worker::new(config, parameters, backend)?, averaging))
            })
            .collect::<Result<_>>()?;
        Ok(Some(Self { peers: Mutex::new(peers), averaging: first }))
    }

    /// The loss of a batch and its gradients, of which the first device computes a share with its network.
    ///
    /// # Errors
    /// Those of every device; [`Error::Device`] when one ended.
    pub(super) fn gradients(
        &self,
        (first, network): (&Worker, &Network),
        weights: &Tensor<1>,
        patches: &[Patch],
    ) -> Result<(f64, Tensor<1>)> {
        let peers = self.peers.lock().unwrap_or_else(PoisonError::into_inner);
        let count = peers.len() + 1;
        let mut shares = patches.chunks_exact(patches.len() / count);
        let own = shares.next().expect("a batch has a share for each device");
        let going: Vec<Sender<()>> =
            peers.iter().zip(shares).map(|(peer, share)| peer.send(weights, share)).collect();
        let computed = first.gradients(network, own).and_then(written);
        // All have answered before any error is returned: no answer is left for the next batch.
        let answers: Vec<Result<f64>> = peers.iter().map(Peer::answer).collect();
        let (own_loss, gradients) = computed?;
        let losses = answers.into_iter().collect::<Result<Vec<_>>>()?;
        going.iter().for_each(|go| _ = go.send(()));
        let loss = (own_loss + losses.iter().sum::<f64>()) / count as f64;
        Ok((loss, self.averaging.average(gradients)))
    }
}

impl Peer {
    /// Begins the thread of a device, which ends when there is nothing more to come.
    fn begin(worker: Worker, averaging: Averaging) -> Self {
        let name = worker.backend.to_string();
        let (shares, incoming) = mpsc::channel::<Share>();
        let (answers, losses) = mpsc::channel();
        thread::spawn(move || {
            for Share { weights, patches, go } in incoming {
                let computed = share_of(&worker, weights, &patches);
                let (answer, gradients) =
                    computed.map_or_else(|e| (Err(e), None), |(loss, g)| (Ok(loss), Some(g)));
                if answers.send(answer).is_err() {
                    return;
                }
                if let (Some(gradients), Ok(())) = (gradients, go.recv()) {
                    averaging.average(gradients);
                }
            }
        });
        Self { name, shares, losses }
    }

    /// Hands a share over; what is returned tells the peer to go on.
    fn send(&self, weights: &Tensor<1>, patches: &[Patch]) -> Sender<()> {
        let (going, go) = mpsc::channel();
        // A thread that has ended is noticed by the answer that it owes.
        _ = self.shares.send(Share { weights: weights.clone(), patches: patches.to_vec(), go });
        going
    }

    fn answer(&self) -> Result<f64> {
        let ended = |_| Error::Device(format!("the computation on {} ended; see above for why", self.name));
        self.losses
            .recv()
            .map_err(ended)?
            .map_err(|error| error.while_doing(format!("computing on {}", self.name)))
    }
}

/// Loss and gradients of a share on a peer's device.
fn share_of(worker: &Worker, weights: Tensor<1>, patches: &[Patch]) -> Result<(f64, Tensor<1>)> {
    let weights = weights.to_device(&worker.backend.device());
    written(worker.gradients(&worker.network_of_flat(&weights), patches)?)
}

/// Waits for gradients, so that what failed on the way to them is known before others wait for them.
fn written((loss, gradients): (f64, Tensor<1>)) -> Result<(f64, Tensor<1>)> {
    numbers_of(gradients.clone().slice(s![0..1]))?;
    Ok((loss, gradients))
}

/// Averages the places of all devices, to learn of what lacks before anything is computed.
fn rehearse(averaging: &[Averaging], backends: &Backends) -> Result<(), String> {
    #[expect(clippy::cast_precision_loss, reason = "a machine has few devices")]
    let average = |(place, (averaging, backend)): (usize, (&Averaging, &Backend))| {
        let given = Tensor::<1>::from_floats([place as f32], &backend.device());
        numbers_of(averaging.average(given)).map_err(|error| error.to_string())
    };
    let tried: Vec<_> = thread::scope(|scope| {
        let devices = averaging.iter().zip(backends.all()).enumerate();
        // A library that is not there is no fault of the program's, and some backends panic over it.
        let average = |device| scope.spawn(move || panic::catch_unwind(AssertUnwindSafe(|| average(device))));
        let averages: Vec<_> = devices.map(average).collect();
        averages.into_iter().map(|average| average.join().and_then(|found| found)).collect()
    });
    #[expect(clippy::cast_precision_loss, reason = "a machine has few devices")]
    let expected = (averaging.len() - 1) as f32 / 2.0;
    for found in tried {
        let found = found.unwrap_or_else(|panicked| Err(told_by(&*panicked)))?;
        if found.len() != 1 || (found[0] - expected).abs() > 1e-3 {
            return Err(format!("the mean of their places is {expected}, and they make {found:?} of it"));
        }
    }
    Ok(())
}

/// What a panic said.
fn told_by(panicked: &(dyn Any + Send)) -> String {
    let text = panicked.downcast_ref::<&str>().map(|text| (*text).to_owned());
    let text = text.or_else(|| panicked.downcast_ref::<String>().cloned());
    text.unwrap_or_else(|| "a library failed".to_owned())
}

/// Refuses a batch that so many devices cannot share evenly.
fn check_batch(config: &TrainConfig, count: usize) -> Result<()> {
    let batch = config.data.batch;
    if batch.is_multiple_of(count) {
        return Ok(());
    }
    let step = batch * config.data.accumulate;
    let same_step = if step.is_multiple_of(count) {
        format!(
            ", such as --set data.batch={count} --set data.accumulate={}, of which a step is the same",
            step / count
        )
    } else {
        String::new()
    };
    let reason = format!(
        "is {batch}, which {count} devices cannot share evenly; take a multiple of {count}{same_step}"
    );
    Err(Error::config("data.batch", reason))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_batch_that_devices_cannot_share_is_refused_with_one_that_they_can() {
        let config = TrainConfig::default();
        check_batch(&config, 1).unwrap();
        let message = check_batch(&config, 4).unwrap_err().to_string();
        assert!(message.contains("data.batch=4 --set data.accumulate=4"), "{message}");
        let message = check_batch(&config, 3).unwrap_err().to_string();
        assert!(message.contains("a multiple of 3") && !message.contains("accumulate"), "{message}");
    }

    #[test]
    fn devices_that_exchange_are_rehearsed_with_and_others_are_told_of() {
        let backends = Backends::as_devices(3);
        assert_eq!(rehearse(&Averaging::among(&backends), &backends), Ok(()));
        let devices: Vec<Device> = backends.all().iter().map(|backend| backend.device()).collect();
        let collective: Vec<_> = devices.iter().map(|_| Averaging::AllReduce(devices.clone())).collect();
        let message = rehearse(&collective, &backends).unwrap_err();
        assert!(message.contains("not supported"), "Burn has no collective operation on the CPU: {message}");
    }
}
