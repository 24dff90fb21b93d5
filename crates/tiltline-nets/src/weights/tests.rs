use super::*;
use crate::detector::Detector;
use burn::tensor::Device;

fn small() -> DetectorConfig {
    DetectorConfig { channels: 3, depth: 2 }
}

fn weights() -> Weights {
    let network = initialise(Detector::new(&small(), &Device::flex()), 1);
    Weights::of(&network, NetworkConfig::Detector(small()), Record::from([("seed".into(), "1".into())]))
}

#[test]
fn every_half_comes_back_and_singles_are_rounded_to_the_nearest() {
    for bits in (0..=u16::MAX).filter(|bits| bits & 0x7c00 != 0x7c00) {
        assert_eq!(half_bits(half_value(bits)), bits, "{bits:#x}");
    }
    // Halves between 1 and 2 are 2^-10 apart; ties go to the even one.
    let step = 2.0_f32.powi(-10);
    for (value, nearest) in [(1.0 + 0.4 * step, 1.0), (1.0 + 0.5 * step, 1.0), (1.0 + 1.5 * step, 1.0 + 2.0 * step)] {
        assert_eq!(half_value(half_bits(value)), nearest);
    }
    assert_eq!(half_value(half_bits(1e9)), 65504.0);
}

#[test]
fn weights_are_the_same_after_a_file() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("weights.safetensors");
    let weights = weights();
    weights.write(&path, Precision::Single).unwrap();
    let read = Weights::read(&path).unwrap();
    assert_eq!((&read.network, &read.record, &read.tensors), (&weights.network, &weights.record, &weights.tensors));
    assert_eq!(read.sha256.len(), 64);
    let network = read.load_into(Detector::new(&small(), &Device::flex()), &path).unwrap();
    assert_eq!(collect(&network), weights.tensors);
}

#[test]
fn random_weights_depend_on_seed_and_name_only_and_have_the_variance_of_he() {
    let deeper = DetectorConfig { depth: 3, ..small() };
    let [a, b, c] = [(small(), 1), (deeper, 1), (small(), 2)]
        .map(|(config, seed)| collect(&initialise(Detector::new(&config, &Device::flex()), seed)));
    let name = "down.1.second.conv.weight";
    assert_eq!(a[name], b[name]);
    assert_ne!(a[name], c[name]);
    let wide = DetectorConfig { channels: 16, depth: 2 };
    let wide = &collect(&initialise(Detector::new(&wide, &Device::flex()), 1))["down.2.second.conv.weight"];
    let variance: f64 = wide.values.iter().map(|v| f64::from(v * v)).sum::<f64>() / wide.values.len() as f64;
    // 36,864 weights: the variance is known to 0.7 percent.
    assert!((variance * (64.0 * 9.0) / 2.0 - 1.0).abs() < 0.05, "{variance}");
}

#[test]
fn damaged_and_foreign_files_are_refused_without_a_panic() {
    let path = Path::new("weights.safetensors");
    let bytes = weights().to_bytes(Precision::Half);
    assert!(Weights::from_bytes(&bytes, path).is_ok());
    for length in [0, 4, 8, 20, bytes.len() / 2, bytes.len() - 1] {
        assert!(matches!(Weights::from_bytes(&bytes[..length], path), Err(WeightsError::Foreign { .. })), "{length}");
    }
    // A header that claims to be as long as memory.
    let mut huge = bytes.clone();
    huge[..8].copy_from_slice(&u64::MAX.to_le_bytes());
    assert!(matches!(Weights::from_bytes(&huge, path), Err(WeightsError::Foreign { .. })));
    // A pickle, and somebody else's safetensors.
    assert!(matches!(Weights::from_bytes(b"\x80\x04\x95 pickle and more", path), Err(WeightsError::Foreign { .. })));
    let view = TensorView::new(Dtype::F32, vec![1], &[0; 4]).unwrap();
    let other = serialize([("weight", view)], None).unwrap();
    let error = Weights::from_bytes(&other, path).unwrap_err();
    assert!(error.to_string().contains("no configuration"), "{error}");
}

#[test]
fn weights_of_another_shape_are_named() {
    let path = Path::new("weights.safetensors");
    let other = Detector::new(&DetectorConfig { channels: 4, depth: 2 }, &Device::flex());
    let error = weights().load_into(other, path).unwrap_err();
    assert!(error.to_string().contains("[3, 1, 3, 3], not [4, 1, 3, 3]"), "{error}");
    let mut missing = weights();
    missing.tensors.remove("head.bias");
    let error = missing.load_into(Detector::new(&small(), &Device::flex()), path).unwrap_err();
    assert!(error.to_string().contains("head.bias is missing"), "{error}");
}
