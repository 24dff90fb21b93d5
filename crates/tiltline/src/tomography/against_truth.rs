//! Tomograms of simulated series, judged by the scores of stereo pairs: the comparison that a method against N views needs.
//!
//! Everything that a user would have to estimate or choose is taken from the truth: alignment, tilts, the depth of the volume, and
//! the threshold, which is the one that gives the best F-score. What is left is the tomogram's own error, and the figures are
//! generous to it. Views are flattened and inverted as in [`super::prepare`].

use ndarray::{Array2, Array3};
use serde::Serialize;

use super::compare::thresholds;
use super::curves::{CurveSettings, VolumeCurve, curves};
use super::prepare::{PrepareSettings, prepare, upright_from_projection};
use super::{Geometry, Method, TomographyError, evenly_spaced, volume};
use crate::curve::Flag;
use crate::geometry::{Point3, Similarity2, Vector3};
use crate::score::{PairScore, ResultCurve, ResultCurves, ResultPoint, ScoreError, ScoreSettings, score_pair};
use crate::truth::{Truth, TruthError, TruthPair};

/// Layers of the volume above and below the deepest lines, px.
const MARGIN_PX: f64 = 8.0;
/// What a tomogram's curves state as the sigma of their disparity, px: they know none, and are not judged by it.
const SIGMA_PX: f64 = 1.0;

