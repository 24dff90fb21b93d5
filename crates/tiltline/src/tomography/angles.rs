//! What the tilts of a series cover: the missing wedge, the angle each view stands for, and evenly spaced choices.

use std::f64::consts::PI;

use super::TomographyError;

/// Tilts closer than this are one direction, radians (0.001 degree).
const SAME_RAD: f64 = 0.001 * PI / 180.0;
/// The largest gap between neighbouring tilts is a missing wedge where it is this many times the middle one.
const WEDGE_GAPS: f64 = 1.9;

/// What a set of tilts covers.
#[derive(Clone, Debug, PartialEq)]
pub struct Coverage {
    /// Number of different directions.
    pub directions: usize,
    /// Least and largest tilt, radians.
    pub range_rad: [f64; 2],
    /// Largest angle without a view, radians; opposite directions show the same.
    pub missing_rad: f64,
    /// Whether that angle is a missing wedge rather than the step of a full turn.
    pub wedge: bool,
    /// The angle that each view stands for, radians: half way to its neighbours on either side, but not into the wedge; views
    /// of one direction share it.
    pub weights_rad: Vec<f64>,
}

/// What tilts (radians) cover.
///
/// # Errors
/// [`TomographyError::TooFewViews`] where there are not two directions, [`TomographyError::Value`] where a tilt is not finite.
pub fn coverage(tilts_rad: &[f64]) -> Result<Coverage, TomographyError> {
    if let Some(tilt) = tilts_rad.iter().find(|tilt| !tilt.is_finite()) {
        return Err(TomographyError::Value { name: "a tilt", value: *tilt, expected: "give finite angles" });
    }
    let mut order: Vec<(f64, usize)> =
        tilts_rad.iter().enumerate().map(|(view, tilt)| (tilt.rem_euclid(PI), view)).collect();
    order.sort_by(|a, b| a.0.total_cmp(&b.0));
    let mut directions: Vec<(f64, Vec<usize>)> = Vec::new();
    for (angle, view) in order {
        match directions.last_mut().filter(|(last, _)| angle - *last < SAME_RAD) {
            Some((_, views)) => views.push(view),
            None => directions.push((angle, vec![view])),
        }
    }
    // 180 degrees and 0 are one direction.
    if let [(first, _), .., (last, _)] = directions[..]
        && first + PI - last < SAME_RAD
        && let Some((_, views)) = directions.pop()
    {
        directions[0].1.extend(views);
    }
    let count = directions.len();
    if count < 2 {
        return Err(TomographyError::TooFewViews { views: tilts_rad.len(), distinct: count });
    }
    let gaps: Vec<f64> =
        (0..count).map(|index| (directions[(index + 1) % count].0 - directions[index].0).rem_euclid(PI)).collect();
    let widest = (0..count).max_by(|a, b| gaps[*a].total_cmp(&gaps[*b])).unwrap_or(0);
    let mut sorted = gaps.clone();
    sorted.sort_by(f64::total_cmp);
    let wedge = gaps[widest] > WEDGE_GAPS * sorted[(count - 1) / 2];
    let mut weights_rad = vec![0.0; tilts_rad.len()];
    for (index, (_, views)) in directions.iter().enumerate() {
        let (before, after) = ((index + count - 1) % count, index);
        let mut sides = [gaps[before], gaps[after]];
        // The last view before the wedge reaches as far into it as it does to the other side.
        if wedge && before == widest {
            sides[0] = sides[1];
        } else if wedge && after == widest {
            sides[1] = sides[0];
        }
        for view in views {
            weights_rad[*view] = 0.5 * (sides[0] + sides[1]) / views.len() as f64;
        }
    }
    let range_rad = [
        tilts_rad.iter().copied().fold(f64::INFINITY, f64::min),
        tilts_rad.iter().copied().fold(f64::NEG_INFINITY, f64::max),
    ];
    Ok(Coverage { directions: count, range_rad, missing_rad: gaps[widest], wedge, weights_rad })
}

