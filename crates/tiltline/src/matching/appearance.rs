//! How alike the surroundings of a left and a right point look: zero-mean normalised cross-correlation (NCC).
//!
//! NCC ignores gain and offset, which differ between views. A window is a stack of row profiles along the curve, so that
//! it follows both lines whatever their slopes and sums evidence along the arc, not across it. A line at another depth that
//! passes nearby moves against this one (the foil is transparent): where it was traced its pixels are left out, and each
//! window is scored three times, whole and with the background of one side only. Sums of moments instead of pixels make
//! stacking cheap.

use ndarray::Array2;

/// Longest profile: widest half-width is 16 px.
const MAX_PROFILE: usize = 33;
/// The one-sided windows have fewer pixels, so that chance agreement is higher; they must win by this much.
const ONE_SIDED_HANDICAP: f32 = 0.03;
/// Variance below which a window of a normalised image counts as empty.
const MIN_VARIANCE: f32 = 1e-6;

/// The half-widths of a row profile in px.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct ProfileShape {
    /// Half-width of the whole profile.
    pub half: usize,
    /// Half-width of its middle part, which holds the line.
    pub line: usize,
}

impl ProfileShape {
    /// Fits the line and about as much background on either side.
    pub fn for_line_width(line_width_px: f64) -> Self {
        let half = (1.5 * line_width_px).round().clamp(3.0, 13.0) as usize + 3;
        let line = (0.5 * line_width_px).round().clamp(1.0, 8.0) as usize + 1;
        Self { half, line }
    }
}

/// Intensity along a row, centred on a point; NaN where there is no data.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Profile {
    values: [f32; MAX_PROFILE],
}

impl Profile {
    /// Samples `[row, column]` bilinearly at `(x - half .. x + half, y)`.
    pub fn sample(image: &Array2<f32>, x: f64, y: f64, shape: ProfileShape) -> Self {
        let mut values = [f32::NAN; MAX_PROFILE];
        let (height, width) = image.dim();
        if y < 0.0 || y > height as f64 - 1.0 || !x.is_finite() {
            return Self { values };
        }
        let row = (y as usize).min(height.saturating_sub(2));
        let next_row = (row + 1).min(height - 1);
        let v = (y - row as f64) as f32;
        let left = x.floor();
        let u = (x - left) as f32;
        for (slot, value) in values.iter_mut().enumerate().take(2 * shape.half + 1) {
            let column = left as i64 + slot as i64 - shape.half as i64;
            // The last column has no right neighbour; it needs none where the weight is zero.
            if column < 0 || column as usize >= width {
                continue;
            }
            let column = column as usize;
            let next = if u > 0.0 { column + 1 } else { column };
            if next < width {
                let top = image[[row, column]] * (1.0 - u) + image[[row, next]] * u;
                let bottom = image[[next_row, column]] * (1.0 - u) + image[[next_row, next]] * u;
                *value = top * (1.0 - v) + bottom * v;
            }
        }
        Self { values }
    }

    /// Blanks the pixels that lie on other lines rather than on this one; `others` are their `x` on this row less this
    /// one's. They stand at their own depth, so that they move against this line from view to view.
    pub fn without_lines(mut self, others: impl Iterator<Item = f64>, shape: ProfileShape) -> Self {
        for other in others {
            for (slot, value) in self.values.iter_mut().enumerate().take(2 * shape.half + 1) {
                let offset = slot as f64 - shape.half as f64;
                if (offset - other).abs() <= shape.line as f64 && (offset - other).abs() < offset.abs() {
                    *value = f32::NAN;
                }
            }
        }
        self
    }

    /// The pixels of a row around `(column, row)`, which may lie outside the image.
    pub fn of_pixels(image: &Array2<f32>, column: i64, row: i64, shape: ProfileShape) -> Self {
        let mut values = [f32::NAN; MAX_PROFILE];
        let (height, width) = image.dim();
        if (0..height as i64).contains(&row) {
            for (slot, value) in values.iter_mut().enumerate().take(2 * shape.half + 1) {
                let column = column + slot as i64 - shape.half as i64;
                if (0..width as i64).contains(&column) {
                    *value = image[[row as usize, column as usize]];
                }
            }
        }
        Self { values }
    }
}

/// Sums over pairs of pixels from which NCC follows.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Moments {
    n: f32,
    left: f32,
    right: f32,
    left_left: f32,
    right_right: f32,
    left_right: f32,
}

impl Moments {
    fn add_pixel(&mut self, left: f32, right: f32) {
        // A product with a missing value is NaN, so one test serves both.
        let product = left * right;
        if product.is_finite() {
            self.n += 1.0;
            self.left += left;
            self.right += right;
            self.left_left += left * left;
            self.right_right += right * right;
            self.left_right += product;
        }
    }

    fn add(&mut self, other: &Self) {
        self.n += other.n;
        self.left += other.left;
        self.right += other.right;
        self.left_left += other.left_left;
        self.right_right += other.right_right;
        self.left_right += other.left_right;
    }

    /// Correlation in `[-1, 1]`; `None` with fewer than `min_n` pixels or without contrast.
    fn ncc(&self, min_n: f32) -> Option<f32> {
        if self.n < min_n {
            return None;
        }
        let variance_left = self.left_left / self.n - (self.left / self.n).powi(2);
        let variance_right = self.right_right / self.n - (self.right / self.n).powi(2);
        let covariance = self.left_right / self.n - self.left * self.right / (self.n * self.n);
        (variance_left > MIN_VARIANCE && variance_right > MIN_VARIANCE)
            .then(|| (covariance / (variance_left * variance_right).sqrt()).clamp(-1.0, 1.0))
    }
}

