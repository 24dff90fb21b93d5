//! Line masks from sub-pixel curves.

use ndarray::Array2;

use crate::geometry::Point2;
use crate::truth::TrueView;

/// Pixels `[row, column]` whose centre lies within half of `width_px` of the contrast of a curve; `visible_only` leaves out
/// what does not stand out from the noise. A line narrower than 1 px may have gaps.
pub fn curve_mask(view: &TrueView, closed: impl Fn(&str) -> bool, width_px: f64, visible_only: bool) -> Array2<bool> {
    let mut mask = Array2::from_elem([view.height, view.width], false);
    for curve in &view.curves {
        let points = &curve.contrast;
        let count = points.len();
        for end in 1..count + usize::from(closed(&curve.label)) {
            let (from, to) = (end - 1, end % count);
            if !visible_only || (curve.is_visible(from) && curve.is_visible(to)) {
                draw_segment(&mut mask, points[from], points[to], width_px);
            }
        }
    }
    mask
}

/// Sets the pixels whose centre lies within half of `width_px` of a polyline.
pub fn draw_polyline(mask: &mut Array2<bool>, points: &[Point2], width_px: f64) {
    for ends in points.windows(2) {
        draw_segment(mask, ends[0], ends[1], width_px);
    }
}

fn draw_segment(mask: &mut Array2<bool>, a: Point2, b: Point2, width_px: f64) {
    let radius = 0.5 * width_px;
    let along = b - a;
    let length2 = along.norm_squared().max(1e-12);
    let (height, width) = mask.dim();
    let range = |low: f64, high: f64, count: usize| {
        let (low, high) = ((low - radius).ceil().max(0.0), (high + radius).floor().min(count as f64 - 1.0));
        if low <= high { low as usize..high as usize + 1 } else { 0..0 }
    };
    for row in range(a.y.min(b.y), a.y.max(b.y), height) {
        for column in range(a.x.min(b.x), a.x.max(b.x), width) {
            let offset = Point2::new(column as f64, row as f64) - a;
            let foot = (offset.dot(&along) / length2).clamp(0.0, 1.0);
            if (offset - along * foot).norm_squared() <= radius * radius {
                mask[[row, column]] = true;
            }
        }
    }
}
