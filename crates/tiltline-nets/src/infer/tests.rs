use super::*;
use crate::weights::{Record, initialise};
use tiltline::filter::gaussian_blur;

fn image(rows: usize, columns: usize) -> Array2<f32> {
    let noise = Array2::from_shape_fn((rows, columns), |(row, column)| {
        let mut bits = (row * 5000 + column) as u32;
        bits = (bits ^ (bits >> 16)).wrapping_mul(0x7feb_352d);
        bits = (bits ^ (bits >> 15)).wrapping_mul(0x846c_a68b);
        ((bits ^ (bits >> 16)) as f32) / (u32::MAX as f32)
    });
    gaussian_blur(&noise, 2.0)
}

/// Tiles as wide as the field of view leave every pixel what it is without them, but for rounding.
#[test]
fn a_tiled_detection_is_that_of_the_whole_image() {
    let config = DetectorConfig { channels: 3, depth: 3 };
    let device = Device::flex();
    let network = initialise(Detector::new(&config, &device), 5);
    let weights = Weights::of(&network, NetworkConfig::Detector(config.clone()), Record::new());
    let named = Named { path: "test".into(), weights };
    let detector = NetDetector::new(&named, &device).unwrap();
    let image = image(700, 610);
    let tiled = detector.probability(&image, 0);
    let whole = cut(
        &flattened(&image),
        &Tile { start: 0, length: 704, keep: 0..700 },
        &Tile { start: 0, length: 616, keep: 0..610 },
    );
    let values = probability(detector.network.forward(tensor(&whole, &device)).logits);
    let whole = Array2::from_shape_vec((704, 616), values).unwrap();
    assert!(tiles(700, TILE_PX, detector.margin_px(), 8).len() == 2, "the test must see a border of tiles");
    let spread = whole.iter().fold(0.0_f32, |most, p| most.max((p - 0.5).abs()));
    assert!(spread > 0.01, "the network must say something: {spread}");
    for ((row, column), p) in tiled.indexed_iter() {
        assert!((p - whole[[row, column]]).abs() < 1e-5, "{p} at {row}, {column}");
    }
}

#[test]
fn weights_of_the_other_network_are_refused() {
    let device = Device::flex();
    let config = DetectorConfig { channels: 2, depth: 1 };
    let network = Detector::new(&config, &device);
    let weights = Weights::of(&network, NetworkConfig::Detector(config), Record::new());
    let named = Named { path: "my.safetensors".into(), weights };
    let error = NetMatcher::new(&named, None, MatchSettings::default(), &device).unwrap_err();
    assert_eq!(error.to_string(), "my.safetensors holds the weights of a detector, not of a matcher");
}

/// Costs of a tile are those of the whole image: its margin is as wide as the network sees.
#[test]
fn a_tiled_matching_is_that_of_the_whole_image() {
    let config = MatcherConfig {
        features: 8,
        concatenated: 4,
        groups: 4,
        channels: 4,
        hourglasses: 1,
        levels: 8,
        ..MatcherConfig::default()
    };
    let device = Device::flex();
    let network = initialise(Matcher::new(&config, &device), 5);
    let weights = Weights::of(&network, NetworkConfig::Matcher(config.clone()), Record::new());
    let named = Named { path: "test".into(), weights };
    let matcher = NetMatcher::new(&named, None, MatchSettings::default(), &device).unwrap();
    let (rows, columns) = (768, 208);
    let images = [image(rows, columns), image(rows, columns).mapv(|value| 1.0 - value)];
    let lines = [image(rows, columns), image(rows, columns)];
    let [height, _] = matcher.margins_px();
    assert!(tiles(rows, TILE_PX, height, 16).len() == 2, "the test must see a border of tiles");
    let costs = matcher.costs(&images, &lines, &Array2::from_elem((rows, columns), true));
    let input = |view: usize| matcher.input(&flattened(&images[view]), &lines[view]);
    let whole = matcher.network.forward(input(0), input(1)).pop().unwrap();
    let mut expected = Costs::new((rows, columns), &config);
    let tile = |count| Tile { start: 0, length: count, keep: 0..count };
    expected.put(whole, &tile(rows), &tile(columns));
    let mut spread = 0.0_f32;
    for row in (0..rows).step_by(5) {
        for column in (0..columns).step_by(7) {
            let [found, expected] = [&costs, &expected].map(|costs| costs.at(column as f64, row as f64).unwrap());
            for (a, b) in found.iter().zip(&expected) {
                spread = spread.max((b - expected[0]).abs());
                assert!((a - b).abs() < 1e-3 * (1.0 + b.abs()), "{a} {b} at {row}, {column}");
            }
        }
    }
    assert!(spread > 0.1, "the network must say something: {spread}");
}

/// A picture twice as large is looked at in half its size: its lines are as wide as they were.
#[test]
fn a_larger_picture_of_the_same_lines_is_halved() {
    let detector = NetDetector::new(&Named::built_in_detector().unwrap(), &Device::flex()).unwrap();
    // A dark line of 4 px full width that winds through the picture, at some scale.
    let picture = |scale: f64| {
        let side = (240.0 * scale) as usize;
        Array2::from_shape_fn((side, side), |(row, column)| {
            let (x, y) = (column as f64 / scale, row as f64 / scale);
            let distance = (x - 120.0 - 40.0 * (y / 40.0).sin()) / 1.4;
            (0.7 - 0.4 * (-0.5 * distance * distance).exp()) as f32
        })
    };
    let octaves = [1.0, 4.0].map(|scale| detector.octave(&picture(scale)));
    assert!(octaves[0] == 0 && octaves[1] >= 1, "{octaves:?}");
}

#[test]
fn the_built_in_weights_are_what_they_are_called() {
    let device = Device::flex();
    NetDetector::new(&Named::built_in_detector().unwrap(), &device).unwrap();
    NetMatcher::new(&Named::built_in_matcher().unwrap(), None, MatchSettings::default(), &device).unwrap();
}
