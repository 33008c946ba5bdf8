//! Looks at the machine: instruction set, threads, memory.

use super::Findings;
use crate::core::bytes::format_bytes;
use crate::io::available_memory_bytes;
use crate::kernels::Isa;

const ABOUT: &str = "machine";

/// The least memory that is worth beginning with: half of what commands take unless `--max-memory` says otherwise.
const LITTLE_BYTES: u64 = 1 << 30;

pub(super) fn look(findings: &mut Findings) {
    instruction_set(Isa::current().name(), Isa::available()[0].name(), findings);
    let (used, there) =
        (rayon::current_num_threads(), std::thread::available_parallelism().map_or(1, usize::from));
    threads(used, there, findings);
    if let Some(bytes) = available_memory_bytes() {
        memory(bytes, findings);
    }
}

fn instruction_set(used: &str, best: &str, findings: &mut Findings) {
    let check = "instruction-set";
    if used != best {
        let what = format!("networks compute with {used}, by UDC_SIMD, where this CPU has {best}");
        return findings.warn(ABOUT, check, what, "unset UDC_SIMD, unless results must be those of that set");
    }
    match used {
        "portable" => findings.warn(
            ABOUT,
            check,
            "networks compute without vector instructions: this CPU has neither AVX-512 nor AVX2 with FMA",
            "train and restore on another CPU where it takes too long; `udc bench` tells how long",
        ),
        set => findings.ok(
            ABOUT,
            check,
            format!("networks compute with {set}; on CPUs with another set results differ by rounding"),
        ),
    }
}

fn threads(used: usize, there: usize, findings: &mut Findings) {
    let check = "threads";
    if used > there {
        let what = format!("{used} threads share {there} cores");
        findings.warn(ABOUT, check, what, format!("leave out --threads, or give --threads {there}"));
    } else {
        findings.ok(ABOUT, check, format!("{used} threads on {there} cores"));
    }
}

fn memory(bytes: u64, findings: &mut Findings) {
    let (check, what) = ("memory", format!("{} of memory can be taken", format_bytes(bytes)));
    if bytes < LITTLE_BYTES {
        let mend = format!("end other programs, or give commands --max-memory {}", format_bytes(bytes / 2));
        findings.warn(ABOUT, check, what, mend);
    } else {
        findings.ok(ABOUT, check, what);
    }
}

#[cfg(test)]
mod tests {
    use super::super::Level;
    use super::*;

    fn level(look: impl FnOnce(&mut Findings)) -> Level {
        let mut findings = Findings::default();
        look(&mut findings);
        let [found] = &findings.0[..] else { panic!("{findings:?}") };
        assert_eq!(found.mend.is_some(), found.level > Level::Ok, "{found:?}");
        found.level
    }

    #[test]
    fn a_machine_that_is_slower_than_it_could_be_is_found() {
        assert_eq!(level(|f| instruction_set("avx512", "avx512", f)), Level::Ok);
        assert_eq!(level(|f| instruction_set("avx2", "avx512", f)), Level::Warning);
        assert_eq!(level(|f| instruction_set("portable", "portable", f)), Level::Warning);
        assert_eq!(level(|f| threads(2, 2, f)), Level::Ok);
        assert_eq!(level(|f| threads(64, 2, f)), Level::Warning);
    }

    #[test]
    fn little_memory_is_found() {
        assert_eq!(level(|f| memory(8 << 30, f)), Level::Ok);
        assert_eq!(level(|f| memory(200 << 20, f)), Level::Warning);
    }
}
