//! How many rounds and steps captures are given, by the samples of their transforms and by what is left unexplained.

/// Samples of transforms that the light of lamps is looked for with, and the steps that are taken at least and at most.
const LAMP_WORK: usize = 80_000_000;
const LAMP_STEPS: [usize; 2] = [20, 200];

/// The same where that light is known from half the resolution: the samples of a transform up to which the most steps are taken. The
/// more samples there are, the more has been told before. Four rounds of four steps restore photographs of 800 × 800 pixels 0.1 dB
/// better than four of 13 without what half the resolution tells, and 0.2 dB better than three of four.
const KNOWN_LAMP_SAMPLES: usize = 500_000;
const KNOWN_LAMP_STEPS: [usize; 2] = [9, 160];

/// Samples of a transform above which rounds of one step are all that is taken.
const FEW_STEPS_SAMPLES: usize = 2_000_000;

/// Rounds and steps from an inverse, whose edges are known. Five photographs of 8 megapixels are restored 0.2 dB better so than by three
/// rounds of three steps from the blurred scene, six of 2.5 megapixels as well; below, many steps find more: sixteen of 800 × 800 pixels
/// would lose 0.1 dB.
pub(super) const SHARP_EFFORT: [usize; 2] = [3, 1];

/// The same at reduced resolutions: what edges tell is more than what further steps do. Three rounds of
/// three steps restore those photographs the same, three of one 0.1 dB worse.
const LARGE_REDUCED_EFFORT: [usize; 2] = [4, 1];

/// At reduced resolutions: rounds at most, steps in all at least and at most, and the samples that all steps may transform beyond
/// the least. Four rounds of 15 steps have 1.6 dB less than six of ten.
const REDUCED_ROUNDS: usize = 6;
const REDUCED_STEPS: [usize; 2] = [12, 60];
const REDUCED_WORK: usize = 11_000_000;

/// Samples of a transform above which so few are taken at reduced resolutions: twelve photographs of 3.2 megapixels are restored 0.05 dB
/// better than by four rounds of three steps.
const LARGE_REDUCED_SAMPLES: usize = 600_000;

/// Steps that a round takes at least.
const LEAST_STEPS: usize = 3;

/// Samples of a transform up to which captures without noise and lamps, with light from outside, begin from what
/// [`constrained`](super::super::constrained) makes of them: how much of the light it takes to come from outside is then kept, and none
/// of 60 is restored worse than by it. Its many steps take three times as long as all of the restoration of 800 × 800 pixels,
/// where twelve captures from the blurred scene have 43.9 dB, and 42.1 by it alone.
const EXPLAINED_SAMPLES: usize = 600_000;

/// Rounds and steps for such captures, up to so many samples and above.
const CLEAN_EFFORTS: [[usize; 2]; 2] = [[2, 2], [1, 3]];

/// Steps of further rounds of photographs without lamps, rounds at most, and the samples that they may transform.
///
/// What is bright and does not saturate is told apart from its flare slowly: rounds follow while what the scene leaves of its capture
/// is more than noise, and less than so much of what it left a round before. Of 350 captures by another simulator 41 change by more than
/// 0.1 dB, from 20.8 to 23.0 dB: neon, bright text on dark ground, halls. Of 192 usual ones nine do: three by up to 0.2 dB, and six
/// with large light around the frame, of which SSIM rises by up to 0.1; PSNR falls by 0.1 to 0.6 dB in five and rises by 4 dB in one.
const FURTHER_STEPS: usize = 24;
const FURTHER_ROUNDS: usize = 8;
const FURTHER_WORK: usize = 80_000_000;
const LEAST_MISFIT: f64 = 1.0;
const MISFIT_LEFT: f64 = 0.95;

/// Whether a capture without noise is explained by many steps first.
pub(super) fn is_explained_first(samples: usize) -> bool {
    samples <= EXPLAINED_SAMPLES
}

