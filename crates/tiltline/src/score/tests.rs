//! Hand-computable cases. The scene: lines in a foil seen at -4 and 4 degrees, 1 px per nm, rows level; a perfect result is
//! the truth itself, and each test spoils it in one known way.

use std::path::Path;

use approx::{assert_abs_diff_eq, assert_relative_eq};
use proptest::prelude::*;

use super::summary::Figures;
use super::*;
use crate::curve::Flag;
use crate::geometry::{Point3, TiltPair, Vector2};
use crate::reconstruction::LengthUnit;
use crate::simulate::{Dislocation, Foil};
use crate::truth::{ProjectedCurve, Truth, ViewGeometry, ViewMap};

/// Ends of pieces and tolerances at ends: a piece at either end of a curve.
const RESOLUTION_PX: f64 = 1.0;

fn tilts() -> TiltPair {
    TiltPair::from_degrees(-4.0, 4.0)
}

fn truth_of(lines: Vec<Vec<Point3>>) -> Truth {
    let line = |points| Dislocation { points, closed: false, burgers_nm: None, plane_normal: None };
    let dislocations = lines.into_iter().map(line).collect();
    let foil = Foil { thickness_nm: 200.0, size_nm: [256.0, 256.0], dislocations };
    let view = |name: &str, tilt_rad| ViewGeometry {
        name: name.into(),
        tilt_rad,
        shape: [256, 256],
        map: ViewMap { scale_px: 1.0, axis_rad: 0.0, origin_px: [127.5, 127.5] },
    };
    Truth::of_foil(&foil, &[view("left", tilts().left_rad), view("right", tilts().right_rad)])
}

/// A straight line from a to b, points 1 nm apart.
fn straight(a: [f64; 3], b: [f64; 3]) -> Vec<Point3> {
    let (a, b) = (Point3::from(a), Point3::from(b));
    let steps = (b - a).norm().ceil() as usize;
    (0..=steps).map(|step| a + (b - a) * (step as f64 / steps as f64)).collect()
}

/// What a perfect program would return: its origin elsewhere, its depth relative to somewhere.
fn perfect(truth: &Truth) -> ResultCurves {
    let pair = truth.pair(0, 1).unwrap();
    let curve = |paired: crate::truth::PairedCurve<'_>| {
        let positions = paired.curve.points.as_ref().unwrap();
        let point = |index: usize| ResultPoint {
            left: paired.left[index],
            right: paired.right[index].unwrap(),
            sigma_disparity_px: 0.5,
            position: positions[index] + nalgebra::Vector3::new(11.0, -7.0, 33.0),
            flag: Flag::Ok,
        };
        ResultCurve { points: (0..positions.len()).map(point).collect(), closed: paired.curve.closed }
    };
    let curves = pair.curves().into_iter().map(curve).collect();
    ResultCurves { unit: LengthUnit::Nm, curves, unmatched_left: Some(Vec::new()) }
}

fn score(result: &ResultCurves, truth: &Truth) -> PairScore {
    score_pair("test", result, &truth.pair(0, 1).unwrap(), &ScoreSettings::default()).unwrap()
}

/// Moves the image points, and the position by what that triangulates to.
fn displace(point: &mut ResultPoint, left: Vector2, right: Vector2) {
    point.left += left;
    point.right += right;
    let (x, z) = tilts().triangulate(left.x, right.x);
    point.position += nalgebra::Vector3::new(x, 0.5 * (left.y + right.y), z);
}

fn vertical(x: f64, z: f64) -> Vec<Point3> {
    straight([x, -50.0, z], [x, 50.0, z])
}

#[test]
fn the_truth_scores_full_marks_whatever_its_origin() {
    let truth = truth_of(vec![vertical(-40.0, 20.0), straight([-20.0, -50.0, -60.0], [60.0, 40.0, 60.0])]);
    let score = score(&perfect(&truth), &truth);
    assert_relative_eq!(score.paper.coverage, 1.0);
    assert_abs_diff_eq!(score.paper.epe_px.unwrap(), 0.0, epsilon = 1e-9);
    assert_abs_diff_eq!(score.paper.bad_1_percent, 0.0);
    let end = &score.end_to_end;
    assert_eq!(end.basis, Basis::Core);
    assert_relative_eq!(end.completeness, 1.0);
    assert_relative_eq!(end.correctness.unwrap(), 1.0);
    assert_relative_eq!(end.f_score, 1.0);
    assert_abs_diff_eq!(end.across_px.unwrap().mean, 0.0, epsilon = 1e-6);
    assert_abs_diff_eq!(end.distance.unwrap().p95, 0.0, epsilon = 1e-6);
    // The offsets of `perfect`, found again in the left view and as disparity.
    assert_abs_diff_eq!(
        end.origin_shift_px[0],
        33.0 * tilts().right_rad.sin() - 11.0 * tilts().right_rad.cos(),
        epsilon = 1e-6
    );
    assert_abs_diff_eq!(end.origin_shift_px[1], 7.0, epsilon = 1e-6);
    assert_abs_diff_eq!(end.removed_offset_px, 33.0 / tilts().depth_gain(), epsilon = 1e-6);
    assert_relative_eq!(score.lines.cl_dice, 1.0);
    assert_eq!(end.junctions, JunctionScore::default());
}

