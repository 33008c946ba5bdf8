//! Decodes lossless JPEG (ITU-T T.81, annex H; process 14), in which most cameras compress a raw image's tiles: each
//! sample is predicted from its neighbours, and the difference is stored in a Huffman code.
//!
//! Components are interleaved sample by sample. A mosaic's line is often stored as half as many columns of two.

use std::ops::Range;

/// The samples of an image, line by line.
#[derive(Debug)]
pub(super) struct Samples {
    /// Columns times components.
    pub(super) per_line: usize,
    pub(super) values: Vec<u16>,
}

/// Markers: start and end of the image, frame, Huffman tables, restart interval, scan.
const START: u8 = 0xd8;
const END: u8 = 0xd9;
const LOSSLESS_FRAME: u8 = 0xc3;
const TABLES: u8 = 0xc4;
const RESTARTS: u8 = 0xdd;
const SCAN: u8 = 0xda;
/// Frames of every other process; among them are markers of no frame, which are met before.
const OTHER_FRAMES: Range<u8> = 0xc0..0xd0;

/// Decodes an image of up to `most` samples, which may have up to 16 bits.
///
/// # Errors
/// Why it is no such image, or what is damaged.
pub(super) fn decode(bytes: &[u8], most: usize) -> Result<Samples, String> {
    let mut segments = Segments { bytes, at: 0 };
    if segments.marker()? != START {
        return Err("no JPEG starts where one should".to_owned());
    }
    let mut tables: [Option<Huffman>; 4] = [const { None }; 4];
    let (mut frame, mut restarts) = (None, 0);
    loop {
        match segments.marker()? {
            LOSSLESS_FRAME => frame = Some(Frame::read(segments.segment()?)?),
            TABLES => read_tables(segments.segment()?, &mut tables)?,
            RESTARTS => restarts = segments.segment()?.first_chunk().copied().map_or(0, u16::from_be_bytes),
            SCAN => {
                let frame = frame.ok_or("a scan comes before its frame")?;
                let scan = Scan::read(segments.segment()?, &frame, &tables)?;
                if frame.columns * frame.lines * frame.components > most {
                    return Err(format!("it has more samples than the {most} of its tile or strip"));
                }
                return scan.decode(&segments.bytes[segments.at..], &frame, restarts.into());
            }
            END => return Err("it has no scan".to_owned()),
            marker if OTHER_FRAMES.contains(&marker) => return Err("it is lossy JPEG".to_owned()),
            _ => _ = segments.segment()?,
        }
    }
}

/// The parts of a file before the scan's data.
struct Segments<'a> {
    bytes: &'a [u8],
    at: usize,
}

impl<'a> Segments<'a> {
    /// The code of the next marker.
    fn marker(&mut self) -> Result<u8, String> {
        loop {
            let marker = self.bytes.get(self.at..).and_then(|rest| rest.first_chunk::<2>());
            let &[first, second] = marker.ok_or("it is cut off")?;
            if first != 0xff {
                return Err(format!("a marker is missing at byte {}", self.at));
            }
            // Any number of bytes 0xff may come before the code.
            self.at += 1;
            if second != 0xff {
                self.at += 1;
                return Ok(second);
            }
        }
    }

    /// What follows a marker, behind the length.
    fn segment(&mut self) -> Result<&'a [u8], String> {
        let rest = &self.bytes[self.at..];
        let length = rest.first_chunk().copied().map_or(0, u16::from_be_bytes).into();
        let segment = rest.get(2..length).ok_or("it is cut off")?;
        self.at += length;
        Ok(segment)
    }
}

/// What a frame header says.
#[derive(Clone, Copy)]
struct Frame {
    bits: u8,
    lines: usize,
    columns: usize,
    components: usize,
}

impl Frame {
    fn read(segment: &[u8]) -> Result<Self, String> {
        let (&[bits, y0, y1, x0, x1, components], rest) =
            segment.split_first_chunk().ok_or("its frame header is cut off")?;
        let [lines, columns] = [[y0, y1], [x0, x1]].map(|pair| usize::from(u16::from_be_bytes(pair)));
        let components = usize::from(components);
        if !(2..=16).contains(&bits) || lines == 0 || columns == 0 || !(1..=4).contains(&components) {
            return Err(format!(
                "it declares {columns} × {lines} × {components} samples of {bits} bits, which are not read"
            ));
        }
        let sampling = rest.chunks_exact(3).map(|component| component[1]);
        if rest.len() != 3 * components || sampling.into_iter().any(|sampling| sampling != 0x11) {
            return Err("its components have different sizes, which are not read".to_owned());
        }
        Ok(Self { bits, lines, columns, components })
    }
}

