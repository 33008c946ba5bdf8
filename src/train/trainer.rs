//! The training itself, without files: weights, optimiser and position, advanced one step at a time.

use std::borrow::Cow;
use std::panic;
use std::sync::Arc;
use std::thread;
use std::time::{Duration, Instant};

use burn::module::{Module, ModuleVisitor, Param};
use burn::tensor::{Gradients as BurnGradients, Tensor};
use rayon::prelude::*;
use serde::Serialize;

use super::config::TrainConfig;
use super::data::{Patch, TrainingData};
use super::on_device::{OnDevice, Told};
use super::optimizer::{Gradients, Moments, average, clip, global_norm};
use super::peers::Peers;
use super::sampler::Sampler;
use super::schedule::learning_rate;
use super::worker::Worker;
use crate::core::error::{Error, Result};
use crate::core::rng::Rng;
use crate::network::{Backends, Network, Parameters};

/// What one step did.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Step {
    /// Number of steps done, this one included.
    pub iteration: u64,
    /// The loss before the step.
    pub loss: f64,
    /// The learning rate that it was made with.
    pub learning_rate: f64,
    /// Norm of the gradients before any clipping.
    pub gradient_norm: f64,
}

/// A training between two steps.
#[derive(Clone, Debug)]
pub struct Trainer {
    config: TrainConfig,
    sampler: Sampler,
    /// What computes, on the first device.
    worker: Worker,
    /// The devices beside it.
    peers: Option<Arc<Peers>>,
    /// The samples that the last step learned from last.
    recent: Vec<Patch>,
    /// The batch of a number that was drawn while the one before was computed.
    ahead: Option<(u64, Vec<Patch>)>,
    /// What was on the host last: all of it where there is nothing on a device.
    state: State,
    /// What steps change, where they are computed on another device than the CPU.
    on_device: Option<OnDevice>,
    /// How long the last step waited for samples.
    waited: Duration,
}

/// Everything that a step changes.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct State {
    /// Number of steps done.
    pub(super) iteration: u64,
    /// The weights.
    pub(super) parameters: Parameters,
    /// The optimiser's memory.
    pub(super) moments: Moments,
    /// The running mean of the weights, when it is asked for.
    pub(super) average: Option<Parameters>,
}

impl Trainer {
    /// Starts a training over `items` items from the given weights, or from random ones.
    ///
    /// # Errors
    /// [`Error::Config`] when the configuration is out of range; [`Error::Unsupported`] without items; those of
    /// reading the weights that the loss needs.
    pub fn new(
        config: &TrainConfig,
        initial: Option<Parameters>,
        items: usize,
        backends: impl Into<Backends>,
    ) -> Result<Self> {
        let parameters = initial
            .unwrap_or_else(|| Parameters::random(&config.architecture, config.initialisation, config.seed));
        let moments = Moments::zeros(&parameters);
        let average = (config.optimizer.ema_decay > 0.0).then(|| parameters.clone());
        Self::from_state(
            config,
            State { iteration: 0, parameters, moments, average },
            items,
            &backends.into(),
        )
    }

    /// Goes on from a state.
    pub(super) fn from_state(
        config: &TrainConfig,
        state: State,
        items: usize,
        backends: &Backends,
    ) -> Result<Self> {
        config.validate()?;
        if items == 0 {
            return Err(Error::Unsupported(
                "there is nothing to train on: the data have no items".to_owned(),
            ));
        }
        let sampler = Sampler::new(config.seed, items, config.data.shuffle);
        let backend = backends.first();
        let worker = Worker::new(config, &state.parameters, backend)?;
        let peers = Peers::beside(config, &state.parameters, backends)?.map(Arc::new);
        let on_device = (!backend.is_cpu()).then(|| OnDevice::upload(&state, &backend.device()));
        Ok(Self {
            config: config.clone(),
            sampler,
            worker,
            peers,
            recent: Vec::new(),
            ahead: None,
            waited: Duration::ZERO,
            state,
            on_device,
        })
    }

    /// Number of steps done.
    pub fn iteration(&self) -> u64 {
        self.state.iteration
    }

    /// How long the last step waited for samples, which are drawn while others are computed with.
    pub fn waited(&self) -> Duration {
        self.waited
    }