#[test]
fn a_curve_shifted_by_one_and_a_half_px_scores_exactly_that() {
    // A vertical line moved sideways in both images: the disparity stays, so the paper's protocol sees no error.
    let truth = truth_of(vec![vertical(-40.0, 0.0), vertical(30.0, 10.0)]);
    let mut result = perfect(&truth);
    let shift = Vector2::new(1.5, 0.0);
    result.curves[0].points.iter_mut().for_each(|point| displace(point, shift, shift));
    let score_ = score(&result, &truth);
    assert_abs_diff_eq!(score_.paper.epe_px.unwrap(), 0.0, epsilon = 1e-9);
    let end = &score_.end_to_end;
    assert_relative_eq!(end.completeness, 1.0);
    assert_relative_eq!(end.across_px.unwrap().mean, 0.5 * 1.5, epsilon = 1e-9);
    assert_relative_eq!(end.across_px.unwrap().p95, 1.5, epsilon = 1e-9);
    // Half of the detected lines lie 1.5 px off: just inside a mask 3 px wide.
    assert_relative_eq!(score_.lines.cl_dice, 1.0);

    // Moved in the right image only, that is the error of the prediction.
    let mut result = perfect(&truth);
    for point in result.curves.iter_mut().flat_map(|curve| &mut curve.points) {
        displace(point, Vector2::zeros(), Vector2::new(1.5, 0.0));
    }
    let score = score(&result, &truth);
    assert_relative_eq!(score.paper.epe_px.unwrap(), 1.5, epsilon = 1e-9);
    assert_relative_eq!(score.paper.bad_1_percent, 100.0);
    assert_relative_eq!(score.paper.bad_3_percent, 0.0);
    assert_relative_eq!(score.paper.depth_error_px.unwrap(), 1.5 / (2.0 * 4.0_f64.to_radians().sin()), epsilon = 1e-9);
}

#[test]
fn a_disparity_offset_is_removed_end_to_end_but_not_in_the_papers_protocol() {
    let truth = truth_of(vec![vertical(-40.0, -20.0), vertical(10.0, 20.0), vertical(50.0, 0.0)]);
    let mut result = perfect(&truth);
    for point in result.curves.iter_mut().flat_map(|curve| &mut curve.points) {
        displace(point, Vector2::zeros(), Vector2::new(7.0, 0.0));
    }
    let score_ = score(&result, &truth);
    assert_relative_eq!(score_.paper.epe_px.unwrap(), 7.0, epsilon = 1e-9);
    assert_relative_eq!(score_.paper.bad_5_percent, 100.0);
    let end = &score_.end_to_end;
    assert_relative_eq!(end.completeness, 1.0);
    assert_abs_diff_eq!(end.disparity_px.unwrap().p95, 0.0, epsilon = 1e-9);

    // One line of three off by 2.5 px of disparity cannot be blamed on the offset: it is wrong in both.
    let mut result = perfect(&truth);
    result.curves[1].points.iter_mut().for_each(|point| point.position.z += 2.5 * tilts().depth_gain());
    let end = score(&result, &truth).end_to_end;
    assert_relative_eq!(end.completeness, 2.0 / 3.0, epsilon = 1e-9);
    assert_relative_eq!(end.correctness.unwrap(), 2.0 / 3.0, epsilon = 1e-9);
    // Off by exactly the tolerance, it is still right, and the mean says how far off.
    let mut result = perfect(&truth);
    result.curves[1].points.iter_mut().for_each(|point| point.position.z += 2.0 * tilts().depth_gain());
    let end = score(&result, &truth).end_to_end;
    assert_relative_eq!(end.completeness, 1.0, epsilon = 1e-9);
    assert_relative_eq!(end.disparity_px.unwrap().mean, 2.0 / 3.0, epsilon = 1e-9);
}

#[test]
fn a_depth_of_the_wrong_sign_is_wrong() {
    // Disparities of +-14 px: mirrored in depth, only what lies near the middle can be right.
    let truth = truth_of(vec![straight([-50.0, -60.0, -100.0], [50.0, 60.0, 100.0]), vertical(-40.0, 80.0)]);
    let mut result = perfect(&truth);
    result.curves.iter_mut().flat_map(|curve| &mut curve.points).for_each(|point| point.position.z *= -1.0);
    let end = score(&result, &truth).end_to_end;
    assert!(end.completeness < 0.5, "{}", end.completeness);
}

