//! Tells people of a kernel bank and of codes.

use super::pca::explained_share;
use crate::core::kernel_code::{KernelBank, KernelCode};

/// The code of each kernel of a bank, a line each.
pub fn code_lines(bank: &KernelBank) -> Vec<String> {
    let line = |index| format!("{:<8} {}", bank.kernel_name(index), show_code(&bank.code(index).to_owned()));
    (0..bank.len()).map(line).collect()
}

/// How many kernels a bank holds, of which size, and how much of them its codes hold, in a sentence.
pub fn bank_in_words(bank: &KernelBank) -> String {
    format!(
        "{} kernels of {} × {}, codes of {} numbers that hold {:.2} % of the set's variance",
        bank.len(),
        bank.psfs[0].height(),
        bank.psfs[0].width(),
        bank.code_dim(),
        100.0 * explained_share(bank)
    )
}

pub(super) fn show_code(code: &KernelCode) -> String {
    code.iter().map(|value| format!("{value:+.6e}")).collect::<Vec<_>>().join(" ")
}
