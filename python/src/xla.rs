//! The handler that XLA calls for the operations of a task: JAX then needs neither Python nor the
//! GIL in a compiled function.
//!
//! The structures are those of XLA's foreign function interface, `xla/ffi/api/c_api.h`, major
//! version 0, whose layout is stable. Only fields that the handler reads are named beyond their
//! place.

use crate::arrays::with_precision;
use crate::operations::{Array, Operation, called, run};
use physgrad_cli::api;
use std::ffi::{CString, c_char, c_int, c_void};
use std::ptr::null_mut;

const METADATA: c_int = 1;
const EXECUTE: c_int = 3;
const S32: c_int = 4;
const S64: c_int = 5;
const F32: c_int = 11;
const F64: c_int = 12;
const INVALID_ARGUMENT: c_int = 3;

#[repr(C)]
struct Extension {
    size: usize,
    kind: c_int,
    next: *mut Extension,
}

#[repr(C)]
struct Version {
    size: usize,
    extension: *mut Extension,
    major: c_int,
    minor: c_int,
}

#[repr(C)]
struct Metadata {
    size: usize,
    version: Version,
}

#[repr(C)]
struct MetadataExtension {
    base: Extension,
    metadata: *mut Metadata,
}

#[repr(C)]
struct NewError {
    size: usize,
    extension: *mut Extension,
    message: *const c_char,
    code: c_int,
}

/// An error of XLA.
#[repr(C)]
pub struct Error {
    _opaque: [u8; 0],
}

#[repr(C)]
struct Api {
    size: usize,
    extension: *mut Extension,
    version: Version,
    internal: *const c_void,
    create_error: Option<unsafe extern "C" fn(*mut NewError) -> *mut Error>,
}

#[repr(C)]
struct Buffer {
    size: usize,
    extension: *mut Extension,
    dtype: c_int,
    data: *mut c_void,
    rank: i64,
    dims: *const i64,
}

/// Arguments, or results. The kind of all is that of a buffer.
#[repr(C)]
struct Buffers {
    size: usize,
    extension: *mut Extension,
    count: i64,
    kinds: *const c_int,
    buffers: *const *const Buffer,
}

#[repr(C)]
struct Name {
    text: *const u8,
    len: usize,
}

#[repr(C)]
struct Number {
    dtype: c_int,
    value: *const c_void,
}

#[repr(C)]
struct Attributes {
    size: usize,
    extension: *mut Extension,
    count: i64,
    kinds: *const c_int,
    names: *const *const Name,
    values: *const *const Number,
}

/// A call of the handler.
#[repr(C)]
pub struct Frame {
    size: usize,
    extension: *mut Extension,
    api: *const Api,
    context: *mut c_void,
    stage: c_int,
    arguments: Buffers,
    results: Buffers,
    attributes: Attributes,
}

/// Address of the handler, for `jax.ffi.register_ffi_target`.
pub fn address() -> usize {
    handler as *const () as usize
}

/// Runs an operation. Its attributes are `operation`, a code of [`Operation`], and `handle`, that
/// of [`called`]. The first argument has the step numbers, and the others are those of the operation.
unsafe extern "C" fn handler(frame: *mut Frame) -> *mut Error {
    // SAFETY: XLA passes a valid frame, whose arrays have the lengths that it states.
    let frame = unsafe { &*frame };
    unsafe {
        if answered_metadata(frame) || frame.stage != EXECUTE {
            return null_mut();
        }
        match std::panic::catch_unwind(|| execute(frame)) {
            Ok(Ok(())) => null_mut(),
            Ok(Err(message)) => error(frame, &message),
            Err(_) => error(frame, "internal error of physgrad, please report it: a panic"),
        }
    }
}

/// Answers the question for the version of the interface with the version of the caller: the
/// handler reads nothing that depends on the minor version.
///
/// # Safety
/// As [`handler`].
unsafe fn answered_metadata(frame: &Frame) -> bool {
    unsafe {
        let mut extension = frame.extension;
        while !extension.is_null() {
            if (*extension).kind == METADATA {
                let metadata = (*extension.cast::<MetadataExtension>()).metadata;
                let minor = frame.api.as_ref().map_or(0, |api| api.version.minor);
                (*metadata).version.major = 0;
                (*metadata).version.minor = minor;
                return true;
            }
            extension = (*extension).next;
        }
        false
    }
}