/// The axis is no property of the foil: a result that took it to be 0.8 degrees off is the same foil in a turned frame. Turning
/// the frame back must not turn wrong curves into right ones.
#[test]
fn a_result_about_another_axis_is_as_good_and_displaced_curves_are_not() {
    let truth = truth_of(vec![
        vertical(-40.0, 60.0),
        straight([-90.0, -90.0, -60.0], [90.0, 80.0, 60.0]),
        straight([-80.0, 90.0, 20.0], [95.0, -70.0, -40.0]),
    ]);
    for degrees in [0.8_f64, -0.8, 60.0] {
        let angle = degrees.to_radians();
        let turn = nalgebra::Rotation3::from_axis_angle(&nalgebra::Vector3::z_axis(), -angle);
        let turned = |mut result: ResultCurves| {
            for point in result.curves.iter_mut().flat_map(|curve| &mut curve.points) {
                point.position = turn * point.position;
            }
            result
        };
        let end = score(&turned(perfect(&truth)), &truth).end_to_end;
        assert_abs_diff_eq!(end.frame_turn_deg, degrees, epsilon = 1e-6);
        assert_relative_eq!(end.f_score, 1.0, epsilon = 1e-9);
        assert_abs_diff_eq!(end.across_px.unwrap().p95, 0.0, epsilon = 1e-5);
        assert_abs_diff_eq!(end.disparity_px.unwrap().p95, 0.0, epsilon = 1e-5);

        // What a program finds that rectifies about that axis: it turns both images, so that the left columns are turned exactly,
        // and reads off a disparity smaller by the cosine. That leaves sin(angle) of half the disparity (8 px at most) and the
        // cosine's part.
        let mut rectified = perfect(&truth);
        for point in rectified.curves.iter_mut().flat_map(|curve| &mut curve.points) {
            let image_turn = nalgebra::Rotation2::new(-angle);
            let centre = Point2::new(127.5, 127.5);
            let [left, right] = [point.left, point.right].map(|at| image_turn * (at - centre));
            let (x, z) = tilts().triangulate(left.x, right.x);
            point.position = Point3::new(x, left.y, z);
        }
        let end = score(&rectified, &truth).end_to_end;
        if degrees.abs() < 1.0 {
            assert_relative_eq!(end.f_score, 1.0, epsilon = 1e-9);
            assert_abs_diff_eq!(end.across_px.unwrap().p95, 0.0, epsilon = 4.0 * angle.abs().sin() + 0.02);
            assert_abs_diff_eq!(end.disparity_px.unwrap().p95, 0.0, epsilon = 8.0 * (1.0 - angle.cos()) + 0.01);
        }

        // Curves 3 px off across their direction, in alternate directions, each beside where its own image says it is.
        let mut displaced = perfect(&truth);
        for (index, curve) in displaced.curves.iter_mut().enumerate() {
            let tangent = curve.points[curve.points.len() - 1].left - curve.points[0].left;
            let across = Vector2::new(-tangent.y, tangent.x).normalize() * if index == 1 { -3.0 } else { 3.0 };
            curve.points.iter_mut().for_each(|point| displace(point, across, across));
        }
        let end = score(&turned(displaced), &truth).end_to_end;
        assert!(end.f_score < 0.1, "{}", end.f_score);
    }
}

#[test]
fn half_a_curve_missing_is_half_complete_and_fully_correct() {
    let truth = truth_of(vec![straight([-50.0, -50.0, -30.0], [50.0, 50.0, 30.0])]);
    let mut result = perfect(&truth);
    let keep = result.curves[0].points.len() / 2;
    result.curves[0].points.truncate(keep + 1);
    let score = score(&result, &truth);
    let slack = RESOLUTION_PX / score.end_to_end.truth_length_px;
    assert_abs_diff_eq!(score.end_to_end.completeness, 0.5, epsilon = slack);
    assert_relative_eq!(score.end_to_end.correctness.unwrap(), 1.0);
    assert_abs_diff_eq!(score.paper.coverage, 0.5, epsilon = slack);
    assert_abs_diff_eq!(score.paper.bad_3_percent, 50.0, epsilon = 100.0 * slack);
    // The last predicted piece lies just behind the result's end and has the disparity of that end.
    assert_abs_diff_eq!(score.paper.epe_px.unwrap(), 0.0, epsilon = 1e-3);
}

#[test]
fn doubled_curves_are_not_twice_as_good() {
    let truth = truth_of(vec![vertical(-40.0, 0.0), vertical(30.0, 20.0)]);
    let mut result = perfect(&truth);
    // One of two lines is found and the other is somewhere else entirely: half right.
    result.curves[1]
        .points
        .iter_mut()
        .for_each(|point| displace(point, Vector2::new(20.0, 0.0), Vector2::new(20.0, 0.0)));
    let once = score(&result, &truth).end_to_end;
    assert_relative_eq!(once.completeness, 0.5);
    assert_relative_eq!(once.correctness.unwrap(), 0.5);
    for shift in [0.0, 0.4] {
        let mut doubled = result.clone();
        let mut copy = result.curves[0].clone();
        copy.points.iter_mut().for_each(|point| displace(point, Vector2::new(shift, 0.0), Vector2::new(shift, 0.0)));
        doubled.curves.push(copy);
        let twice = score(&doubled, &truth).end_to_end;
        assert_relative_eq!(twice.completeness, 0.5);
        assert_relative_eq!(twice.correctness.unwrap(), 1.0 / 3.0, epsilon = 1e-9);
    }
    // There and back again within one curve: the way back is not right a second time.
    let mut hairpin = perfect(&truth);
    let mut back = hairpin.curves[0].points.clone();
    back.reverse();
    back.iter_mut().for_each(|point| displace(point, Vector2::new(0.3, 0.0), Vector2::new(0.3, 0.0)));
    hairpin.curves[0].points.extend(back);
    let end = score(&hairpin, &truth).end_to_end;
    assert_relative_eq!(end.completeness, 1.0);
    // Lengths 200 and 100; near the turn the two legs cannot be told apart.
    assert_abs_diff_eq!(end.correctness.unwrap(), 2.0 / 3.0, epsilon = 0.02);
}

