//! Metrics for other tools: JSON lines and event files of TensorBoard.

use super::numbers::physgrad;
use super::python;
use serde_json::Value;
use std::fs;
use std::path::{Path, PathBuf};
use std::time::{SystemTime, UNIX_EPOCH};
use tempfile::TempDir;

const EVENTS: &str = "events.out.tfevents.physgrad";
const SMALL: &str = "--set training.train_samples=16 --set training.test_samples=8 --set horizon=25 --set policy.widths=[8]";

/// Column names and rows of `metrics.csv`.
fn metrics(run: &Path) -> (Vec<String>, Vec<Vec<String>>) {
    let text = fs::read_to_string(run.join("metrics.csv")).expect("metrics");
    let mut rows = text.lines().map(|line| line.split(',').map(String::from).collect());
    (rows.next().expect("a header"), rows.collect())
}

/// Masked CRC-32C, bit by bit (Castagnoli, reflected polynomial 0x82f63b78).
fn masked_crc(bytes: &[u8]) -> u32 {
    let step = |crc: u32| (crc >> 1) ^ (0x82f6_3b78 & (crc & 1).wrapping_neg());
    let crc =
        !bytes.iter().fold(!0, |crc, &byte| (0..8).fold(crc ^ u32::from(byte), |crc, _| step(crc)));
    crc.rotate_left(17).wrapping_add(0xa282_ead8)
}

/// Field of a message: field number, contents, and the slice of the message with the contents.
/// Contents of a varint are eight little-endian bytes, and the slice is empty.
type Field<'a> = (u64, Vec<u8>, &'a [u8]);

/// Fields of a protobuf message.
fn fields(mut bytes: &[u8]) -> Vec<Field<'_>> {
    fn varint(bytes: &mut &[u8]) -> u64 {
        let length = bytes.iter().position(|byte| byte & 0x80 == 0).expect("an end") + 1;
        let (number, rest) = bytes.split_at(length);
        *bytes = rest;
        number.iter().rev().fold(0, |value, byte| value << 7 | u64::from(byte & 0x7f))
    }
    let mut fields = Vec::new();
    while !bytes.is_empty() {
        let key = varint(&mut bytes);
        let length = match key & 7 {
            0 => {
                fields.push((key >> 3, varint(&mut bytes).to_le_bytes().to_vec(), &[][..]));
                continue;
            }
            1 => 8,
            2 => varint(&mut bytes) as usize,
            5 => 4,
            other => panic!("wire type {other}"),
        };
        let (contents, rest) = bytes.split_at(length);
        bytes = rest;
        fields.push((key >> 3, contents.to_vec(), contents));
    }
    fields
}

/// An event: wall time, step, version of the file, and the values of its summary.
struct Event {
    wall_time: f64,
    step: u64,
    version: Option<String>,
    values: Vec<(String, f32)>,
}

/// Returns the events in the event file of a run. Checks the checksums of all frames.
fn events(run: &Path) -> Vec<Event> {
    let bytes = fs::read(run.join(EVENTS)).expect("events");
    let (mut rest, mut events) = (&bytes[..], Vec::new());
    let u32_at = |bytes: &[u8], at: usize| {
        u32::from_le_bytes(bytes[at..at + 4].try_into().expect("4 bytes"))
    };
    while !rest.is_empty() {
        let length = u64::from_le_bytes(rest[..8].try_into().expect("8 bytes")) as usize;
        assert_eq!(u32_at(rest, 8), masked_crc(&rest[..8]), "checksum of a length");
        let message = &rest[12..12 + length];
        assert_eq!(u32_at(rest, 12 + length), masked_crc(message), "checksum of a message");
        rest = &rest[16 + length..];
        let mut event = Event { wall_time: 0.0, step: 0, version: None, values: Vec::new() };
        for (number, value, contents) in fields(message) {
            match number {
                1 => event.wall_time = f64::from_le_bytes(value.try_into().expect("8 bytes")),
                2 => event.step = u64::from_le_bytes(value.try_into().expect("8 bytes")),
                3 => event.version = Some(String::from_utf8(value).expect("text")),
                5 => event.values.extend(fields(contents).into_iter().map(|(_, _, value)| {
                    let [tag, number] = &fields(value)[..] else { panic!("a tag and a number") };
                    assert_eq!((tag.0, number.0), (1, 2));
                    let number = f32::from_le_bytes(number.1[..].try_into().expect("4 bytes"));
                    (String::from_utf8(tag.1.clone()).expect("text"), number)
                })),
                other => panic!("field {other} of an event"),
            }
        }
        events.push(event);
    }
    events
}

