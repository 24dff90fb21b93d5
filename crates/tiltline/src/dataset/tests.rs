use std::collections::BTreeMap;
use std::fs;
use std::path::Path;
use std::sync::atomic::{AtomicUsize, Ordering};

use super::*;
use crate::io::{ReadOptions, read_micrograph_with};
use crate::simulate::{Family, Lines, SimulateSettings};

fn settings() -> SimulateSettings {
    SimulateSettings { size_px: 64, ..SimulateSettings::of_family(Family::Gan) }
}

fn plan(count: u32) -> Manifest {
    Manifest::simulated(settings(), 3, count, None).unwrap()
}

fn go_on(_: usize, _: usize) -> bool {
    true
}

/// Every file below a folder with its content.
fn content(folder: &Path) -> BTreeMap<String, Vec<u8>> {
    let mut found = BTreeMap::new();
    for entry in fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        let name = path.file_name().unwrap().to_string_lossy().into_owned();
        if path.is_dir() {
            found.extend(content(&path).into_iter().map(|(inner, bytes)| (format!("{name}/{inner}"), bytes)));
        } else {
            found.insert(name, fs::read(&path).unwrap());
        }
    }
    found
}

#[test]
fn the_same_seed_gives_the_same_bytes_whatever_the_threads_and_interruptions() {
    let folder = tempfile::tempdir().unwrap();
    let [one, two] = ["one", "two"].map(|name| folder.path().join(name));
    let pool = |threads| rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
    pool(1).install(|| make(&plan(4), Lines::Random, &one, &go_on)).unwrap();
    let stop_after_two = AtomicUsize::new(0);
    let stopping = |_: usize, _: usize| stop_after_two.fetch_add(1, Ordering::Relaxed) < 2;
    let stopped = pool(1).install(|| make(&plan(4), Lines::Random, &two, &stopping));
    assert!(matches!(stopped, Err(DatasetError::Stopped)), "{stopped:?}");
    // What a killed run leaves behind does not stay.
    fs::create_dir(two.join(".tiltline-left")).unwrap();
    let (dataset, made) = pool(3).install(|| make(&plan(4), Lines::Random, &two, &go_on)).unwrap();
    assert_eq!((made.kept, made.made), (2, 2));
    dataset.check().unwrap();
    assert_eq!(content(&one), content(&two));
    // A longer set holds the shorter one.
    let (longer, made) = make(&plan(5), Lines::Random, &one, &go_on).unwrap();
    assert_eq!((made.kept, made.made), (4, 1));
    assert_eq!(longer.manifest.items[..4], dataset.manifest.items[..]);
    // And asking for the shorter one again loses nothing.
    let (still, _) = make(&plan(4), Lines::Random, &one, &go_on).unwrap();
    assert_eq!(still.manifest, longer.manifest);
}

#[test]
fn a_damaged_file_is_found_and_mended() {
    let folder = tempfile::tempdir().unwrap();
    let target = folder.path().join("data");
    let (dataset, _) = make(&plan(2), Lines::Random, &target, &go_on).unwrap();
    let before = content(&target);
    let image = target.join("00001/right.tif");
    let mut bytes = fs::read(&image).unwrap();
    let middle = bytes.len() / 2;
    bytes[middle] ^= 1;
    fs::write(&image, bytes).unwrap();
    let message = dataset.check().unwrap_err().to_string();
    assert!(message.contains("right.tif") && message.contains("SHA-256"), "{message}");
    let (_, made) = make(&plan(2), Lines::Random, &target, &go_on).unwrap();
    assert_eq!(made.mended, ["00001"]);
    assert_eq!(content(&target), before);
    fs::remove_file(target.join("00000/truth.json")).unwrap();
    assert!(dataset.check().unwrap_err().to_string().contains("truth.json"));
    make(&plan(2), Lines::Random, &target, &go_on).unwrap();
    fs::create_dir(target.join("00007")).unwrap();
    fs::copy(target.join("00000/truth.json"), target.join("00007/truth.json")).unwrap();
    assert!(matches!(dataset.check(), Err(DatasetError::NotInManifest { item, .. }) if item == "00007"));
}

