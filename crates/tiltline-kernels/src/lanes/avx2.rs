//! Eight floats with AVX2 and FMA.

use super::Lanes;
use std::arch::x86_64::*;

#[derive(Clone, Copy)]
pub(crate) struct Avx2(());

impl Avx2 {
    /// Only callable where the instructions are known to be there.
    #[target_feature(enable = "avx2,fma")]
    #[inline]
    pub(crate) fn new() -> Self {
        Self(())
    }
}

/// `MASKS[8 - n..]` starts with `n` set lanes; `MASKS[16 - n..]` with `n` clear ones (as far as 8 lanes go).
static MASKS: [i32; 24] = [-1, -1, -1, -1, -1, -1, -1, -1, 0, 0, 0, 0, 0, 0, 0, 0, -1, -1, -1, -1, -1, -1, -1, -1];

// In the blocks below "the token" is `self`: an `Avx2` can only be made where AVX2 and FMA are present.
impl Lanes for Avx2 {
    const COUNT: usize = 8;
    const TILE: usize = 4;
    type Vector = __m256;

    #[inline(always)]
    fn splat(self, value: f32) -> __m256 {
        // SAFETY: the token proves that the instruction exists.
        unsafe { _mm256_set1_ps(value) }
    }

    #[inline(always)]
    fn add(self, a: __m256, b: __m256) -> __m256 {
        // SAFETY: the token proves that the instruction exists.
        unsafe { _mm256_add_ps(a, b) }
    }

    #[inline(always)]
    fn sub(self, a: __m256, b: __m256) -> __m256 {
        // SAFETY: the token proves that the instruction exists.
        unsafe { _mm256_sub_ps(a, b) }
    }

    #[inline(always)]
    fn mul_add(self, a: __m256, b: __m256, c: __m256) -> __m256 {
        // SAFETY: the token proves that the instruction exists.
        unsafe { _mm256_fmadd_ps(a, b, c) }
    }

    #[inline(always)]
    fn relu(self, a: __m256) -> __m256 {
        // The second operand is returned where either is NaN.
        // SAFETY: the token proves that the instructions exist.
        unsafe { _mm256_max_ps(_mm256_setzero_ps(), a) }
    }

    #[inline(always)]
    fn keep_where_positive(self, condition: __m256, value: __m256) -> __m256 {
        // SAFETY: the token proves that the instructions exist.
        unsafe { _mm256_and_ps(_mm256_cmp_ps::<_CMP_GT_OQ>(condition, _mm256_setzero_ps()), value) }
    }

    #[inline(always)]
    fn keep_where_equal(self, a: __m256, b: __m256, value: __m256) -> __m256 {
        // SAFETY: the token proves that the instructions exist.
        unsafe { _mm256_and_ps(_mm256_cmp_ps::<_CMP_EQ_OQ>(a, b), value) }
    }

    #[inline(always)]
    fn keep_where_unequal(self, a: __m256, b: __m256, value: __m256) -> __m256 {
        // SAFETY: the token proves that the instructions exist.
        unsafe { _mm256_andnot_ps(_mm256_cmp_ps::<_CMP_EQ_OQ>(a, b), value) }
    }

    #[inline(always)]
    fn max(self, a: __m256, b: __m256) -> __m256 {
        // The instruction returns its second operand where either is NaN: right where it is `a` that is.
        // SAFETY: the token proves that the instructions exist.
        unsafe { _mm256_blendv_ps(_mm256_max_ps(b, a), b, _mm256_cmp_ps::<_CMP_UNORD_Q>(b, b)) }
    }

    #[inline(always)]
    fn sum(self, a: __m256) -> f32 {
        // SAFETY: the token proves that the instructions exist.
        unsafe {
            let four = _mm_add_ps(_mm256_castps256_ps128(a), _mm256_extractf128_ps::<1>(a));
            let two = _mm_add_ps(four, _mm_movehl_ps(four, four));
            _mm_cvtss_f32(_mm_add_ss(two, _mm_movehdup_ps(two)))
        }
    }

    #[inline(always)]
    unsafe fn load(self, from: *const f32) -> __m256 {
        // SAFETY: the caller promises eight readable floats; the token proves that the instruction exists.
        unsafe { _mm256_loadu_ps(from) }
    }

    #[inline(always)]
    unsafe fn store(self, to: *mut f32, vector: __m256) {
        // SAFETY: the caller promises eight writable floats; the token proves that the instruction exists.
        unsafe { _mm256_storeu_ps(to, vector) }
    }

    #[inline(always)]
    unsafe fn store_lanes(self, to: *mut f32, vector: __m256, first: usize, end: usize) {
        debug_assert!(first < end && end <= 8);
        // SAFETY: `first <= 8` and `end <= 8`, so both loads stay inside `MASKS`; only lanes `first..end` are set in the mask,
        // and the caller promises that these are writable; the token proves that the instructions exist.
        unsafe {
            let below_end = _mm256_loadu_si256(MASKS.as_ptr().add(8 - end).cast());
            let from_first = _mm256_loadu_si256(MASKS.as_ptr().add(16 - first).cast());
            _mm256_maskstore_ps(to, _mm256_and_si256(below_end, from_first), vector);
        }
    }

    #[inline(always)]
    unsafe fn load_deinterleaved(self, from: *const f32) -> [__m256; 2] {
        // SAFETY: the caller promises sixteen readable floats; the token proves that the instructions exist.
        unsafe {
            let (low, high) = (_mm256_loadu_ps(from), _mm256_loadu_ps(from.add(8)));
            // Pairs in the order low, high, low, high.
            let even = _mm256_castps_pd(_mm256_shuffle_ps::<0b10_00_10_00>(low, high));
            let odd = _mm256_castps_pd(_mm256_shuffle_ps::<0b11_01_11_01>(low, high));
            [
                _mm256_castpd_ps(_mm256_permute4x64_pd::<0b11_01_10_00>(even)),
                _mm256_castpd_ps(_mm256_permute4x64_pd::<0b11_01_10_00>(odd)),
            ]
        }
    }

    #[inline(always)]
    unsafe fn store_interleaved(self, to: *mut f32, even: __m256, odd: __m256) {
        // SAFETY: the caller promises sixteen writable floats; the token proves that the instructions exist.
        unsafe {
            // Within each half of the registers.
            let (low, high) = (_mm256_unpacklo_ps(even, odd), _mm256_unpackhi_ps(even, odd));
            _mm256_storeu_ps(to, _mm256_permute2f128_ps::<0x20>(low, high));
            _mm256_storeu_ps(to.add(8), _mm256_permute2f128_ps::<0x31>(low, high));
        }
    }

    #[inline(always)]
    fn sums<const N: usize>(self, vectors: [__m256; N]) -> [f32; N] {
        let mut sums = [0.0; N];
        let (fours, _) = vectors.as_chunks::<4>();
        for (sums, &[a, b, c, d]) in sums.chunks_exact_mut(4).zip(fours) {
            // SAFETY: the token proves that the instructions exist; `sums` has room for four floats.
            unsafe {
                let halves = _mm256_hadd_ps(_mm256_hadd_ps(a, b), _mm256_hadd_ps(c, d));
                let four = _mm_add_ps(_mm256_castps256_ps128(halves), _mm256_extractf128_ps::<1>(halves));
                _mm_storeu_ps(sums.as_mut_ptr(), four);
            }
        }
        for i in N / 4 * 4..N {
            sums[i] = self.sum(vectors[i]);
        }
        sums
    }
}