    /// The weights to use: their running mean when it is asked for.
    pub fn weights(&self) -> Cow<'_, Parameters> {
        let on_host = self.state.average.as_ref().unwrap_or(&self.state.parameters);
        let Some(on_device) = &self.on_device else { return Cow::Borrowed(on_host) };
        let mut weights = on_host.clone();
        on_device.download_weights(&mut weights);
        Cow::Owned(weights)
    }

    /// Everything that a step changes.
    pub(super) fn state(&self) -> Cow<'_, State> {
        let Some(on_device) = &self.on_device else { return Cow::Borrowed(&self.state) };
        let mut state = self.state.clone();
        on_device.download(&mut state);
        Cow::Owned(state)
    }

    /// Draws samples, computes gradients and changes the weights; draws the next samples while it computes, so that
    /// every step is to be given the same data.
    ///
    /// # Errors
    /// Those of the data; [`Error::Diverged`] when loss, gradients or what would become of weights and moments are
    /// not finite, or a weight would be larger than any that computes something; [`Error::Unsupported`] when a weight
    /// has no gradient. All leave weights and moments as they were.
    pub fn step(&mut self, data: &dyn TrainingData) -> Result<Step> {
        let Some(on_device) = self.on_device.take() else {
            // On a thread of the pool, which begins each operation at once instead of waking another.
            return rayon::scope(|_| self.step_here(data));
        };
        let stepped = self.step_there(&on_device, data);
        let (outcome, next) = stepped.map_or_else(|e| (Err(e), on_device), |(step, next)| (Ok(step), next));
        self.on_device = Some(next);
        outcome
    }

    fn step_here(&mut self, data: &dyn TrainingData) -> Result<Step> {
        let config = self.config.clone();
        let rate = learning_rate(&config.optimizer, &config.schedule, self.state.iteration);
        let network = self.worker.network(&self.state.parameters);
        let mut gradients = Gradients::new();
        let count = config.data.accumulate;
        let total = self.batches(
            data,
            |trainer, patches| trainer.differentiate(&network, patches),
            |part| accumulate(&mut gradients, part, count),
        )?;
        let iteration = self.state.iteration + 1;
        let gradient_norm = global_norm(&gradients);
        if !(total.is_finite() && gradient_norm.is_finite()) {
            return Err(diverged(iteration, "at", total));
        }
        if config.optimizer.clip_norm > 0.0 {
            clip(&mut gradients, gradient_norm, config.optimizer.clip_norm);
        }
        // On a copy: a state that has overflowed is never kept, or saved.
        let mut next = self.state.clone();
        next.iteration = iteration;
        next.moments.step(&mut next.parameters, &gradients, &config.optimizer, (iteration, rate));
        if let Some(mean) = &mut next.average {
            average(mean, &next.parameters, config.optimizer.ema_decay);
        }
        if let Some((what, name)) = next.first_overflow() {
            return Err(overflowed(iteration, what, name, gradient_norm));
        }
        self.state = next;
        Ok(Step { iteration, loss: total, learning_rate: rate, gradient_norm })
    }

    /// The same where weights and moments are on a device; returns what the step makes of them.
    fn step_there(&mut self, on_device: &OnDevice, data: &dyn TrainingData) -> Result<(Step, OnDevice)> {
        let config = self.config.clone();
        let iteration = self.state.iteration + 1;
        let rate = learning_rate(&config.optimizer, &config.schedule, self.state.iteration);
        let network = self.worker.network_of_flat(on_device.weights());
        let mut gradients: Option<Tensor<1>> = None;
        let share = 1.0 / config.data.accumulate as f64;
        let total = self.batches(
            data,
            |trainer, patches| match &trainer.peers {
                None => trainer.worker.gradients(&network, patches),
                Some(peers) => peers.gradients((&trainer.worker, &network), on_device.weights(), patches),
            },
            |part| {
                let part = part.mul_scalar(share);
                gradients = Some(gradients.take().map_or_else(|| part.clone(), |sum| sum + part.clone()));
            },
        )?;
        let gradients = gradients.expect("a step has batches");
        let (next, told) = on_device.stepped(gradients, &config.optimizer, (iteration, rate))?;
        let Told { gradient_norm, largest_weight } = told;
        if !(total.is_finite() && gradient_norm.is_finite()) {
            return Err(diverged(iteration, "at", total));
        }
        if largest_weight > f64::from(LARGEST_WEIGHT) {
            return Err(overflowed(iteration, "largest value", "all weights", gradient_norm));
        }
        self.state.iteration = iteration;
        Ok((Step { iteration, loss: total, learning_rate: rate, gradient_norm }, next))
    }

    /// Computes loss and gradients of a step's batches, each drawn while the one before was computed; `add` takes the
    /// gradients. Returns the mean loss.
    fn batches<G: Send>(
        &mut self,
        data: &dyn TrainingData,
        compute: impl Fn(&Self, &[Patch]) -> Result<(f64, G)> + Sync,
        mut add: impl FnMut(G),
    ) -> Result<f64> {
        let (count, crop) = (self.config.data.accumulate as u64, self.config.data.crop);
        let mut total = 0.0;
        self.waited = Duration::ZERO;
        for number in self.state.iteration * count..(self.state.iteration + 1) * count {
            let began = Instant::now();
            let patches = self.batch(data, number)?;
            let drawn_at = Instant::now();
            let next = number + 1;
            let is_due = next < self.config.iterations.saturating_mul(count);
            let samples = is_due.then(|| self.samples(next));
            // Another thread draws if one is free; else this one does, once it has computed. What cannot be drawn is
            // drawn again when its turn comes, and reported then.
            let this = &*self;
            let ((computed, computing), drawn) = this
                .beside(|| (compute(this, &patches), drawn_at.elapsed()), || draw(data, samples?, crop).ok());
            self.waited += (drawn_at - began) + drawn_at.elapsed().saturating_sub(computing);
            self.ahead = drawn.map(|patches| (next, patches));
            let (loss, part) = computed?;
            total += loss / count as f64;
            self.recent = patches;
            add(part);
        }
        Ok(total)
    }

    /// Checks that the weights compute something: the loss of the samples that were drawn last, by the weights that the
    /// last step left and by their running mean.
    ///
    /// # Errors
    /// [`Error::Diverged`] when it is not finite.
    pub(super) fn check(&self) -> Result<()> {
        let Some(on_device) = &self.on_device else {
            let kept = [&self.state.parameters].into_iter().chain(&self.state.average);
            return rayon::scope(|_| self.check_networks(kept.map(|kept| self.worker.network(kept))));
        };
        self.check_networks(on_device.kept().map(|kept| self.worker.network_of_flat(kept)))
    }

    fn check_networks(&self, networks: impl Iterator<Item = Network>) -> Result<()> {
        if self.recent.is_empty() {
            return Ok(());
        }
        for network in networks {
            let loss = self.worker.loss(&network, &self.recent)?;
            if !loss.is_finite() {
                return Err(diverged(self.state.iteration, "with the weights after", loss));
            }
        }
        Ok(())
    }

    /// Computes and draws at the same time. What is on a device is computed by this thread always: a device keeps memory for
    /// each thread that it is used by.
    fn beside<A: Send, B: Send>(
        &self,
        compute: impl FnOnce() -> A + Send,
        draw: impl FnOnce() -> B + Send,
    ) -> (A, B) {
        if !self.worker.backend.is_cpu() {
            return thread::scope(|scope| {
                let drawing = scope.spawn(draw);
                let computed = compute();
                (computed, drawing.join().unwrap_or_else(|panicked| panic::resume_unwind(panicked)))
            });
        }
        rayon::join(compute, draw)
    }

    /// The batch of a number, counted from the training's start: the one that was drawn ahead, or drawn now.
    fn batch(&mut self, data: &dyn TrainingData, number: u64) -> Result<Vec<Patch>> {
        match self.ahead.take() {
            Some((ahead, patches)) if ahead == number => Ok(patches),
            _ => draw(data, self.samples(number), self.config.data.crop),
        }
    }

    /// The items that a batch is drawn from, and the random stream of each.
    fn samples(&mut self, number: u64) -> Vec<(usize, Rng)> {
        let batch = self.config.data.batch as u64;
        (number * batch..(number + 1) * batch)
            .map(|position| (self.sampler.item(position), self.sampler.stream(position)))
            .collect()
    }

    /// The loss of a batch and its gradients.
    fn differentiate(&self, network: &Network, patches: &[Patch]) -> Result<(f64, Gradients)> {
        let (value, gradients) = self.worker.backward(network, patches)?;
        let mut collect = Collect { gradients, found: vec![None; self.state.parameters.len()] };
        network.visit(&mut collect);
        Ok((value, self.worker.complete(collect.found)?))
    }
}