fn read_tables(mut segment: &[u8], tables: &mut [Option<Huffman>; 4]) -> Result<(), String> {
    while let Some((&class_and_place, rest)) = segment.split_first() {
        let damaged = "a Huffman table is damaged";
        let (counts, rest) = rest.split_first_chunk().ok_or(damaged)?;
        let codes = counts.iter().copied().map(usize::from).sum();
        let (values, rest) = rest.split_at_checked(codes).ok_or(damaged)?;
        *tables.get_mut(usize::from(class_and_place)).ok_or(damaged)? =
            Some(Huffman::new(counts, values).ok_or(damaged)?);
        segment = rest;
    }
    Ok(())
}

/// Bits that the table of short codes looks at.
const SHORT: u32 = 9;

/// A canonical Huffman code for numbers of bits.
struct Huffman {
    /// For the next [`SHORT`] bits the length of the code they begin with and its value; length 0 for longer codes.
    short: Vec<(u8, u8)>,
    /// For each length one past its last code, as the upper bits of 16.
    ends: [u32; 17],
    /// For each length what is added to a code to get the place of its value.
    offsets: [i32; 17],
    values: Vec<u8>,
}

impl Huffman {
    /// The code with `counts[i]` codes of `i + 1` bits; `None` where there are no such codes or a value is out of range.
    fn new(counts: &[u8; 16], values: &[u8]) -> Option<Self> {
        if values.iter().any(|&bits| bits > 16) {
            return None;
        }
        let (mut ends, mut offsets) = ([0; 17], [0; 17]);
        let mut short = vec![(0, 0); 1 << SHORT];
        let (mut code, mut place) = (0_u32, 0_usize);
        for (length, &count) in (1..).zip(counts) {
            offsets[length as usize] = i32::try_from(place).ok()? - code.cast_signed();
            for &value in &values[place..place + usize::from(count)] {
                if code >> length != 0 {
                    return None;
                }
                if let Some(free) = SHORT.checked_sub(length) {
                    let first = (code << free) as usize;
                    short[first..first + (1 << free)].fill((u8::try_from(length).ok()?, value));
                }
                code += 1;
            }
            place += usize::from(count);
            ends[length as usize] = code << (16 - length);
            code <<= 1;
        }
        Some(Self { short, ends, offsets, values: values.to_vec() })
    }

    /// The value of the code that the next bits begin with.
    #[inline]
    fn read(&self, bits: &mut Bits<'_>) -> Result<u8, String> {
        let next = bits.peek();
        let (length, value) = self.short[(next >> (16 - SHORT)) as usize];
        if length > 0 {
            bits.skip(length.into());
            return Ok(value);
        }
        let length = (SHORT as usize + 1..=16).find(|&length| next < self.ends[length]);
        let length = length.ok_or("a code is damaged")?;
        bits.skip(u32::try_from(length).unwrap_or(16));
        let place = (next >> (16 - length)).cast_signed() + self.offsets[length];
        let value = usize::try_from(place).ok().and_then(|place| self.values.get(place));
        value.copied().ok_or_else(|| "a code is damaged".to_owned())
    }
}

/// What a scan header says.
struct Scan<'a> {
    tables: Vec<&'a Huffman>,
    predictor: u8,
    /// How many bits lower samples are stored.
    shift: u8,
}

impl<'a> Scan<'a> {
    fn read(segment: &[u8], frame: &Frame, tables: &'a [Option<Huffman>; 4]) -> Result<Self, String> {
        let components = usize::from(*segment.first().ok_or("its scan header is cut off")?);
        if components != frame.components || segment.len() != 4 + 2 * components {
            return Err("its components are stored one after the other, which is not read".to_owned());
        }
        let table = |selector: &[u8]| tables.get(usize::from(selector[1] >> 4))?.as_ref();
        let tables = segment[1..1 + 2 * components].chunks_exact(2).map(table).collect::<Option<Vec<_>>>();
        let (predictor, shift) = (segment[1 + 2 * components], segment[3 + 2 * components] & 15);
        if !(1..=7).contains(&predictor) || shift >= frame.bits {
            return Err(format!("its scan has predictor {predictor} and point transform {shift}"));
        }
        Ok(Self { tables: tables.ok_or("a Huffman table is missing")?, predictor, shift })
    }

