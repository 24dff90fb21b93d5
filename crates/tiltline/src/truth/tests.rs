use approx::{assert_abs_diff_eq, assert_relative_eq};

use super::*;
use crate::simulate::Dislocation;

/// A straight threading line and a loop, seen at -4 and 4 degrees with the axis turned and the right image magnified.
pub(crate) fn foil() -> Foil {
    let line =
        (0..=100).map(|i| Point3::new(-40.0 + 0.6 * f64::from(i), -50.0 + f64::from(i), -30.0 + 0.6 * f64::from(i)));
    let ring = (0..90).map(|i| {
        let (sin, cos) = (f64::from(i) * 4.0).to_radians().sin_cos();
        Point3::new(40.0 + 25.0 * cos, 25.0 * sin, 10.0 * cos)
    });
    let dislocation =
        |points: Vec<Point3>, closed| Dislocation { points, closed, burgers_nm: None, plane_normal: None };
    let dislocations = vec![dislocation(line.collect(), false), dislocation(ring.collect(), true)];
    Foil { thickness_nm: 80.0, size_nm: [200.0, 200.0], dislocations }
}

pub(crate) fn views(tilts_deg: [f64; 2]) -> Vec<ViewGeometry> {
    let view = |name: &str, tilt_deg: f64, scale_px, axis_deg: f64, origin_px| ViewGeometry {
        name: name.into(),
        tilt_rad: tilt_deg.to_radians(),
        shape: [256, 256],
        map: ViewMap { scale_px, axis_rad: axis_deg.to_radians(), origin_px },
    };
    vec![
        view("left.tif", tilts_deg[0], 1.0, 20.0, [127.5, 127.5]),
        view("right.tif", tilts_deg[1], 1.01, 20.5, [130.0, 124.0]),
    ]
}

pub(crate) fn truth() -> Truth {
    Truth::of_foil(&foil(), &views([-4.0, 4.0]))
}

#[test]
fn a_file_comes_back_as_it_was_written() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("truth.json");
    let mut truth = truth();
    truth.views[0].curves[1].visible = Some((0..90).map(|i| i % 7 != 0).collect());
    truth.family = Some("gan".into());
    truth.curves[0].burgers_nm = Some(Vector3::new(0.1, 0.2, 0.3));
    truth.write(&path).unwrap();
    let back = Truth::read(&path).unwrap();
    assert_relative_eq!(back.views[1].tilt_rad.unwrap(), 4.0_f64.to_radians(), epsilon = 1e-12);
    assert_eq!(back.views[0].curves[1].visible, truth.views[0].curves[1].visible);
    for (a, b) in back.views[1].curves[0].contrast.iter().zip(&truth.views[1].curves[0].contrast) {
        // Half of the last written digit.
        assert_abs_diff_eq!((a - b).norm(), 0.0, epsilon = 1e-4);
    }
    // Rounded once, it stays: the same truth gives the same bytes.
    assert_eq!(back.to_json().unwrap(), truth.to_json().unwrap());
}

#[test]
fn the_right_point_of_a_core_is_its_own_projection_and_gives_its_depth() {
    let truth = truth();
    let pair = truth.pair(0, 1).unwrap();
    let geometry = pair.geometry.unwrap();
    for paired in pair.curves() {
        for (index, point) in paired.curve.points.as_ref().unwrap().iter().enumerate() {
            let right = paired.right[index].unwrap();
            // The bisection of rows is exact, but rows that agree to 1e-3 px count as the same.
            assert_abs_diff_eq!(
                (right - truth.views[1].curve(&paired.curve.label).unwrap().contrast[index]).norm(),
                0.0
            );
            let (plan, disparity) = geometry.of_images(&paired.left[index], &right);
            let (true_plan, true_disparity) = geometry.of_specimen(point);
            assert_abs_diff_eq!((plan - true_plan).norm(), 0.0, epsilon = 1e-9);
            assert_abs_diff_eq!(disparity, true_disparity, epsilon = 1e-9);
            // Symmetric tilts: the mid-view frame is the specimen's.
            let (mid_plan, mid_disparity) = geometry.of_mid_view(point);
            assert_abs_diff_eq!((mid_plan - true_plan).norm() + (mid_disparity - disparity).abs(), 0.0, epsilon = 1e-9);
            // z > 0 (away) moves right as the tilt grows.
            assert_relative_eq!(disparity, point.z * 2.0 * 4.0_f64.to_radians().sin(), epsilon = 1e-9);
        }
    }
}

