//! Which point matches are right: random sampling with a score (MSAC, Torr and Zisserman 2000) and local optimisation
//! (Chum, Matas and Kittler 2003), first of the similarity that most matches share, then of the epipolar geometry.
//!
//! The epipolar constraint alone lets any wrong match pass that happens to lie on the right row, and such matches, with
//! huge disparities, would decide the axis. A foil is thin: its disparities lie in a band about a plane. So matches must
//! also agree roughly with a common similarity, and in the end with the other inliers' disparities.

use std::collections::HashSet;

use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

use nalgebra::{Matrix3, Vector3, Vector4};

use super::epipolar::{AxisPrior, Epipolar, Moments, Posterior, fit_similarity, fit_with_prior, wrapped};
use super::point_matching::{PointMatch, PointMatches};
use crate::geometry::{Point2, Similarity2};

/// Largest distance from the common similarity, as a share of the image's diagonal: generous for tilted, thick foils.
const PARALLAX_SHARE: f64 = 1.0 / 12.0;
/// Largest residual of one coordinate, px per 1448 px of diagonal (1024 x 1024) and at least that.
const RESIDUAL_PX: f64 = 2.0;
/// Samples at most; fewer where many matches agree.
const SAMPLES: usize = 4000;
/// Most that a sample's axis may count against it, as a negative log probability.
const MOST_DOUBT: f64 = 10.0;
/// Degrees of freedom of the t distribution of residuals.
const TAIL: f64 = 2.0;
/// A sample's rotation and scale may differ so much from the common similarity's.
const SANE_TURN_RAD: f64 = 0.2;
const SANE_SCALE: f64 = 1.2;

/// What the matches say.
#[derive(Clone, Debug)]
pub struct Consensus {
    /// Matches that agree.
    pub inliers: Vec<PointMatch>,
    /// Those of them that the fit rests on: the others' disparities stand out from the common plane.
    pub fitted: Vec<PointMatch>,
    /// Distinct matches, and those that the geometry found among the possible ones.
    pub matches: usize,
    /// The fit to them.
    pub posterior: Posterior,
    /// The similarity that takes left points to right ones, least squares over the inliers.
    pub right_from_left: Similarity2,
}

/// Finds the geometry that most matches share; `Err` holds how many agreed where that is too few to fit.
///
/// `diagonal_px` is the diagonal of the larger image.
pub fn consensus(matches: &PointMatches, diagonal_px: f64, prior: &AxisPrior, seed: u64) -> Result<Consensus, usize> {
    let mut rng = Pcg64::seed_from_u64(seed);
    let reach = PARALLAX_SHARE * diagonal_px;
    let similarity = common_similarity(&matches.distinct, reach, &mut rng).ok_or(0_usize)?;
    let near = |pairs: &[PointMatch]| -> Vec<PointMatch> {
        pairs.iter().filter(|pair| (similarity * pair.left - pair.right).norm() < reach).copied().collect()
    };
    let mut agreeing = near(&matches.distinct);
    let limit = RESIDUAL_PX * (diagonal_px / 1448.0).max(1.0);
    let sampled = sample_epipolar(&agreeing, &similarity, limit, prior, &mut rng);
    // Matches that a similarity explains exactly (the same image twice) leave four-point samples nothing to go by.
    let start = sampled.unwrap_or_else(|| from_similarity(&similarity, prior.axis_rad));
    let mut refined = refine(&agreeing, &start, limit, prior)?;
    let possible = near(&matches.possible);
    let distinct = agreeing.len();
    for _ in 0..2 {
        let added = wanted_of(&possible, &agreeing, distinct, &refined, limit);
        agreeing.truncate(distinct);
        agreeing.extend(added);
        refined = refine(&agreeing, &refined.posterior.geometry, limit, prior)?;
    }
    let choose = |indices: &[usize]| -> Vec<PointMatch> { indices.iter().map(|&i| agreeing[i]).collect() };
    let (inliers, fitted) = (choose(&refined.inliers), choose(&refined.fitted));
    let right_from_left = fit_similarity(fitted.iter().map(|pair| (pair, 1.0))).ok_or(inliers.len())?;
    let matches = matches.distinct.len() + agreeing.len() - distinct;
    Ok(Consensus { inliers, fitted, matches, posterior: refined.posterior, right_from_left })
}

/// The similarity most of the matches share.
pub fn common(matches: &[PointMatch], diagonal_px: f64, seed: u64) -> Option<Similarity2> {
    common_similarity(matches, PARALLAX_SHARE * diagonal_px, &mut Pcg64::seed_from_u64(seed))
}