/// Cuts a square of `side` pixels out of each item.
fn draw(data: &dyn TrainingData, samples: Vec<(usize, Rng)>, side: usize) -> Result<Vec<Patch>> {
    samples.into_par_iter().map(|(item, mut rng)| data.patch(item, side, &mut rng)).collect()
}

impl State {
    /// The first array that holds a number that is not finite, or a weight beyond [`LARGEST_WEIGHT`]: what it is, and of
    /// which weights.
    fn first_overflow(&self) -> Option<(&'static str, &str)> {
        let Moments { first, second } = &self.moments;
        let arrays =
            self.parameters.iter().zip(first).zip(second).flat_map(|((parameter, first), second)| {
                let name = parameter.name.as_str();
                let values: [(_, &[f32], f32); 3] = [
                    ("mean squared gradient", second, f32::MAX),
                    ("mean gradient", first, f32::MAX),
                    ("value", &parameter.values, LARGEST_WEIGHT),
                ];
                values.map(|(what, values, limit)| (what, name, values, limit))
            });
        let averages = self.average.iter().flat_map(|average| average.iter());
        let averages =
            averages.map(|mean| ("running mean", mean.name.as_str(), &mean.values[..], LARGEST_WEIGHT));
        // No number that is not one is at most anything.
        let fits = |values: &[f32], limit: f32| values.par_iter().all(|value| value.abs() <= limit);
        let mut arrays = arrays.chain(averages);
        arrays.find(|(.., values, limit)| !fits(values, *limit)).map(|(what, name, ..)| (what, name))
    }
}

