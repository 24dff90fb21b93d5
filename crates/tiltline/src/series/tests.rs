//! Series read, aligned, registered and re-projected on images and lines whose truth is known.

use std::fs;
use std::path::{Path, PathBuf};

use super::*;
use crate::export::mrc::write_stack;
use crate::export::png::write_grey;
use crate::geometry::{Point2, Point3, TiltPair, Vector2};
use crate::io::ReadOptions;
use crate::reconstruction::LengthUnit;
use crate::simulate::{Scene, SceneSettings, ViewSettings, render};

fn options() -> ReadOptions {
    ReadOptions::default()
}

/// A stack of `views` small sections, none of them constant.
fn stack(folder: &Path, views: usize) -> PathBuf {
    let section = |k: usize| ndarray::Array2::from_shape_fn([40, 48], |(row, column)| (row * column + 7 * k) as i16);
    let sections: Vec<_> = (0..views).map(section).collect();
    let path = folder.join("series.mrc");
    write_stack(&sections, Some(2.0), &mut fs::File::create(&path).unwrap()).unwrap();
    path
}

fn open(path: &Path, tilts: Option<&str>) -> Result<Series, SeriesError> {
    Series::open(&path.to_string_lossy(), tilts, &options())
}

#[test]
fn a_stack_in_any_order_is_sorted_and_keeps_its_sections() {
    let folder = tempfile::tempdir().unwrap();
    let path = stack(folder.path(), 5);
    let series = open(&path, Some("0,2,-2,4,-4")).unwrap();
    assert_eq!(series.tilts_deg(), [-4.0, -2.0, 0.0, 2.0, 4.0]);
    assert_eq!(series.views.iter().map(|view| view.section).collect::<Vec<_>>(), [4, 2, 0, 1, 3]);
    assert!(series.warnings.iter().any(|warning| warning.message.contains("sorted")));
    assert_eq!(series.view(0).unwrap().pixels[[0, 0]], 28.0);
    // A `.rawtlt` beside it serves where no tilts are given.
    fs::write(path.with_extension("rawtlt"), "-4\n-2\n0\n2\n4\n").unwrap();
    assert_eq!(open(&path, None).unwrap().tilts_from, "series.rawtlt");
}

/// Stacks of ImageJ (made by tifffile, see `tests/data/make.py`): a directory for each image, or one for all as it writes big ones. Pixel size
/// from the description, 250 px per um.
#[test]
fn stacks_of_imagej_are_series() {
    for name in ["imagej_stack.tif", "imagej_one_directory.tif"] {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data").join(name);
        let series = open(&path, Some("6,-6,2,-2")).unwrap();
        assert_eq!(series.tilts_deg(), [-6.0, -2.0, 2.0, 6.0], "{name}");
        assert_eq!(series.views.iter().map(|view| view.section).collect::<Vec<_>>(), [1, 3, 2, 0]);
        assert_eq!(series.pixel_size.as_ref().map(|(size, _)| *size), Some(4.0));
        for view in 0..4 {
            let page = format!("{}#{}", path.to_string_lossy(), series.views[view].section);
            let expected = crate::io::read_micrograph(&page).unwrap().pixels;
            assert_eq!(series.view(view).unwrap().pixels, expected, "{name} {view}");
        }
        let first = |view: usize| series.view(view).unwrap().pixels[[0, 0]];
        assert!(first(0) != first(3), "{name}");
    }
}

#[test]
fn what_is_no_series_is_named_with_its_values() {
    let folder = tempfile::tempdir().unwrap();
    let path = stack(folder.path(), 3);
    let message = |tilts: Option<&str>| open(&path, tilts).unwrap_err().to_string();
    assert!(message(Some("-4,4")).contains("3 views") && message(Some("-4,4")).contains("2 tilts"));
    assert!(message(None).contains("--tilts"));
    assert!(message(Some("5,5,5")).contains("every view has the tilt 5"));
    let one = stack(tempfile::tempdir_in(folder.path()).unwrap().keep().as_path(), 1);
    assert!(open(&one, Some("3")).unwrap_err().to_string().contains("1 view(s)"));
    // Cut off in the middle of the second section.
    let bytes = fs::read(&path).unwrap();
    fs::write(&path, &bytes[..bytes.len() / 2]).unwrap();
    assert!(message(Some("-4,0,4")).contains("truncated"));
}