/// Indices of distinct random matches.
fn draw<const N: usize>(count: usize, rng: &mut Pcg64) -> [usize; N] {
    let mut drawn = [usize::MAX; N];
    for i in 0..N {
        drawn[i] = loop {
            let index = rng.random_range(0..count);
            if !drawn[..i].contains(&index) {
                break index;
            }
        };
    }
    drawn
}

/// Samples needed to draw one of `size` right matches with 99.9 percent, if a share is right.
fn samples_needed(share: f64, size: i32) -> usize {
    let all_right = share.powi(size).clamp(1e-9, 1.0 - 1e-9);
    ((1e-3_f64).ln() / (1.0 - all_right).ln()).ceil() as usize
}

/// The similarity (right from left) about which most matches crowd: a match scores more the nearer it is.
fn common_similarity(matches: &[PointMatch], reach: f64, rng: &mut Pcg64) -> Option<Similarity2> {
    if matches.len() < 2 {
        return None;
    }
    let core2 = (reach / 6.0).powi(2);
    let score = |similarity: &Similarity2| -> f64 {
        let squares = matches.iter().map(|pair| (similarity * pair.left - pair.right).norm_squared());
        squares.filter(|square| *square < reach * reach).map(|square| core2 / (core2 + square)).sum()
    };
    let mut best: Option<(f64, Similarity2)> = None;
    let mut needed = SAMPLES;
    let mut sample = 0;
    while sample < needed.min(SAMPLES) {
        sample += 1;
        let pair: [usize; 2] = draw(matches.len(), rng);
        let Some(similarity) = fit_similarity(pair.iter().map(|&i| (&matches[i], 1.0))) else { continue };
        if !(0.5..2.0).contains(&similarity.scaling()) {
            continue;
        }
        let found = score(&similarity);
        if best.as_ref().is_none_or(|(highest, _)| found > *highest) {
            best = Some((found, similarity));
            // The score counts near matches only in part, so this asks for more samples rather than fewer.
            needed = samples_needed(found / matches.len() as f64, 2).max(200);
        }
    }
    let (_, mut similarity) = best?;
    for _ in 0..10 {
        let weighted = matches.iter().map(|pair| {
            let square = (similarity * pair.left - pair.right).norm_squared();
            (pair, if square < reach * reach { (core2 / (core2 + square)).powi(2) } else { 0.0 })
        });
        similarity = fit_similarity(weighted)?;
    }
    Some(similarity)
}

/// The constraint through four matches: the direction of (x_L, y_L, x_R, y_R) perpendicular to their differences.
fn through_four(matches: [&PointMatch; 4]) -> (Vector4<f64>, f64) {
    let [p, q, r, s] = matches.map(|pair| Vector4::new(pair.left.x, pair.left.y, pair.right.x, pair.right.y));
    let rows = [q - p, r - p, s - p];
    let minor = |skip: usize| {
        let column = |index: usize| index + usize::from(index >= skip);
        Matrix3::from_fn(|row, index| rows[row][column(index)]).determinant()
    };
    let normal = Vector4::new(minor(0), -minor(1), minor(2), -minor(3));
    (normal, -normal.dot(&p))
}

/// The geometry of a level plane that a similarity (right from left) maps, about the given axis.
fn from_similarity(similarity: &Similarity2, axis_rad: f64) -> Epipolar {
    let axis_right_rad = axis_rad + similarity.isometry.rotation.angle();
    let scale = similarity.scaling();
    let level = Epipolar { axis_left_rad: axis_rad, axis_right_rad, scale, row_offset: 0.0 };
    let origin = level.rectified_from_right() * (similarity * Point2::origin());
    Epipolar { row_offset: -origin.y, ..level }
}

fn sane(geometry: &Epipolar, similarity: &Similarity2) -> bool {
    let turn = geometry.relative_rotation_rad() - similarity.isometry.rotation.angle();
    let scale = geometry.scale / similarity.scaling();
    wrapped(turn, std::f64::consts::TAU).abs() < SANE_TURN_RAD && (1.0 / SANE_SCALE..SANE_SCALE).contains(&scale)
}

fn residuals2(geometry: &Epipolar, matches: &[PointMatch]) -> Vec<f64> {
    let gain2 = geometry.row_noise_gain().powi(2);
    geometry.differences(matches).iter().map(|difference| difference.y * difference.y / gain2).collect()
}

