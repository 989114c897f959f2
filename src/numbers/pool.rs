//! [`lend`]: buffers of the current thread, kept between calls.
//!
//! Derivatives of large systems need buffers whose sizes are known only after a first evaluation. A
//! buffer keeps its capacity, so later calls of the same size do not allocate.

use std::any::Any;
use std::cell::RefCell;

thread_local! {
    static POOL: RefCell<Vec<Box<dyn Any>>> = const { RefCell::new(Vec::new()) };
}

/// Calls `work` with a value of the type `T` that belongs to the current thread.
///
/// A call receives a value that an earlier call left, or the default value if there is none. Nested
/// calls receive different values.
pub fn lend<T: Default + 'static, Out>(work: impl FnOnce(&mut T) -> Out) -> Out {
    let mut value: Box<T> = POOL.with_borrow_mut(|pool| {
        // From the end, where the last call left its value.
        let found = pool.iter().rposition(|value| value.is::<T>());
        found.map_or_else(Box::default, |i| {
            pool.swap_remove(i).downcast().expect("`rposition` found a value of this type")
        })
    });
    let result = work(&mut value);
    POOL.with_borrow_mut(|pool| pool.push(value));
    result
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn later_calls_receive_the_pushed_byte_and_nested_calls_an_empty_buffer() {
        lend(|outer: &mut Vec<u8>| {
            outer.push(1);
            lend(|inner: &mut Vec<u8>| assert!(inner.is_empty()));
            lend(|other: &mut Vec<u16>| assert!(other.is_empty()));
        });
        let mut lengths = lend(|a: &mut Vec<u8>| lend(|b: &mut Vec<u8>| [a.len(), b.len()]));
        lengths.sort_unstable();
        assert_eq!(lengths, [0, 1]);
    }
}
