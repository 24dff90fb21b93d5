//! What the other views of a series say about a pair: whether its views are swapped, and whether its tilts agree with the others'.
//!
//! Both look at views tilted away from the pair, where depth moves points most. With depth turned over, curves fit such views
//! as badly as they can; a swapped pair fits them better so. A wrong angle between the views of the pair scales all depths by one
//! factor, which is measured in each view. The *absolute* sign of depth is in no parallel projection: turning over both depth and
//! all tilts changes no image.

use serde::Serialize;

use super::{LineIndex, SavedCurves, Series, ViewPose, ViewReprojection, register};
use crate::geometry::{Point3, Vector3};
use crate::measure::MeasureSettings;

/// Views that take part, the furthest ones on either side.
const MOST_VIEWS: usize = 12;
/// Views take part from this tilt away from the middle of the pair on, degrees.
const LEAST_AWAY_DEG: f64 = 6.0;
/// Tilts are compared only where views span more than this, degrees: below, an error of all tilts alike looks like one of depth.
const LEAST_SPAN_DEG: f64 = 30.0;
/// Shifts are looked for so far when depth is turned over, px.
const SEARCH_PX: f64 = 16.0;
/// By so much the share of points near lines must differ for the order to be told, in the mean over views.
const ORDER_MARGIN: f64 = 0.06;
/// And in so many of the views.
const ORDER_VOTES: f64 = 0.75;
/// Fewer views tell nothing about tilts.
const LEAST_VIEWS: usize = 3;
/// A factor on depths known worse than this tells nothing.
const MOST_SIGMA: f64 = 0.2;

/// Whether the views of the pair are in the order that the series' tilts say.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum PairOrder {
    /// They are.
    Consistent,
    /// Left and right are swapped (or the tilts of the series have the other sign).
    Swapped,
    /// Depths differ too little, or there are no views far enough away.
    CannotTell,
}

/// Whether the angle between the views of the pair agrees with the tilts of the others.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[serde(rename_all = "snake_case", tag = "result")]
pub enum PairTilts {
    /// Within the errors.
    Agree {
        /// Factor by which all depths would have to change to fit the other views best.
        depth_factor: f64,
        /// One sigma of it, that of the tilts in it.
        sigma: f64,
    },
    /// The angle between the views should be `phi_deg`.
    Disagree {
        /// Factor by which all depths would have to change.
        depth_factor: f64,
        /// One sigma of it.
        sigma: f64,
        /// The angle between the views that would give those depths, degrees.
        phi_deg: f64,
    },
    /// The views span too little, or there are too few of them.
    CannotTell,
}

/// The self-checks.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Checks {
    /// Order of the pair.
    pub order: PairOrder,
    /// Share of points near lines with the depths as they are, and turned over: means over the views that were looked at.
    pub near_lines: Option<[f64; 2]>,
    /// Tilts of the pair.
    pub tilts: PairTilts,
    /// Tilts of the views that were looked at, degrees.
    pub views_deg: Vec<f64>,
    /// What none of this can tell.
    pub sign: &'static str,
}

/// What no series can tell.
const SIGN: &str = "the absolute sign of depth cannot be known from parallel projections: turning over depth and all tilts together \
    changes no image";

/// Compares the pair with the views.
pub(super) fn check(
    curves: &SavedCurves,
    points: &[(Point3, Vector3)],
    found: &[(ViewReprojection, LineIndex)],
    series: &Series,
) -> Checks {
    let phi = curves.tilts.phi();
    let away = |view: &ViewReprojection| view.pose.tilt_rad.abs();
    let least = LEAST_AWAY_DEG.to_radians().max(0.75 * phi.abs());
    let mut far: Vec<&(ViewReprojection, LineIndex)> =
        found.iter().filter(|(view, _)| !view.in_pair && away(view) >= least && view.distances.is_some()).collect();
    far.sort_by(|(a, _), (b, _)| away(b).total_cmp(&away(a)));
    // At the largest tilts lines are poor: every second of the further half.
    let far: Vec<_> = far.iter().step_by(far.len().div_ceil(MOST_VIEWS).max(1)).take(MOST_VIEWS).copied().collect();
    let turned: Vec<(Point3, Vector3)> = points
        .iter()
        .map(|(point, tangent)| {
            (Point3::new(point.x, point.y, -point.z), Vector3::new(tangent.x, tangent.y, -tangent.z))
        })
        .collect();
    let mut near = Vec::new();
    for (view, lines) in &far {
        let as_is = register(points, lines, &view.pose, SEARCH_PX, false);
        let over = register(&turned, lines, &view.pose, SEARCH_PX, false);
        if let (Some(as_is), Some(over)) = (as_is, over) {
            near.push([as_is.near, over.near]);
        }
    }
    let (order, near_lines) = order(&near);
    let span_deg = match (series.views.first(), series.views.last()) {
        (Some(first), Some(last)) => last.tilt_deg - first.tilt_deg,
        _ => 0.0,
    };
    let tilts = if span_deg > LEAST_SPAN_DEG && order != PairOrder::Swapped {
        let free = |(view, lines): &&(ViewReprojection, LineIndex)| free_depth(points, lines, &view.pose);
        let supported = far.iter().copied().filter(|(view, _)| view.supported);
        tilts(&supported.collect::<Vec<_>>().iter().filter_map(free).collect::<Vec<_>>(), phi, curves.reliability())
    } else {
        PairTilts::CannotTell
    };
    Checks { order, near_lines, tilts, views_deg: far.iter().map(|(view, _)| view.tilt_deg).collect(), sign: SIGN }
}

/// The factor on depths in one view, and its sigma.
fn free_depth(points: &[(Point3, Vector3)], lines: &LineIndex, pose: &ViewPose) -> Option<[f64; 2]> {
    register(points, lines, pose, 4.0, true)
        .filter(|found| found.is_supported() && found.depth[1] > 0.0)
        .map(|found| found.depth)
}

