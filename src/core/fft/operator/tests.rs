use super::super::{Convolver, Damping, copy_row};
use super::*;

const PLANE: [usize; 2] = [19, 23];
/// The second is transformed line beside line with darkness around it, the third anyway.
const PLANES: [[usize; 2]; 3] = [PLANE, [62, 70], [64, 80]];
const KERNEL: [usize; 2] = [7, 40];
const BOTH: [TransformPrecision; 2] = [TransformPrecision::Single, TransformPrecision::Double];

fn plane([height, width]: [usize; 2], seed: usize) -> Array2<f32> {
    Array2::from_shape_fn((height, width), |(y, x)| ((y * 31 + x * 17 + seed) % 23) as f32 / 23.0)
}

fn kernel() -> Array2<f32> {
    let k = plane(KERNEL, 5);
    let sum = k.sum();
    k / sum
}

fn rows(x: &Array2<f32>) -> (usize, impl Fn(usize, &mut [f32]) + Sync) {
    (x.nrows(), |y, out: &mut [f32]| {
        out[..x.ncols()].iter_mut().zip(x.row(y)).for_each(|(out, x)| *out = *x);
    })
}

fn assert_near(a: &Array2<f32>, b: &Array2<f32>) {
    // Sums of 280 products of numbers below 1 with a kernel of unit sum: 1e-5 is far above their rounding.
    assert!(a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-5), "{a} is not {b}");
}

#[test]
fn convolves_and_correlates_as_the_convolver_does() {
    for (size, boundary) in each_plane() {
        let convolver = Convolver::new(size, KERNEL, boundary).unwrap();
        let otf = convolver.kernel_spectrum(kernel().view()).unwrap();
        // One row is left of the second, as lamps leave a few.
        let mut dark = plane(size, 2);
        dark.indexed_iter_mut().filter(|((y, _), _)| *y != 17).for_each(|(_, light)| *light = 0.0);
        let planes = [plane(size, 1), dark];
        for precision in BOTH {
            let operator = PlaneOperator::new(size, KERNEL, boundary, precision);
            let of_kernel = operator.transfer_function(kernel().view(), |k| k).unwrap();
            let mut found = Array2::zeros(size);
            for x in &planes {
                operator.convolve(&of_kernel, rows(x), (&mut found, copy_row));
                assert_near(&found, &convolver.convolve_plane(x.view(), &otf));
                operator.correlate(&of_kernel, rows(x), (&mut found, copy_row));
                assert_near(&found, &convolver.correlate_plane(x.view(), &otf));
            }
        }
    }
}

fn each_plane() -> impl Iterator<Item = ([usize; 2], Boundary)> {
    PLANES.into_iter().flat_map(|size| [Boundary::Zero, Boundary::Periodic].map(|boundary| (size, boundary)))
}

#[test]
fn lines_are_transformed_side_by_side_where_sides_allow_it() {
    let is_so = |(size, boundary)| {
        let operator = PlaneOperator::new(size, KERNEL, boundary, TransformPrecision::Single);
        matches!(operator.transform, EitherTransform::Lanes(_))
    };
    assert_eq!(each_plane().map(is_so).collect::<Vec<_>>(), [false, false, true, false, true, true]);
}

#[test]
fn a_part_of_a_plane_is_that_of_the_dark_plane_around_it() {
    for (size, boundary) in each_plane() {
        let operator = PlaneOperator::new(size, KERNEL, boundary, TransformPrecision::Single);
        let otf = operator.transfer_function(kernel().view(), |k| k * k).unwrap();
        let part = plane([9, 12], 3);
        let mut whole = Array2::zeros(size);
        whole.slice_mut(ndarray::s![..9, ..12]).assign(&part);
        let (mut of_part, mut of_whole) = (Array2::zeros((4, 20)), Array2::zeros(size));
        operator.convolve(&otf, rows(&part), (&mut of_part, copy_row));
        operator.convolve(&otf, rows(&whole), (&mut of_whole, copy_row));
        assert_near(&of_part, &of_whole.slice(ndarray::s![..4, ..20]).to_owned());
    }
}