/// A comparison of windows: background on the left of the line, the line, background on its right.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Likeness {
    parts: [Moments; 3],
}

impl Likeness {
    /// Compares two profiles.
    pub fn of(left: &Profile, right: &Profile, shape: ProfileShape) -> Self {
        let mut parts = [Moments::default(); 3];
        let (start, end) = (shape.half - shape.line.min(shape.half), shape.half + shape.line.min(shape.half) + 1);
        for (part, range) in parts.iter_mut().zip([0..start, start..end, end..2 * shape.half + 1]) {
            for (left, right) in left.values[range.clone()].iter().zip(&right.values[range]) {
                part.add_pixel(*left, *right);
            }
        }
        Self { parts }
    }

    /// Adds the comparison of another row.
    pub fn add(&mut self, other: &Self) {
        for (part, other) in self.parts.iter_mut().zip(&other.parts) {
            part.add(other);
        }
    }

    /// NCC of the best of the three windows; `None` where there is too little data or contrast.
    pub fn ncc(&self) -> Option<f32> {
        let [left, line, right] = self.parts;
        let window = |parts: &[Moments]| {
            let mut sum = line;
            parts.iter().for_each(|part| sum.add(part));
            sum.ncc(9.0)
        };
        let whole = window(&[left, right]);
        let one_sided = [window(&[left]), window(&[right])].into_iter().flatten().map(|ncc| ncc - ONE_SIDED_HANDICAP);
        whole.into_iter().chain(one_sided).reduce(f32::max)
    }

    /// Number of pixels compared.
    pub fn pixels(&self) -> f32 {
        self.parts.iter().map(|part| part.n).sum()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use approx::assert_relative_eq;

    const SHAPE: ProfileShape = ProfileShape { half: 6, line: 2 };

    fn texture(x: f64) -> f32 {
        ((0.9 * x).sin() + (0.37 * x).cos()) as f32
    }

    #[test]
    fn gain_offset_and_missing_pixels_do_not_change_the_ncc_of_equal_windows() {
        let left = Array2::from_shape_fn((5, 40), |(_, x)| texture(x as f64));
        let mut right = left.mapv(|value| 3.0 * value - 1.0);
        right[[2, 15]] = f32::NAN;
        let (a, b) = (Profile::sample(&left, 18.0, 2.0, SHAPE), Profile::sample(&right, 18.0, 2.0, SHAPE));
        let likeness = Likeness::of(&a, &b, SHAPE);
        assert_eq!(likeness.pixels(), 12.0);
        assert_relative_eq!(likeness.ncc().expect("data"), 1.0, epsilon = 1e-5);
    }

    #[test]
    fn another_line_on_one_side_does_not_spoil_the_window() {
        // A dark line at 20 in both; a second one stands 5 px to the right in one image only.
        let dip = |x: f64, at: f64| (-0.5 * (x - at).powi(2) / 2.25).exp();
        let left = Array2::from_shape_fn((5, 40), |(_, x)| 1.0 - dip(x as f64, 20.0) as f32);
        let right = Array2::from_shape_fn((5, 40), |(_, x)| (1.0 - dip(x as f64, 20.0) - dip(x as f64, 25.5)) as f32);
        let (a, b) = (Profile::sample(&left, 20.0, 2.0, SHAPE), Profile::sample(&right, 20.0, 2.0, SHAPE));
        let likeness = Likeness::of(&a, &b, SHAPE);
        let mut whole = likeness.parts[1];
        whole.add(&likeness.parts[0]);
        whole.add(&likeness.parts[2]);
        assert!(whole.ncc(9.0).expect("data") < 0.7);
        assert!(likeness.ncc().expect("data") > 0.95);
    }

    #[test]
    fn a_traced_line_that_changes_sides_is_left_out() {
        // The other line stands on the right in one image and on the left in the other: no side is free in both.
        let dip = |x: f64, at: f64| (-0.5 * (x - at).powi(2) / 2.25).exp();
        let image = |other: f64| {
            Array2::from_shape_fn((5, 40), |(_, x)| (1.0 - dip(x as f64, 20.0) - dip(x as f64, 20.0 + other)) as f32)
        };
        let profile = |other: f64| Profile::sample(&image(other), 20.0, 2.0, SHAPE);
        let plain = Likeness::of(&profile(5.0), &profile(-5.0), SHAPE).ncc().expect("data");
        let [a, b] = [5.0, -5.0].map(|other| profile(other).without_lines([other].into_iter(), SHAPE));
        // One row leaves few pixels; a stack of them is what the matcher compares.
        let mut blanked = Likeness::of(&a, &b, SHAPE);
        blanked.add(&Likeness::of(&a, &b, SHAPE));
        assert!(plain < 0.8);
        // What is left of the other line is the tail of its profile.
        assert!(blanked.ncc().expect("data") > 0.9);
    }

    #[test]
    fn nothing_to_compare_gives_no_value() {
        let flat = Array2::from_elem((5, 40), 1.0_f32);
        let empty = Array2::from_elem((5, 40), f32::NAN);
        let profile = |image: &Array2<f32>| Profile::sample(image, 20.0, 2.0, SHAPE);
        assert_eq!(Likeness::of(&profile(&flat), &profile(&flat), SHAPE).ncc(), None);
        assert_eq!(Likeness::of(&profile(&flat), &profile(&empty), SHAPE).ncc(), None);
        assert_eq!(Likeness::of(&profile(&flat), &Profile::sample(&flat, 20.0, -1.0, SHAPE), SHAPE).pixels(), 0.0);
    }
}
