//! Every file of a result: golden files of a small one made by hand, numbers read back, empty results, and folders that
//! are written whole or not at all.

// In a test a failed unwrap is a failed test; clippy's own exception does not reach helpers outside #[test].
#![allow(clippy::unwrap_used)]

mod common;

use std::collections::BTreeMap;
use std::fs;
use std::io::Cursor;
use std::path::Path;

use approx::assert_relative_eq;
use common::assert_golden;
use ndarray::Array2;
use tiltline::curve::{Flag, LineMap, MatchedCurve, MatchedPoint, TraceEnd, TraceGraph, UnmatchedLine};
use tiltline::export::graph::CurveGraph;
use tiltline::export::{ExportError, Staging, WRITERS, check_target, png, tiff, write_all};
use tiltline::geometry::{Point2, Similarity2, TiltPair, Vector2};
use tiltline::measure::{MeasureSettings, measure};
use tiltline::micrograph::{Micrograph, StereoPair, View};
use tiltline::reconstruction::Reconstruction;
use tiltline::rectify::{Rectification, RectifiedPair};
use tiltline::simulate::ViewSettings;
use tiltline::triangulate::triangulate;

/// Left input px to rectified px.
const SHIFT: [f64; 2] = [1.0, 2.0];

fn matched(left: &[[f64; 2]], disparity: impl Fn(usize) -> f64, ends: [TraceEnd; 2], closed: bool) -> MatchedCurve {
    let points = left.iter().enumerate().map(|(index, &[x, y])| MatchedPoint {
        left: Point2::new(x, y),
        tangent_left: Vector2::y(),
        tangent_right: None,
        disparity_px: disparity(index),
        sigma_px: 0.1,
        flag: if index == 1 { Flag::Bridged } else { Flag::Ok },
    });
    MatchedCurve { left_trace: 0, points: points.collect(), closed, ends }
}

/// Two lines that meet a third at (10, 10); a fourth that only crosses there, far below; a loop.
fn y_and_loop() -> Vec<MatchedCurve> {
    let junction = TraceEnd::Junction(3);
    let down = |x: f64| move |step: usize| [x, 10.0 + step as f64];
    vec![
        matched(
            &[[10.0, 6.0], [10.0, 7.0], [10.0, 8.0], [10.0, 9.5]],
            |step| 0.1 * step as f64,
            [TraceEnd::Free, junction],
            false,
        ),
        matched(&[[10.5, 10.5], [11.5, 11.5], [12.5, 12.5]], |_| 0.3, [junction, TraceEnd::Border], false),
        // Three px from the junction: linked by a segment, not merged.
        matched(&[[7.0, 11.0], [6.0, 12.0], [5.0, 13.0]], |_| 0.35, [junction, TraceEnd::Free], false),
        matched(&[0, 1, 2].map(down(10.0)), |_| 4.0, [junction, TraceEnd::Free], false),
        matched(&[[20.0, 5.0], [21.0, 6.0], [20.0, 7.0], [19.0, 6.0]], |_| -1.0, [TraceEnd::Free; 2], true),
    ]
}

fn result(matched: Vec<MatchedCurve>, pixel_size_nm: Option<f64>) -> Reconstruction {
    let tilts = TiltPair::from_degrees(-4.0, 4.0);
    let shape = [24, 32];
    let micrograph = || Micrograph { pixel_size_nm, ..Micrograph::new(Array2::from_elem(shape, 7.0)) };
    let pair = StereoPair { left: micrograph(), right: micrograph(), tilts, tilt_axis_rad: 0.0 };
    let view = ViewSettings { shape, ..ViewSettings::default() };
    let shift = Similarity2::new(Vector2::from(SHIFT), 0.0, 1.0);
    let rectification = Rectification { rectified_from_left: shift, ..Rectification::from_known_views(&view, &view) };
    let grey = Array2::from_shape_fn(shape, |(row, column)| if row == 0 { f32::NAN } else { column as f32 / 32.0 });
    let rectified = RectifiedPair { left: grey.clone(), right: grey, rectification };
    let (curves, frame) = triangulate(&matched, &rectified, &pair, 0.1_f64.to_radians(), false);
    let (measures, warnings) = measure(&curves, &frame, &rectified, &MeasureSettings::default());
    let mut probability = Array2::zeros(shape);
    probability[[12, 11]] = 1.0;
    let lines = LineMap { probability, line_width_px: 3.0 };
    let unmatched = if matched.is_empty() {
        Vec::new()
    } else {
        vec![UnmatchedLine { view: View::Right, points_input: vec![Point2::new(1.0, 2.25), Point2::new(1.5, 3.0)] }]
    };
    let junctions = vec![Point2::new(10.0, 10.0); 4];
    let traces = [TraceGraph { traces: Vec::new(), junctions }, TraceGraph::default()];
    let lines = [lines.clone(), lines];
    Reconstruction { pair, rectified, lines, traces, matched, curves, unmatched, frame, measures, warnings }
}