#[test]
fn one_line_through_a_narrow_dipole_finds_one_of_the_two() {
    let truth = truth_of(vec![vertical(0.0, 0.0), vertical(1.4, 0.0), vertical(60.0, 0.0)]);
    let mut result = perfect(&truth);
    result.curves.remove(1);
    let end = score(&result, &truth).end_to_end;
    assert_relative_eq!(end.completeness, 2.0 / 3.0, epsilon = 1e-9);
    assert_relative_eq!(end.correctness.unwrap(), 1.0);
}

#[test]
fn crossing_lines_are_told_apart_by_depth_and_direction() {
    let truth = truth_of(vec![
        straight([-50.0, -50.0, -80.0], [50.0, 50.0, -80.0]),
        straight([-50.0, 50.0, 80.0], [50.0, -50.0, 80.0]),
    ]);
    let result = perfect(&truth);
    let full = score(&result, &truth);
    assert_relative_eq!(full.end_to_end.f_score, 1.0);
    assert_abs_diff_eq!(full.paper.epe_px.unwrap(), 0.0, epsilon = 1e-9);
    // No end lies at a crossing: it is not a junction.
    assert_eq!(full.end_to_end.junctions.truth + full.end_to_end.junctions.result, 0);
    // With one line gone, the other must not be credited for the crossing...
    let mut one = result.clone();
    one.curves.truncate(1);
    let end = score(&one, &truth);
    assert_relative_eq!(end.end_to_end.completeness, 0.5, epsilon = 1e-9);
    // ...and neither when it lies at the same depth.
    let flat = truth_of(vec![
        straight([-50.0, -50.0, 0.0], [50.0, 50.0, 0.0]),
        straight([-50.0, 50.0, 0.0], [50.0, -50.0, 0.0]),
    ]);
    let mut one = perfect(&flat);
    one.curves.truncate(1);
    let end = score(&one, &flat).end_to_end;
    assert_relative_eq!(end.completeness, 0.5, epsilon = 1e-9);
    assert_relative_eq!(end.correctness.unwrap(), 1.0);
}

#[test]
fn dropping_hard_lines_costs_completeness_and_coverage() {
    let truth = truth_of(vec![vertical(-40.0, 0.0), vertical(0.0, 20.0), vertical(40.0, 20.0)]);
    let mut result = perfect(&truth);
    // The hard line is wrong by 4 px of disparity.
    result.curves[2].points.iter_mut().for_each(|point| displace(point, Vector2::zeros(), Vector2::new(4.0, 0.0)));
    let with = score(&result, &truth);
    result.curves.truncate(2);
    let without = score(&result, &truth);
    // EPE alone looks better; every figure beside it does not.
    assert!(without.paper.epe_px < with.paper.epe_px);
    assert_relative_eq!(without.paper.coverage, 2.0 / 3.0, epsilon = 1e-9);
    assert!(without.paper.bad_1_percent >= with.paper.bad_1_percent - 1e-9);
    assert!(without.end_to_end.completeness <= with.end_to_end.completeness + 1e-9);
    assert_relative_eq!(without.end_to_end.any_distance_px.p95, FAR_PX);
}

#[test]
fn what_is_invisible_is_not_asked_for_and_not_wrong_to_find() {
    let mut truth = truth_of(vec![vertical(-40.0, 0.0), vertical(30.0, 0.0)]);
    truth.views[1].curves[1].visible = Some((0..101).map(|i| i < 51).collect());
    let result = perfect(&truth);
    let all = score(&result, &truth);
    assert_relative_eq!(all.end_to_end.completeness, 1.0);
    assert_relative_eq!(all.end_to_end.correctness.unwrap(), 1.0);
    assert_relative_eq!(all.end_to_end.visible_share, 0.75, epsilon = 1e-9);
    assert_relative_eq!(all.paper.truth_length_px, 150.0, epsilon = 1e-9);
    let mut one = result;
    one.curves.truncate(1);
    assert_relative_eq!(score(&one, &truth).end_to_end.completeness, 100.0 / 150.0, epsilon = 1e-9);
}