#[test]
fn views_are_found_by_angle_within_half_a_step() {
    let folder = tempfile::tempdir().unwrap();
    let series = open(&stack(folder.path(), 5), Some("-8:8:4")).unwrap();
    assert_eq!((series.nearest(-5.0).unwrap(), series.nearest(9.9).unwrap()), (1, 4));
    let message = series.nearest(11.0).unwrap_err().to_string();
    assert!(message.contains("nearest is at 8") && message.contains("-8 to 8"), "{message}");
    assert!(pair_at(&series, [-4.0, -3.0]).unwrap_err().to_string().contains("both mean the view at -4"));
    assert_eq!(pair_at(&series, [-4.0, 4.0]).unwrap().views, [1, 3]);
}

#[test]
fn folders_take_tilts_from_a_table_or_from_names() {
    let folder = tempfile::tempdir().unwrap();
    let image = ndarray::Array2::from_shape_fn([40, 48], |(row, column)| (row + column) as u8);
    for name in ["a_-4.0.png", "a_0.0.png", "a_4.0.png"] {
        let mut file = fs::File::create(folder.path().join(name)).unwrap();
        write_grey(&image, &mut file).unwrap();
    }
    let series = open(folder.path(), None).unwrap();
    assert_eq!((series.tilts_deg(), series.tilts_from.as_str()), (vec![-4.0, 0.0, 4.0], "the images' names"));
    fs::write(folder.path().join("tilts.csv"), "file,tilt\na_-4.0.png,3\na_0.0.png,1\na_4.0.png,-1\n").unwrap();
    let series = open(folder.path(), None).unwrap();
    assert_eq!(series.tilts_deg(), [-1.0, 1.0, 3.0]);
    assert!(series.views[2].spec.ends_with("a_-4.0.png"));
    fs::write(folder.path().join("tilts.csv"), "file,tilt\na_0.0.png,1\n").unwrap();
    assert!(open(folder.path(), None).unwrap_err().to_string().contains("a_4.0.png is not in it"));
}

/// A scene written as a series of views that are shifted against each other.
fn scene_series(folder: &Path, axis_deg: f64, tilts_deg: &[f64]) -> (Series, Vec<ViewSettings>, Scene) {
    let scene = Scene::random(&SceneSettings { size_px: 256.0, thickness_px: 60.0, ..SceneSettings::default() });
    let views: Vec<ViewSettings> = tilts_deg
        .iter()
        .enumerate()
        .map(|(k, tilt)| ViewSettings {
            shape: [256, 256],
            tilt_rad: tilt.to_radians(),
            axis_rad: axis_deg.to_radians(),
            shift_px: [6.0 * (2.1 * k as f64).sin(), 6.0 * (1.3 * k as f64).cos()],
            seed: k as u64,
            ..ViewSettings::default()
        })
        .collect();
    let sections: Vec<_> =
        views.iter().map(|view| render(&scene, view).pixels.mapv(|value| (8000.0 * value) as i16)).collect();
    let path = folder.join("scene.mrc");
    write_stack(&sections, None, &mut fs::File::create(&path).unwrap()).unwrap();
    let tilts: Vec<String> = tilts_deg.iter().map(f64::to_string).collect();
    (open(&path, Some(&tilts.join(","))).unwrap(), views, scene)
}

/// Shifts of a series, found without any line. A common shift of the specimen, `X cos a + Z sin a`, is no error.
#[test]
fn a_series_is_aligned() {
    let folder = tempfile::tempdir().unwrap();
    let tilts: Vec<f64> = (-12..=12).map(|k| 4.0 * f64::from(k)).collect();
    for axis_deg in [0.0, 90.0, -35.0] {
        let (series, views, _) = scene_series(folder.path(), axis_deg, &tilts);
        let aligned = align(&series, f64::to_radians(axis_deg), &|_, _| ()).unwrap();
        // Along the axis nothing moves but by the shift: what is left there is the error.
        let axis = Vector2::new(-axis_deg.to_radians().sin(), axis_deg.to_radians().cos());
        let off: Vec<f64> = views
            .iter()
            .zip(&aligned.poses)
            .map(|(view, pose)| axis.dot(&(pose.origin() - view.image_from_projection() * Point2::origin())))
            .collect();
        let mean = off.iter().sum::<f64>() / off.len() as f64;
        let worst = off.iter().map(|value| (value - mean).abs()).fold(0.0, f64::max);
        assert!(worst < 2.5, "axis {axis_deg}: {worst} px off along it: {off:?}");
    }
}

