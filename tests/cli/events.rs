//! Reads TensorBoard's event files by their published description alone: record framing with checksums, and the
//! few protocol-buffer fields of scalars.

use std::path::Path;

/// What one event says.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Event {
    pub(crate) wall_time: f64,
    pub(crate) step: u64,
    pub(crate) file_version: String,
    /// Whether readers are told to forget this step and later ones.
    pub(crate) restart: bool,
    pub(crate) scalars: Vec<(String, f32)>,
}

/// The events of every event file of a folder, in the order of the files' names.
pub(crate) fn read_folder(folder: &Path) -> Vec<Vec<Event>> {
    let mut names: Vec<_> = std::fs::read_dir(folder)
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .filter(|path| path.to_string_lossy().contains("tfevents"))
        .collect();
    names.sort();
    names.iter().map(|path| read(&std::fs::read(path).unwrap())).collect()
}

fn read(mut bytes: &[u8]) -> Vec<Event> {
    let mut events = Vec::new();
    while !bytes.is_empty() {
        let length = usize::try_from(u64::from_le_bytes(bytes[..8].try_into().unwrap())).unwrap();
        assert_eq!(unmasked(&bytes[8..12]), crc32c(&bytes[..8]), "checksum of a length");
        let contents = &bytes[12..12 + length];
        assert_eq!(unmasked(&bytes[12 + length..16 + length]), crc32c(contents), "checksum of an event");
        events.push(event(contents));
        bytes = &bytes[16 + length..];
    }
    events
}

/// CRC-32C bit by bit, as polynomial division.
fn crc32c(bytes: &[u8]) -> u32 {
    let mut remainder = u32::MAX;
    for byte in bytes {
        remainder ^= u32::from(*byte);
        for _ in 0..8 {
            let carry = remainder & 1;
            remainder >>= 1;
            if carry == 1 {
                remainder ^= 0x1edc_6f41u32.reverse_bits();
            }
        }
    }
    !remainder
}

fn unmasked(bytes: &[u8]) -> u32 {
    u32::from_le_bytes(bytes.try_into().unwrap()).wrapping_sub(0xa282_ead8).rotate_left(15)
}

/// A field's value, by its wire type.
enum Value<'a> {
    Number(u64),
    Bytes(&'a [u8]),
}

fn fields(mut message: &[u8]) -> Vec<(u64, Value<'_>)> {
    fn varint(message: &mut &[u8]) -> u64 {
        let mut value = 0;
        for shift in (0..).step_by(7) {
            let (byte, rest) = message.split_first().unwrap();
            *message = rest;
            value |= u64::from(byte & 0x7f) << shift;
            if byte & 0x80 == 0 {
                break;
            }
        }
        value
    }
    let mut found = Vec::new();
    while !message.is_empty() {
        let key = varint(&mut message);
        let length = match key & 7 {
            0 => {
                found.push((key >> 3, Value::Number(varint(&mut message))));
                continue;
            }
            1 => 8,
            2 => usize::try_from(varint(&mut message)).unwrap(),
            5 => 4,
            other => panic!("wire type {other}"),
        };
        let (bytes, rest) = message.split_at(length);
        found.push((key >> 3, Value::Bytes(bytes)));
        message = rest;
    }
    found
}

fn event(message: &[u8]) -> Event {
    let mut event = Event::default();
    for (field, value) in fields(message) {
        match (field, value) {
            (1, Value::Bytes(bytes)) => event.wall_time = f64::from_le_bytes(bytes.try_into().unwrap()),
            (2, Value::Number(step)) => event.step = step,
            (3, Value::Bytes(bytes)) => event.file_version = String::from_utf8(bytes.to_vec()).unwrap(),
            (5, Value::Bytes(bytes)) => event.scalars = fields(bytes).iter().map(scalar).collect(),
            (7, Value::Bytes(bytes)) => {
                event.restart = matches!(fields(bytes)[..], [(1, Value::Number(1))]);
            }
            (field, _) => panic!("an event has no field {field}"),
        }
    }
    event
}

fn scalar((field, value): &(u64, Value<'_>)) -> (String, f32) {
    let (1, Value::Bytes(bytes)) = (field, value) else { panic!("a summary has values only") };
    match &fields(bytes)[..] {
        [(1, Value::Bytes(tag)), (2, Value::Bytes(value))] => {
            (String::from_utf8(tag.to_vec()).unwrap(), f32::from_le_bytes((*value).try_into().unwrap()))
        }
        _ => panic!("a value is a tag and a number"),
    }
}