/// An error with this message.
///
/// # Safety
/// As [`handler`].
unsafe fn error(frame: &Frame, message: &str) -> *mut Error {
    let text = CString::new(message.replace('\0', "")).expect("a text without zeros");
    let mut arguments = NewError {
        size: size_of::<NewError>(),
        extension: null_mut(),
        message: text.as_ptr(),
        code: INVALID_ARGUMENT,
    };
    unsafe { (*frame.api).create_error.map_or(null_mut(), |create| create(&mut arguments)) }
}

/// # Safety
/// As [`handler`].
unsafe fn execute(frame: &Frame) -> Result<(), String> {
    unsafe {
        let number = |name: &str| attribute(&frame.attributes, name);
        let operation = number("operation").and_then(Operation::of_code);
        let operation = operation.ok_or("physgrad: the call has no known operation")?;
        let called = number("handle").and_then(|handle| called(handle as u64));
        let called = called.ok_or(
            "physgrad: this process does not know the task of the call; create the function from the task before a graph of another process runs",
        )?;
        let arguments = buffers(&frame.arguments);
        let (t, inputs) = arguments.split_first().ok_or("physgrad: the call has no arguments")?;
        let dims_of = |buffer: &&Buffer| dims(buffer);
        let (steps, step_dims) = (step_numbers(t)?, dims_of(t));
        let is_f32 = inputs.first().is_some_and(|buffer| buffer.dtype == F32);
        let expected = if is_f32 { F32 } else { F64 };
        let results = buffers(&frame.results);
        if inputs.iter().chain(&results).any(|buffer| buffer.dtype != expected) {
            return Err("physgrad: all arrays must be float32, or all float64".into());
        }
        with_precision!(is_f32, F => {
            let inputs: Vec<Array<'_, F>> = inputs
                .iter()
                .map(|buffer| Array { dims: dims_of(buffer), numbers: slice(buffer) })
                .collect();
            let mut outputs: Vec<&mut [F]> = results.iter().map(|buffer| slice_mut(buffer)).collect();
            run(&called, operation, (&steps, &step_dims), &inputs, &mut outputs)
                .map_err(|error| api::plain(&format!("{error:#}")).into_owned())
        })
    }
}

/// # Safety
/// As [`handler`].
unsafe fn attribute(attributes: &Attributes, name: &str) -> Option<i64> {
    (0..attributes.count as usize).find_map(|i| unsafe {
        let found = &**attributes.names.add(i);
        let number = &**attributes.values.add(i);
        let is_it = std::slice::from_raw_parts(found.text, found.len) == name.as_bytes();
        (is_it && number.dtype == S64).then(|| *number.value.cast::<i64>())
    })
}

/// # Safety
/// As [`handler`].
unsafe fn buffers(buffers: &Buffers) -> Vec<&Buffer> {
    (0..buffers.count as usize).map(|i| unsafe { &**buffers.buffers.add(i) }).collect()
}

/// # Safety
/// As [`handler`].
unsafe fn dims(buffer: &Buffer) -> Vec<usize> {
    (0..buffer.rank as usize).map(|i| unsafe { *buffer.dims.add(i) as usize }).collect()
}

/// # Safety
/// As [`handler`]. `F` must be the type of the buffer.
unsafe fn slice<F>(buffer: &Buffer) -> &[F] {
    match unsafe { dims(buffer) }.iter().product() {
        0 => &[],
        len => unsafe { std::slice::from_raw_parts(buffer.data.cast(), len) },
    }
}

/// # Safety
/// As [`slice`], of a result, which no other buffer overlaps.
#[allow(clippy::mut_from_ref)]
unsafe fn slice_mut<F>(buffer: &Buffer) -> &mut [F] {
    match unsafe { dims(buffer) }.iter().product() {
        0 => &mut [],
        len => unsafe { std::slice::from_raw_parts_mut(buffer.data.cast(), len) },
    }
}

/// # Safety
/// As [`handler`].
unsafe fn step_numbers(buffer: &Buffer) -> Result<Vec<i64>, String> {
    match buffer.dtype {
        S32 => Ok(unsafe { slice::<i32>(buffer) }.iter().map(|&t| t.into()).collect()),
        S64 => Ok(unsafe { slice::<i64>(buffer) }.to_vec()),
        _ => Err("physgrad: `t` must be an array of int32 or int64".into()),
    }
}