fn files(result: &Reconstruction) -> BTreeMap<&'static str, Vec<u8>> {
    let written = WRITERS.iter().map(|(name, writer)| {
        let mut out = Cursor::new(Vec::new());
        writer(result, &mut out).unwrap();
        (*name, out.into_inner())
    });
    written.collect()
}

fn text(files: &BTreeMap<&str, Vec<u8>>, name: &str) -> String {
    String::from_utf8(files[name].clone()).unwrap()
}

const TEXT_FILES: [&str; 8] =
    ["curves.csv", "curves.json", "curves.vtp", "curves.ply", "curves.obj", "curves.swc", "curves.data", "lines.csv"];

#[test]
fn text_files_are_as_they_were() {
    let files = files(&result(y_and_loop(), Some(2.0)));
    for name in TEXT_FILES {
        assert_golden(name, &files[name]);
    }
    let in_px = self::files(&result(y_and_loop()[..1].to_vec(), None));
    for name in ["curves.csv", "curves.vtp", "curves.data"] {
        assert_golden(&format!("px/{name}"), &in_px[name]);
    }
}

#[test]
fn the_csv_reads_back_the_numbers() {
    let result = result(y_and_loop(), Some(2.0));
    let csv = text(&files(&result), "curves.csv");
    let mut lines = csv.lines();
    assert_eq!(
        lines.next(),
        Some(
            "curve,point,x_left_px,y_left_px,x_right_px,y_right_px,disparity_px,sigma_disparity_px,x_nm,y_nm,z_nm,\
             sigma_z_nm,flag"
        )
    );
    for (curve_index, curve) in result.curves.iter().enumerate() {
        for (point_index, point) in curve.points.iter().enumerate() {
            let row: Vec<&str> = lines.next().unwrap().split(',').collect();
            assert_eq!(row.len(), 13);
            assert_eq!((row[0], row[1]), (curve_index.to_string().as_str(), point_index.to_string().as_str()));
            let number = |column: usize| row[column].parse::<f64>().unwrap();
            // Four decimals are written.
            let close = |column: usize, value: f64| assert_relative_eq!(number(column), value, epsilon = 0.51e-4);
            // The input is the rectified image less its shift; the right image is not shifted.
            close(2, point.left_rectified.x - SHIFT[0]);
            close(3, point.left_rectified.y - SHIFT[1]);
            close(4, point.left_rectified.x + point.disparity_px);
            close(5, point.left_rectified.y);
            close(6, point.disparity_px);
            close(7, 0.1);
            // z = d pixel / (2 sin(phi / 2)) less the median; sigma alike.
            let gain = 2.0 / (2.0 * 4.0_f64.to_radians().sin());
            close(10, point.disparity_px * gain - result.frame.median_z);
            close(11, 0.1 * gain);
            assert_eq!(row[12], if point_index == 1 { "bridged" } else { "ok" });
        }
    }
    assert_eq!(lines.next(), None);
}

#[test]
fn json_has_the_names_of_the_csv() {
    let json: serde_json::Value = serde_json::from_slice(&files(&result(y_and_loop(), None))["curves.json"]).unwrap();
    let points = &json["curves"][0]["points"];
    for name in ["x_left_px", "y_right_px", "sigma_disparity_px", "x_px", "z_px", "sigma_z_px", "flag"] {
        assert_eq!(points[name].as_array().map(Vec::len), Some(4), "{name}");
    }
    assert_eq!(json["curves"][4]["closed"], true);
    assert_eq!(json["curves"][0]["ends"], serde_json::json!(["free", { "junction": 0 }]));
    assert_eq!(json["junctions"][0]["ends"].as_array().map(Vec::len), Some(4));
}

