//! Lines of one view of a series, and which of them is nearest to a point.

use std::sync::Arc;

use ndarray::{Array2, Zip};
use rstar::RTree;
use rstar::primitives::GeomWithData;

use super::{Series, SeriesError};
use crate::curve::TraceGraph;
use crate::filter::gaussian_blur;
use crate::geometry::{Point2, Similarity2, Vector2};
use crate::micrograph::{Micrograph, View};
use crate::pipeline::Detect;
use crate::rectify::{Rectification, RectifiedPair};
use crate::tomography::prepare::flattened;
use crate::trace::{TraceSettings, trace};

/// Standard deviation of the mean that is the background of a line, px: several times its width.
const BACKGROUND_PX: f64 = 12.0;
/// Standard deviation of the smoothing of contrast, px: as wide as a line.
const LINE_PX: f64 = 1.0;
/// Standard deviation of the mean that is the noise about a pixel, px.
const NOISE_PX: f64 = 36.0;
/// A place that differs from its background by less is the same everywhere.
const LEAST_SIGMA: f32 = 1e-5;

/// Views of a series that are asked how lines look in it, at most.
const MOST_ASKED: usize = 15;

/// Lines found in one view, in its input px.
#[derive(Clone, Debug, PartialEq)]
pub struct ViewLines {
    /// Centrelines.
    pub traces: TraceGraph,
    /// Rows and columns of the image.
    pub shape: [usize; 2],
    /// Probability of a line `[row, column]` in 255ths, as far below the threshold of tracing as the detector sees any; 0 by 0 where
    /// only the centrelines are known.
    pub probability: Arc<Array2<u8>>,
    /// How much darker than its surroundings a pixel is, smoothed to the width of a line, in steps of [`ViewLines::CONTRAST_STEP`] standard
    /// deviations of the image about it; 0 by 0 where it is not known.
    pub contrast: Arc<Array2<i8>>,
}

/// A view that is typical of how lines look in a series, normalised: beside it all views are looked at alike ([`detect_lines`]). Where lines
/// are between two widths single views want this or that by chance; what is found in all of them together decides. `None` where the detector
/// has nothing to decide, and where none of the views that are asked shows anything.
///
/// # Errors
/// Where a view cannot be read.
pub fn typical_view(series: &Series, detector: &dyn Detect) -> Result<Option<Array2<f32>>, SeriesError> {
    let count = series.views.len();
    let asked = count.min(MOST_ASKED);
    let mut found = Vec::new();
    for place in 0..asked {
        let view = place * (count - 1) / (asked - 1).max(1);
        let pixels = series.view(view)?.normalised();
        if pixels.iter().any(|value| *value != 0.0) {
            let looks = detector.looks(&pixels);
            if looks.is_empty() {
                return Ok(None);
            }
            found.push((view, looks));
        }
    }
    let (views, looks): (Vec<usize>, Vec<Vec<f64>>) = found.into_iter().unzip();
    typical(&looks).map(|place| Ok(series.view(views[place])?.normalised())).transpose()
}

/// The view that tells most clearly for the look at which most is found in all of them together, from what is found in each.
fn typical(found: &[Vec<f64>]) -> Option<usize> {
    let looks = found.iter().map(Vec::len).min()?;
    let sums: Vec<f64> = (0..looks).map(|look| found.iter().map(|each| each[look]).sum()).collect();
    let best = largest(&sums);
    let share = |each: &Vec<f64>| each[best] / each[largest(each)].max(f64::MIN_POSITIVE);
    // The first of equals.
    (0..found.len()).rev().max_by(|&a, &b| share(&found[a]).total_cmp(&share(&found[b])))
}

/// The place of the largest value, the first of equals.
fn largest(values: &[f64]) -> usize {
    (0..values.len()).rev().max_by(|&a, &b| values[a].total_cmp(&values[b])).unwrap_or(0)
}

