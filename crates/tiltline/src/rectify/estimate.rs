//! From point matches to the maps of both images onto one grid, with what is to be doubted about them.

use nalgebra::Translation2;

use super::epipolar::{systematic_row_error_px, wrapped};
use super::paper_model::fit_paper;
use super::ransac::{consensus, median};
use super::resample::{LARGEST_GROWTH, common_grid};
use super::{Model, PointMatch, PointMatches, Rectification, RectifyError, RectifySettings, SMALLEST_INLIERS};
use crate::geometry::{Point2, Similarity2, Vector2};
use crate::progress::Stage;
use crate::warning::Warning;

/// Fewer inliers are a warning.
const FEW_INLIERS: usize = 12;
/// A larger root mean square row error is a warning.
const LARGE_ROW_ERROR_PX: f64 = 1.0;
/// Reach of the paper's shift, as a share of the diagonal.
const PAPER_REACH_SHARE: f64 = 1.0 / 24.0;

/// The geometry before both images are put on a grid.
struct Geometry {
    maps: [Similarity2; 2],
    inliers: Vec<PointMatch>,
    matches: usize,
    sigma_row_px: Option<f64>,
    axis_rad: f64,
    axis_sigma_rad: f64,
    held_by_prior: bool,
    eigenvalue_ratio: Option<f64>,
    relative_rotation_rad: f64,
    relative_scale: f64,
    right_from_left: Similarity2,
}

/// Estimates the rectification of two images of the given shapes (rows, columns) from point matches in their px.
///
/// `tilt_axis_rad` is the given axis, radians clockwise on the screen from image y. The median disparity of the inliers
/// becomes zero. The same seed gives the same result.
pub fn estimate(
    matches: &PointMatches,
    shapes: [[usize; 2]; 2],
    tilt_axis_rad: f64,
    settings: &RectifySettings,
    seed: u64,
) -> Result<(Rectification, Vec<Warning>), RectifyError> {
    let mut warnings = Vec::new();
    let mut warn = |message: String| warnings.push(Warning::new(Stage::Rectify, message));
    let geometry = match settings.model {
        Model::Affine => affine(matches, shapes, tilt_axis_rad, settings, seed, &mut warn)?,
        Model::Paper => paper(matches, shapes[0], seed, &mut warn)?,
    };
    let [left, right] = geometry.maps;
    let differences: Vec<Vector2> = geometry.inliers.iter().map(|pair| right * pair.right - left * pair.left).collect();
    let mut disparities: Vec<f64> = differences.iter().map(|difference| difference.x).collect();
    disparities.sort_by(f64::total_cmp);
    let centre = median(disparities.iter().copied());
    let at = |share: f64| disparities[((disparities.len() - 1) as f64 * share).round() as usize] - centre;
    let right = Translation2::new(-centre, 0.0) * right;
    let squares: f64 = differences.iter().map(|difference| difference.y * difference.y).sum();
    let rms_row_error_px = (squares / differences.len() as f64).sqrt();

    let grid = common_grid(shapes, [&left, &right]);
    let shift = Translation2::from(grid.shift);
    let rectification = Rectification {
        rectified_from_left: shift * left,
        rectified_from_right: shift * right,
        shape: grid.shape,
        inliers: geometry.inliers.len(),
        matches: geometry.matches,
        rms_row_error_px,
        sigma_row_px: geometry.sigma_row_px.unwrap_or(rms_row_error_px),
        axis_deg: geometry.axis_rad.to_degrees(),
        axis_sigma_deg: geometry.axis_sigma_rad.to_degrees(),
        axis_held_by_prior: geometry.held_by_prior,
        eigenvalue_ratio: geometry.eigenvalue_ratio,
        relative_rotation_deg: geometry.relative_rotation_rad.to_degrees(),
        relative_scale: geometry.relative_scale,
        right_from_left: geometry.right_from_left,
        disparity_range_px: [at(0.01), at(0.99)],
        points: geometry.inliers,
    };
    if grid.left_only {
        warn(format!(
            "both images together would fill more than {LARGEST_GROWTH} times the left image's pixels; only the left \
             image's area is used, and what the right one shows outside it is lost"
        ));
    }
    if rms_row_error_px > LARGE_ROW_ERROR_PX {
        warn(format!(
            "rows are off by {rms_row_error_px:.2} px rms over {} matches: noise in the single points, which leaves the fit good to \
             {:.2} px, or drift and distortion that no rotation, scale and shift can mend; look whether rows of the rectified \
             images agree, since depths of lines near the row direction suffer first",
            rectification.inliers, rectification.sigma_row_px
        ));
    }
    if rectification.inliers < FEW_INLIERS {
        let chance = by_chance(&rectification, shapes[1]);
        warn(format!(
            "only {} of {} point matches agree (chance alone gives about {chance:.1}): look at the rectified images before \
             trusting a depth; views closer in tilt match better",
            rectification.inliers, rectification.matches
        ));
    }
    Ok((rectification, warnings))
}

