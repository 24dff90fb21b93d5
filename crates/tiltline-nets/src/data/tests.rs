use super::augment::Window;
use super::*;
use ndarray::Array2;
use rand::SeedableRng;

/// A pair in which a bright dot at `(x, y)` on the left lies at `(x + d, y)` on the right.
fn dots() -> (Example, Vec<([f64; 2], f64)>) {
    let dots: Vec<([f64; 2], f64)> =
        vec![([60.0, 50.0], 6.0), ([90.0, 70.0], -3.0), ([45.0, 95.0], 2.0), ([100.0, 110.0], 8.0)];
    let mut images = [Array2::zeros((160, 160)), Array2::zeros((160, 160))];
    let mut disparity = Array2::from_elem((160, 160), f32::NAN);
    let mut lines = Array2::zeros((160, 160));
    for &([x, y], d) in &dots {
        for (image, at) in images.iter_mut().zip([x, x + d]) {
            for ((row, column), value) in image.indexed_iter_mut() {
                let squared = (column as f64 - at).powi(2) + (row as f64 - y).powi(2);
                *value += (-squared / (2.0 * 2.0 * 2.0)).exp() as f32;
            }
        }
        for row in -2..=2 {
            for column in -2..=2 {
                let place = [(y as isize + row) as usize, (x as isize + column) as usize];
                disparity[place] = d as f32;
                lines[place] = 1.0;
            }
        }
    }
    let lines = [Some(lines), None];
    (Example { images, lines, disparity: Some(disparity), median_px: 0.0 }, dots)
}

/// Sub-pixel position of the brightest dot within 4 px of a place.
fn brightest(image: &Array2<f32>, near: [f64; 2]) -> [f64; 2] {
    let (mut sum, mut at) = (0.0, [0.0; 2]);
    for ((row, column), value) in image.indexed_iter() {
        let [x, y] = [column as f64, row as f64];
        if (x - near[0]).hypot(y - near[1]) < 4.5 {
            let weight = f64::from(value.max(0.0)).powi(2);
            sum += weight;
            at = [at[0] + weight * x, at[1] + weight * y];
        }
    }
    at.map(|value| value / sum)
}

/// Whatever is done to the geometry, the dot on the right lies where the left dot's disparity says, but for the row
/// that misalignment moves it to.
#[test]
fn the_disparity_follows_every_geometric_change() {
    let (example, dots) = dots();
    let none = AugmentSettings::none();
    let changes = [
        ("nothing", none.clone()),
        ("scale", AugmentSettings { scale: [0.8, 1.3], ..none.clone() }),
        ("flips", AugmentSettings { flip: true, ..none.clone() }),
        ("shift", AugmentSettings { shift_px: 5.0, ..none.clone() }),
        ("misaligned", AugmentSettings { row_px: 1.0, right_turn_deg: 1.0, ..none.clone() }),
        ("all", AugmentSettings { ..AugmentSettings::default() }),
    ];
    for (name, settings) in changes {
        let mut seen = 0;
        for seed in 0..12 {
            let mut rng = Pcg64::seed_from_u64(seed);
            let window = Window::random_for_tests(&example, 144, &settings, &mut rng);
            let crop = Crop::cut(&example, &window, Task::Matcher, 0);
            for ((row, column), d) in crop.disparity.indexed_iter().filter(|(_, d)| !d.is_nan()) {
                // Only at the middle of a dot: its neighbourhood has its disparity too, but not its brightness.
                let source = window.left([column as f64, row as f64]);
                let Some((_, true_d)) = dots.iter().find(|([x, y], _)| (source[0] - x).hypot(source[1] - y) < 0.4)
                else {
                    continue;
                };
                let left = brightest(&crop.images[0], [column as f64, row as f64]);
                let expected = left[0] + window.disparity(left, *true_d);
                let margin = |v: f64| v > 6.0 && v < 137.0;
                if !(margin(left[0]) && margin(left[1]) && margin(expected)) {
                    continue;
                }
                let right = brightest(&crop.images[1], [expected, left[1]]);
                assert!((right[0] - expected).abs() < 0.15, "{name}: {right:?} and {expected}, d {d}");
                assert!((f64::from(*d) - (right[0] - left[0])).abs() < 0.3, "{name}: {d}");
                seen += 1;
            }
        }
        assert!(seen > 10, "{name}: only {seen} dots in the crops");
    }
}

/// Mirrored in a vertical mirror, what was further right in the right image is further left in it.
#[test]
fn a_mirror_turns_the_sign_of_the_disparity_and_enlargement_scales_it() {
    let window = |common| Window {
        side: 64,
        common,
        middle: [50.0, 50.0],
        right: ([[1.0, 0.0], [0.0, 1.0]], [0.0; 2]),
        offset: 0.0,
    };
    let at = [20.0, 40.0];
    assert!((window([[-1.0, 0.0], [0.0, 1.0]]).disparity(at, 5.0) + 5.0).abs() < 1e-12);
    assert!((window([[1.0, 0.0], [0.0, -1.0]]).disparity(at, 5.0) - 5.0).abs() < 1e-12);
    assert!((window([[0.5, 0.0], [0.0, 0.5]]).disparity(at, 5.0) - 10.0).abs() < 1e-12);
}

fn small() -> DataSettings {
    DataSettings {
        families: vec![Family::Gan, Family::Tial],
        physics: 0.0,
        simulated_px: 96,
        crop_px: 48,
        batch: 3,
        crops_per_example: 2,
        ..DataSettings::default()
    }
}