/// Finds and traces the lines of a single view with the detector of a pair. What a detector decides for both views of a pair by the left one,
/// such as how wide lines are, it decides for all views of a series by the same one, `beside` which they are looked at ([`typical_view`]);
/// without it by the view alone.
pub fn detect_lines(
    image: &Micrograph,
    beside: Option<&Array2<f32>>,
    detector: &dyn Detect,
    settings: &TraceSettings,
) -> ViewLines {
    let pixels = image.normalised();
    let shape = [pixels.nrows(), pixels.ncols()];
    if pixels.iter().all(|value| *value == 0.0) {
        return ViewLines::new(TraceGraph::default(), shape);
    }
    let contrast = contrast(&pixels);
    let left = beside.unwrap_or(&pixels).clone();
    let rectification = Rectification::known([Similarity2::identity(); 2], shape);
    let pair = RectifiedPair { left, right: pixels, rectification };
    let map = detector.detect(&pair, View::Right);
    let probability = map.probability.mapv(|value| (255.0 * value.clamp(0.0, 1.0)).round() as u8);
    let lines = ViewLines::new(trace(&map, settings), shape);
    ViewLines { probability: Arc::new(probability), contrast: Arc::new(contrast), ..lines }
}

/// See [`ViewLines::contrast`].
fn contrast(pixels: &Array2<f32>) -> Array2<i8> {
    let mut darker = gaussian_blur(&flattened(pixels, BACKGROUND_PX).mapv_into(|value| -value), LINE_PX);
    // Noise is not the same everywhere; where there is no data there is none.
    let known = gaussian_blur(&darker.mapv(|value| if value == 0.0 { 0.0 } else { 1.0 }), NOISE_PX);
    let squares = gaussian_blur(&darker.mapv(|value| value * value), NOISE_PX);
    Zip::from(&mut darker).and(&squares).and(&known).for_each(|value, square, known| {
        let sigma = (square / known.max(1e-3)).sqrt();
        // What has no contrast has that of its rounding.
        *value = if sigma > LEAST_SIGMA { *value / (ViewLines::CONTRAST_STEP * sigma) } else { 0.0 };
    });
    darker.mapv(|value| value.round().clamp(-127.0, 127.0) as i8)
}

impl ViewLines {
    /// A step of [`ViewLines::contrast`]: 3 standard deviations are as much as there is.
    pub const CONTRAST_STEP: f32 = 3.0 / 127.0;

    /// Centrelines whose map of probabilities is not known.
    pub fn new(traces: TraceGraph, shape: [usize; 2]) -> Self {
        Self { traces, shape, probability: Arc::default(), contrast: Arc::default() }
    }

    /// Length of all lines, px.
    pub fn length_px(&self) -> f64 {
        self.traces.traces.iter().map(crate::curve::Trace::length_px).fold(0.0, |sum, length| sum + length)
    }
}

/// A point of a line that is near another point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NearLine {
    /// Index of the trace.
    pub trace: usize,
    /// Index of its point.
    pub point: usize,
    /// The nearest place on the line.
    pub place: Point2,
    /// Unit tangent of the line there.
    pub tangent: Vector2,
    /// One-sigma error of the line across itself, px.
    pub sigma_px: f64,
}

/// The lines of a view, to be asked for the nearest.
#[derive(Clone, Debug)]
pub struct LineIndex {
    tree: RTree<GeomWithData<[f64; 2], (usize, usize)>>,
    lines: ViewLines,
}

impl LineIndex {
    /// Indexes lines.
    pub fn new(lines: ViewLines) -> Self {
        let points = lines.traces.traces.iter().enumerate().flat_map(|(trace, line)| {
            let point = move |(index, point): (usize, &crate::curve::TracePoint)| {
                GeomWithData::new([point.position.x, point.position.y], (trace, index))
            };
            line.points.iter().enumerate().map(point)
        });
        Self { tree: RTree::bulk_load(points.collect()), lines }
    }