/// Wrong matches that may be expected among the inliers if they fall anywhere in the right image.
fn by_chance(rectification: &Rectification, shape: [usize; 2]) -> f64 {
    let [low, high] = rectification.disparity_range_px;
    let accepted = (high - low + 4.0) * 6.0 * rectification.rms_row_error_px.max(0.1);
    (rectification.matches - rectification.inliers) as f64 * accepted / (shape[0] * shape[1]).max(1) as f64
}

fn affine(
    matches: &PointMatches,
    shapes: [[usize; 2]; 2],
    tilt_axis_rad: f64,
    settings: &RectifySettings,
    seed: u64,
    warn: &mut impl FnMut(String),
) -> Result<Geometry, RectifyError> {
    let few = |inliers| RectifyError::TooFewMatches { matches: matches.distinct.len(), inliers };
    let diagonal_px = shapes.iter().map(|[height, width]| (*height as f64).hypot(*width as f64)).fold(0.0, f64::max);
    let prior = settings.prior(tilt_axis_rad);
    let found = consensus(matches, diagonal_px, &prior, seed).map_err(few)?;
    if found.inliers.len() < SMALLEST_INLIERS {
        return Err(few(found.inliers.len()));
    }
    let posterior = &found.posterior;
    let epipolar = posterior.geometry;
    let disparities: Vec<f64> = epipolar.differences(&found.inliers).iter().map(|difference| difference.x).collect();
    let centre = median(disparities.iter().copied());
    let squares: f64 = disparities.iter().map(|d| (d - centre).powi(2)).sum();
    let spread = (squares / disparities.len() as f64).sqrt();

    let held_by_prior = posterior.points_sigma_rad > prior.sigma_rad;
    let (axis, sigma) = (epipolar.axis_left_rad.to_degrees(), posterior.axis_sigma_rad.to_degrees());
    if held_by_prior {
        warn(format!(
            "the {} point matches show the tilt axis only to {:.1} degrees (third eigenvalue {:.1} times the fourth; near 1 \
             all points lie in one plane): it is held at {axis:.2} +- {sigma:.2} degrees by the axis given ({:.2} +- {:.2}), \
             so --tilt-axis matters; an error of 1 degree moves a row by 0.017 px per px of disparity",
            found.inliers.len(),
            posterior.points_sigma_rad.to_degrees(),
            posterior.eigenvalue_ratio,
            prior.axis_rad.to_degrees(),
            settings.axis_prior_sigma_deg,
        ));
    } else {
        let off = wrapped(posterior.points_axis_rad - prior.axis_rad, std::f64::consts::PI).to_degrees();
        let expected = posterior.points_sigma_rad.to_degrees().hypot(settings.axis_prior_sigma_deg);
        if off.abs() > 3.0 * expected {
            warn(format!(
                "the points show the tilt axis {off:+.2} degrees from the one given ({expected:.2} expected); {axis:.2} +- \
                 {sigma:.2} degrees is used: check --tilt-axis",
            ));
        }
    }
    Ok(Geometry {
        maps: [epipolar.rectified_from_left(), epipolar.rectified_from_right()],
        sigma_row_px: Some(systematic_row_error_px(posterior, &found.fitted, spread, shapes[0])),
        axis_rad: epipolar.axis_left_rad,
        axis_sigma_rad: posterior.axis_sigma_rad,
        held_by_prior,
        eigenvalue_ratio: Some(posterior.eigenvalue_ratio),
        relative_rotation_rad: epipolar.relative_rotation_rad(),
        relative_scale: epipolar.scale,
        right_from_left: found.right_from_left,
        inliers: found.inliers,
        matches: found.matches,
    })
}

fn paper(
    matches: &PointMatches,
    shape: [usize; 2],
    seed: u64,
    warn: &mut impl FnMut(String),
) -> Result<Geometry, RectifyError> {
    let [height, width] = shape.map(|side| side as f64);
    let centre = Point2::new(0.5 * (width - 1.0), 0.5 * (height - 1.0));
    let fit = fit_paper(&matches.distinct, centre, PAPER_REACH_SHARE * width.hypot(height), seed);
    let inliers = fit.as_ref().map_or(0, |fit| fit.inliers.len());
    let fit = fit.filter(|fit| fit.inliers.len() >= SMALLEST_INLIERS);
    let fit = fit.ok_or(RectifyError::TooFewMatches { matches: matches.distinct.len(), inliers })?;
    warn(format!(
        "rectified by the paper's model: a shift, then the right image alone turned by {:.2} degrees; scale and the axis's \
         direction in the left image are not corrected (use model = \"affine\" unless you compare)",
        fit.theta_rad.to_degrees()
    ));
    Ok(Geometry {
        maps: [Similarity2::identity(), fit.rectified_from_right],
        sigma_row_px: None,
        axis_rad: fit.theta_rad,
        axis_sigma_rad: fit.theta_sigma_rad,
        held_by_prior: false,
        eigenvalue_ratio: None,
        relative_rotation_rad: -fit.theta_rad,
        relative_scale: 1.0,
        right_from_left: fit.rectified_from_right.inverse(),
        inliers: fit.inliers,
        matches: matches.distinct.len(),
    })
}