#[test]
fn transforms_bring_the_axis_to_the_middle_and_read_back() {
    let folder = tempfile::tempdir().unwrap();
    let (series, ..) = scene_series(folder.path(), 0.0, &[-4.0, 0.0, 4.0]);
    let poses = [-4.0, 0.0, 4.0]
        .map(|tilt: f64| ViewPose::new(tilt.to_radians(), 0.4, 1.1, Point2::new(100.0 + tilt, 120.0 - 2.0 * tilt)));
    let aligned = AlignedSeries { poses: poses.to_vec(), contrast: vec![], axis_rad: 0.4, warnings: vec![] };
    let (transforms, tilts) = aligned.transforms(&series);
    assert_eq!(tilts, [-4.0, 0.0, 4.0]);
    // A point on the axis lands on the vertical through the middle of the aligned image; "up the axis" is up.
    let middle = Point2::new(127.5, 127.5);
    for (pose, transform) in poses.iter().zip(&transforms) {
        for y in [-30.0, 0.0, 50.0] {
            let there = transform.matrix * (pose.project(&Point3::new(0.0, y, 0.0)) - middle) + transform.shift;
            assert!((there - Vector2::new(0.0, y)).norm() < 1e-9);
        }
    }
    let mut text = Vec::new();
    crate::export::xf::write_xf(&transforms, &mut text).unwrap();
    let read = crate::io::xf::parse(&String::from_utf8(text).unwrap()).unwrap();
    let back = AlignedSeries::from_transforms(&series, &read, "series.xf").unwrap();
    for (pose, other) in poses.iter().zip(&back.poses) {
        assert!((pose.origin() - other.origin()).norm() < 2e-3 && (pose.axis_rad() - other.axis_rad()).abs() < 1e-6);
    }
    assert!(
        AlignedSeries::from_transforms(&series, &read[..2], "short.xf")
            .unwrap_err()
            .to_string()
            .contains("2 transforms")
    );
}

#[test]
fn constant_views_are_passed_over_and_named() {
    let folder = tempfile::tempdir().unwrap();
    let constant = ndarray::Array2::from_elem([40, 48], 7_i16);
    let path = folder.path().join("grey.mrc");
    write_stack(&vec![constant; 3], None, &mut fs::File::create(&path).unwrap()).unwrap();
    let series = open(&path, Some("-4,0,4")).unwrap();
    let message = align(&series, 0.0, &|_, _| ()).unwrap_err().to_string();
    assert!(message.contains("constant grey: 3 of 3"), "{message}");
    assert!(choose_pair(&series).unwrap_err().to_string().contains("fewer than two show lines"));
}

#[test]
fn the_pair_is_eight_degrees_apart_about_the_least_tilted_view() {
    let folder = tempfile::tempdir().unwrap();
    let tilts: Vec<f64> = (-6..=6).map(|k| 4.0 * f64::from(k)).collect();
    let (series, ..) = scene_series(folder.path(), 0.0, &tilts);
    let pair = choose_pair(&series).unwrap();
    let [left, right] = pair.views.map(|view| series.views[view].tilt_deg);
    assert_eq!(right - left, 8.0);
    assert!((left + right).abs() <= 8.0, "{}", pair.reason);
    assert!(pair.reason.contains("8.0 degrees apart"));
}

/// The true curves of a scene in the frame of a pair at -4 and 4 degrees, as a result would have them; with `sign` -1 turned over.
fn saved(scene: &Scene, views: [&ViewSettings; 2], sign: f64) -> SavedCurves {
    let curves = scene.curves.iter().map(|curve| SavedCurve {
        points: curve.iter().map(|point| Point3::new(point.x, point.y, sign * point.z)).collect(),
        sigma_z: vec![0.5; curve.len()],
        flags: vec![crate::curve::Flag::Ok; curve.len()],
        closed: false,
    });
    let poses = views.map(|view| {
        ViewPose::new(view.tilt_rad, view.axis_rad, view.scale, view.image_from_projection() * Point2::origin())
    });
    let tilts = TiltPair::from_degrees(-4.0, 4.0);
    SavedCurves {
        curves: curves.collect(),
        tilts,
        poses,
        unit: (LengthUnit::Px, 1.0),
        depth_flipped: false,
        sha256: String::new(),
    }
}

