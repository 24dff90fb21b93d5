//! Four floats in plain Rust: any machine, and Miri. The compiler makes SSE or NEON vectors of it.

use super::Lanes;

#[derive(Clone, Copy)]
pub(crate) struct Portable;

#[derive(Clone, Copy)]
#[repr(align(16))]
pub(crate) struct Four([f32; 4]);

/// Where the target always has the fused instruction it is one operation; elsewhere it would be a call of a library.
const FUSED: bool = cfg!(any(target_arch = "aarch64", target_feature = "fma"));

impl Lanes for Portable {
    const COUNT: usize = 4;
    /// aarch64 has 32 registers, x86-64 without AVX-512 has 16.
    const TILE: usize = if cfg!(target_arch = "aarch64") { 8 } else { 4 };
    type Vector = Four;

    #[inline(always)]
    fn splat(self, value: f32) -> Four {
        Four([value; 4])
    }

    #[inline(always)]
    fn add(self, a: Four, b: Four) -> Four {
        let (Four(a), Four(b)) = (a, b);
        Four([a[0] + b[0], a[1] + b[1], a[2] + b[2], a[3] + b[3]])
    }

    #[inline(always)]
    fn sub(self, a: Four, b: Four) -> Four {
        let (Four(a), Four(b)) = (a, b);
        Four([a[0] - b[0], a[1] - b[1], a[2] - b[2], a[3] - b[3]])
    }

    #[inline(always)]
    fn mul_add(self, a: Four, b: Four, c: Four) -> Four {
        let (Four(a), Four(b), Four(c)) = (a, b, c);
        if FUSED {
            Four([
                a[0].mul_add(b[0], c[0]),
                a[1].mul_add(b[1], c[1]),
                a[2].mul_add(b[2], c[2]),
                a[3].mul_add(b[3], c[3]),
            ])
        } else {
            Four([a[0] * b[0] + c[0], a[1] * b[1] + c[1], a[2] * b[2] + c[2], a[3] * b[3] + c[3]])
        }
    }

    #[inline(always)]
    fn relu(self, a: Four) -> Four {
        let Four(a) = a;
        let mut kept = [0.0; 4];
        for i in 0..4 {
            kept[i] = if a[i] < 0.0 { 0.0 } else { a[i] };
        }
        Four(kept)
    }

    #[inline(always)]
    fn keep_where_positive(self, condition: Four, value: Four) -> Four {
        let (Four(condition), Four(value)) = (condition, value);
        let mut kept = [0.0; 4];
        for i in 0..4 {
            kept[i] = if condition[i] > 0.0 { value[i] } else { 0.0 };
        }
        Four(kept)
    }

    #[inline(always)]
    fn keep_where_equal(self, a: Four, b: Four, value: Four) -> Four {
        let (Four(a), Four(b), Four(value)) = (a, b, value);
        let mut kept = [0.0; 4];
        for i in 0..4 {
            kept[i] = if a[i] == b[i] { value[i] } else { 0.0 };
        }
        Four(kept)
    }

    #[inline(always)]
    fn keep_where_unequal(self, a: Four, b: Four, value: Four) -> Four {
        let (Four(a), Four(b), Four(value)) = (a, b, value);
        let mut kept = [0.0; 4];
        for i in 0..4 {
            kept[i] = if a[i] == b[i] { 0.0 } else { value[i] };
        }
        Four(kept)
    }

    #[inline(always)]
    fn max(self, a: Four, b: Four) -> Four {
        let (Four(a), Four(b)) = (a, b);
        let mut larger = a;
        for i in 0..4 {
            if b[i] > a[i] || b[i].is_nan() {
                larger[i] = b[i];
            }
        }
        Four(larger)
    }

    #[inline(always)]
    fn sum(self, a: Four) -> f32 {
        let Four(a) = a;
        (a[0] + a[2]) + (a[1] + a[3])
    }

    #[inline(always)]
    unsafe fn load(self, from: *const f32) -> Four {
        // SAFETY: the caller promises four readable floats; an array of floats needs no more alignment than they have.
        Four(unsafe { from.cast::<[f32; 4]>().read() })
    }

    #[inline(always)]
    unsafe fn store(self, to: *mut f32, vector: Four) {
        // SAFETY: the caller promises four writable floats.
        unsafe { to.cast::<[f32; 4]>().write(vector.0) }
    }

    #[inline(always)]
    unsafe fn store_lanes(self, to: *mut f32, vector: Four, first: usize, end: usize) {
        for lane in first..end {
            // SAFETY: the caller promises that these elements are writable. `to` itself may lie outside of its array,
            // and so the arithmetic wraps.
            unsafe { to.wrapping_add(lane).write(vector.0[lane]) };
        }
    }

    #[inline(always)]
    unsafe fn load_deinterleaved(self, from: *const f32) -> [Four; 2] {
        // SAFETY: the caller promises eight readable floats.
        let [a, b, c, d, e, f, g, h] = unsafe { from.cast::<[f32; 8]>().read() };
        [Four([a, c, e, g]), Four([b, d, f, h])]
    }

    #[inline(always)]
    unsafe fn store_interleaved(self, to: *mut f32, even: Four, odd: Four) {
        let (Four(even), Four(odd)) = (even, odd);
        let all = [even[0], odd[0], even[1], odd[1], even[2], odd[2], even[3], odd[3]];
        // SAFETY: the caller promises eight writable floats.
        unsafe { to.cast::<[f32; 8]>().write(all) }
    }
}