/// Three ends meet; the fourth has another depth and only crosses in projection, so it stays free.
#[test]
fn a_junction_joins_ends_that_agree_in_depth() {
    let graph = CurveGraph::new(&result(y_and_loop(), None));
    let joined: Vec<bool> = graph.junctions[0].ends.iter().map(|end| end.joined).collect();
    assert_eq!(joined, [true, true, true, false]);
    // (10, 10) in the left image; x in the mid view is half a disparity further, and 2 cos(phi / 2) is nearly 2.
    let position = graph.junctions[0].position;
    let mean_disparity = (0.3 + 0.3 + 0.35) / 3.0;
    let cos = 4.0_f64.to_radians().cos();
    assert_relative_eq!(position.x, (10.0 - 15.5 + 0.5 * mean_disparity) / cos, epsilon = 1e-9);
    assert_relative_eq!(position.y, 10.0 - 11.5, epsilon = 1e-9);
    let points: usize = y_and_loop().iter().map(|curve| curve.points.len()).sum();
    // Two of the three ends are the junction, one is linked to it.
    assert_eq!(graph.nodes.len(), points - 2 + 1);
    // Steps along the open curves, the four of the loop, the link.
    assert_eq!(graph.segments.len(), 3 + 2 + 2 + 2 + 4 + 1);
}

#[test]
fn swc_is_a_forest_with_parents_first() {
    let swc = text(&files(&result(y_and_loop(), None)), "curves.swc");
    let rows: Vec<Vec<&str>> =
        swc.lines().filter(|line| !line.starts_with('#')).map(|line| line.split(' ').collect()).collect();
    let mut roots = 0;
    for (index, row) in rows.iter().enumerate() {
        assert_eq!(row.len(), 7);
        assert_eq!(row[0], (index + 1).to_string());
        let parent: i64 = row[6].parse().unwrap();
        roots += usize::from(parent == -1);
        assert!(parent == -1 || (1..=index as i64).contains(&parent));
    }
    // The Y with its link, the line below it, the loop.
    assert_eq!(roots, 3);
    assert_eq!(swc.lines().filter(|line| line.starts_with("# loop cut")).count(), 1);
}

#[test]
fn paradis_arms_are_mutual_and_burgers_vectors_unknown() {
    let data = text(&files(&result(y_and_loop(), None)), "curves.data");
    assert!(data.contains("BURGERS VECTORS AND GLIDE PLANES ARE UNKNOWN"));
    let body = data.split("nodalData").nth(1).unwrap();
    let mut numbers = body.lines().skip(1).filter(|line| !line.starts_with('#')).flat_map(str::split_whitespace);
    let mut arms = std::collections::BTreeSet::new();
    let mut nodes = 0;
    while let Some(tag) = numbers.next() {
        nodes += 1;
        let mut next = || numbers.next().unwrap();
        let _position = [next(), next(), next()];
        let (count, constraint): (usize, u8) = (next().parse().unwrap(), next().parse().unwrap());
        assert_eq!(constraint, if count == 1 { 7 } else { 0 });
        for _ in 0..count {
            arms.insert((tag.to_owned(), next().to_owned()));
            assert!((0..6).all(|_| next() == "0.0"));
        }
    }
    assert!(data.contains(&format!("nodeCount =   {nodes}\n")));
    assert!(arms.iter().all(|(a, b)| arms.contains(&(b.clone(), a.clone()))));
}

#[test]
fn disparity_is_painted_on_the_lines_without_gaps() {
    let [disparity, sigma] = tiff::rasterise(&result(y_and_loop(), None));
    // A column of the first curve: disparity 0.1 px a step, the rows between by interpolation.
    for (row, value) in [(6, 0.0), (7, 0.1), (8, 0.2)] {
        assert_relative_eq!(disparity[[row, 10]], value, epsilon = 0.051);
    }
    // The loop is closed: all four points and none inside.
    for pixel in [[5, 20], [6, 21], [7, 20], [6, 19]] {
        assert_eq!(disparity[pixel], -1.0);
        assert_eq!(sigma[pixel], 0.1);
    }
    assert!(disparity[[6, 20]].is_nan() && sigma[[0, 0]].is_nan());
}

#[test]
fn line_images_lie_on_the_input_grid() {
    let result = result(y_and_loop(), None);
    // The one line pixel of the rectified grid, at column 11 and row 12.
    let left = png::lines_on_input(&result, View::Left);
    assert_eq!(left[[10, 10]], 255);
    assert_eq!(left.iter().filter(|&&value| value > 0).count(), 1);
    assert_eq!(png::lines_on_input(&result, View::Right)[[12, 11]], 255);
}

#[test]
fn an_empty_result_has_every_file() {
    let files = files(&result(Vec::new(), Some(1.0)));
    for name in TEXT_FILES {
        assert_golden(&format!("empty/{name}"), &files[name]);
    }
    assert!(files.values().all(|content| !content.is_empty()));
    serde_json::from_slice::<serde_json::Value>(&files["curves.json"]).unwrap();
}

