//! How the allocator treats the large arrays of networks.

/// Tells glibc's allocator to keep freed memory for the next array instead of giving it back to the system, page by page and
/// at every step: training is 15 to 40 percent faster for it. To be called once, when a program starts; does nothing elsewhere.
pub fn keep_freed_memory() {
    #[cfg(all(target_os = "linux", target_env = "gnu"))]
    {
        // From malloc.h of glibc: numbers that are part of its interface.
        const M_TRIM_THRESHOLD: i32 = -1;
        const M_TOP_PAD: i32 = -2;
        const M_MMAP_MAX: i32 = -4;
        unsafe extern "C" {
            fn mallopt(parameter: i32, value: i32) -> i32;
        }
        for (parameter, value) in [(M_MMAP_MAX, 0), (M_TRIM_THRESHOLD, i32::MAX), (M_TOP_PAD, 64 << 20)] {
            // SAFETY: mallopt has this signature, takes any value, and may be called at any time; it says 0 for what it
            // does not know, which leaves things as they are.
            unsafe { mallopt(parameter, value) };
        }
    }
}
