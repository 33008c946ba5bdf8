//! Prints how often `udc restore --angle auto` finds the panel's angle: `cargo bench --bench angle -- DATASET [STEP]`.
//!
//! DATASET is a folder of triplets, as `udc synth` makes them; every STEPth of them is searched (all by default). Without
//! one, nothing is measured. Printed are how often the kernel found is the true one, how often the true one or its
//! neighbour (in nine of ten cases it has to be), what a search costs, and every miss.
#![expect(clippy::print_stdout, reason = "a benchmark prints its result")]

use std::path::Path;
use std::time::Instant;

use udc::core::progress::Progress;
use udc::dataset::Dataset;
use udc::restore::{WEAK_LEAD, search_angle};

/// The share of kernels found, or neighbours of them, that is asked for.
const GOAL: f64 = 0.9;

fn main() {
    let mut arguments = std::env::args().skip(1).filter(|argument| !argument.starts_with("--"));
    let Some(folder) = arguments.next() else {
        println!("no dataset given: cargo bench --bench angle -- DATASET [STEP]");
        return;
    };
    let step = arguments.next().map_or(1, |text| text.parse().expect("STEP is a number"));
    let dataset = Dataset::open(Path::new(&folder)).expect("a dataset");
    let bank = dataset.bank.as_ref().expect("a dataset with a bank");
    let curve = dataset.formation.curve().expect("a tone curve");
    let (mut count, mut exact, mut near, mut weak, mut seconds) = (0.0, 0.0, 0.0, 0.0, 0.0);
    for triplet in dataset.triplets.iter().step_by(step) {
        let truth = dataset.kernel_index(triplet).expect("a kernel of the bank");
        let capture = curve.tone_map(&dataset.read_degraded(triplet).expect("a degraded image"));
        let started = Instant::now();
        let found = search_angle(&capture, bank, [curve; 3], &Progress::default()).expect("an angle");
        seconds += started.elapsed().as_secs_f64();
        count += 1.0;
        let apart = found.best.abs_diff(truth);
        exact += f64::from(u8::from(apart == 0));
        near += f64::from(u8::from(apart <= 1));
        weak += f64::from(u8::from(found.lead < WEAK_LEAD));
        if apart > 1 {
            println!(
                "{} behind {}: {:.1}°, lead {:.1}",
                triplet.id, triplet.kernel, found.angle_deg, found.lead
            );
        }
    }
    println!(
        "{count} captures: {:.1} % exact, {:.1} % exact or neighbour, {:.1} % with weak evidence, {:.0} ms each",
        100.0 * exact / count,
        100.0 * near / count,
        100.0 * weak / count,
        1e3 * seconds / count
    );
    assert!(near / count >= GOAL, "fewer than {GOAL} are near the truth");
}