#[test]
fn nothing_else_is_overwritten() {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("thesis.txt"), "five years").unwrap();
    let refused = make(&plan(1), Lines::Random, folder.path(), &go_on);
    assert!(matches!(refused, Err(DatasetError::Foreign { .. })));
    let target = folder.path().join("data");
    make(&plan(1), Lines::Random, &target, &go_on).unwrap();
    let before = content(&target);
    let other_seed = Manifest::simulated(settings(), 4, 1, None).unwrap();
    let other_settings = Manifest::simulated(SimulateSettings { size_px: 96, ..settings() }, 3, 1, None).unwrap();
    for other in [other_seed, other_settings] {
        assert!(matches!(make(&other, Lines::Random, &target, &go_on), Err(DatasetError::Other { .. })));
    }
    assert_eq!(content(&target), before);
    assert!(matches!(Manifest::simulated(settings(), 1 << 30, 1, None), Err(DatasetError::Seed { .. })));
}

/// A network so dense that its lines cover each other: refused, and nothing stays behind that a second try would meet.
#[test]
fn a_plan_that_cannot_be_simulated_leaves_nothing_behind() {
    let folder = tempfile::tempdir().unwrap();
    let target = folder.path().join("data");
    let mut nodes = String::new();
    for index in 0..400 {
        let (start, end, y) = (2 * index, 2 * index + 1, 2.0 * f64::from(index) - 400.0);
        nodes += &format!(
            " 0,{start} -195 {y} 0 1 7\n 0,{end} 1 0 0\n 0 0 1\n 0,{end} 195 {y} 0 1 7\n 0,{start} -1 0 0\n 0 0 1\n"
        );
    }
    let text = format!(
        "dataFileVersion = 4\nnumFileSegments = 1\nminCoordinates = [\n-400\n-400\n-400\n]\nmaxCoordinates = [\n400\n400\n400\n]\n\
         nodeCount = 800\ndataDecompType = 1\ndataDecompGeometry = [ 1 1 1 ]\nnodalData =\n{nodes}"
    );
    let network = crate::simulate::paradis::Network::parse(&text, &Default::default()).unwrap();
    let refused = make(&plan(2), Lines::Network(&network), &target, &go_on);
    assert!(refused.as_ref().is_err_and(|error| error.to_string().contains("too dense")), "{refused:?}");
    assert!(!target.exists());
}

#[test]
fn images_carry_pixel_size_and_tilt_and_a_series_is_also_a_stack() {
    let folder = tempfile::tempdir().unwrap();
    let settings = SimulateSettings { tilts_deg: vec![-10.0, -4.0, 0.0, 4.5], ..settings() };
    let plan = Manifest::simulated(settings, 3, 1, None).unwrap();
    let (dataset, _) = make(&plan, Lines::Random, &folder.path().join("data"), &go_on).unwrap();
    let item = &dataset.manifest.items[0];
    assert_eq!(item.pair, [1, 3]);
    let truth = dataset.truth(item).unwrap();
    let read = |path: &str| {
        let path = dataset.path(item, path);
        read_micrograph_with(&path.to_string_lossy(), &ReadOptions::default())
    };
    for (index, view) in truth.views.iter().enumerate() {
        let image = read(&view.name).unwrap();
        assert_eq!(image.tilt_deg.unwrap().value, [-10.0, -4.0, 0.0, 4.5][index]);
        let size = image.pixel_size_nm.unwrap().value;
        assert!((size / truth.pixel_size_nm.unwrap() - 1.0).abs() < 1e-6);
        // The stack holds the same picture, the same way up, in signed 16 bits.
        let section = dataset.path(item, "series.mrc").to_string_lossy().into_owned() + &format!("#{index}");
        let section = read_micrograph_with(&section, &ReadOptions::default()).unwrap();
        assert_eq!(section.tilt_deg.unwrap().value, [-10.0, -4.0, 0.0, 4.5][index]);
        for (from_stack, from_tiff) in section.micrograph.pixels.iter().zip(&image.micrograph.pixels) {
            assert!((2.0 * from_stack - from_tiff).abs() <= 1.5);
        }
    }
}

