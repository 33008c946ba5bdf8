use super::*;

struct Probe;

impl Kernel for Probe {
    type Output = Vec<f32>;
    #[inline(always)]
    fn run<S: Simd>(self, simd: S) -> Vec<f32> {
        let from: Vec<f32> = (0..S::LANES + 3).map(|i| i as f32 - 2.0).collect();
        let mut to = vec![0.0; S::LANES];
        // SAFETY: three floats more than a vector follow the start of `from`; `to` is one vector long; three
        // floats begin at either place of the parts.
        unsafe {
            let v = simd.load(&from, 1);
            let leaked = simd.leak(v, v, simd.splat(0.5));
            simd.store(&mut to, 0, simd.sub_mul(simd.splat(1.0), leaked, simd.splat(2.0)));
            to.push(simd.sum(leaked));
            // Three lanes and none: what lies past them is neither read nor written.
            for count in [3, 0] {
                let mut part = vec![-7.0; 4];
                let v = simd.load_part(&from[..5], 2, count);
                simd.store_part(&mut part, 1, count, v);
                to.extend(part);
                to.push(simd.sum(v));
            }
        }
        to
    }
}

#[test]
fn every_set_computes_the_same() {
    for isa in Isa::available() {
        let expected = |i: usize| {
            let v = i as f32 - 1.0;
            1.0 - 2.0 * if v > 0.0 { v } else { 0.5 * v }
        };
        let mut expected: Vec<_> = (0..isa.lanes()).map(expected).collect();
        expected.push(expected.iter().map(|value| (1.0 - value) / 2.0).sum());
        expected.extend([-7.0, 0.0, 1.0, 2.0, 3.0, -7.0, -7.0, -7.0, -7.0, 0.0]);
        assert_eq!(isa.run(Probe), expected, "{}", isa.name());
    }
}

#[test]
fn sums_that_do_not_fill_lanes_keep_their_products() {
    for isa in Isa::available() {
        assert_eq!(isa.for_sums_over(48), isa);
        let Some(rounded) = isa.with_bf16_products() else { continue };
        assert_eq!((rounded.for_sums_over(48), rounded.for_sums_over(64)), (isa, rounded));
    }
}

#[test]
fn a_set_is_found_by_its_name_only() {
    assert_eq!(Isa::named("portable").unwrap().name(), "portable");
    assert!(Isa::named("altivec").is_none());
}

#[test]
fn a_set_that_is_misspelt_or_that_the_cpu_lacks_is_an_error_that_names_the_others() {
    let portable = Isa::named("portable").unwrap();
    assert_eq!(Isa::choose("portable", &[portable]), Ok(Some(portable)));
    assert_eq!(Isa::choose("", &[portable]), Ok(None));
    let said = Isa::choose("avx512", &[portable]).unwrap_err();
    assert!(said.contains("avx512, which this CPU does not have; it has portable"), "{said}");
    let said = Isa::choose("AVX2", &[portable]).unwrap_err();
    assert!(said.contains("must be one of avx512, avx2, portable, found \"AVX2\""), "{said}");
    let known = |isa: &Isa| NAMES.contains(&isa.name());
    assert!(Isa::available().iter().all(known));
}

/// Written past the capture of passing tests' output, so that a log shows what it stands for.
#[test]
fn instruction_sets_that_the_tests_cannot_run_are_named_in_their_output() {
    use std::io::Write as _;
    let available = Isa::available();
    let mut ran: Vec<&str> = available.iter().map(Isa::name).collect();
    ran.extend(available.iter().filter_map(|isa| Some(isa.with_bf16_products()?.name())));
    let all = [&NAMES[..], &["avx512, bfloat16 products"]].concat();
    let skipped: Vec<&str> = all.into_iter().filter(|name| !ran.contains(name)).collect();
    let of_cpu = if skipped.is_empty() { "none".to_owned() } else { skipped.join("; ") };
    let line =
        format!("kernels tested with: {}; skipped, as this CPU lacks them: {of_cpu}\n", ran.join("; "));
    std::io::stderr().write_all(line.as_bytes()).unwrap();
    assert_eq!(ran.len() + skipped.len(), 4, "{line}");
}