#[test]
fn a_folder_appears_whole_with_the_extra_files() {
    let parent = tempfile::tempdir().unwrap();
    let folder = parent.path().join("out");
    check_target(&folder, false).unwrap();
    assert!(!folder.exists());
    let paths =
        write_all(&result(y_and_loop(), None), &[("run.toml", b"seed = 1\n".to_vec())], &folder, false).unwrap();
    assert_eq!(paths.len(), WRITERS.len() + 1);
    assert!(paths.iter().all(|path| path.is_file()));
    assert_eq!(fs::read(folder.join("run.toml")).unwrap(), b"seed = 1\n");
    assert_eq!(names(&folder).len(), paths.len());
    assert_eq!(names(parent.path()), ["out"]);
}

#[test]
fn an_empty_folder_is_filled_and_a_full_one_refused_without_force() {
    let parent = tempfile::tempdir().unwrap();
    let folder = parent.path().join("out");
    fs::create_dir(&folder).unwrap();
    let small = result(y_and_loop(), None);
    write_all(&small, &[], &folder, false).unwrap();
    fs::write(folder.join("notes.txt"), "mine").unwrap();
    fs::write(folder.join("curves.csv"), "old").unwrap();

    for refused in [check_target(&folder, false), write_all(&small, &[], &folder, false).map(drop)] {
        assert!(matches!(refused, Err(ExportError::NotEmpty { .. })), "{refused:?}");
    }
    assert_eq!(fs::read(folder.join("curves.csv")).unwrap(), b"old");

    write_all(&small, &[], &folder, true).unwrap();
    assert!(fs::read_to_string(folder.join("curves.csv")).unwrap().starts_with("curve,point"));
    assert_eq!(fs::read(folder.join("notes.txt")).unwrap(), b"mine");
    assert_eq!(names(&folder).len(), WRITERS.len() + 1);
    assert_eq!(names(parent.path()), ["out"]);
}

#[test]
fn targets_that_cannot_be_are_refused_with_their_path() {
    let parent = tempfile::tempdir().unwrap();
    let file = parent.path().join("file");
    fs::write(&file, "x").unwrap();
    let message = |folder: &Path| check_target(folder, true).unwrap_err().to_string();
    assert!(message(&file).contains("is a file"));
    assert!(message(&file.join("out")).contains("is not an existing folder"));
    let missing = message(&parent.path().join("no/out"));
    assert!(missing.contains("is not an existing folder; make it first"), "{missing}");
    assert_eq!(names(parent.path()), ["file"]);
}

#[test]
fn a_failing_writer_leaves_nothing_behind() {
    let parent = tempfile::tempdir().unwrap();
    let folder = parent.path().join("out");
    for target_exists in [false, true] {
        if target_exists {
            fs::create_dir(&folder).unwrap();
        }
        let staging = Staging::begin(&folder, false).unwrap();
        staging.write("first", |out| out.write_all(b"done")).unwrap();
        let full = |_: &mut dyn tiltline::export::WriteSeek| Err(std::io::ErrorKind::StorageFull.into());
        let error = staging.write("second", full).unwrap_err();
        assert!(matches!(&error, ExportError::NoSpace { path } if *path == folder.join("second")), "{error:?}");
        drop(staging);
        assert_eq!(folder.exists(), target_exists);
    }
    assert_eq!(names(parent.path()), ["out"]);
    assert!(names(&folder).is_empty());
    let bad = write_all(&result(Vec::new(), None), &[("../run.toml", Vec::new())], &folder, false);
    assert!(matches!(bad, Err(ExportError::BadName { .. })));
    assert!(names(&folder).is_empty() && names(parent.path()) == ["out"]);
}

/// A shell that is interrupted removes this folder, and then nothing is left.
#[test]
fn the_staging_path_is_all_there_is_before_the_commit() {
    let parent = tempfile::tempdir().unwrap();
    let staging = Staging::begin(&parent.path().join("out"), false).unwrap();
    staging.write("a", |out| out.write_all(b"a")).unwrap();
    assert_eq!(names(parent.path()).len(), 1);
    fs::remove_dir_all(staging.path()).unwrap();
    assert!(names(parent.path()).is_empty());
}

fn names(folder: &Path) -> Vec<String> {
    let mut names: Vec<String> =
        fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect();
    names.sort();
    names
}