/// The map's value at a line is what the truth's own geometry says of the 3D point: z times 2 sin(phi / 2), up to one offset.
#[test]
fn the_disparity_map_is_depth_times_two_sine_of_half_the_angle() {
    let mut settings = SimulateSettings { size_px: 256, ..settings() };
    settings.visible_above_noise = 0.0;
    settings.least_contrast = 0.0;
    let sample = crate::simulate::sample(&settings, Lines::Random, 21).unwrap();
    let mut truth = sample.truth;
    // Contrast on the cores: the shift of contrast from the core is another matter.
    for curve in truth.views.iter_mut().flat_map(|view| &mut view.curves) {
        curve.contrast = curve.core.clone().unwrap();
    }
    let pair = truth.pair(0, 1).unwrap();
    let map = disparity_map(&pair);
    let px_per_nm = pair.left.input_from_projection.unwrap().scale_px;
    let depth_px = 2.0 * 4.0_f64.to_radians().sin() * px_per_nm;
    let mut errors = Vec::new();
    for (curve, seen) in truth.curves.iter().zip(&pair.left.curves) {
        for (point, place) in curve.points.as_ref().unwrap().iter().zip(&seen.contrast) {
            let (column, row) = (place.x.round(), place.y.round());
            if column < 0.0 || row < 0.0 || column > 255.0 || row > 255.0 {
                continue;
            }
            let value = f64::from(map[[row as usize, column as usize]]);
            if value.is_finite() {
                // x_R - x_L about the tilt axis = Z 2 sin(phi / 2) in the mid-view frame, here the untilted one.
                errors.push((value - point.z * depth_px).abs());
            }
        }
    }
    errors.sort_by(f64::total_cmp);
    assert!(errors.len() > 100, "{}", errors.len());
    // Half a pixel off the point along an inclined line changes disparity by less than this; where lines cross, the other
    // line's value may be meant.
    assert!(errors[errors.len() / 2] < 0.05 && errors[errors.len() * 9 / 10] < 0.5, "{}", errors[errors.len() / 2]);
}

#[test]
fn a_manifest_that_leads_out_of_its_folder_or_contradicts_itself_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join(MANIFEST);
    let head = "format = 'tiltline-dataset'\nversion = 1\n";
    for (body, word) in [
        ("[[items]]\nname = '../other'", "../other"),
        ("[[items]]\nname = 'a'\ntruth = '/etc/passwd'", "passwd"),
        ("[[items]]\nname = 'a'\n[[items]]\nname = 'a'", "twice"),
        ("[[items]]\nname = 'a'\nsettings = 'none'", "none"),
        ("[[items]]\nname = 'a'\npair = [1, 1]", "twice"),
        ("[[items]]\nnam = 'a'", "nam"),
        ("sead = 3", "sead"),
    ] {
        fs::write(&path, format!("{head}{body}\n")).unwrap();
        let message = Dataset::open(folder.path()).unwrap_err().to_string();
        assert!(message.contains(word), "{body}: {message}");
    }
    fs::write(&path, "format = 'tiltline-dataset'\nversion = 7\n").unwrap();
    assert!(matches!(Dataset::open(folder.path()), Err(DatasetError::Version { found: 7, .. })));
}

mod labelled {
    use super::super::label::{LabelledPair, add_labelled};
    use super::*;
    use crate::simulate::geometry::Split;

    fn labels(side: usize, x: f64) -> String {
        format!(
            r#"{{"shapes": [{{"label": "a", "points": [[{x}, 2.5], [{x}, 30.5]], "shape_type": "linestrip"}}],
                "imagePath": "any.tif", "imageHeight": {side}, "imageWidth": {side}}}"#
        )
    }

    #[test]
    fn a_pair_labelled_in_labelme_becomes_an_item_and_a_wrong_size_does_not() {
        let folder = tempfile::tempdir().unwrap();
        let source = folder.path().join("source");
        let (dataset, _) = make(&plan(1), Lines::Random, &source, &go_on).unwrap();
        let item = &dataset.manifest.items[0];
        let images = ["left.tif", "right.tif"].map(|name| dataset.path(item, name));
        let label_files = [folder.path().join("left.json"), folder.path().join("right.json")];
        fs::write(&label_files[0], labels(64, 20.5)).unwrap();
        fs::write(&label_files[1], labels(64, 23.5)).unwrap();
        let target = folder.path().join("mine");
        let pair = LabelledPair {
            name: "first",
            images: [&images[0], &images[1]],
            labels: [&label_files[0], &label_files[1]],
            tilts_deg: Some([-4.0, 4.0]),
            pixel_size_nm: None,
            family: None,
            split: Split::Train,
        };
        assert!(add_labelled(&target, &pair).unwrap().is_empty());
        let mine = Dataset::open(&target).unwrap();
        mine.check().unwrap();
        let truth = mine.truth(&mine.manifest.items[0]).unwrap();
        let map = disparity_map(&truth.pair(0, 1).unwrap());
        assert_eq!(map[[10, 20]], 3.0);
        assert!(map[[10, 30]].is_nan());
        // The same name again, and labels of another size, change nothing.
        let before = content(&target);
        assert!(add_labelled(&target, &pair).unwrap_err().to_string().contains("first"));
        fs::write(&label_files[1], labels(80, 23.5)).unwrap();
        let refused = add_labelled(&target, &LabelledPair { name: "second", ..pair });
        assert!(matches!(refused, Err(DatasetError::ImageSize { .. })));
        assert_eq!(content(&target), before);
    }
}