#[test]
fn contrast_that_leaves_the_row_is_paired_on_the_row() {
    // No rotation; a line at 45 degrees whose contrast is 2 px lower in the right image: on the left point's row, the right
    // contrast lies 2 px further back along x.
    let points: Vec<Point3> = (0..80).map(|i| Point3::new(f64::from(i) - 40.0, f64::from(i) - 40.0, 0.0)).collect();
    let line = Dislocation { points, closed: false, burgers_nm: None, plane_normal: None };
    let foil = Foil { thickness_nm: 10.0, size_nm: [100.0; 2], dislocations: vec![line] };
    let mut geometry = views([-4.0, 4.0]);
    for view in &mut geometry {
        view.map = ViewMap { scale_px: 1.0, axis_rad: 0.0, origin_px: [127.5, 127.5] };
    }
    let mut truth = Truth::of_foil(&foil, &geometry);
    truth.views[1].curves[0].contrast.iter_mut().for_each(|point| point.y += 2.0);
    let pair = truth.pair(0, 1).unwrap();
    let paired = &pair.curves()[0];
    let (left, right) = (paired.left[40], paired.right[40].unwrap());
    assert_abs_diff_eq!(right.y, left.y, epsilon = 1e-9);
    assert_abs_diff_eq!(right.x - left.x, -2.0 * 4.0_f64.to_radians().cos(), epsilon = 1e-9);
}

#[test]
fn hand_labels_are_paired_by_row_and_keep_to_their_own_arm() {
    let view = |name: &str, shift: f64| {
        // A "U": every row is crossed twice.
        let points = [[20.0, 10.0], [20.0, 60.0], [50.0, 60.5], [50.0, 10.0]];
        let contrast = points.iter().map(|[x, y]| Point2::new(x + shift, *y)).collect();
        TrueView {
            name: name.into(),
            tilt_rad: None,
            width: 100,
            height: 80,
            input_from_projection: None,
            visible_above_noise: None,
            curves: vec![ProjectedCurve { label: "u".into(), contrast, core: None, visible: None }],
        }
    };
    let curve = TrueCurve { label: "u".into(), closed: false, points: None, burgers_nm: None, plane_normal: None };
    let truth = Truth { curves: vec![curve], views: vec![view("a", 0.0), view("b", 3.0)], ..truth() };
    truth.check().unwrap();
    let pair = truth.pair(0, 1).unwrap();
    let paired = &pair.curves()[0];
    assert!(paired.left.len() > 120);
    assert!(paired.counts.iter().all(|counts| *counts));
    for (left, right) in paired.left.iter().zip(&paired.right) {
        assert_abs_diff_eq!(pair.disparity_px(left, &right.unwrap()), 3.0, epsilon = 1e-9);
    }
}

#[test]
fn a_mask_is_as_wide_as_asked_and_leaves_out_what_cannot_be_seen() {
    let mut truth = truth();
    truth.views[0].curves.truncate(1);
    let straight = (0..20).map(|i| Point2::new(30.0 + f64::from(i), 50.0)).collect();
    truth.views[0].curves[0] =
        ProjectedCurve { visible: Some((0..20).map(|i| i < 10).collect()), ..ProjectedCurve::on_core("0", straight) };
    let all = curve_mask(&truth.views[0], |_| false, 3.0, false);
    // Three rows of 20, and at each end the three pixels within 1.5 px of it.
    assert_eq!(all.iter().filter(|set| **set).count(), 66);
    let seen = curve_mask(&truth.views[0], |_| false, 3.0, true);
    assert!(seen[[51, 39]] && !seen[[50, 41]]);
}

