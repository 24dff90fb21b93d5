use std::sync::LazyLock;

use ndarray::Array2;

use super::figures;
use super::page::{self, escaped};
use super::series::{ReportSeriesView, ViewPicture};
use super::*;
use crate::curve::TraceGraph;
use crate::geometry::{Similarity2, TiltPair, Vector2, Vector3};
use crate::matching::ClassicalMatcher;
use crate::micrograph::{Micrograph, StereoPair};
use crate::pipeline::reconstruct;
use crate::ridge::RidgeDetector;
use crate::series::{LineIndex, SavedCurves, ViewLines};
use crate::settings::Settings;
use crate::simulate::{Scene, SceneSettings, ViewSettings, render};

static IN_NM: LazyLock<Reconstruction> = LazyLock::new(|| reconstructed(Some(2.0)));
static IN_PX: LazyLock<Reconstruction> = LazyLock::new(|| reconstructed(None));

/// A drawn pair, reconstructed; small, so that it takes a moment only.
fn reconstructed(pixel_size_nm: Option<f64>) -> Reconstruction {
    let scene = Scene::random(&SceneSettings { seed: 4, curves: 8, ..SceneSettings::default() });
    let view = |tilt_deg: f64, seed| {
        let settings =
            ViewSettings { tilt_rad: tilt_deg.to_radians(), seed, shape: [256, 288], ..ViewSettings::default() };
        Micrograph { pixel_size_nm, ..Micrograph::new(render(&scene, &settings).pixels) }
    };
    let (left, right) = (view(-5.0, 1), view(5.0, 2));
    let pair = StereoPair { left, right, tilts: TiltPair::from_degrees(-5.0, 5.0), tilt_axis_rad: 0.0 };
    let settings = Settings::default();
    let detector = RidgeDetector { settings: settings.ridge.clone() };
    let matcher = ClassicalMatcher { settings: settings.matching.clone() };
    reconstruct(pair, &detector, &matcher, &settings, &|_| ()).unwrap()
}

#[test]
fn positions_follow_from_the_columns_as_in_the_result() {
    for result in [&*IN_NM, &*IN_PX] {
        let report = Report::new(result, "").unwrap();
        assert!(!report.curves.is_empty());
        assert_eq!(report.curves.len(), result.curves.len());
        // Columns are kept to 0.001 px and 0.0001 px; depth is 5.7 times disparity at 10 degrees.
        let tolerance = 0.0015 * result.frame.pixel;
        for (kept, curve) in report.curves.iter().zip(&result.curves) {
            assert_eq!(kept.flags.len(), curve.points.len());
            for (index, point) in curve.points.iter().enumerate() {
                let [x, y, z] = report.position(kept, index);
                let away = Vector3::new(x, y, z) - point.position.coords;
                assert!(away.norm() < tolerance, "{away}");
                assert!((report.sigma_z(kept.sigma[index]) - point.sigma_z).abs() < tolerance);
                assert_eq!(kept.flags.as_bytes()[index] - b'0', flag_code(point.flag));
            }
        }
    }
}

#[test]
fn residuals_are_those_that_the_rectification_reports() {
    let rectification = &IN_PX.rectified.rectification;
    let report = Report::new(&IN_PX, "").unwrap();
    let rows = &report.point_matches.row;
    assert_eq!(rows.len(), rectification.inliers);
    let rms = (rows.iter().map(|row| row * row).sum::<f64>() / rows.len() as f64).sqrt();
    assert!((rms - rectification.rms_row_error_px).abs() < 1e-3);
    let mut disparities = report.point_matches.disparity.clone();
    disparities.sort_unstable_by(f64::total_cmp);
    // The rectification puts the median of the inliers at zero.
    assert!(disparities[disparities.len() / 2].abs() < 0.05);
}

#[test]
fn a_page_gives_its_report_back_and_is_the_same_again() {
    let report = Report::new(&IN_NM, "seed = 0\n").unwrap();
    let text = page::write(&report).unwrap();
    let again = page::read(&text).unwrap();
    assert_eq!(again, report);
    assert_eq!(page::write(&again).unwrap(), text);
}

