//! Event files of TensorBoard: a sequence of records, each with one `Event` message.
//!
//! Framing: `tensorflow/core/lib/io/record_writer.h`. Messages with their field numbers:
//! `tensorboard/compat/proto/event.proto` and `summary.proto`
//! (<https://github.com/tensorflow/tensorboard>).

use prost::Message;

#[derive(Clone, PartialEq, Message)]
struct Event {
    /// Seconds since 1970.
    #[prost(double, tag = "1")]
    wall_time: f64,
    #[prost(int64, tag = "2")]
    step: i64,
    #[prost(string, optional, tag = "3")]
    file_version: Option<String>,
    #[prost(message, optional, tag = "5")]
    summary: Option<Summary>,
}

#[derive(Clone, PartialEq, Message)]
struct Summary {
    #[prost(message, repeated, tag = "1")]
    value: Vec<Value>,
}

#[derive(Clone, PartialEq, Message)]
struct Value {
    #[prost(string, tag = "1")]
    tag: String,
    /// Part of a `oneof` in the format: written even if it is 0.
    #[prost(float, optional, tag = "2")]
    simple_value: Option<f32>,
}

/// First record of a file.
pub fn start(wall_time: f64) -> Vec<u8> {
    record(&Event { wall_time, step: 0, file_version: Some("brain.Event:2".into()), summary: None })
}

/// Record with values of a step. Numbers beyond the range of f32 become infinite.
pub fn scalars<'a>(
    step: usize,
    wall_time: f64,
    values: impl Iterator<Item = (&'a str, f64)>,
) -> Vec<u8> {
    let value = values
        .map(|(tag, value)| Value { tag: tag.into(), simple_value: Some(value as f32) })
        .collect();
    record(&Event {
        wall_time,
        step: step as i64,
        file_version: None,
        summary: Some(Summary { value }),
    })
}

/// Frame of a message: its length, the checksum of the length, the message, its checksum.
fn record(event: &Event) -> Vec<u8> {
    let message = event.encode_to_vec();
    let length = (message.len() as u64).to_le_bytes();
    [&length[..], &masked_crc(&length), &message, &masked_crc(&message)].concat()
}

/// Masked CRC-32C.
fn masked_crc(bytes: &[u8]) -> [u8; 4] {
    const CRC: crc::Crc<u32> = crc::Crc::<u32>::new(&crc::CRC_32_ISCSI);
    CRC.checksum(bytes).rotate_right(15).wrapping_add(0xa282_ead8).to_le_bytes()
}
