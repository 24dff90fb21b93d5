//! Which two views of a series make the pair of a reconstruction.

use rayon::prelude::*;

use super::{Series, SeriesError, SeriesView, detect_lines};
use crate::micrograph::Micrograph;
use crate::ridge::RidgeDetector;
use crate::trace::TraceSettings;

/// The angle between the views that is best: further apart depth is sharper and lines change more (paper, Table 4: errors are
/// least at about 8 degrees).
const WANTED_DEG: f64 = 8.0;
/// Angles that are taken if there are any.
const POSSIBLE_DEG: [f64; 2] = [3.0, 16.0];
/// A pair that is so many degrees off the wanted angle is as bad as one whose middle is tilted by [`TILTED_DEG`].
const OFF_DEG: f64 = 4.0;
const TILTED_DEG: f64 = 12.0;
/// Views are looked at up to this tilt from the least tilted one, degrees, and at most so many of them.
const REACH_DEG: f64 = 14.0;
const MOST_VIEWS: usize = 17;
/// A view with less than this share of the usual length of lines is not used.
const LEAST_LINES: f64 = 0.6;
/// Images are averaged down to at most so many px a side for the comparison.
const LARGEST_PX: usize = 512;

/// The views of a pair, by their places in [`Series::views`]; left is the one of the smaller tilt unless asked otherwise.
#[derive(Clone, Debug, PartialEq)]
pub struct ChosenPair {
    /// Left and right.
    pub views: [usize; 2],
    /// Why these, in a sentence.
    pub reason: String,
}

/// The pair nearest to two angles in degrees, left and right.
///
/// # Errors
/// Where a view is further away than half a step, or both angles mean the same view.
pub fn pair_at(series: &Series, [left_deg, right_deg]: [f64; 2]) -> Result<ChosenPair, SeriesError> {
    let views = [series.nearest(left_deg)?, series.nearest(right_deg)?];
    let [left, right] = views.map(|view| series.views[view].tilt_deg);
    if views[0] == views[1] {
        return Err(SeriesError::OneView { first_deg: left_deg, second_deg: right_deg, view_deg: left });
    }
    let reason = format!("views at {left} and {right} degrees, nearest to the {left_deg} and {right_deg} asked for");
    Ok(ChosenPair { views, reason })
}

/// The best pair: about 8 degrees apart, about the least tilted view, of views with enough lines.
///
/// Lines are found by the ridge filter at reduced size, so that one rule serves every detector. A blurred view, and one in
/// which a bend contour or another diffraction condition hides the lines, has fewer.
///
/// # Errors
/// Where a view cannot be read, or fewer than two show lines.
pub fn choose_pair(series: &Series) -> Result<ChosenPair, SeriesError> {
    let tilt = |view: usize| series.views[view].tilt_deg;
    let least = (0..series.views.len()).min_by(|&a, &b| tilt(a).abs().total_cmp(&tilt(b).abs())).unwrap_or(0);
    let mut near: Vec<usize> = (0..series.views.len()).collect();
    near.sort_by(|&a, &b| (tilt(a) - tilt(least)).abs().total_cmp(&(tilt(b) - tilt(least)).abs()));
    let within = near.iter().filter(|&&view| (tilt(view) - tilt(least)).abs() <= REACH_DEG).count();
    // Steps may be wider than the reach: two views are always looked at, and some more in case they are no good.
    near.truncate(within.clamp(4, MOST_VIEWS).min(near.len()));
    near.sort_unstable();
    let images: Vec<Micrograph> = near.iter().map(|&view| series.view(view)).collect::<Result<_, _>>()?;
    let lengths: Vec<f64> = images.par_iter().map(line_length_px).collect();
    let mut sorted = lengths.clone();
    sorted.sort_by(f64::total_cmp);
    // Half of all views may be bad: the upper quartile is what a good one shows.
    let usual = sorted[(3 * sorted.len()) / 4];
    let usable = |at: usize| lengths[at] > 0.0 && lengths[at] >= LEAST_LINES * usual;
    let mut best: Option<(f64, [usize; 2])> = None;
    for first in (0..near.len()).filter(|&at| usable(at)) {
        for second in (first + 1..near.len()).filter(|&at| usable(at)) {
            let (phi, middle) =
                (tilt(near[second]) - tilt(near[first]), 0.5 * (tilt(near[second]) + tilt(near[first])));
            let outside = if (POSSIBLE_DEG[0]..=POSSIBLE_DEG[1]).contains(&phi) { 0.0 } else { 100.0 };
            let few = 2.0 - (lengths[first] + lengths[second]) / usual.max(1e-9);
            let cost =
                ((phi - WANTED_DEG) / OFF_DEG).powi(2) + (middle / TILTED_DEG).powi(2) + 0.5 * few.max(0.0) + outside;
            if best.is_none_or(|(least, _)| cost < least) {
                best = Some((cost, [first, second]));
            }
        }
    }
    let Some((_, places)) = best else {
        let seen: Vec<String> = near.iter().map(|&view| format!("{}", tilt(view))).collect();
        let what = format!(
            "of the views at {} degrees fewer than two show lines; name two with --pair LEFT,RIGHT",
            seen.join(", ")
        );
        return Err(SeriesError::Blank { path: series.path.clone(), what });
    };
    let [left, right] = places.map(|at| tilt(near[at]));
    let passed: Vec<String> = (0..near.len())
        .filter(|&at| !usable(at))
        .map(|at| format!("{} ({:.0} px)", tilt(near[at]), lengths[at]))
        .collect();
    let passed = match passed.is_empty() {
        true => String::new(),
        false => format!("; passed over for too few lines: {}", passed.join(", ")),
    };
    let reason = format!(
        "views at {left} and {right} degrees: {:.1} degrees apart ({WANTED_DEG} is best), {:.1} from untilted in the middle, with \
         {:.0} and {:.0} px of lines where a good view near them has {usual:.0}{passed}",
        right - left,
        (0.5 * (left + right)).abs(),
        lengths[places[0]],
        lengths[places[1]],
    );
    Ok(ChosenPair { views: places.map(|at| near[at]), reason })
}

/// Length of the lines of an image, px of the image as it is looked at.
fn line_length_px(image: &Micrograph) -> f64 {
    let step = image.width().max(image.height()).div_ceil(LARGEST_PX);
    let small = if step == 1 {
        image.clone()
    } else {
        let mean = |row: usize, column: usize| {
            let block =
                image.pixels.slice(ndarray::s![row * step..(row + 1) * step, column * step..(column + 1) * step]);
            block.mean().unwrap_or(0.0)
        };
        let shape = (image.height() / step, image.width() / step);
        Micrograph::new(ndarray::Array2::from_shape_fn(shape, |(row, column)| mean(row, column)))
    };
    detect_lines(&small, None, &RidgeDetector::default(), &TraceSettings::default()).length_px()
}

impl SeriesView {
    /// "36 (4 degrees)": section and tilt, for messages.
    pub fn name(&self) -> String {
        format!("{} ({} degrees)", self.section, self.tilt_deg)
    }
}