/// Rounds and steps for a capture without noise and lamps, with light from outside.
pub(super) fn clean_effort(samples: usize) -> [usize; 2] {
    let [careful, swift] = CLEAN_EFFORTS;
    if is_explained_first(samples) { careful } else { swift }
}

/// Rounds at most for a photograph without lamps that has got its own, by the samples of its transforms.
pub(super) fn further_rounds(samples: usize) -> usize {
    (FURTHER_WORK / FURTHER_STEPS / samples.max(1)).clamp(1, FURTHER_ROUNDS)
}

/// Rounds and steps of each of those, by what was left of the capture when the last round began, over what noise leaves, and the one before.
pub(super) fn further_effort([last, before]: [f64; 2]) -> [usize; 2] {
    if last > LEAST_MISFIT && last < MISFIT_LEFT * before { [1, FURTHER_STEPS] } else { [0, 0] }
}

/// Whether a capture is so large that it is given rounds of one step, from a first scene that is sharp.
pub(super) fn takes_few_steps(samples: usize) -> bool {
    samples > FEW_STEPS_SAMPLES
}

/// Rounds and steps for a photograph with lamps, by the samples of its transforms: so many that they take seconds.
pub(super) fn lamp_effort(samples: usize) -> [usize; 2] {
    let [least, most] = LAMP_STEPS;
    of_rounds((LAMP_WORK / samples.max(1)).clamp(least, most))
}

/// The same where the light of the lamps is known from half the resolution.
pub(super) fn known_lamp_effort(samples: usize) -> [usize; 2] {
    let ([least, most], samples) = (KNOWN_LAMP_STEPS, samples.max(1));
    of_rounds((most * KNOWN_LAMP_SAMPLES / samples * KNOWN_LAMP_SAMPLES / samples).clamp(least, most))
}

fn of_rounds(steps: usize) -> [usize; 2] {
    let rounds = (steps / 20).clamp(4, 10).min(steps / LEAST_STEPS);
    [rounds, steps / rounds]
}

/// Rounds and steps for a photograph with lamps at a reduced resolution.
pub(super) fn reduced_effort(samples: usize) -> [usize; 2] {
    if samples > LARGE_REDUCED_SAMPLES {
        return LARGE_REDUCED_EFFORT;
    }
    let [least, most] = REDUCED_STEPS;
    let steps = (REDUCED_WORK / samples.max(1)).clamp(least, most);
    let rounds = REDUCED_ROUNDS.min(steps / LEAST_STEPS);
    [rounds, steps / rounds]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lamps_get_as_many_steps_as_time_allows() {
        assert_eq!(lamp_effort(100 * 100), [10, 20]);
        assert_eq!(lamp_effort(800 * 800), [6, 20]);
        assert_eq!(lamp_effort(1200 * 1200), [4, 13]);
        assert_eq!(lamp_effort(4096 * 3328), [4, 5]);
        assert_eq!(known_lamp_effort(640 * 640), [8, 20]);
        assert_eq!(known_lamp_effort(1024 * 1024), [4, 9]);
        assert_eq!(known_lamp_effort(1200 * 1200), [4, 4]);
        assert_eq!(known_lamp_effort(4096 * 3328), [3, 3]);
        assert_eq!(reduced_effort(400 * 400), [6, 10]);
        assert_eq!(reduced_effort(600 * 600), [6, 5]);
        assert_eq!(reduced_effort(900 * 900), [4, 1]);
        assert_eq!(reduced_effort(2048 * 1664), [4, 1]);
    }

    #[test]
    fn photographs_without_lamps_go_on_while_that_explains_more() {
        assert_eq!(further_effort([f64::INFINITY; 2]), [0, 0]);
        assert_eq!(further_effort([3.0, 9.0]), [1, FURTHER_STEPS]);
        assert_eq!(further_effort([3.0, 3.1]), [0, 0]);
        assert_eq!(further_effort([0.9, 9.0]), [0, 0]);
        assert_eq!([400 * 400, 1024 * 1024, 2_000_000].map(further_rounds), [8, 3, 1]);
    }
}