/// Both kinds of transforms tell the same of a transfer function.
#[test]
fn means_over_frequencies_do_not_depend_on_how_planes_are_transformed() {
    let operators = BOTH.map(|precision| PlaneOperator::new([64, 80], KERNEL, Boundary::Periodic, precision));
    let otfs =
        operators.each_ref().map(|operator| operator.transfer_function(kernel().view(), |k| k).unwrap());
    let weight = |k: usize| 1.0 + (k % 5) as f64;
    let of = |power: f32, laplacian: f32| power * (1.0 + laplacian);
    let mean = |i: usize| operators[i].mean(&otfs[i], of, [&weight, &weight]);
    assert!((mean(0) / mean(1) - 1.0).abs() < 1e-5, "{} {}", mean(0), mean(1));
    let bands = |i: usize| operators[i].band_means(&otfs[i], |power| power, 8);
    assert_near(&bands(0), &bands(1));
}

#[test]
fn what_rows_are_kept_as_is_added_up() {
    let operator = PlaneOperator::new(PLANE, KERNEL, Boundary::Zero, TransformPrecision::Single);
    let otf = operator.transfer_function(kernel().view(), |k| k).unwrap();
    let x = plane(PLANE, 1);
    let (mut copied, mut doubled) = (Array2::zeros(PLANE), Array2::<f32>::zeros(PLANE));
    assert_eq!(operator.convolve(&otf, rows(&x), (&mut copied, copy_row)), 0.0);
    let keep = |row: usize, samples: &[f32], out: &mut [f32]| {
        out.iter_mut().zip(samples).for_each(|(out, sample)| *out = 2.0 * sample);
        row as f64 * f64::from(samples[3])
    };
    let sum = operator.convolve(&otf, rows(&x), (&mut doubled, keep));
    assert_eq!(doubled, &copied * 2.0);
    let expected: f64 = (0..PLANE[0]).map(|row| row as f64 * f64::from(copied[[row, 3]])).sum();
    assert!((sum - expected).abs() < 1e-9, "{sum} {expected}");
}

/// The Laplacian of a wave is the wave times 4·sin²(π·k/N), summed over the axes, and a kernel of one sample passes all.
#[test]
fn a_filter_reads_the_laplacian_of_a_wave() {
    for size in [[16, 24], [16, 32], [48, 64]] {
        let phases = size.map(|side| side as f32 / 8.0);
        let wave = Array2::from_shape_fn((size[0], size[1]), |(y, x)| {
            (2.0 * PI * (3.0 * y as f32 / size[0] as f32 + 5.0 * x as f32 / size[1] as f32)).cos()
        });
        let of_axis = |k: f32, axis: usize| 4.0 * (PI * k / (8.0 * phases[axis])).sin().powi(2);
        let eigenvalue = of_axis(3.0, 0) + of_axis(5.0, 1);
        let damping = Damping { smoothness: 0.5, floor: 0.1 };
        for precision in BOTH {
            let operator = PlaneOperator::new(size, [1, 1], Boundary::Periodic, precision);
            let otf = operator.transfer_function(Array2::from_elem((1, 1), 0.7).view(), |k| k).unwrap();
            let normal = 0.7 * 0.7 + 0.5 * eigenvalue + 0.1;
            for (response, factor) in
                [(Response::NormalInverse(damping), 1.0 / normal), (Response::Inverse(damping), 0.7 / normal)]
            {
                let mut found = Array2::zeros(size);
                operator.filter(&otf, response, rows(&wave), (&mut found, copy_row));
                assert_near(&found, &(&wave * factor));
            }
            let mean = operator.mean(&otf, |_, laplacian| laplacian, [&|_| 1.0, &|_| 1.0]);
            // Over half of the columns and one, since half a spectrum holds the two real ones once: 2 along y, a little more along x.
            assert!((mean - 4.0).abs() < 0.2, "{mean}");
        }
    }
}

#[test]
#[should_panic(expected = "belongs to this operator")]
fn refuses_the_transfer_function_of_another_precision() {
    let of = |precision| PlaneOperator::new(PLANE, KERNEL, Boundary::Zero, precision);
    let otf = of(BOTH[0]).transfer_function(kernel().view(), |k| k).unwrap();
    of(BOTH[1]).convolve(&otf, rows(&plane(PLANE, 1)), (&mut Array2::zeros(PLANE), copy_row));
}