#[test]
fn no_user_text_is_markup() {
    let mut report = Report::new(&IN_PX, "").unwrap();
    let hostile = "</script><script>alert(1)</script></title><!--\u{1}\"'&.png";
    report.sources[0].path = hostile.into();
    report.run = hostile.into();
    report.warnings.push(Warning::new(crate::progress::Stage::Read, hostile));
    let text = page::write(&report).unwrap();
    let harmless = page::write(&Report::new(&IN_PX, "").unwrap()).unwrap();
    for tag in ["<script", "</script", "<!--", "<title", "</title"] {
        assert_eq!(text.matches(tag).count(), harmless.matches(tag).count(), "{tag}");
    }
    assert_eq!(page::read(&text).unwrap(), report);
    for figure in figures::all(&report) {
        assert!(!figure.svg.contains("<script"), "{}", figure.name);
        assert!(figure.svg.contains(&escaped(&page::title(&report))), "{}", figure.name);
    }
}

#[test]
fn other_files_and_versions_are_refused_with_a_word() {
    assert!(matches!(page::read("<html></html>"), Err(ReportError::NoData)));
    let text = page::write(&Report::new(&IN_PX, "").unwrap()).unwrap();
    let later = text.replacen("\"format_version\":1", "\"format_version\":99", 1);
    let error = page::read(&later).unwrap_err();
    assert!(error.to_string().contains("99"), "{error}");
    assert!(matches!(page::read(&text.replacen("\"sources\"", "\"wells\"", 1)), Err(ReportError::Json(_))));
}

#[test]
fn figures_have_the_curves_and_their_units() {
    let report = Report::new(&IN_NM, "").unwrap();
    let figures = figures::all(&report);
    let names: Vec<&str> = figures.iter().map(|figure| figure.name).collect();
    assert_eq!(names, ["images", "projections", "histograms", "residuals"]);
    for figure in &figures {
        assert!(figure.svg.starts_with("<?xml") && figure.svg.ends_with("</svg>\n"));
        assert!(figure.svg.contains("width=\"180.00mm\""));
        assert!(!figure.svg.contains("NaN") && !figure.svg.contains("inf\""), "{}", figure.name);
        assert!(figure.svg.contains("(px)") || figure.svg.contains("(nm)"), "{}", figure.name);
    }
    // A path begins at the left end of each curve's first colour, twice in the images: its white edge and itself.
    assert_eq!(figures[0].svg.matches("stroke=\"#ffffff\"").count(), 2 * report.curves.len());
    let residuals = figures[3].svg.matches("<circle").count();
    assert_eq!(residuals, report.point_matches.x.len());
    let mut unknown = report.clone();
    unknown.curves.clear();
    unknown.point_matches = PointColumns::default();
    let names: Vec<&str> = figures::all(&unknown).iter().map(|figure| figure.name).collect();
    assert_eq!(names, ["images"]);
}

#[test]
fn thinned_lines_stay_within_their_tolerance() {
    let wave: Vec<Point2> =
        (0..200).map(|step| Point2::new(f64::from(step), 8.0 * (0.1 * f64::from(step)).sin())).collect();
    let kept = thinned(&wave);
    assert!(kept.len() < wave.len(), "{}", kept.len());
    let corners: Vec<Point2> = kept.chunks_exact(2).map(|pair| Point2::new(pair[0], pair[1])).collect();
    for point in &wave {
        let near = corners.windows(2).map(|pair| {
            let along = pair[1] - pair[0];
            let t = ((point - pair[0]).dot(&along) / along.norm_squared()).clamp(0.0, 1.0);
            (point - (pair[0] + along * t)).norm()
        });
        // The tolerance, and the rounding to a tenth of a pixel.
        assert!(near.fold(f64::INFINITY, f64::min) < LINE_TOLERANCE_PX + 0.08);
    }
    assert!(thinned(&[]).is_empty());
    let ring: Vec<Point2> = [[0.0, 0.0], [5.0, 0.0], [5.0, 5.0], [0.0, 0.0]].map(|[x, y]| Point2::new(x, y)).to_vec();
    assert_eq!(thinned(&ring).len(), 8);
}

#[test]
fn a_picture_is_a_jpeg_of_the_image_and_void_is_grey() {
    use base64::Engine;
    let mut image = Array2::from_elem((16, 24), 1.0_f32);
    image[[3, 3]] = f32::NAN;
    let picture = Picture::encode(&image).unwrap();
    let bytes = base64::engine::general_purpose::STANDARD.decode(&picture.0).unwrap();
    assert_eq!(bytes[..2], [0xff, 0xd8]);
    // The frame header (SOF0) holds the rows and columns.
    let frame = bytes.windows(2).position(|pair| pair == [0xff, 0xc0]).unwrap();
    assert_eq!(bytes[frame + 5..frame + 9], [0, 16, 0, 24]);
    let long = Picture::encode(&Array2::zeros((1, 70_000)));
    assert!(matches!(long, Err(ReportError::TooLarge { columns: 70_000, rows: 1 })));
}