/// NaN is not equal to itself: compare bits.
fn bits(batch: &Batch) -> Vec<u32> {
    let parts = [&batch.left, &batch.right, &batch.left_lines, &batch.right_lines, &batch.disparity];
    parts.iter().flat_map(|part| part.iter().map(|value| value.to_bits())).collect()
}

#[test]
fn batches_depend_on_settings_seed_and_step_only() {
    let source = Source::new(&small(), Task::Matcher, 3, Split::Train).unwrap();
    let straight: Vec<Vec<u32>> = (0..8).map(|step| bits(&source.batch(step).unwrap())).collect();
    let again = Source::new(&small(), Task::Matcher, 3, Split::Train).unwrap();
    assert_eq!(bits(&again.batch(6).unwrap()), straight[6], "out of order");
    for threads in [1, 3] {
        let settings = DataSettings { threads, ..small() };
        let mut queue = Queue::start(&settings, Task::Matcher, 3, 2).unwrap();
        for (step, expected) in straight.iter().enumerate().skip(2) {
            assert_eq!(&bits(&queue.next_batch().unwrap()), expected, "{threads} threads, step {step}");
        }
    }
    let other = Source::new(&small(), Task::Matcher, 4, Split::Train).unwrap();
    assert_ne!(bits(&other.batch(0).unwrap()), straight[0]);
    let validation = Source::new(&small(), Task::Matcher, 3, Split::Val).unwrap();
    assert_ne!(bits(&validation.batch(0).unwrap()), straight[0]);
}

/// Lines are dark or bright against what is beside them: a mask that is off by some px would not notice.
#[test]
fn masks_lie_on_the_lines() {
    let settings = DataSettings { simulated_px: 256, crop_px: 224, augment: AugmentSettings::none(), ..small() };
    let source = Source::new(&settings, Task::Detector, 5, Split::Train).unwrap();
    let (mut on, mut beside) = (0.0, 0.0);
    for step in 0..4 {
        let batch = source.batch(step).unwrap();
        let side = batch.side;
        let at = |image: usize, row: usize, column: usize| f64::from(batch.left[(image * side + row) * side + column]);
        for image in 0..batch.count {
            for row in 8..side - 8 {
                for column in 8..side - 8 {
                    if batch.left_lines[(image * side + row) * side + column] == 1.0 {
                        let ring: f64 = [[0, 6], [6, 0], [12, 6], [6, 12]]
                            .iter()
                            .map(|[dy, dx]| at(image, row + dy - 6, column + dx - 6))
                            .sum();
                        on += at(image, row, column);
                        beside += ring / 4.0;
                    }
                }
            }
        }
    }
    // Both families show dark lines.
    assert!(on < 0.97 * beside, "{on} on the lines, {beside} beside them");
}

#[test]
fn impossible_settings_are_named() {
    let error = DataSettings { crop_px: 50, ..small() }.validate().unwrap_err();
    assert!(error.to_string().contains("crop_px"), "{error}");
    let nothing = DataSettings { families: Vec::new(), ..small() };
    assert!(Source::new(&nothing, Task::Detector, 0, Split::Train).is_err());
}

/// The square that dense matchers are scored on is the example itself: disparities as they are, dots where they were.
#[test]
fn the_middle_of_an_example_is_not_changed() {
    let (example, dots) = dots();
    let crop = Crop::middle(&example);
    assert_eq!(crop.disparity.dim(), (128, 128));
    for ([x, y], d) in dots {
        let [x, y] = [x - 16.0, y - 16.0];
        assert!((f64::from(crop.disparity[[y as usize, x as usize]]) - d).abs() < 1e-5);
        let [found, row] = brightest(&crop.images[1], [x + d, y]);
        assert!((found - x - d).abs() < 0.3 && (row - y).abs() < 0.3, "{found} {row}");
    }
}

/// Images that nothing can be matched in teach a detector, and no matcher.
#[test]
fn pairs_that_cannot_be_rectified_teach_detectors_only() {
    let folder = tempfile::tempdir().unwrap();
    let mut plan = tiltline::figures::low_contrast::foils(96);
    plan.items.truncate(1);
    // So few photons that the pair has no point in common.
    for settings in plan.settings.values_mut() {
        settings.acquisition.dose = [1.0, 1.0];
        settings.visible_above_noise = 1e-3;
    }
    let data = folder.path().join("data");
    let lines = tiltline::simulate::Lines::Random;
    let (set, _) = tiltline::dataset::make(&plan, lines, &data, &|_, _| true).unwrap();
    assert!(whole(&set, &set.manifest.items[0]).unwrap().is_none());
    let settings =
        DataSettings { folders: vec![data], families: Vec::new(), crop_px: 64, batch: 1, ..DataSettings::default() };
    let source = |task| Source::new(&settings, task, 1, Split::Train).unwrap();
    let batch = source(Task::Detector).batch(0).unwrap();
    assert!(batch.left.iter().all(|value| value.is_finite()));
    let error = source(Task::Matcher).batch(0).unwrap_err().to_string();
    assert!(error.contains("none of the 1 pairs can be rectified"), "{error}");
    // Where there is something else it is left out.
    let bad = settings.folders[0].join(&set.manifest.items[0].name);
    let settings = DataSettings { folders: settings.folders.clone(), folder_share: 1.0, ..small() };
    let source = Source::new(&settings, Task::Matcher, 1, Split::Train).unwrap();
    assert!(source.left_out().is_empty());
    assert_eq!(source.batch(0).unwrap().count, settings.batch);
    assert_eq!(source.left_out(), [bad]);
}