fn sample_epipolar(
    matches: &[PointMatch],
    similarity: &Similarity2,
    limit: f64,
    prior: &AxisPrior,
    rng: &mut Pcg64,
) -> Option<Epipolar> {
    if matches.len() < 4 {
        return None;
    }
    let axis_rad = prior.axis_rad;
    // MSAC: each match costs its squared residual, at most the limit's. Where few matches agree, or all lie in one plane,
    // many axes do equally well and the given one is preferred, at the price of a few matches at most.
    let cost = |residuals2: &[f64], geometry: &Epipolar| -> f64 {
        let doubt = prior.negative_log(geometry.axis_left_rad).min(MOST_DOUBT);
        let variance = (limit / 2.5).powi(2);
        residuals2.iter().map(|square| square.min(limit * limit)).sum::<f64>() + 2.0 * variance * doubt
    };
    let mut best: Option<(f64, Epipolar)> = None;
    let mut needed = SAMPLES;
    let mut sample = 0;
    while sample < needed.min(SAMPLES) {
        sample += 1;
        let four: [usize; 4] = draw(matches.len(), rng);
        let (normal, f) = through_four(four.map(|i| &matches[i]));
        let Some(geometry) = Epipolar::from_constraint(&normal.normalize(), f / normal.norm(), axis_rad) else {
            continue;
        };
        if !sane(&geometry, similarity) {
            continue;
        }
        let squares = residuals2(&geometry, matches);
        let found = cost(&squares, &geometry);
        if best.as_ref().is_some_and(|(lowest, _)| found >= *lowest) {
            continue;
        }
        best = Some((found, geometry));
        // Local optimisation: fit to the inliers, wide to narrow, and keep what is better.
        let mut current = geometry;
        for widening in [2.0, 1.5, 1.0, 1.0] {
            let squares = residuals2(&current, matches);
            let inside = (widening * limit).powi(2);
            let chosen = matches.iter().zip(&squares).filter(|(_, square)| **square < inside).map(|(pair, _)| pair);
            let moments = Moments::of(chosen.map(|pair| (pair, 1.0)));
            let Some(fitted) = (moments.weight >= 5.0).then(|| moments.fit(axis_rad)).flatten() else { break };
            if !sane(&fitted, similarity) {
                break;
            }
            current = fitted;
            let squares = residuals2(&current, matches);
            let found = cost(&squares, &current);
            if best.as_ref().is_none_or(|(lowest, _)| found < *lowest) {
                best = Some((found, current));
                let inliers = squares.iter().filter(|square| **square < limit * limit).count();
                needed = samples_needed(inliers as f64 / matches.len() as f64, 4).max(100);
            }
        }
    }
    best.map(|(_, geometry)| geometry)
}

/// A geometry and the matches it rests on.
struct Refined {
    posterior: Posterior,
    inliers: Vec<usize>,
    fitted: Vec<usize>,
    band: DisparityBand,
}

/// Final fit: matches are chosen by row residual (three sigma, as estimated from them) and by disparity, and the
/// geometry is fitted to them with the prior, until the choice stays.
///
/// Both limits are three robust sigmas. Were the one along the rows wider, the errors of points in one plane would
/// scatter further along the rows than across, and look like depth that shows the axis.
fn refine(matches: &[PointMatch], start: &Epipolar, limit: f64, prior: &AxisPrior) -> Result<Refined, usize> {
    let mut geometry = *start;
    let mut refined: Option<Refined> = None;
    for _ in 0..20 {
        let squares = residuals2(&geometry, matches);
        let mut within: Vec<usize> = (0..matches.len()).filter(|&i| squares[i] < limit * limit).collect();
        let cut = row_cut(within.iter().map(|&i| squares[i].sqrt()), limit);
        within.retain(|&i| squares[i] < cut * cut);
        let band = DisparityBand::of(matches, &geometry, &within);
        let choose = |bound: f64| -> Vec<usize> {
            within.iter().copied().filter(|&i| band.distance(&geometry, &matches[i]) <= bound).collect()
        };
        let (fitted, inliers) = (choose(3.0 * band.sigma), choose(band.widest()));
        let settled = refined.as_ref().is_some_and(|refined| refined.fitted == fitted);
        let posterior = match refined {
            Some(refined) if settled => refined.posterior,
            _ => {
                // Weights of Student's t: errors have long tails, because what moves as one in a transparent foil is
                // seldom one thing alone.
                let weigh = |i: usize| 1.0 / (1.0 + squares[i] / (TAIL * (cut / 3.0).powi(2)));
                let moments = Moments::of(fitted.iter().map(|&i| (&matches[i], weigh(i))));
                fit_with_prior(&moments, prior).ok_or(fitted.len())?
            }
        };
        geometry = posterior.geometry;
        refined = Some(Refined { posterior, inliers, fitted, band });
        if settled {
            break;
        }
    }
    refined.ok_or(0)
}

