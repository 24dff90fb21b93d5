//! Vectors of floats: one trait, and an implementation a set of instructions.

#[cfg(all(target_arch = "x86_64", not(miri)))]
mod avx2;
#[cfg(all(target_arch = "x86_64", not(miri)))]
mod avx512;
mod portable;

#[cfg(all(target_arch = "x86_64", not(miri)))]
pub(crate) use avx2::Avx2;
#[cfg(all(target_arch = "x86_64", not(miri)))]
pub(crate) use avx512::Avx512;
pub(crate) use portable::Portable;

/// A value of an implementing type is a proof that the machine has its instructions.
///
/// Every method is `#[inline(always)]`; see [`crate::path::Kernel`].
pub(crate) trait Lanes: Copy {
    /// Floats in a vector; at most [`MAX_COUNT`].
    const COUNT: usize;
    /// Output channels in a full register tile: 8 where there are 32 registers, 4 where there are 16.
    const TILE: usize;
    /// A vector.
    type Vector: Copy;

    fn splat(self, value: f32) -> Self::Vector;
    fn add(self, a: Self::Vector, b: Self::Vector) -> Self::Vector;
    fn sub(self, a: Self::Vector, b: Self::Vector) -> Self::Vector;
    /// `a * b + c`, rounded once where the machine can.
    fn mul_add(self, a: Self::Vector, b: Self::Vector, c: Self::Vector) -> Self::Vector;
    /// `max(a, 0)`, with NaN kept.
    fn relu(self, a: Self::Vector) -> Self::Vector;
    /// `value` where `condition > 0`, else 0.
    fn keep_where_positive(self, condition: Self::Vector, value: Self::Vector) -> Self::Vector;
    /// `value` where `a == b`, else 0.
    fn keep_where_equal(self, a: Self::Vector, b: Self::Vector, value: Self::Vector) -> Self::Vector;
    /// 0 where `a == b`, else `value`.
    fn keep_where_unequal(self, a: Self::Vector, b: Self::Vector, value: Self::Vector) -> Self::Vector;
    /// The larger one, or NaN if either is.
    fn max(self, a: Self::Vector, b: Self::Vector) -> Self::Vector;
    /// The sum of all lanes, in an order that does not vary.
    fn sum(self, a: Self::Vector) -> f32;

    /// # Safety
    /// `from` must be valid for reading `COUNT` floats. No alignment is needed.
    unsafe fn load(self, from: *const f32) -> Self::Vector;
    /// # Safety
    /// `to` must be valid for writing `COUNT` floats. No alignment is needed.
    unsafe fn store(self, to: *mut f32, vector: Self::Vector);
    /// Stores lanes `first..end` at `to + first..to + end`, and touches nothing else.
    ///
    /// # Safety
    /// `first < end <= COUNT`, and those elements must be valid for writing; the rest of `to` need not exist.
    unsafe fn store_lanes(self, to: *mut f32, vector: Self::Vector, first: usize, end: usize);

    /// `from[0]`, `from[2]`, `from[4]` and so on, and `from[1]`, `from[3]` and so on.
    ///
    /// # Safety
    /// `from` must be valid for reading `2 COUNT` floats.
    unsafe fn load_deinterleaved(self, from: *const f32) -> [Self::Vector; 2];
    /// Stores the lanes of both in turns, beginning with the even ones.
    ///
    /// # Safety
    /// `to` must be valid for writing `2 COUNT` floats.
    unsafe fn store_interleaved(self, to: *mut f32, even: Self::Vector, odd: Self::Vector);

    /// The sum of the lanes of each of `N` vectors.
    #[inline(always)]
    fn sums<const N: usize>(self, vectors: [Self::Vector; N]) -> [f32; N] {
        let mut sums = [0.0; N];
        for i in 0..N {
            sums[i] = self.sum(vectors[i]);
        }
        sums
    }
}

/// The longest vector of any implementation.
pub(crate) const MAX_COUNT: usize = 16;