/// The `count` views whose tilts are nearest to evenly spaced ones from the least to the largest, in the order of their tilts.
///
/// # Errors
/// [`TomographyError::NoSuchCount`] where there are fewer views, [`TomographyError::TooFewViews`] for fewer than two.
pub fn evenly_spaced(tilts: &[f64], count: usize) -> Result<Vec<usize>, TomographyError> {
    let views = tilts.len();
    if count > views {
        return Err(TomographyError::NoSuchCount { wanted: count, views });
    }
    if count < 2 {
        return Err(TomographyError::TooFewViews { views: count, distinct: count });
    }
    let mut order: Vec<usize> = (0..views).collect();
    order.sort_by(|a, b| tilts[*a].total_cmp(&tilts[*b]));
    let (least, largest) = (tilts[order[0]], tilts[order[views - 1]]);
    let mut chosen = Vec::with_capacity(count);
    let mut next = 0;
    for step in 0..count {
        let wanted = least + (largest - least) * step as f64 / (count - 1) as f64;
        // Enough views must be left for the steps that follow.
        let last = views - (count - step);
        let nearest = (next..=last)
            .min_by(|a, b| (tilts[order[*a]] - wanted).abs().total_cmp(&(tilts[order[*b]] - wanted).abs()));
        let at = nearest.unwrap_or(next);
        chosen.push(order[at]);
        next = at + 1;
    }
    Ok(chosen)
}

#[cfg(test)]
mod tests {
    use super::*;
    use approx::assert_relative_eq;

    fn degrees(tilts: &[f64]) -> Vec<f64> {
        tilts.iter().map(|tilt| tilt.to_radians()).collect()
    }

    #[test]
    fn a_series_of_152_degrees_misses_28_and_each_view_stands_for_its_step() {
        let tilts: Vec<f64> = (-38..=38).map(|step| (2.0 * f64::from(step)).to_radians()).collect();
        let found = coverage(&tilts).unwrap();
        assert!(found.wedge);
        assert_relative_eq!(found.missing_rad.to_degrees(), 28.0, epsilon = 1e-9);
        assert!(found.weights_rad.iter().all(|weight| (weight.to_degrees() - 2.0).abs() < 1e-9));
    }

    #[test]
    fn a_half_turn_has_no_wedge_and_its_weights_are_pi_in_all() {
        let tilts = degrees(&(0..60).map(|step| 3.0 * f64::from(step)).collect::<Vec<_>>());
        let found = coverage(&tilts).unwrap();
        assert!(!found.wedge);
        assert_relative_eq!(found.weights_rad.iter().sum::<f64>(), PI, epsilon = 1e-9);
        // A full turn shows each direction twice.
        let twice = degrees(&(0..120).map(|step| 3.0 * f64::from(step)).collect::<Vec<_>>());
        let found = coverage(&twice).unwrap();
        assert_eq!(found.directions, 60);
        assert_relative_eq!(found.weights_rad[7].to_degrees(), 1.5, epsilon = 1e-9);
    }

    #[test]
    fn duplicates_share_and_unsorted_uneven_tilts_reach_half_way() {
        let found = coverage(&degrees(&[10.0, -10.0, 0.0, 10.0, 30.0])).unwrap();
        let weights: Vec<f64> = found.weights_rad.iter().map(|weight| weight.to_degrees()).collect();
        for (weight, expected) in weights.iter().zip([7.5, 10.0, 10.0, 7.5, 20.0]) {
            assert_relative_eq!(*weight, expected, epsilon = 1e-9);
        }
        assert!(matches!(coverage(&degrees(&[5.0, 5.0])), Err(TomographyError::TooFewViews { views: 2, distinct: 1 })));
        assert!(coverage(&[f64::NAN, 0.0]).is_err());
    }

    #[test]
    fn chosen_views_are_the_ends_and_the_nearest_between() {
        let tilts: Vec<f64> = (-25..=25).map(|step| 2.0 * f64::from(step)).collect();
        let chosen =
            |count| -> Vec<f64> { evenly_spaced(&tilts, count).unwrap().into_iter().map(|view| tilts[view]).collect() };
        assert_eq!(chosen(3), [-50.0, 0.0, 50.0]);
        assert_eq!(chosen(51).len(), 51);
        let fives = chosen(5);
        assert!(fives.windows(2).all(|pair| (pair[1] - pair[0] - 25.0).abs() <= 2.0), "{fives:?}");
        for count in 2..=51 {
            assert!(chosen(count).windows(2).all(|pair| pair[1] > pair[0]));
        }
        assert!(evenly_spaced(&tilts, 52).is_err() && evenly_spaced(&tilts, 1).is_err());
    }
}