    /// The lines.
    pub fn lines(&self) -> &ViewLines {
        &self.lines
    }

    /// Distance to the nearest line, px; `None` without lines.
    pub fn distance(&self, point: &Point2) -> Option<f64> {
        let nearest = self.tree.nearest_neighbor([point.x, point.y])?;
        Some((self.near(nearest.data, point).place - point).norm())
    }

    /// The nearest line within `reach_px` whose direction is within `most_turn` (sine of the angle) of `tangent`.
    pub fn nearest_along(&self, point: &Point2, tangent: &Vector2, reach_px: f64, most_turn: f64) -> Option<NearLine> {
        let within = self.tree.locate_within_distance([point.x, point.y], reach_px * reach_px);
        let along = within.filter(|found| {
            let other = self.lines.traces.traces[found.data.0].points[found.data.1].tangent;
            (tangent.x * other.y - tangent.y * other.x).abs() <= most_turn
        });
        let squared = |found: &&GeomWithData<[f64; 2], (usize, usize)>| {
            (found.geom()[0] - point.x).powi(2) + (found.geom()[1] - point.y).powi(2)
        };
        // Equals in the order of the lines: the tree's own order is not part of the result.
        let found = along.min_by(|a, b| squared(a).total_cmp(&squared(b)).then(a.data.cmp(&b.data)))?;
        Some(self.near(found.data, point))
    }

    /// Where the line across a curve (through `point`, perpendicular to the unit `tangent`) meets a detected line that runs along it:
    /// the offset along the normal `(-tangent.y, tangent.x)`, and the line's own sigma, px. `None` where there is none within reach.
    ///
    /// Unlike the nearest point of a noisy line, this offset is not drawn towards where one looks from, and does not reach beyond
    /// the line's ends. Where two lines that run along each other are in reach, it is not known which is meant, and nothing is said.
    pub fn offset_across(
        &self,
        point: &Point2,
        tangent: &Vector2,
        reach_px: f64,
        most_turn: f64,
    ) -> Option<(f64, f64, usize)> {
        let near = self.nearest_along(point, tangent, reach_px, most_turn)?;
        if self.is_ambiguous(point, tangent, near.trace, reach_px, most_turn) {
            return None;
        }
        let points = &self.lines.traces.traces[near.trace].points;
        let along = |index: usize| tangent.dot(&(points[index].position - point));
        let normal = Vector2::new(-tangent.y, tangent.x);
        // From the nearest point outwards, on both sides in turn.
        let walk = 2 * reach_px.ceil() as usize + 2;
        let mut found: Option<(usize, f64)> = None;
        for start in (near.point.saturating_sub(walk)..(near.point + walk).min(points.len() - 1))
            .filter(|at| at + 1 < points.len())
        {
            let (a, b) = (along(start), along(start + 1));
            if a * b > 0.0 || a == b {
                continue;
            }
            let share = a / (a - b);
            let place = points[start].position + (points[start + 1].position - points[start].position) * share;
            let offset = normal.dot(&(place - point));
            let steps = start.abs_diff(near.point);
            if offset.abs() <= reach_px && found.is_none_or(|(best, _)| steps < best) {
                found = Some((steps, offset));
            }
        }
        found.map(|(_, offset)| (offset, near.sigma_px, near.trace))
    }

    /// Whether another line along the same direction is within reach.
    fn is_ambiguous(&self, point: &Point2, tangent: &Vector2, trace: usize, reach_px: f64, most_turn: f64) -> bool {
        self.tree.locate_within_distance([point.x, point.y], reach_px * reach_px).any(|found| {
            let other = self.lines.traces.traces[found.data.0].points[found.data.1].tangent;
            found.data.0 != trace && (tangent.x * other.y - tangent.y * other.x).abs() <= most_turn
        })
    }

