//! From costs to matched curves: the cheapest smooth path of disparities along each left line, then the soft-argmin (paper,
//! Equation 1) about it.

use tiltline::curve::{LineMap, MatchedCurve, Trace, TraceGraph};
use tiltline::filter::sample_linear;
use tiltline::geometry::angle_to_row;
use tiltline::matching::{Measured, assemble};
use tiltline::rectify::Rectification;

use super::costs::Costs;
use super::octaves::halved_at;

/// Disparity changes by at most this much per px along a line, px.
const MAX_SLOPE: f64 = 1.0;
/// Cost of a change of disparity by 1 px from one point to the next: what the logarithm of a probability loses.
const CHANGE_COST: f32 = 0.7;
/// The soft-argmin is taken over the levels this close to the path, px.
const WINDOW_PX: f32 = 4.0;
/// Least share of the probability within the window: less is no match.
const LEAST_SHARE: f64 = 0.25;
/// Least probability of a line in the right image within [`NEAR_PX`] of the match.
const LEAST_LINE: f32 = 0.25;
const NEAR_PX: i32 = 3;
/// Error where the truth is outside the window, px.
const OUTSIDE_PX: f64 = 6.0;
/// Lines closer to the row than half a degree are no better known than at half a degree.
const LEAST_SINE: f64 = 0.0087;
/// Smallest sigma, px: the network's levels are 1 px apart.
const LEAST_SIGMA_PX: f64 = 0.3;

/// Matched curves along the left traces, with disparities in `range_px`; the costs are of images halved `octave` times.
pub fn match_traces(
    costs: &Costs,
    octave: u32,
    right: &LineMap,
    left: &TraceGraph,
    rectification: &Rectification,
    range_px: [f64; 2],
) -> Vec<MatchedCurve> {
    let spread_px = (range_px[1] - range_px[0]) / 12.0_f64.sqrt();
    let curves = left.traces.iter().enumerate().flat_map(|(index, trace)| {
        let measured = measure(costs, octave, right, trace, range_px);
        assemble(index, trace, &measured, rectification.sigma_row_px, spread_px)
    });
    curves.collect()
}

fn measure(costs: &Costs, octave: u32, right: &LineMap, trace: &Trace, [low, high]: [f64; 2]) -> Vec<Option<Measured>> {
    // Levels are px of the halved images; all else is px of the images.
    let scale = f64::from(1_u32 << octave);
    let levels = &costs.levels_px;
    let logs: Vec<Option<Vec<f32>>> = trace
        .points
        .iter()
        .map(|point| {
            let [x, y] = [point.position.x, point.position.y].map(|at| halved_at(at, octave));
            costs.at(x, y).map(|costs| log_probabilities(&costs))
        })
        .collect();
    let allowed: Vec<bool> = levels.iter().map(|level| (low..=high).contains(&(scale * f64::from(*level)))).collect();
    if !allowed.iter().any(|allowed| *allowed) {
        return vec![None; trace.points.len()];
    }
    let path = smooth_path(&logs, &allowed);
    let points = trace.points.iter().zip(&logs).zip(path);
    points
        .map(|((point, logs), level)| {
            let logs = logs.as_ref()?;
            let near = (0..levels.len()).filter(|&other| (levels[other] - levels[level]).abs() <= WINDOW_PX);
            let (mut sum, mut mean) = (0.0, 0.0);
            for index in near.clone() {
                let p = f64::from(logs[index].exp());
                sum += p;
                mean += p * f64::from(levels[index]);
            }
            if sum < LEAST_SHARE {
                return None;
            }
            let mean = mean / sum;
            let variance: f64 =
                near.map(|index| f64::from(logs[index].exp()) * (f64::from(levels[index]) - mean).powi(2)).sum::<f64>()
                    / sum;
            let line = (-NEAR_PX..=NEAR_PX).filter_map(|offset| {
                let x = point.position.x + scale * (mean + f64::from(offset));
                sample_linear(&right.probability.view(), x, point.position.y)
            });
            if line.fold(0.0, f32::max) < LEAST_LINE {
                return None;
            }
            // What lies outside the window may be the truth.
            let doubt = (variance + (1.0 - sum) * OUTSIDE_PX * OUTSIDE_PX).sqrt().max(LEAST_SIGMA_PX);
            let along = point.sigma_perp_px / angle_to_row(&point.tangent).sin().max(LEAST_SINE);
            let sigma_px = (scale * doubt).hypot(along);
            Some(Measured { disparity_px: scale * mean, sigma_px, tangent_right: None })
        })
        .collect()
}

/// Logarithms of `softmax(-cost)`.
fn log_probabilities(costs: &[f32]) -> Vec<f32> {
    let least = costs.iter().copied().fold(f32::INFINITY, f32::min);
    let sum: f32 = costs.iter().map(|cost| (least - cost).exp()).sum();
    costs.iter().map(|cost| least - cost - sum.ln()).collect()
}

/// The levels of the most probable path, one a point, with a price on every change (Viterbi 1967). Points without costs pass
/// on what their neighbours say.
fn smooth_path(logs: &[Option<Vec<f32>>], allowed: &[bool]) -> Vec<usize> {
    let count = allowed.len();
    let reach = MAX_SLOPE.ceil() as usize;
    let start: Vec<f32> = allowed.iter().map(|allowed| if *allowed { 0.0 } else { f32::INFINITY }).collect();
    let mut total = start;
    let mut from: Vec<Vec<usize>> = Vec::with_capacity(logs.len());
    for (index, logs) in logs.iter().enumerate() {
        let mut next = vec![f32::INFINITY; count];
        let mut came = vec![0; count];
        for level in (0..count).filter(|&level| allowed[level]) {
            let lowest = if index == 0 { level } else { level.saturating_sub(reach) };
            let highest = if index == 0 { level } else { (level + reach).min(count - 1) };
            for (before, total) in total.iter().enumerate().take(highest + 1).skip(lowest) {
                let price = total + CHANGE_COST * level.abs_diff(before) as f32;
                if price < next[level] {
                    (next[level], came[level]) = (price, before);
                }
            }
            // A point alone cannot rule a path out: another line may cross there.
            next[level] += logs.as_ref().map_or(0.0, |logs| (-logs[level]).min(6.0));
        }
        total = next;
        from.push(came);
    }
    let mut level = (0..count).min_by(|a, b| total[*a].total_cmp(&total[*b])).unwrap_or(0);
    let mut path = vec![0; logs.len()];
    for index in (0..logs.len()).rev() {
        path[index] = level;
        level = from[index][level];
    }
    path
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Where another line crosses, the network is surer of that one for a few points; the path stays with its own.
    #[test]
    fn the_path_passes_a_crossing() {
        let peaked = |at: usize| {
            let costs: Vec<f32> = (0..21).map(|level: usize| 2.0 * level.abs_diff(at) as f32).collect();
            log_probabilities(&costs)
        };
        let logs: Vec<Option<Vec<f32>>> =
            (0..40).map(|point| Some(peaked(if (18..22).contains(&point) { 15 } else { 5 + point / 10 }))).collect();
        let path = smooth_path(&logs, &[true; 21]);
        for (point, level) in path.iter().enumerate() {
            assert!(level.abs_diff(5 + point / 10) <= 1, "{level} at {point}");
        }
    }

    #[test]
    fn probabilities_sum_to_one() {
        let sum: f32 = log_probabilities(&[3.0, -1.0, 700.0, 0.5]).iter().map(|log| log.exp()).sum();
        assert!((sum - 1.0).abs() < 1e-6);
    }
}