/// Weights lie around 1 or below; what computes with one of this size is no restoration.
const LARGEST_WEIGHT: f32 = 1e6;

fn overflowed(iteration: u64, what: &str, name: &str, gradient_norm: f64) -> Error {
    Error::Diverged(format!(
        "the training overflowed: the {what} of {name} is no longer finite, or beyond {LARGEST_WEIGHT:e}, at iteration \
         {iteration}, with gradients of norm {gradient_norm:.3e}; {ADVICE}"
    ))
}

/// What to do when a training cannot go on.
pub(super) const ADVICE: &str = "take a smaller optimizer.learning-rate, or set optimizer.clip-norm";

fn diverged(iteration: u64, when: &str, loss: f64) -> Error {
    Error::Diverged(format!("the training diverged: loss {loss} {when} iteration {iteration}; {ADVICE}"))
}

/// Adds the `count`-th part of gradients to those of earlier batches.
fn accumulate(sum: &mut Gradients, part: Gradients, count: usize) {
    if count == 1 {
        *sum = part;
        return;
    }
    #[expect(clippy::cast_precision_loss, reason = "a number of batches is far below 2²⁴")]
    let share = 1.0 / count as f32;
    if sum.is_empty() {
        *sum = part.iter().map(|values| vec![0.0; values.len()]).collect();
    }
    for (sum, part) in sum.iter_mut().zip(&part) {
        sum.par_iter_mut().zip(part).for_each(|(sum, g)| *sum += share * g);
    }
}

/// Copies every weight's gradient to its place in the architecture's order.
struct Collect {
    gradients: BurnGradients,
    found: Vec<Option<Vec<f32>>>,
}

impl ModuleVisitor for Collect {
    fn visit_float<const D: usize>(&mut self, param: &Param<Tensor<D>>) {
        let index = usize::try_from(param.id.val()).expect("ids are small indices");
        self.found[index] = param
            .val()
            .grad_remove(&mut self.gradients)
            .map(|gradient| gradient.try_into_vec_as::<f32>().expect("gradients are 32-bit floats"));
    }
}

#[cfg(test)]
mod tests;