#[test]
fn cores_and_contrast_are_scored_apart() {
    // Contrast 3 px to the right of the core in both views, and the result follows the contrast.
    let mut truth = truth_of(vec![vertical(-40.0, 0.0), vertical(40.0, 20.0)]);
    for curve in truth.views.iter_mut().flat_map(|view| &mut view.curves) {
        curve.contrast.iter_mut().for_each(|point| point.x += 3.0);
    }
    let mut result = perfect(&truth);
    // `perfect` takes the image points from the contrast, and positions from the core.
    let (x, _) = tilts().triangulate(3.0, 3.0);
    result.curves.iter_mut().flat_map(|curve| &mut curve.points).for_each(|point| point.position.x += x);
    let end = score(&result, &truth).end_to_end;
    let contrast = end.on_contrast.unwrap();
    assert_relative_eq!(end.completeness, 0.0);
    assert_relative_eq!(contrast.completeness, 1.0);
    assert_relative_eq!(contrast.core_to_contrast_px.unwrap().mean, 3.0, epsilon = 1e-9);
    assert_abs_diff_eq!(contrast.across_px.unwrap().mean, 0.0, epsilon = 1e-6);
}

#[test]
fn sigma_that_fits_is_called_right() {
    // Errors 0.25, 0.75, 1.25, ... with sigma 0.5: a quarter each within 1 sigma, 2 sigma, and beyond twice.
    let truth = truth_of((0..4).map(|i| vertical(-60.0 + 30.0 * f64::from(i), 0.0)).collect());
    let mut result = perfect(&truth);
    for (index, curve) in result.curves.iter_mut().enumerate() {
        let off = Vector2::new(0.25 + 0.5 * index as f64, 0.0);
        curve.points.iter_mut().for_each(|point| displace(point, Vector2::zeros(), off));
        curve.points.iter_mut().for_each(|point| point.sigma_disparity_px = 0.5 + 1e-3 * index as f64);
    }
    result.curves[3].points.iter_mut().for_each(|point| point.flag = Flag::Bridged);
    let calibration = score(&result, &truth).calibration;
    assert_relative_eq!(calibration.within_1_sigma.unwrap(), 0.25, epsilon = 1e-9);
    assert_relative_eq!(calibration.within_2_sigma.unwrap(), 0.5, epsilon = 1e-9);
    assert_relative_eq!(calibration.median_sigma_px.unwrap(), 0.501, epsilon = 1e-9);
    assert_eq!(calibration.deciles.len(), 10);
    assert_relative_eq!(calibration.deciles[0].rms_error_px, 0.25, epsilon = 1e-9);
    assert_relative_eq!(calibration.deciles[9].median_error_px, 1.75, epsilon = 1e-9);
    assert_eq!(calibration.by_flag.len(), 2);
    assert_relative_eq!(calibration.by_flag[0].within_1_sigma, 1.0 / 3.0, epsilon = 1e-9);
}

#[test]
fn junctions_are_ends_that_meet_not_lines_that_cross() {
    // A node of three arms, and an end on the middle of another line.
    let truth = truth_of(vec![
        straight([0.0, 0.0, 10.0], [-40.0, -30.0, 20.0]),
        straight([0.0, 0.0, 10.0], [40.0, -30.0, 0.0]),
        straight([0.0, 0.0, 10.0], [0.0, 60.0, 10.0]),
        straight([0.0, 30.0, 10.0], [50.0, 40.0, 10.0]),
    ]);
    let result = perfect(&truth);
    let junctions = score(&result, &truth).end_to_end.junctions;
    assert_eq!(junctions, JunctionScore { truth: 2, result: 2, missed: 0, extra: 0 });
    // An arm that stops 8 px short leaves two arms: no junction.
    let mut short = result.clone();
    short.curves[1].points.drain(..8);
    assert_eq!(score(&short, &truth).end_to_end.junctions, JunctionScore { truth: 2, result: 1, missed: 1, extra: 0 });
    // Ends 100 nm (14 px of disparity) apart in depth do not meet.
    let mut deep = result;
    deep.curves[3].points.iter_mut().for_each(|point| point.position.z += 100.0);
    assert_eq!(score(&deep, &truth).end_to_end.junctions.missed, 1);
}

#[test]
fn cl_dice_of_masks_by_hand() {
    // A true line of 10 px, 3 px wide; the detection covers its left half and runs on 5 px beside it.
    let mask = |inside: fn(usize, usize) -> bool| {
        ndarray::Array2::from_shape_fn([12, 20], |(row, column)| inside(row, column))
    };
    let truth = mask(|row, column| (4..7).contains(&row) && (2..12).contains(&column));
    let predicted = mask(|row, column| (row == 5 || row == 10) && (2..7).contains(&column));
    // The skeleton of what is one pixel wide is itself; that of the truth is its middle row.
    let skeleton = |mask: &ndarray::Array2<bool>| {
        let mut thin = mask.clone();
        for row in [4, 6] {
            if mask[[5, 2]] && mask[[4, 2]] {
                thin.row_mut(row).fill(false);
            }
        }
        thin
    };
    // Precision 5 of 10, sensitivity 5 of 10.
    assert_relative_eq!(cl_dice(&predicted, &truth, skeleton).unwrap(), 0.5);
    let empty = mask(|_, _| false);
    assert_relative_eq!(cl_dice(&empty, &truth, skeleton).unwrap(), 0.0);
    assert_relative_eq!(cl_dice(&empty, &empty, skeleton).unwrap(), 1.0);
    assert!(cl_dice(&empty, &ndarray::Array2::from_elem([3, 3], true), skeleton).is_err());
}