/// Lines of the scene in a view without error: what a perfect detector would find.
fn true_lines(scene: &Scene, view: &ViewSettings) -> ViewLines {
    let traces = view.project_curves(scene).into_iter().map(|points| {
        let last = points.len() - 1;
        let point = |at: usize| crate::curve::TracePoint {
            position: points[at],
            tangent: (points[(at + 1).min(last)] - points[at.saturating_sub(1)]).normalize(),
            probability: 1.0,
            sigma_perp_px: 0.2,
        };
        let ends = [crate::curve::TraceEnd::Free; 2];
        crate::curve::Trace { points: (0..=last).map(point).collect(), closed: false, ends }
    });
    ViewLines::new(crate::curve::TraceGraph { traces: traces.collect(), junctions: Vec::new() }, view.shape)
}

/// True curves lie on the lines of every view; curves with depth turned over are found out as a swapped pair, because points
/// behind mid-foil then move the wrong way as the tilt grows; depths a quarter too large are found out where views span enough.
#[test]
fn reprojection_measures_nothing_on_the_truth_and_finds_a_swapped_pair() {
    let folder = tempfile::tempdir().unwrap();
    let tilts: Vec<f64> = (-10..=10).map(|k| 4.0 * f64::from(k)).collect();
    let (series, views, scene) = scene_series(folder.path(), 20.0, &tilts);
    let aligned = align(&series, 20_f64.to_radians(), &|_, _| ()).unwrap();
    let all: Vec<usize> = (0..series.views.len()).collect();
    let pair = [&views[9], &views[11]];
    let mut lines_of = |view: usize| Ok(true_lines(&scene, &views[view]));
    let found = reproject(&saved(&scene, pair, 1.0), &series, &aligned, &all, &mut lines_of).unwrap();
    for view in &found.views {
        let distances = view.distances.unwrap();
        assert!(view.supported && distances.median_px < 0.1 && distances.within_2px > 0.99, "{view:?}");
        let truth = views[view.view].image_from_projection() * Point2::origin();
        assert!((view.pose.origin() - truth).norm() < 0.2, "{}: {:?} {truth:?}", view.tilt_deg, view.pose.origin());
    }
    assert_eq!(found.views.iter().filter(|view| view.in_pair).count(), 2);
    assert_eq!(found.checks.order, PairOrder::Consistent);
    assert!(matches!(found.checks.tilts, PairTilts::Agree { .. }), "{:?}", found.checks);
    // Depth turned over.
    let turned = reproject(&saved(&scene, pair, -1.0), &series, &aligned, &all, &mut lines_of).unwrap();
    assert_eq!(turned.checks.order, PairOrder::Swapped, "{:?}", turned.checks);
    assert!(turned.checks.sentences()[0].contains("SWAPPED"));
    // As if the pair had been 6.4 degrees apart.
    let deep = reproject(&saved(&scene, pair, 1.25), &series, &aligned, &all, &mut lines_of).unwrap();
    let PairTilts::Disagree { depth_factor, .. } = deep.checks.tilts else { panic!("{:?}", deep.checks) };
    assert!((depth_factor - 0.8).abs() < 0.05, "{depth_factor}");
    // Within 30 degrees an error of all tilts looks the same.
    let near: Vec<usize> = (0..series.views.len()).filter(|view| tilts[*view].abs() <= 12.0).collect();
    let mut few = series.clone();
    few.views = near.iter().map(|view| series.views[*view].clone()).collect();
    let poses = near.iter().map(|view| aligned.poses[*view]).collect();
    let few_aligned = AlignedSeries { poses, ..aligned.clone() };
    let places: Vec<usize> = (0..near.len()).collect();
    let mut lines_of = |view: usize| Ok(true_lines(&scene, &views[near[view]]));
    let found = reproject(&saved(&scene, pair, 1.25), &few, &few_aligned, &places, &mut lines_of).unwrap();
    assert_eq!(found.checks.tilts, PairTilts::CannotTell);
}

/// No number of views can tell the sign: depth and all tilts turned over together project to the same points.
#[test]
fn turning_over_depth_and_tilts_changes_no_view() {
    let pose = ViewPose::new(0.4, 0.1, 1.0, Point2::new(3.0, 4.0));
    let turned = ViewPose { tilt_rad: -0.4, ..pose };
    let point = Point3::new(5.0, 6.0, 7.0);
    let over = Point3::new(5.0, 6.0, -7.0);
    assert!((pose.project(&point) - turned.project(&over)).norm() < 1e-12);
}