    /// The foot of a point on the polyline about one of its points.
    fn near(&self, (trace, index): (usize, usize), point: &Point2) -> NearLine {
        let points = &self.lines.traces.traces[trace].points;
        let own = points[index].position;
        let mut best = own;
        for other in [index.checked_sub(1), Some(index + 1)].into_iter().flatten().filter_map(|at| points.get(at)) {
            let along = other.position - own;
            let foot = ((point - own).dot(&along) / along.norm_squared().max(1e-12)).clamp(0.0, 1.0);
            let place = own + along * foot;
            if (place - point).norm_squared() < (best - point).norm_squared() {
                best = place;
            }
        }
        let crate::curve::TracePoint { tangent, sigma_perp_px, .. } = points[index];
        NearLine { trace, point: index, place: best, tangent, sigma_px: sigma_perp_px }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::curve::LineMap;

    /// Sees the lines of a view as clearly as the left one is bright.
    struct Both;

    impl Detect for Both {
        fn detect(&self, pair: &RectifiedPair, view: View) -> LineMap {
            let probability = pair.view(view).mapv(|value| value * pair.left[[0, 0]]);
            LineMap { probability, line_width_px: 3.0 }
        }
    }

    /// What is found in a view depends on the view that it is seen beside, which may have another shape, or on itself alone.
    #[test]
    fn a_view_is_seen_beside_another() {
        let pixels = Array2::from_shape_fn([20, 30], |(_, column)| if column < 3 { 1.0 } else { 0.0 });
        let image = Micrograph::new(pixels);
        let found = |beside: Option<&Array2<f32>>| {
            detect_lines(&image, beside, &Both, &TraceSettings::default()).probability[[0, 1]]
        };
        assert_eq!(found(None), 255);
        assert_eq!(found(Some(&Array2::from_elem([8, 9], 0.2))), 51);
        assert_eq!(found(Some(&Array2::zeros([50, 9]))), 0);
    }

    /// Views of which some want this look and some that by a little: what they have together decides, and a view that wants that, or nearly does,
    /// stands for all.
    #[test]
    fn what_all_views_have_together_decides() {
        let of = |found: &[&[f64]]| typical(&found.iter().map(|each| each.to_vec()).collect::<Vec<_>>());
        assert_eq!(of(&[&[1.0, 1.1, 0.2], &[3.0, 2.0, 0.1], &[1.0, 1.2, 0.3]]), Some(1));
        assert_eq!(of(&[&[1.0, 1.1], &[1.0, 0.95], &[0.8, 1.0]]), Some(0));
        assert_eq!(of(&[&[1.0, 0.8, 0.0], &[0.0, 0.9, 1.0]]), Some(1));
        // A view without lines wants nothing; views may be too small for a look.
        assert_eq!(of(&[&[0.0; 3], &[0.0; 2]]), Some(0));
        assert_eq!(of(&[&[0.1], &[0.0, 5.0, 5.0]]), Some(0));
        assert_eq!(of(&[]), None);
    }

    /// A dark line stands out by its sign and in the view's own noise, whatever the grey levels; nothing does so by more than is kept.
    #[test]
    fn a_dark_line_has_positive_contrast_and_a_bright_one_negative() {
        for (level, gain) in [(0.5_f32, 1.0_f32), (200.0, 300.0)] {
            let noise = |row: usize, column: usize| 0.02 * ((7 * row + 13 * column) as f32).sin();
            let value = |(row, column): (usize, usize)| match column {
                30 => -0.1,
                70 => 0.1,
                _ => noise(row, column),
            };
            let found = contrast(&Array2::from_shape_fn([90, 100], |at| level + gain * value(at)));
            assert!(found[[45, 30]] > 60 && found[[45, 70]] < -60 && found[[45, 50]].abs() < 40, "{found}");
        }
        assert!(contrast(&Array2::from_elem([20, 20], 3.0)).iter().all(|value| *value == 0));
    }
}
