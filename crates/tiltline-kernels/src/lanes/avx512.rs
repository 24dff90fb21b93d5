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
    fn keep_where_equal(self, a: __m512, b: __m512, value: __m512) -> __m512 {
        // SAFETY: the token proves that the instructions exist.
        unsafe { _mm512_maskz_mov_ps(_mm512_cmp_ps_mask::<_CMP_EQ_OQ>(a, b), value) }
    }

    #[inline(always)]
    fn keep_where_unequal(self, a: __m512, b: __m512, value: __m512) -> __m512 {
        // SAFETY: the token proves that the instructions exist.
        unsafe { _mm512_maskz_mov_ps(_mm512_cmp_ps_mask::<_CMP_NEQ_UQ>(a, b), value) }
    }

    #[inline(always)]
    fn max(self, a: __m512, b: __m512) -> __m512 {
        // The instruction returns its second operand where either is NaN: right where it is `a` that is.
        // SAFETY: the token proves that the instructions exist.
        unsafe { _mm512_mask_mov_ps(_mm512_max_ps(b, a), _mm512_cmp_ps_mask::<_CMP_UNORD_Q>(b, b), b) }
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

    #[inline(always)]
    unsafe fn load_deinterleaved(self, from: *const f32) -> [__m512; 2] {
        // SAFETY: the caller promises 32 readable floats; the token proves that the instructions exist.
        unsafe {
            let (low, high) = (_mm512_loadu_ps(from), _mm512_loadu_ps(from.add(16)));
            let even = _mm512_setr_epi32(0, 2, 4, 6, 8, 10, 12, 14, 16, 18, 20, 22, 24, 26, 28, 30);
            let odd = _mm512_setr_epi32(1, 3, 5, 7, 9, 11, 13, 15, 17, 19, 21, 23, 25, 27, 29, 31);
            [_mm512_permutex2var_ps(low, even, high), _mm512_permutex2var_ps(low, odd, high)]
        }
    }

    #[inline(always)]
    unsafe fn store_interleaved(self, to: *mut f32, even: __m512, odd: __m512) {
        // SAFETY: the caller promises 32 writable floats; the token proves that the instructions exist.
        unsafe {
            let low = _mm512_setr_epi32(0, 16, 1, 17, 2, 18, 3, 19, 4, 20, 5, 21, 6, 22, 7, 23);
            let high = _mm512_setr_epi32(8, 24, 9, 25, 10, 26, 11, 27, 12, 28, 13, 29, 14, 30, 15, 31);
            _mm512_storeu_ps(to, _mm512_permutex2var_ps(even, low, odd));
            _mm512_storeu_ps(to.add(16), _mm512_permutex2var_ps(even, high, odd));
        }
    }

    #[inline(always)]
    fn sums<const N: usize>(self, vectors: [__m512; N]) -> [f32; N] {
        let mut sums = [0.0; N];
        let (fours, _) = vectors.as_chunks::<4>();
        for (sums, &[a, b, c, d]) in sums.chunks_exact_mut(4).zip(fours) {
            // SAFETY: the token proves that the instructions exist; `sums` has room for four floats.
            unsafe {
                // First the halves of pairs of vectors, so that every later step works on whole registers.
                let ab = _mm512_add_ps(_mm512_shuffle_f32x4::<0x44>(a, b), _mm512_shuffle_f32x4::<0xee>(a, b));
                let cd = _mm512_add_ps(_mm512_shuffle_f32x4::<0x44>(c, d), _mm512_shuffle_f32x4::<0xee>(c, d));
                // Quarters in the order a, b, c, d.
                let abcd = _mm512_add_ps(_mm512_shuffle_f32x4::<0x88>(ab, cd), _mm512_shuffle_f32x4::<0xdd>(ab, cd));
                // The first lane of each quarter holds its sum after two more steps.
                let pairs = _mm512_add_ps(abcd, _mm512_permute_ps::<0b10_11_00_01>(abcd));
                let all = _mm512_add_ps(pairs, _mm512_permute_ps::<0b01_00_11_10>(pairs));
                let firsts = _mm512_setr_epi32(0, 4, 8, 12, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0);
                _mm_storeu_ps(sums.as_mut_ptr(), _mm512_castps512_ps128(_mm512_permutexvar_ps(firsts, all)));
            }
        }
        for i in N / 4 * 4..N {
            sums[i] = self.sum(vectors[i]);
        }
        sums
    }
}
