//! Encodes TensorBoard's `Event` messages as protocol buffers: scalars at a step, and the marks of a file.
//!
//! Only the fields that are used are known here. `Event`: `wall_time` 1 (double), `step` 2 (int64),
//! `file_version` 3 (string), `summary` 5 (message), `session_log` 7 (message). `Summary`: `value` 1 (message) of
//! `tag` 1 (string) and `simple_value` 2 (float). `SessionLog`: `status` 1 (enum, 1 for START).

/// The version that readers look for in the first event of a file.
const FILE_VERSION: &str = "brain.Event:2";

/// Wire types of protocol buffers.
const VARINT: u8 = 0;
const FIXED64: u8 = 1;
const BYTES: u8 = 2;
const FIXED32: u8 = 5;

/// The event that every file begins with.
pub(super) fn file_version(wall_time_s: f64) -> Vec<u8> {
    let mut event = wall_time(wall_time_s);
    put_bytes(&mut event, 3, FILE_VERSION.as_bytes());
    event
}

/// The event that tells readers to forget what they have read of `step` and later ones.
pub(super) fn restart(wall_time_s: f64, step: u64) -> Vec<u8> {
    let mut event = at_step(wall_time_s, step);
    let mut session_log = Vec::new();
    put_varint_field(&mut session_log, 1, 1);
    put_bytes(&mut event, 7, &session_log);
    event
}

/// The event that holds named numbers of one step.
pub(super) fn scalars(wall_time_s: f64, step: u64, values: &[(String, f64)]) -> Vec<u8> {
    let mut summary = Vec::new();
    for (tag, value) in values {
        let mut entry = Vec::new();
        put_bytes(&mut entry, 1, tag.as_bytes());
        entry.push(key(2, FIXED32));
        #[expect(clippy::cast_possible_truncation, reason = "the format keeps scalars in 32 bits")]
        entry.extend((*value as f32).to_le_bytes());
        put_bytes(&mut summary, 1, &entry);
    }
    let mut event = at_step(wall_time_s, step);
    put_bytes(&mut event, 5, &summary);
    event
}

/// The step of an event that [`restart`] or [`scalars`] made; 0 for others.
pub(super) fn step_of(event: &[u8]) -> u64 {
    // The wall time of 9 bytes comes first, then the step.
    let Some((key_byte, rest)) = event.get(9..).and_then(<[u8]>::split_first) else { return 0 };
    if *key_byte == key(2, VARINT) { varint(rest) } else { 0 }
}

fn at_step(wall_time_s: f64, step: u64) -> Vec<u8> {
    let mut event = wall_time(wall_time_s);
    put_varint_field(&mut event, 2, step);
    event
}

fn wall_time(wall_time_s: f64) -> Vec<u8> {
    let mut event = vec![key(1, FIXED64)];
    event.extend(wall_time_s.to_le_bytes());
    event
}

fn key(field: u8, wire_type: u8) -> u8 {
    field << 3 | wire_type
}

fn put_varint_field(message: &mut Vec<u8>, field: u8, value: u64) {
    message.push(key(field, VARINT));
    put_varint(message, value);
}

fn put_bytes(message: &mut Vec<u8>, field: u8, bytes: &[u8]) {
    message.push(key(field, BYTES));
    put_varint(message, bytes.len() as u64);
    message.extend(bytes);
}

/// Seven bits a byte, the lowest first; the top bit says that more follow.
fn put_varint(message: &mut Vec<u8>, mut value: u64) {
    while value >= 0x80 {
        message.push((value & 0x7f) as u8 | 0x80);
        value >>= 7;
    }
    message.push((value & 0x7f) as u8);
}

fn varint(bytes: &[u8]) -> u64 {
    let length = bytes.iter().take(10).position(|byte| byte & 0x80 == 0).map_or(0, |last| last + 1);
    bytes[..length].iter().rev().fold(0, |value, byte| value << 7 | u64::from(byte & 0x7f))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Spelt out by hand from the format's description: 300 is ac 02 as a varint, 0.5 is 3f000000 as a float.
    #[test]
    fn a_scalar_is_encoded_as_the_format_says() {
        let event = scalars(1.0, 300, &[("loss".to_owned(), 0.5)]);
        let expected: [&[u8]; 6] = [
            &[0x09, 0, 0, 0, 0, 0, 0, 0xf0, 0x3f],
            &[0x10, 0xac, 0x02],
            &[0x2a, 0x0d],
            &[0x0a, 0x0b],
            &[0x0a, 0x04, b'l', b'o', b's', b's'],
            &[0x15, 0, 0, 0, 0x3f],
        ];
        assert_eq!(event, expected.concat());
        assert_eq!(step_of(&event), 300);
    }

    #[test]
    fn steps_of_any_size_are_read_back() {
        for step in [0, 1, 127, 128, 1_000_000, u64::MAX] {
            assert_eq!(step_of(&restart(2.0, step)), step);
        }
        assert_eq!(step_of(&file_version(2.0)), 0);
        assert_eq!(step_of(&[]), 0);
    }
}