/// Three robust sigmas of the residuals of one coordinate, at most the limit.
fn row_cut(residuals: impl Iterator<Item = f64>, limit: f64) -> f64 {
    // Below a twentieth of a px the limit is exact arithmetic's, not a measurement's.
    (3.0 * 1.4826 * median(residuals)).clamp(0.05, limit)
}

/// Those of the possible matches that lie where the geometry and the disparities want them, nearest descriptors first,
/// each place once, and not where one of the first `distinct` matches agrees already.
fn wanted_of(
    possible: &[PointMatch],
    agreeing: &[PointMatch],
    distinct: usize,
    refined: &Refined,
    limit: f64,
) -> Vec<PointMatch> {
    let geometry = &refined.posterior.geometry;
    let residuals = residuals2(geometry, agreeing);
    let cut = row_cut(refined.inliers.iter().map(|&i| residuals[i].sqrt()), limit);
    let kept = refined.inliers.iter().filter(|&&i| i < distinct);
    let (mut left_taken, mut right_taken): (HashSet<_>, HashSet<_>) =
        kept.map(|&i| agreeing[i].places()).map(|[left, right]| (left, right)).unzip();
    let bound = refined.band.widest();
    let mut wanted = Vec::new();
    for (pair, square) in possible.iter().zip(residuals2(geometry, possible)) {
        let [left, right] = pair.places();
        let agrees = square < cut * cut && refined.band.distance(geometry, pair) <= bound;
        if agrees && !left_taken.contains(&left) && !right_taken.contains(&right) {
            left_taken.insert(left);
            right_taken.insert(right);
            wanted.push(*pair);
        }
    }
    wanted
}

/// The disparities of a foil: scattered about a plane.
struct DisparityBand {
    /// Disparity as a function of (x_L, y_L, 1).
    plane: Vector3<f64>,
    /// Robust standard deviation about it, px. Uniform disparities of a thick foil reach 1.3 of it.
    sigma: f64,
}

impl DisparityBand {
    fn of(matches: &[PointMatch], geometry: &Epipolar, within: &[usize]) -> Self {
        let pairs: Vec<PointMatch> = within.iter().map(|&i| matches[i]).collect();
        let disparities: Vec<f64> = geometry.differences(&pairs).iter().map(|difference| difference.x).collect();
        let off = |plane: &Vector3<f64>| -> Vec<f64> {
            pairs.iter().zip(&disparities).map(|(pair, d)| d - plane.dot(&pair.left.to_homogeneous())).collect()
        };
        let mut plane = Vector3::new(0.0, 0.0, median(disparities.iter().copied()));
        for _ in 0..10 {
            // Least absolute deviations by reweighting; a tenth of a px keeps the weights finite.
            let weights = off(&plane).into_iter().map(|off| 1.0 / (0.1 + off.abs()));
            let (mut normal, mut target) = (Matrix3::zeros(), Vector3::zeros());
            for ((pair, d), weight) in pairs.iter().zip(&disparities).zip(weights) {
                let point = pair.left.to_homogeneous();
                normal += weight * point * point.transpose();
                target += weight * *d * point;
            }
            let Some(factor) = normal.cholesky() else { break };
            plane = factor.solve(&target);
        }
        let off = off(&plane);
        let centre = median(off.iter().copied());
        plane.z += centre;
        let sigma = 1.4826 * median(off.iter().map(|off| (off - centre).abs()));
        Self { plane, sigma: sigma.max(0.02) }
    }

    /// How far a match's disparity is from the plane.
    fn distance(&self, geometry: &Epipolar, pair: &PointMatch) -> f64 {
        let disparity = geometry.differences(std::slice::from_ref(pair))[0].x;
        (disparity - self.plane.dot(&pair.left.to_homogeneous())).abs()
    }

    /// Largest distance that a foil may have: generous, for a few lines off a surface that most points lie on.
    fn widest(&self) -> f64 {
        2.0 + 4.0 * self.sigma
    }
}

/// The middle value; 0 of nothing.
pub fn median(values: impl Iterator<Item = f64>) -> f64 {
    let mut values: Vec<f64> = values.collect();
    if values.is_empty() {
        return 0.0;
    }
    let middle = values.len() / 2;
    *values.select_nth_unstable_by(middle, f64::total_cmp).1
}