    /// Decodes the data, which starts anew after each `restarts` columns, unless they are 0.
    fn decode(&self, data: &[u8], frame: &Frame, restarts: usize) -> Result<Samples, String> {
        let Frame { bits, lines, columns, components } = *frame;
        let per_line = columns * components;
        // Each sample takes one bit at least.
        if per_line * lines > 8 * data.len() {
            return Err(format!(
                "{columns} × {lines} × {components} samples are not in its {} bytes",
                data.len()
            ));
        }
        if !restarts.is_multiple_of(columns) {
            return Err("it restarts inside of a line, which is not read".to_owned());
        }
        let mut reader = Bits::new(data);
        let mut values = vec![0_u16; per_line * lines];
        for line in 0..lines {
            let starts = line == 0 || (restarts > 0 && line.is_multiple_of(restarts / columns));
            if starts && line > 0 {
                reader.restart()?;
            }
            let (before, rest) = values.split_at_mut(line * per_line);
            let above = (!starts).then(|| &before[(line - 1) * per_line..]);
            let line = &mut rest[..per_line];
            for (at, table) in (0..per_line).zip(self.tables.iter().cycle()) {
                let prediction = match (at.checked_sub(components), above) {
                    (None, None) => 1 << (bits - self.shift - 1),
                    (None, Some(above)) => above[at].into(),
                    (Some(left), None) => line[left].into(),
                    (Some(left), Some(above)) => self.predict([line[left], above[at], above[left]]),
                };
                let difference = reader.difference(table)?;
                // The sum is taken modulo 2^16.
                line[at] = ((prediction + difference).cast_unsigned() & 0xffff) as u16;
            }
            if reader.is_exhausted() {
                return Err("it is cut off".to_owned());
            }
        }
        if self.shift > 0 {
            values.iter_mut().for_each(|value| *value <<= self.shift);
        }
        Ok(Samples { per_line, values })
    }

    /// The prediction from the samples to the left, above, and above the left one (T.81, table H.1).
    #[inline]
    fn predict(&self, neighbours: [u16; 3]) -> i32 {
        let [left, above, corner] = neighbours.map(i32::from);
        match self.predictor {
            1 => left,
            2 => above,
            3 => corner,
            4 => left + above - corner,
            5 => left + ((above - corner) >> 1),
            6 => above + ((left - corner) >> 1),
            _ => (left + above) >> 1,
        }
    }
}

/// The bits of a scan, the highest of each byte first, without the zeros that follow bytes 0xff.
struct Bits<'a> {
    data: &'a [u8],
    at: usize,
    /// The bits that were read ahead, in the lowest `count`.
    ahead: u64,
    count: u32,
    /// How many of them stand for data that is not there.
    missing: u32,
}

impl<'a> Bits<'a> {
    fn new(data: &'a [u8]) -> Self {
        Self { data, at: 0, ahead: 0, count: 0, missing: 0 }
    }

    /// Reads ahead so that 16 bits and 16 more are there: zeros behind the end of the data.
    #[inline]
    fn fill(&mut self) {
        while self.count <= 56 {
            let byte = match self.data.get(self.at..) {
                Some([0xff, 0, ..]) => {
                    self.at += 2;
                    0xff
                }
                Some([byte, ..]) if *byte != 0xff => {
                    self.at += 1;
                    *byte
                }
                _ => {
                    self.missing += 8;
                    0
                }
            };
            self.ahead = self.ahead << 8 | u64::from(byte);
            self.count += 8;
        }
    }

    /// The next 16 bits.
    #[inline]
    fn peek(&mut self) -> u32 {
        if self.count < 32 {
            self.fill();
        }
        ((self.ahead >> (self.count - 16)) & 0xffff) as u32
    }

    /// Leaves out up to 16 bits, after [`Self::peek`].
    #[inline]
    fn skip(&mut self, bits: u32) {
        self.count -= bits;
    }

    /// The next difference: a number of bits in a Huffman code, then as many bits (T.81, H.1.2.2).
    #[inline]
    fn difference(&mut self, table: &Huffman) -> Result<i32, String> {
        let bits = table.read(self)?;
        if bits == 0 {
            return Ok(0);
        }
        if bits == 16 {
            return Ok(1 << 15);
        }
        let value = (self.peek() >> (16 - bits)).cast_signed();
        self.skip(bits.into());
        let is_negative = value >> (bits - 1) == 0;
        Ok(if is_negative { value - (1 << bits) + 1 } else { value })
    }

    /// Whether more bits were taken than there are.
    fn is_exhausted(&self) -> bool {
        self.missing > self.count
    }

    /// Goes on behind the next restart marker.
    fn restart(&mut self) -> Result<(), String> {
        // Bytes that were read ahead lie before the marker, where reading ahead stops.
        let marker = self.data.get(self.at..).and_then(|rest| rest.first_chunk::<2>());
        if !matches!(marker, Some([0xff, 0xd0..=0xd7])) {
            return Err("a restart marker is missing".to_owned());
        }
        *self = Self { at: self.at + 2, ..Self::new(self.data) };
        Ok(())
    }
}