/// The order from the shares of points near lines, as they are and turned over.
fn order(near: &[[f64; 2]]) -> (PairOrder, Option<[f64; 2]>) {
    if near.is_empty() {
        return (PairOrder::CannotTell, None);
    }
    let count = near.len() as f64;
    let mean = [0, 1].map(|which| near.iter().map(|pair| pair[which]).sum::<f64>() / count);
    let votes = near.iter().filter(|pair| pair[0] > pair[1]).count() as f64 / count;
    let order = if mean[0] - mean[1] > ORDER_MARGIN && votes >= ORDER_VOTES {
        PairOrder::Consistent
    } else if mean[1] - mean[0] > ORDER_MARGIN && votes <= 1.0 - ORDER_VOTES {
        PairOrder::Swapped
    } else {
        PairOrder::CannotTell
    };
    (order, Some(mean))
}

/// Whether the factors of the views agree with 1. Their scatter says how well each is known: their own sigmas know only errors
/// along the lines. Errors of the depths themselves draw the factors towards nothing (regression dilution, Spearman 1904), by the
/// reliability of the depths, which is itself known to about a half of what it is short of 1.
fn tilts(factors: &[[f64; 2]], phi: f64, reliability: f64) -> PairTilts {
    if factors.len() < LEAST_VIEWS {
        return PairTilts::CannotTell;
    }
    let mut sorted: Vec<f64> = factors.iter().map(|factor| factor[0]).collect();
    sorted.sort_by(f64::total_cmp);
    let drawn = sorted[sorted.len() / 2];
    let median = drawn / reliability;
    let mut off: Vec<f64> = sorted.iter().map(|factor| (factor - drawn).abs()).collect();
    off.sort_by(f64::total_cmp);
    let scatter = 1.4826 * off[off.len() / 2];
    // Views share the curves, and with them their errors: they are not independent.
    let own = scatter.max(0.01) / (factors.len() as f64).sqrt().min(2.0);
    let tilt = MeasureSettings::default().tilt_sigma_deg.to_radians() * std::f64::consts::SQRT_2 / phi.abs();
    let sigma = own.hypot(tilt).hypot(0.5 * (1.0 / reliability - 1.0));
    if sigma > MOST_SIGMA {
        return PairTilts::CannotTell;
    }
    if (median - 1.0).abs() <= 2.5 * sigma {
        PairTilts::Agree { depth_factor: median, sigma }
    } else {
        // Depth is disparity over the angle: depths that are too small by a factor come from an angle too large by it.
        PairTilts::Disagree { depth_factor: median, sigma, phi_deg: (phi / median).to_degrees() }
    }
}

impl Checks {
    /// The checks in sentences.
    pub fn sentences(&self) -> Vec<String> {
        let numbers = match self.near_lines {
            Some([as_is, over]) => format!(
                " ({:.0} % of points lie near lines in {} views away from the pair, and {:.0} % with depth turned over)",
                100.0 * as_is,
                self.views_deg.len(),
                100.0 * over
            ),
            None => " (no view far enough from the pair)".to_owned(),
        };
        let order = match self.order {
            PairOrder::Consistent => "the pair's order agrees with the tilts of the series",
            PairOrder::Swapped => "the pair is SWAPPED against the tilts of the series: swap its images or its tilts",
            PairOrder::CannotTell => {
                "whether the pair is swapped cannot be told: depth changes the other views too little"
            }
        };
        let tilts = match self.tilts {
            PairTilts::Agree { depth_factor, sigma } => format!(
                "the pair's tilts agree with the others' (depths fit best times {depth_factor:.3} \u{b1} {sigma:.3})"
            ),
            PairTilts::Disagree { depth_factor, sigma, phi_deg } => format!(
                "the pair's tilts DISAGREE with the others': depths fit best times {depth_factor:.3} \u{b1} {sigma:.3}, as if the \
                 pair's views were {:.2} degrees apart",
                phi_deg.abs()
            ),
            PairTilts::CannotTell => format!(
                "whether the pair's tilts agree with the others' cannot be told: it needs views over more than {LEAST_SPAN_DEG} \
                 degrees with lines that fit"
            ),
        };
        vec![format!("{order}{numbers}"), tilts, self.sign.to_owned()]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_order_needs_a_margin_and_most_views() {
        assert_eq!(order(&[[0.9, 0.3], [0.8, 0.4]]).0, PairOrder::Consistent);
        assert_eq!(order(&[[0.3, 0.9], [0.4, 0.8]]).0, PairOrder::Swapped);
        assert_eq!(order(&[[0.50, 0.48], [0.5, 0.5]]).0, PairOrder::CannotTell);
        assert_eq!(order(&[]).0, PairOrder::CannotTell);
    }

    #[test]
    fn depths_too_small_mean_an_angle_too_large() {
        let phi = 8.0_f64.to_radians();
        let views = |factor: f64| [0.99, 1.0, 1.01, 1.0].map(|noise| [factor * noise, 0.01]);
        assert!(matches!(tilts(&views(1.02), phi, 1.0), PairTilts::Agree { .. }));
        let PairTilts::Disagree { phi_deg, .. } = tilts(&views(1.25), phi, 1.0) else {
            panic!("a quarter is too much")
        };
        assert!((phi_deg - 6.4).abs() < 0.01);
        // Depths of which a fifth of the variance is error show four fifths of themselves.
        assert!(matches!(tilts(&views(0.8), phi, 0.8), PairTilts::Agree { .. }));
        assert_eq!(tilts(&views(1.0)[..2], phi, 1.0), PairTilts::CannotTell);
    }
}