#[test]
fn an_empty_result_scores_nothing_and_fails_at_nothing() {
    let truth = truth_of(vec![vertical(-40.0, 0.0)]);
    let empty = ResultCurves { unit: LengthUnit::Px, curves: Vec::new(), unmatched_left: None };
    let score = score(&empty, &truth);
    assert_eq!(score.end_to_end.correctness, None);
    assert_relative_eq!(score.end_to_end.f_score, 0.0);
    assert_relative_eq!(score.paper.bad_5_percent, 100.0);
    assert_eq!(score.paper.epe_px, None);
    assert!(score.notes.iter().any(|note| note.contains("lines.csv")));
}

#[test]
fn what_does_not_belong_together_is_refused() {
    let truth = truth_of(vec![vertical(-40.0, 0.0)]);
    let pair = truth.pair(0, 1).unwrap();
    let mut result = perfect(&truth);
    result.curves[0].points[7].left.x = 700.0;
    let error = score_pair("x", &result, &pair, &ScoreSettings::default()).unwrap_err().to_string();
    assert!(error.contains("(700.0, ") && error.contains("256x256"), "{error}");
    let mut px = truth.clone();
    px.unit = LengthUnit::Px;
    let error = score_pair("x", &perfect(&truth), &px.pair(0, 1).unwrap(), &ScoreSettings::default()).unwrap_err();
    assert!(matches!(error, ScoreError::Unit));
    let mut hidden = truth.clone();
    hidden.views[0].curves[0].visible = Some(vec![false; 101]);
    let error = score_pair("x", &perfect(&truth), &hidden.pair(0, 1).unwrap(), &ScoreSettings::default()).unwrap_err();
    assert!(matches!(error, ScoreError::NothingToFind { curves: 1, .. }));
}

#[test]
fn labels_without_3d_are_scored_on_the_image_columns() {
    let mut truth = truth_of(vec![vertical(-40.0, 0.0), vertical(30.0, 20.0)]);
    let mut result = perfect(&truth);
    truth.curves.iter_mut().for_each(|curve| curve.points = None);
    for view in &mut truth.views {
        view.input_from_projection = None;
        for curve in &mut view.curves {
            let ends = vec![curve.contrast[0], curve.contrast[100]];
            *curve = ProjectedCurve { label: curve.label.clone(), contrast: ends, core: None, visible: None };
        }
    }
    result.curves[1].points.iter_mut().for_each(|point| point.right.x += 1.0);
    let score = score(&result, &truth);
    assert_eq!(score.end_to_end.basis, Basis::Image);
    assert_relative_eq!(score.end_to_end.f_score, 1.0);
    assert_eq!(score.end_to_end.distance, None);
    assert_relative_eq!(score.paper.epe_px.unwrap(), 0.5, epsilon = 1e-9);
    // The tilts are still known, so depth is too.
    assert!(score.paper.depth_error_px.is_some());
}

#[test]
fn a_table_gives_the_same_scores_as_the_curves_it_was_written_from() {
    let header = "curve,point,x_left_px,y_left_px,x_right_px,y_right_px,disparity_px,sigma_disparity_px,x_nm,y_nm,z_nm,\
                  sigma_z_nm,flag";
    let truth = truth_of(vec![vertical(-40.0, 0.0), straight([-20.0, -50.0, -60.0], [60.0, 40.0, 60.0])]);
    let result = perfect(&truth);
    let mut text = format!("{header}\n");
    for (curve, points) in result.curves.iter().enumerate() {
        for (index, point) in points.points.iter().enumerate() {
            let (left, right, position) = (point.left, point.right, point.position);
            text += &format!(
                "{curve},{index},{},{},{},{},0,{},{},{},{},0,ok\n",
                left.x, left.y, right.x, right.y, point.sigma_disparity_px, position.x, position.y, position.z
            );
        }
    }
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("curves.csv"), &text).unwrap();
    std::fs::write(folder.path().join("lines.csv"), "view,line,point,x_px,y_px\nleft,0,0,5,5\nleft,0,1,5,25\n")
        .unwrap();
    let read = ResultCurves::read(folder.path()).unwrap();
    assert_eq!(read.curves, result.curves);
    assert_eq!(read.unmatched_left.as_ref().unwrap()[0].len(), 2);
    let path = Path::new("curves.csv");
    let message = |text: &str| ResultCurves::parse(text, path).unwrap_err().to_string();
    assert!(message("curve,point\n").contains("curve,point"));
    assert!(message(&text.replace("ok", "good")).contains("unknown flag 'good'"));
    assert!(message(&format!("{header}\n0,0,1,2,3\n")).contains("5 cells, 13 expected"));
    assert!(message(&format!("{header}\n0,0,1,2,3,4,5,6,7,NaN,9,10,ok\n")).contains("line 2: 'NaN'"));
    let px = ResultCurves::parse(&text.replace("_nm", "_px"), path).unwrap();
    // 1 px per nm: the same scores.
    assert_relative_eq!(score(&px, &truth).end_to_end.f_score, 1.0);
}