#[test]
fn bad_truths_are_refused_with_their_values() {
    type Spoil = fn(&mut Truth);
    let cases: [(Spoil, &str); 9] = [
        (|t| t.version = 9, "version 9"),
        (|t| t.views[0].width = 0, "width of view 'left.tif' is 0"),
        (|t| t.views[0].height = 1_000_000, "1000000"),
        (|t| t.views[0].curves[0].contrast[3].x = f64::NAN, "curve '0' in view 'left.tif' is NaN"),
        (|t| t.curves[1].points.as_mut().unwrap()[0].z = 1e30, "curve '1' is 1000000000000000000"),
        (|t| t.views[1].curves[0].visible = Some(vec![true; 7]), "7 points, 101 expected"),
        (|t| t.curves[1].label = "0".into(), "label '0' is used by 2 curves"),
        (|t| t.views[1].curves[0].label = "x".into(), "a curve 'x' that is not in `curves`"),
        (|t| t.views[0].tilt_rad = Some(2.0), "-90 and 90 degrees"),
    ];
    for (spoil, expected) in cases {
        let mut truth = truth();
        spoil(&mut truth);
        let message = truth.to_json().unwrap_err().to_string();
        assert!(message.contains(expected), "{message}");
    }
    let truth = truth();
    assert!(truth.pair(0, 2).unwrap_err().to_string().contains("has 2 views"));
    assert!(truth.views[0].check_image_size([256, 100]).unwrap_err().to_string().contains("100x256"));
}

#[test]
fn unknown_keys_are_errors() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("truth.json");
    let json = truth().to_json().unwrap().replace("\"unit\"", "\"pixel\":1,\"unit\"");
    std::fs::write(&path, json).unwrap();
    assert!(Truth::read(&path).unwrap_err().to_string().contains("unknown field `pixel`"));
}

#[test]
fn labelme_files_become_a_truth_by_matching_labels() {
    let folder = tempfile::tempdir().unwrap();
    let write = |name: &str, shapes: &str| {
        let path = folder.path().join(name);
        let json = format!(
            r#"{{"version":"5.4.1","flags":{{}},"shapes":[{shapes}],"imagePath":"{name}.png","imageData":null,"imageHeight":80,"imageWidth":100}}"#
        );
        std::fs::write(&path, json).unwrap();
        path
    };
    let line = |label: &str, group: &str, x: f64| {
        format!(
            r#"{{"label":"{label}","points":[[{x},10.5],[{x},40.5]],"group_id":{group},"shape_type":"linestrip","flags":{{}}}}"#
        )
    };
    let spot = r#"{"label":"dirt","points":[[1,1],[3,3]],"group_id":null,"shape_type":"circle","flags":{}}"#;
    let left =
        write("l", &[line("d", "1", 20.5), line("d", "2", 30.5), line("only", "null", 5.0), spot.into()].join(","));
    let right = write("r", &[line("d", "1", 22.5), line("d", "2", 29.5)].join(","));
    let (truth, warnings) = import_labelme(&left, &right, Some([-4.0, 4.0])).unwrap();
    assert_eq!(warnings.len(), 2);
    assert!(warnings.iter().any(|warning| warning.to_string().contains("'only' is only in")));
    assert!(warnings.iter().any(|warning| warning.to_string().contains("a circle")));
    let pair = truth.pair(0, 1).unwrap();
    let curves = pair.curves();
    assert_eq!(curves.len(), 2);
    // LabelMe's corner becomes our pixel centre.
    assert_eq!(curves[0].left[0], Point2::new(20.0, 10.0));
    assert_abs_diff_eq!(pair.disparity_px(&curves[0].left[5], &curves[0].right[5].unwrap()), 2.0, epsilon = 1e-12);
    assert_abs_diff_eq!(pair.disparity_px(&curves[1].left[5], &curves[1].right[5].unwrap()), -1.0, epsilon = 1e-12);

    let same = write("s", &[line("d", "null", 22.5), line("d", "null", 29.5)].join(","));
    assert!(import_labelme(&same, &right, None).unwrap_err().to_string().contains("used by 2 curves"));
    let other = write("o", &line("e", "null", 22.5));
    assert!(matches!(import_labelme(&left, &other, None), Err(TruthError::NothingInCommon { .. })));
}