/// Why a tomogram could not be judged.
#[derive(Debug, thiserror::Error)]
pub enum JudgeError {
    /// The truth does not say how a view lies.
    #[error("the truth of view '{view}' has no {what}; only simulated series can be judged")]
    Unknown {
        /// Name of the view.
        view: String,
        /// What is missing.
        what: &'static str,
    },
    /// The number of images is not that of the truth's views.
    #[error("{images} images were given for a truth of {views} views")]
    Count {
        /// Number of images.
        images: usize,
        /// Number of views.
        views: usize,
    },
    /// There is no tomogram.
    #[error(transparent)]
    Tomography(#[from] TomographyError),
    /// The pair that is scored is not possible.
    #[error(transparent)]
    Truth(#[from] TruthError),
    /// The result cannot be scored.
    #[error(transparent)]
    Score(#[from] ScoreError),
}

/// A simulated series whose views lie as the truth says.
#[derive(Clone, Debug)]
pub struct KnownSeries<'a> {
    truth: &'a Truth,
    /// Prepared views, tilt axis upright in the middle.
    views: Vec<Array2<f32>>,
    tilts_rad: Vec<f64>,
    shape: [usize; 2],
    depth: usize,
    px_per_unit: f64,
}

/// The curves of a tomogram at the threshold that suits the truth best.
#[derive(Clone, Debug, Serialize)]
pub struct Judged {
    /// Tilts of the views that were used, degrees.
    pub tilts_deg: Vec<f64>,
    /// The threshold, and the share of the voxels at or above it.
    pub threshold: f32,
    /// See `threshold`.
    pub share: f64,
    /// The scores of the curves there.
    pub score: PairScore,
    /// The curves, (X, Y, Z) in the unit of the truth, in its frame.
    #[serde(skip)]
    pub curves: Vec<VolumeCurve>,
}

impl<'a> KnownSeries<'a> {
    /// Aligns the images of a truth's views by what the truth says about them.
    ///
    /// # Errors
    /// Where the truth lacks a tilt, a map or 3D points.
    pub fn new(truth: &'a Truth, images: &[Array2<f32>], settings: &PrepareSettings) -> Result<Self, JudgeError> {
        if images.len() != truth.views.len() || images.is_empty() {
            return Err(JudgeError::Count { images: images.len(), views: truth.views.len() });
        }
        let shape = [truth.views[0].height, truth.views[0].width];
        let mut px_per_unit = None;
        let mut tilts_rad = Vec::new();
        let mut maps = Vec::new();
        for view in &truth.views {
            let unknown = |what| JudgeError::Unknown { view: view.name.clone(), what };
            tilts_rad.push(view.tilt_rad.ok_or_else(|| unknown("tilt"))?);
            let map = view.input_from_projection.ok_or_else(|| unknown("map"))?;
            let scale = *px_per_unit.get_or_insert(map.scale_px);
            let px_from_unit = Similarity2::from_scaling(scale);
            maps.push(upright_from_projection(shape) * px_from_unit * map.input_from_projection().inverse());
        }
        let px_per_unit = px_per_unit.unwrap_or(1.0);
        let deepest = truth.curves.iter().flat_map(|curve| curve.points.iter().flatten());
        let deepest = deepest.map(|point| point.z.abs() * px_per_unit).fold(0.0, f64::max);
        let views = images.iter().zip(&maps).map(|(image, map)| prepare(image, map, shape, settings)).collect();
        let depth = (2.0 * (deepest + MARGIN_PX)).ceil() as usize;
        Ok(Self { truth, views, tilts_rad, shape, depth, px_per_unit })
    }

    /// The tomogram `[z, y, x]` of `count` evenly spaced views, its geometry, and which views they are.
    ///
    /// # Errors
    /// Where there are not so many views, or a setting is not possible.
    pub fn tomogram(
        &self,
        count: usize,
        method: &Method,
    ) -> Result<(Array3<f32>, Geometry, Vec<usize>), TomographyError> {
        let chosen = evenly_spaced(&self.tilts_rad, count)?;
        let tilts_rad = chosen.iter().map(|view| self.tilts_rad[*view]).collect();
        let geometry = Geometry::centred(tilts_rad, self.shape[1], self.depth);
        let views: Vec<Array2<f32>> = chosen.iter().map(|view| self.views[*view].clone()).collect();
        Ok((volume(&views, &geometry, method)?, geometry, chosen))
    }

    /// The curves of the tomogram of `count` evenly spaced views, at the best threshold, and their scores as those of the stereo
    /// pair `pair` (indices of views).
    ///
    /// # Errors
    /// As for [`KnownSeries::tomogram`], or where the pair cannot be scored.
    pub fn judge(&self, count: usize, method: &Method, pair: [usize; 2]) -> Result<Judged, JudgeError> {
        let stereo = self.truth.pair(pair[0], pair[1])?;
        let (volume, geometry, chosen) = self.tomogram(count, method)?;
        let mut best: Option<Judged> = None;
        for (share, threshold) in thresholds(&volume) {
            let found = curves(&volume, &geometry, threshold, &CurveSettings::default());
            let found: Vec<VolumeCurve> = found.into_iter().map(|curve| self.in_truth_frame(curve)).collect();
            let name = format!("{count} views");
            let score = score_pair(&name, &result(&found, &stereo), &stereo, &ScoreSettings::default())?;
            if best.as_ref().is_none_or(|best| score.end_to_end.f_score > best.score.end_to_end.f_score) {
                let tilts_deg = chosen.iter().map(|view| self.tilts_rad[*view].to_degrees()).collect();
                best = Some(Judged { tilts_deg, threshold, share, score, curves: found });
            }
        }
        best.ok_or(JudgeError::Tomography(TomographyError::Value {
            name: "the largest value of the tomogram",
            value: volume.iter().copied().fold(f32::NEG_INFINITY, f32::max).into(),
            expected: "there is nothing bright in it: are the lines dark and the views not inverted?",
        }))
    }

    /// Where a point of the specimen (unit and frame of the truth) lies in a tomogram: column, row and layer, voxel centres at integers.
    pub fn voxel(&self, geometry: &Geometry, point: &Point3) -> [f64; 3] {
        let px = point * self.px_per_unit;
        [px.x + geometry.axis_column, px.y + 0.5 * (self.shape[0] as f64 - 1.0), px.z + geometry.middle_layer()]
    }

    /// From px about the axis and the first row to the unit of the truth about the specimen's origin.
    fn in_truth_frame(&self, mut curve: VolumeCurve) -> VolumeCurve {
        let middle = Vector3::new(0.0, 0.5 * (self.shape[0] as f64 - 1.0), 0.0);
        curve.points.iter_mut().for_each(|point| *point = (*point - middle) / self.px_per_unit);
        curve
    }
}

/// Curves of a specimen (unit and frame of the truth) as the result of a pair: where each point lies in both images and in the
/// mid-view frame. Stretches outside either image are left out, as no pair could find them.
pub fn result(found: &[VolumeCurve], pair: &TruthPair<'_>) -> ResultCurves {
    let none = ResultCurves { unit: pair.truth.unit, curves: Vec::new(), unmatched_left: Some(Vec::new()) };
    let maps = pair.left.input_from_projection.zip(pair.right.input_from_projection);
    let Some(((left_map, right_map), tilts)) = maps.zip(pair.tilts) else { return none };
    let (sin, cos) = tilts.mid_rad().sin_cos();
    let place = |point: &Point3| {
        let (left, right) = (left_map.project(point, tilts.left_rad), right_map.project(point, tilts.right_rad));
        let position = Point3::new(point.x * cos + point.z * sin, point.y, point.z * cos - point.x * sin);
        (pair.left.contains(&left) && pair.right.contains(&right)).then_some(ResultPoint {
            left,
            right,
            sigma_disparity_px: SIGMA_PX,
            position,
            flag: Flag::Ok,
        })
    };
    let mut curves = Vec::new();
    for curve in found {
        let placed: Vec<Option<ResultPoint>> = curve.points.iter().map(place).collect();
        let whole = placed.iter().all(Option::is_some);
        for run in placed.split(Option::is_none).filter(|run| run.len() >= 2) {
            curves.push(ResultCurve { points: run.iter().flatten().copied().collect(), closed: curve.closed && whole });
        }
    }
    ResultCurves { curves, ..none }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::simulate::draw::union_of_profiles;
    use crate::tomography::{SirtSettings, WbpSettings};
    use crate::truth::{ViewGeometry, ViewMap, tests::foil};

    /// Dark lines of a known foil in views that are turned, shifted and magnified: the tomogram's curves are the truth's, in its
    /// frame, with the sign of z.
    #[test]
    fn the_tomogram_of_a_known_series_has_the_curves_of_the_truth() {
        let views: Vec<ViewGeometry> = (-12..=12)
            .map(|step| ViewGeometry {
                name: format!("view {step}"),
                tilt_rad: (5.0 * f64::from(step)).to_radians(),
                shape: [192, 192],
                map: ViewMap {
                    scale_px: 0.9 + 0.001 * f64::from(step),
                    axis_rad: 0.2 + 0.002 * f64::from(step),
                    origin_px: [95.5 + 0.3 * f64::from(step), 94.0 - 0.2 * f64::from(step)],
                },
            })
            .collect();
        let truth = Truth::of_foil(&foil(), &views);
        let images: Vec<Array2<f32>> = truth
            .views
            .iter()
            .map(|view| {
                let curves: Vec<_> = view.curves.iter().map(|curve| curve.contrast.clone()).collect();
                union_of_profiles([192, 192], &curves, 1.3).mapv(|line| 100.0 * (1.0 - 0.3 * line))
            })
            .collect();
        let series = KnownSeries::new(&truth, &images, &PrepareSettings::dark_lines()).unwrap();
        for method in [Method::Wbp(WbpSettings::default()), Method::Sirt(SirtSettings::default())] {
            let judged = series.judge(25, &method, [11, 13]).unwrap();
            let score = &judged.score.end_to_end;
            assert!(score.completeness > 0.9 && score.correctness.unwrap() > 0.9, "{method:?} {score:?}");
            // In nm, of which there are 1.1 to a px.
            assert!(score.distance.unwrap().mean < 1.5, "{method:?} {:?}", score.distance);
            assert!(
                score.origin_shift_px.iter().all(|shift| shift.abs() < 1e-6) && score.removed_offset_px.abs() < 0.2
            );
        }
        assert!(matches!(
            series.judge(26, &Method::Wbp(WbpSettings::default()), [11, 13]),
            Err(JudgeError::Tomography(_))
        ));
        assert!(KnownSeries::new(&truth, &images[..3], &PrepareSettings::dark_lines()).is_err());
    }
}
