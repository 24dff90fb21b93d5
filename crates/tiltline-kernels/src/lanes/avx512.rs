//! Sixteen floats with AVX-512.

use super::Lanes;
use std::arch::x86_64::*;

#[derive(Clone, Copy)]
pub(crate) struct Avx512(());

impl Avx512 {
    /// Only callable where the instructions are known to be there.
    #[target_feature(enable = "avx512f,avx512vl,avx512bw,avx512dq,fma")]
    #[inline]
    pub(crate) fn new() -> Self {
        Self(())
    }
}

// In the blocks below "the token" is `self`: an `Avx512` can only be made where the instructions are present.
impl Lanes for Avx512 {
    const COUNT: usize = 16;
    const TILE: usize = 8;
    type Vector = __m512;

    #[inline(always)]
    fn splat(self, value: f32) -> __m512 {
        // SAFETY: the token proves that the instruction exists.
        unsafe { _mm512_set1_ps(value) }
    }

    #[inline(always)]
    fn add(self, a: __m512, b: __m512) -> __m512 {
        // SAFETY: the token proves that the instruction exists.
        unsafe { _mm512_add_ps(a, b) }
    }

    #[inline(always)]
    fn sub(self, a: __m512, b: __m512) -> __m512 {
        // SAFETY: the token proves that the instruction exists.
        unsafe { _mm512_sub_ps(a, b) }
    }

    #[inline(always)]
    fn mul_add(self, a: __m512, b: __m512, c: __m512) -> __m512 {
        // SAFETY: the token proves that the instruction exists.
        unsafe { _mm512_fmadd_ps(a, b, c) }
    }

    #[inline(always)]
    fn relu(self, a: __m512) -> __m512 {
        // The second operand is returned where either is NaN.
        // SAFETY: the token proves that the instructions exist.
        unsafe { _mm512_max_ps(_mm512_setzero_ps(), a) }
    }

    #[inline(always)]
    fn keep_where_positive(self, condition: __m512, value: __m512) -> __m512 {
        // SAFETY: the token proves that the instructions exist.
        unsafe { _mm512_maskz_mov_ps(_mm512_cmp_ps_mask::<_CMP_GT_OQ>(condition, _mm512_setzero_ps()), value) }
    }

    #[inline(always)]
    fn sum(self, a: __m512) -> f32 {
        // SAFETY: the token proves that the instruction exists.
        unsafe { _mm512_reduce_add_ps(a) }
    }

    #[inline(always)]
    unsafe fn load(self, from: *const f32) -> __m512 {
        // SAFETY: the caller promises sixteen readable floats; the token proves that the instruction exists.
        unsafe { _mm512_loadu_ps(from) }
    }

    #[inline(always)]
    unsafe fn store(self, to: *mut f32, vector: __m512) {
        // SAFETY: the caller promises sixteen writable floats; the token proves that the instruction exists.
        unsafe { _mm512_storeu_ps(to, vector) }
    }

    #[inline(always)]
    unsafe fn store_lanes(self, to: *mut f32, vector: __m512, first: usize, end: usize) {
        debug_assert!(first < end && end <= 16);
        let mask = ((0xffff_u32 << first) & (0xffff_u32 >> (16 - end))) as u16;
        // SAFETY: only lanes `first..end` are set in the mask, and the caller promises that these are writable; the token
        // proves that the instruction exists.
        unsafe { _mm512_mask_storeu_ps(to, mask, vector) }
    }
}
