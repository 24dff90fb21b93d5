//! Memory: aligned buffers that each thread keeps, and outputs that several threads fill.

use std::cell::RefCell;

/// One cache line of floats; it exists for its alignment.
#[derive(Clone, Copy)]
#[repr(C, align(64))]
struct Line([f32; 16]);

thread_local! {
    static SCRATCH: RefCell<Vec<Line>> = const { RefCell::new(Vec::new()) };
}

/// Lends the thread's own buffer of at least `len` floats, aligned to cache lines. Its content is whatever was left there.
pub(crate) fn with_scratch<T>(len: usize, work: impl FnOnce(&mut [f32]) -> T) -> T {
    // Taken out while in use: if `work` waits on other threads and this one is given another task meanwhile, that task
    // gets a buffer of its own.
    let mut lines = SCRATCH.with_borrow_mut(std::mem::take);
    if lines.len() * 16 < len {
        lines.clear();
        lines.resize(len.div_ceil(16), Line([0.0; 16]));
    }
    // SAFETY: `Line` is `repr(C)` around `[f32; 16]` without padding (its size is its alignment), so `lines.len()` of them are
    // that many times 16 initialised floats, borrowed exclusively here.
    let floats = unsafe { std::slice::from_raw_parts_mut(lines.as_mut_ptr().cast::<f32>(), lines.len() * 16) };
    let result = work(floats);
    SCRATCH.set(lines);
    result
}

/// Where several threads write disjoint parts of one output.
#[derive(Clone, Copy)]
pub(crate) struct Output {
    start: *mut f32,
    len: usize,
}

// SAFETY: the pointer is only written through, and `fill_output` demands that threads write disjoint elements.
unsafe impl Send for Output {}
// SAFETY: as above.
unsafe impl Sync for Output {}

impl Output {
    /// Pointer to `len` elements from `offset` on.
    ///
    /// Not a slice: the memory may not be initialised yet.
    pub(crate) fn part(self, offset: usize, len: usize) -> *mut f32 {
        debug_assert!(offset + len <= self.len, "{offset} + {len} > {}", self.len);
        // `wrapping_add` is defined wherever it points; who writes answers for the bounds.
        self.start.wrapping_add(offset)
    }
}

/// A new array of `len` floats, filled by `work`.
///
/// # Safety
///
/// `work` must write every element, each by one thread only, and nothing outside.
pub(crate) unsafe fn fill_output(len: usize, work: impl FnOnce(Output)) -> Vec<f32> {
    // Not zeroed first: on large maps that costs as much as pooling them.
    let mut values = Vec::<f32>::with_capacity(len);
    work(Output { start: values.as_mut_ptr(), len });
    // SAFETY: the capacity is `len`, and the caller promises that `work` wrote every element.
    unsafe { values.set_len(len) };
    values
}
