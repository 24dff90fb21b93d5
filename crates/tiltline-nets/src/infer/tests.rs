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