#[test]
fn corners_are_those_of_the_input_on_the_rectified_grid() {
    let mut result = IN_PX.clone();
    result.rectified.rectification.rectified_from_left = Similarity2::new(Vector2::new(10.0, 20.0), 0.0, 1.0);
    let report = Report::new(&result, "").unwrap();
    assert_eq!(report.views[0].corners, [[9.5, 19.5], [297.5, 19.5], [297.5, 275.5], [9.5, 275.5]]);
}

/// The curves of a report drawn into the pair's own views lie where they were found there, whichever sign depth was given.
#[test]
fn projections_into_the_views_of_the_pair_are_where_the_curves_were_found() {
    let mut flipped = IN_NM.clone();
    let settings = Settings { flip_depth: true, ..Settings::default() };
    let detector = RidgeDetector { settings: settings.ridge.clone() };
    let matcher = ClassicalMatcher { settings: settings.matching.clone() };
    flipped = reconstruct(flipped.pair, &detector, &matcher, &settings, &|_| ()).unwrap();
    assert!(flipped.frame.depth_flipped);
    for result in [&*IN_NM, &*IN_PX, &flipped] {
        let report = Report::new(result, "").unwrap();
        let curves = SavedCurves::of(result);
        let maps = [&report.rectification.rectified_from_left, &report.rectification.rectified_from_right];
        for (side, view) in [&result.pair.left, &result.pair.right].into_iter().enumerate() {
            let lines = LineIndex::new(ViewLines::new(TraceGraph::default(), [256, 288]));
            let picture = ViewPicture::new(view, 0.0, &curves.poses[side], &lines, &curves).unwrap();
            assert_eq!((picture.size_px, picture.step_px), ([288, 256], 1));
            for curve in &report.curves {
                for index in 0..curve.x.len() {
                    let [x, y, z] = report.position(curve, index);
                    let found = picture.projection.map(|[a, b, c, d]| a * x + b * y + c * z + d);
                    let rectified = Point2::new(curve.x[index] + side as f64 * curve.disparity[index], curve.y[index]);
                    let expected = maps[side].inverse() * rectified;
                    let off = (Point2::new(found[0], found[1]) - expected).norm();
                    // Positions are kept to 0.001 px.
                    assert!(off < 0.01, "{off} px in view {side}");
                }
            }
        }
    }
}

#[test]
fn a_series_is_kept_in_the_page_and_at_most_eight_views_are_pictured() {
    let views = vec![ReportSeriesView {
        tilt_deg: -12.0,
        in_pair: false,
        supported: true,
        distances: crate::series::Distances::of(vec![0.5, 1.0, 3.0], 0.1),
        tilt_error_deg: Some([0.01, 0.05]),
    }];
    let (path, checks) = ("series </script>.mrc".to_owned(), vec!["fine".to_owned()]);
    let series = ReportSeries { path, fitted: true, views, checks, ..ReportSeries::default() };
    let report = Report { series: Some(series), ..Report::new(&IN_PX, "").unwrap() };
    assert_eq!(page::read(&page::write(&report).unwrap()).unwrap(), report);
    let figure = figures::all(&report).pop().unwrap();
    assert_eq!(figure.name, "series");
    // The median of 1 px and 95 percent at 3 px, of 4 px up: a dot a quarter up, in both panels.
    assert!(figure.svg.contains("Residuals") && figure.svg.matches("<circle").count() == 2);
    // Drawn into views again, the curves are still fitted ones.
    let before = report.series.clone().unwrap();
    let again = ReportSeries { fitted: false, ..before.clone() };
    let mut again =
        ReportSeries { views: vec![ReportSeriesView { tilt_error_deg: None, ..before.views[0].clone() }], ..again };
    again = again.after(Some(before));
    assert!(again.fitted && again.views[0].tilt_error_deg == Some([0.01, 0.05]));
    assert_eq!(ReportSeries::pictured(&(10..55).collect::<Vec<_>>()), [10, 16, 22, 28, 35, 41, 47, 54]);
    assert_eq!(ReportSeries::pictured(&[3, 5]), [3, 5]);
}