#[test]
fn a_dense_matcher_is_scored_by_the_same_protocol() {
    let truth = truth_of(vec![vertical(-40.0, 0.0)]);
    let pair = truth.pair(0, 1).unwrap();
    // Disparity 2 everywhere in the upper half of the image, nothing below; the truth has disparity 0.
    let residuals = residuals(&pair, |left, _| {
        let right = left + Vector2::new(2.0, 0.0);
        (left.y < 127.5).then_some(Prediction { right, sigma_px: None, flag: Flag::Ok })
    });
    let score = paper_score(&pair, &residuals);
    assert_relative_eq!(score.epe_px.unwrap(), 2.0, epsilon = 1e-9);
    assert_abs_diff_eq!(score.coverage, 0.5, epsilon = 0.01);
    assert_relative_eq!(score.bad_1_percent, 100.0);
    assert_eq!(calibration(&residuals).within_1_sigma, None);
}

#[test]
fn pooling_weighs_by_length_and_gives_an_interval_over_images() {
    let settings = ScoreSettings { bootstrap_samples: 400, ..ScoreSettings::default() };
    // Long images without error and short ones off by 2 px.
    let mut scores = Vec::new();
    for index in 0..10 {
        let long = index % 2 == 0;
        let mut truth = truth_of(vec![straight([0.0, if long { -60.0 } else { -20.0 }, 0.0], [0.0, 0.0, 0.0])]);
        truth.family = Some(if long { "gan" } else { "tial" }.into());
        let mut result = perfect(&truth);
        if !long {
            result.curves[0].points.iter_mut().for_each(|point| point.right.x += 2.0);
        }
        scores.push(score(&result, &truth));
    }
    let summary = Summary::new(&scores, &settings);
    let epe = summary.all.figures.epe_px.unwrap();
    assert_relative_eq!(epe.value, 2.0 * 20.0 / 80.0, epsilon = 1e-9);
    let [low, high] = epe.interval_95.unwrap();
    assert!(low < epe.value && epe.value < high && low >= 0.0 && high <= 2.0);
    assert!(summary.by_angle.is_empty(), "one angle is no grouping");
    assert_eq!(summary.by_family.len(), 2);
    assert_relative_eq!(summary.by_family[1].figures.epe_px.unwrap().value, 2.0, epsilon = 1e-9);
    // Pooled from a histogram: right to one bin.
    assert_abs_diff_eq!(summary.all.figures.across_p95_px.unwrap().value, 0.02, epsilon = 1e-9);
    assert_eq!(summary, Summary::new(&scores, &settings));
    assert_eq!(Figures::NAMES.len(), summary.all.figures.values().len());
    assert_eq!(Summary::new(&scores[..1], &settings).all.figures.epe_px.unwrap().interval_95, None);
}

#[test]
fn reports_say_where_their_figures_come_from() {
    use super::report::{Protocol, Provenance, Report};
    let mut scores = Vec::new();
    for index in 0..3 {
        let truth = truth_of(vec![vertical(-40.0, 0.0), vertical(20.0 + f64::from(index), 10.0)]);
        scores.push(score(&perfect(&truth), &truth));
    }
    let provenance = Provenance { dataset: Some("bench-8deg".into()), dataset_seed: Some(7), ..Provenance::default() };
    let report = Report::new(provenance, ScoreSettings::default(), scores);
    let text = report.to_markdown(Protocol::Both);
    assert!(text.contains("bench-8deg (version unknown, seed 7)") && text.contains("Weights: none"));
    assert!(text.contains("| completeness | 1.000 (1.000 to 1.000) |"), "{text}");
    assert!(text.contains("| EPE, px | 0.00 (0.00 to 0.00) |"));
    assert!(!report.to_markdown(Protocol::Paper).contains("End to end"));
    assert!(!report.to_markdown(Protocol::EndToEnd).contains("bad-1"));
    // Every row of a table has as many cells as its header.
    for lines in text.split("\n\n").filter(|part| part.starts_with('|')) {
        let cells: Vec<usize> = lines.trim().lines().map(|line| line.matches('|').count()).collect();
        assert!(cells.windows(2).all(|pair| pair[0] == pair[1]), "{lines}");
    }
    // Numbers are read to the last bit or one beside it; these are whole.
    let json: Report = serde_json::from_str(&report.to_json()).unwrap();
    assert_eq!(json.provenance, report.provenance);
    assert_eq!(json.summary.all.figures, report.summary.all.figures);
    assert_eq!(json.pairs[2].paper, report.pairs[2].paper);
}

