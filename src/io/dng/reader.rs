//! Reads the numbers of opcodes one after another.

/// Big-endian numbers, whatever the byte order of the file.
pub(super) struct Reader<'a>(pub(super) &'a [u8]);

impl<'a> Reader<'a> {
    pub(super) fn take(&mut self, length: usize) -> Option<&'a [u8]> {
        let (taken, rest) = self.0.split_at_checked(length)?;
        self.0 = rest;
        Some(taken)
    }

    pub(super) fn u32(&mut self) -> Option<u32> {
        self.take(4)?.first_chunk().map(|bytes| u32::from_be_bytes(*bytes))
    }

    pub(super) fn f64(&mut self) -> Option<f64> {
        self.take(8)?.first_chunk().map(|bytes| f64::from_be_bytes(*bytes))
    }

    pub(super) fn finite(&mut self) -> Option<f64> {
        self.f64().filter(|value| value.is_finite())
    }
}
