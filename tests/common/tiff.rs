//! Writes TIFF files of any fields, as cameras and other programs do.

/// The values of a field.
pub(crate) enum Field {
    Bytes(Vec<u8>),
    Shorts(Vec<u16>),
    Longs(Vec<u32>),
    Rationals(Vec<(u32, u32)>),
    SignedRationals(Vec<(i32, i32)>),
    /// Bytes without a type.
    Data(Vec<u8>),
}

use Field::{Bytes, Data, Longs, Rationals, Shorts, SignedRationals};

impl Field {
    /// Type, count and bytes.
    fn encode(&self) -> (u16, usize, Vec<u8>) {
        match self {
            Bytes(values) => (1, values.len(), values.clone()),
            Shorts(values) => (3, values.len(), values.iter().flat_map(|v| v.to_le_bytes()).collect()),
            Longs(values) => (4, values.len(), values.iter().flat_map(|v| v.to_le_bytes()).collect()),
            Rationals(values) => {
                let bytes = values.iter().flat_map(|(a, b)| [a.to_le_bytes(), b.to_le_bytes()].concat());
                (5, values.len(), bytes.collect())
            }
            SignedRationals(values) => {
                let bytes = values.iter().flat_map(|(a, b)| [a.to_le_bytes(), b.to_le_bytes()].concat());
                (10, values.len(), bytes.collect())
            }
            Data(values) => (7, values.len(), values.clone()),
        }
    }
}

/// A little-endian TIFF file that grows.
pub(crate) struct Tiff(Vec<u8>);

impl Tiff {
    pub(crate) fn new() -> Self {
        Self(b"II*\0\0\0\0\0".to_vec())
    }

    /// Appends data on an even position, and returns it.
    fn append(&mut self, data: &[u8]) -> u32 {
        self.0.resize(self.0.len().next_multiple_of(2), 0);
        let place = u32::try_from(self.0.len()).unwrap();
        self.0.extend_from_slice(data);
        place
    }

    /// Appends a directory, and returns its position.
    pub(crate) fn directory(&mut self, mut fields: Vec<(u16, Field)>) -> u32 {
        fields.sort_by_key(|(tag, _)| *tag);
        let mut directory = u16::try_from(fields.len()).unwrap().to_le_bytes().to_vec();
        for (tag, field) in fields {
            let (kind, count, mut bytes) = field.encode();
            if bytes.len() > 4 {
                bytes = self.append(&bytes).to_le_bytes().to_vec();
            }
            bytes.resize(4, 0);
            directory.extend([tag.to_le_bytes(), kind.to_le_bytes()].concat());
            directory.extend(u32::try_from(count).unwrap().to_le_bytes());
            directory.extend(bytes);
        }
        directory.extend([0; 4]);
        self.append(&directory)
    }

    /// Appends the samples of an image in two strips, and returns the fields that describe it.
    pub(crate) fn image(
        &mut self,
        photometric: u16,
        samples: &[u16],
        [height, width]: [usize; 2],
    ) -> Vec<(u16, Field)> {
        let bands = samples.len() / (height * width);
        let rows = height.div_ceil(2);
        let strips: Vec<Vec<u8>> = samples
            .chunks(rows * width * bands)
            .map(|strip| strip.iter().flat_map(|v| v.to_le_bytes()).collect())
            .collect();
        let long = |value: usize| u32::try_from(value).unwrap();
        vec![
            (256, Longs(vec![long(width)])),
            (257, Longs(vec![long(height)])),
            (258, Shorts(vec![16; bands])),
            (259, Shorts(vec![1])),
            (262, Shorts(vec![photometric])),
            (277, Shorts(vec![u16::try_from(bands).unwrap()])),
            (278, Longs(vec![long(rows)])),
            (279, Longs(strips.iter().map(|strip| long(strip.len())).collect())),
            (273, Longs(strips.iter().map(|strip| self.append(strip)).collect())),
        ]
    }

    /// The file, whose first directory is the one at `first`.
    pub(crate) fn finish(mut self, first: u32) -> Vec<u8> {
        self.0[4..8].copy_from_slice(&first.to_le_bytes());
        self.0
    }
}