/// Wavy curves in both roles, for laws that hold for any input.
fn wavy(seed: [f64; 4], depth: f64) -> Vec<Point3> {
    let [x, slope, bow, phase] = seed;
    (0..=90)
        .map(|i| {
            let t = f64::from(i) / 90.0;
            let y = -50.0 + 100.0 * t;
            Point3::new(x + slope * (t - 0.5) + bow * (6.0 * t + phase).sin(), y, depth * (t - 0.5))
        })
        .collect()
}

fn seeds() -> impl Strategy<Value = Vec<([f64; 4], f64)>> {
    let seed = (-60.0..60.0, -40.0..40.0, 0.0..12.0, 0.0..6.0).prop_map(|(a, b, c, d)| [a, b, c, d]);
    proptest::collection::vec((seed, -80.0..80.0), 1..6)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(48))]

    #[test]
    fn swapping_truth_and_result_swaps_completeness_and_correctness(truth in seeds(), more in seeds(), noise in 0.0..1.5) {
        // The result has some of the true curves, moved a little, and others.
        let true_curves: Vec<_> = truth.iter().map(|(seed, depth)| wavy(*seed, *depth)).collect();
        let other = truth.iter().skip(1).map(|(seed, depth)| ([seed[0] + noise, seed[1], seed[2], seed[3]], *depth));
        let found: Vec<_> = other.chain(more).map(|(seed, depth)| wavy(seed, depth)).collect();
        let (truth, found) = (truth_of(true_curves), truth_of(found));
        let forth = score(&perfect(&found), &truth).end_to_end;
        let back = score(&perfect(&truth), &found).end_to_end;
        prop_assert!((forth.completeness - back.correctness.unwrap()).abs() < 1e-9);
        prop_assert!((forth.correctness.unwrap() - back.completeness).abs() < 1e-9);
        prop_assert!((forth.f_score - back.f_score).abs() < 1e-9);
        let common = 33.0 / tilts().depth_gain();
        // Without anything side by side there is nothing to tell an offset by.
        prop_assert!(forth.removed_offset_px == 0.0 || (forth.removed_offset_px - common + back.removed_offset_px - common).abs() < 1e-6);
    }

    #[test]
    fn points_set_more_densely_change_no_score(truth in seeds(), pieces in 2_usize..5, noise in 0.0..2.5) {
        let truth = truth_of(truth.iter().map(|(seed, depth)| wavy(*seed, *depth)).collect());
        let mut result = perfect(&truth);
        for (index, point) in result.curves.iter_mut().flat_map(|curve| &mut curve.points).enumerate() {
            let off = Vector2::new(noise * (index as f64 * 0.37).sin(), 0.0);
            displace(point, off, -off);
        }
        let mut dense = result.clone();
        for curve in &mut dense.curves {
            let mut points = vec![curve.points[0]];
            for pair in curve.points.windows(2) {
                for step in 1..=pieces {
                    let t = step as f64 / pieces as f64;
                    let mut point = if step == pieces { pair[1] } else { pair[0] };
                    point.left = pair[0].left + (pair[1].left - pair[0].left) * t;
                    point.right = pair[0].right + (pair[1].right - pair[0].right) * t;
                    point.position = pair[0].position + (pair[1].position - pair[0].position) * t;
                    points.push(point);
                }
            }
            curve.points = points;
        }
        let (a, b) = (score(&result, &truth), score(&dense, &truth));
        prop_assert!((a.end_to_end.completeness - b.end_to_end.completeness).abs() < 1e-3);
        prop_assert!((a.end_to_end.f_score - b.end_to_end.f_score).abs() < 1e-3);
        prop_assert!((a.paper.epe_px.unwrap() - b.paper.epe_px.unwrap()).abs() < 1e-3);
        prop_assert!((a.paper.bad_1_percent - b.paper.bad_1_percent).abs() < 0.1);
        prop_assert!((a.paper.coverage - b.paper.coverage).abs() < 1e-3);
        prop_assert!((a.lines.cl_dice - b.lines.cl_dice).abs() < 1e-3);
        prop_assert!((a.end_to_end.any_distance_px.mean - b.end_to_end.any_distance_px.mean).abs() < 1e-3);
    }

    #[test]
    fn more_curves_never_raise_both_scores_above_one(truth in seeds(), copies in 1_usize..4) {
        let truth = truth_of(truth.iter().map(|(seed, depth)| wavy(*seed, *depth)).collect());
        let mut result = perfect(&truth);
        let once = result.curves.clone();
        (0..copies).for_each(|_| result.curves.extend(once.clone()));
        let end = score(&result, &truth).end_to_end;
        prop_assert!(end.completeness <= 1.0 + 1e-9);
        // Each copy is extra: where lines run side by side one may pass for another, never for more than the truth's length.
        prop_assert!(end.correctness.unwrap() <= 1.0 / (copies as f64 + 1.0) + 1e-9);
    }
}