/// Checks that both log files of a run have the rows of `metrics.csv`, for `epochs` epochs. Checks
/// that wall times of events do not decrease and are recent.
fn check(run: &Path, epochs: usize) {
    let (names, rows) = metrics(run);
    assert_eq!(rows.len(), epochs);
    let lines = fs::read_to_string(run.join("metrics.jsonl")).expect("JSON lines");
    let objects: Vec<Value> =
        lines.lines().map(|line| serde_json::from_str(line).expect("JSON")).collect();
    let events = events(run);
    assert_eq!((objects.len(), events.len()), (epochs, epochs + 1));
    assert_eq!((events[0].step, events[0].version.as_deref()), (0, Some("brain.Event:2")));
    for ((row, object), event) in rows.iter().zip(&objects).zip(&events[1..]) {
        assert_eq!(object.as_object().expect("an object").len(), names.len());
        let mut values = Vec::new();
        for (name, cell) in names.iter().zip(row) {
            match cell.parse::<f64>() {
                Ok(number) if number.is_finite() => {
                    // `serde_json` reads numbers with an error of up to one unit in the last place.
                    let found = object[name].as_f64().expect("a number");
                    assert!(
                        (found - number).abs() <= f64::EPSILON * number.abs(),
                        "{name}: {found} and {number}"
                    );
                }
                _ => assert_eq!(object[name], Value::Null, "{name}"),
            }
            values.extend(cell.parse().ok().map(|number: f64| (name.clone(), number as f32)));
        }
        assert_eq!(event.step, object["epoch"].as_u64().expect("an epoch"));
        // Compares texts, because NaN differs from itself.
        assert_eq!(
            format!("{:?}", event.values),
            format!("{:?}", &values[1..]),
            "an event lacks values of its row after the epoch"
        );
    }
    let now = SystemTime::now().duration_since(UNIX_EPOCH).expect("a time").as_secs_f64();
    let times: Vec<f64> = events.iter().map(|event| event.wall_time).collect();
    assert!(
        times.is_sorted() && times[0] > now - 3600.0 && times[epochs] <= now,
        "{times:?} now {now}"
    );
}

#[test]
fn logs_have_the_rows_of_the_metrics_for_all_runs_of_a_comparison() {
    let dir = TempDir::new().expect("a folder");
    let compare = format!(
        "compare cart_pole {SMALL} --fields R,C --seeds 1 --epochs 3 --log jsonl,tensorboard --quiet --out all"
    );
    physgrad(&compare, dir.path()).assert().success();
    let runs: Vec<PathBuf> =
        ["R-0", "C-0"].iter().map(|run| dir.path().join("all/runs").join(run)).collect();
    for run in &runs {
        check(run, 3);
    }
    // R has no cosine.
    let line = fs::read_to_string(runs[0].join("metrics.jsonl")).expect("JSON lines");
    assert!(line.contains("\"cosine\":null"), "{line}");
    let runs: Vec<&Path> = runs.iter().map(PathBuf::as_path).collect();
    if let Some(text) = python::run("check_logs.py", &runs) {
        assert_eq!(text.lines().count(), runs.len(), "{text}");
    }
}

/// A process that is killed after its last checkpoint leaves rows that the resumed run computes
/// again.
#[test]
fn a_resumed_run_has_no_duplicate_rows_and_keeps_its_formats() {
    let dir = TempDir::new().expect("a folder");
    let run = dir.path().join("run");
    physgrad(
        &format!("train cart_pole {SMALL} --epochs 2 --log jsonl,tensorboard --quiet --out run"),
        dir.path(),
    )
    .assert()
    .success();
    let checkpoint = fs::read(run.join("checkpoint.bin")).expect("a checkpoint");
    physgrad("train --resume --epochs 3 --quiet --out run", dir.path()).assert().success();
    check(&run, 3);
    fs::write(run.join("checkpoint.bin"), checkpoint).expect("a file");
    physgrad("train --resume --epochs 4 --quiet --out run", dir.path()).assert().success();
    check(&run, 4);
}

#[test]
fn a_complete_run_gets_a_log_and_others_have_none() {
    let dir = TempDir::new().expect("a folder");
    let run = dir.path().join("run");
    physgrad(&format!("train cart_pole {SMALL} --epochs 2 --quiet --out run"), dir.path())
        .assert()
        .success();
    assert!(!run.join("metrics.jsonl").exists() && !run.join(EVENTS).exists());
    physgrad("train --resume --quiet --out run --log jsonl", dir.path()).assert().success();
    assert!(run.join("metrics.jsonl").exists() && !run.join(EVENTS).exists());
    physgrad("train --resume --quiet --out run --log tensorboard,jsonl", dir.path())
        .assert()
        .success();
    check(&run, 2);
    // A new run in the folder renames the folder of the earlier run to `run.previous-1`.
    physgrad(&format!("train cart_pole {SMALL} --epochs 1 --quiet --out run"), dir.path())
        .assert()
        .success();
    assert!(!run.join("metrics.jsonl").exists() && !run.join(EVENTS).exists());
    check(&dir.path().join("run.previous-1"), 2);
}
