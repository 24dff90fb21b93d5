use super::*;
use crate::data::AugmentSettings;
use tiltline::simulate::Family;

fn small(task: Task, steps: u64) -> TrainSettings {
    TrainSettings {
        task,
        steps,
        warm_up: 2,
        learning_rate: 2e-3,
        report_every: 1,
        checkpoint_every: 3,
        validate_every: 1000,
        validation_count: 1,
        detector: DetectorConfig { channels: 4, depth: 2 },
        matcher: MatcherConfig {
            features: 8,
            concatenated: 4,
            groups: 4,
            channels: 4,
            hourglasses: 1,
            levels: 8,
            ..MatcherConfig::default()
        },
        data: DataSettings {
            families: vec![Family::Gan],
            physics: 0.0,
            simulated_px: 96,
            crop_px: 48,
            batch: 2,
            ..DataSettings::default()
        },
        ..TrainSettings::default()
    }
}

/// The loss of each step as it was reported.
fn losses(run: &mut Run, stop_after: Option<u64>) -> Vec<(u64, u64)> {
    let mut seen = Vec::new();
    run.train(&mut |event| {
        if let Event::Line { line, .. } = event
            && line.kind == "train"
        {
            seen.push((line.step, line.values["loss"].to_bits()));
            return stop_after.is_none_or(|last| line.step < last);
        }
        true
    })
    .unwrap();
    seen
}

/// Bit by bit, wherever the run was cut: after a checkpoint, or by a kill that left an older one.
#[test]
fn a_resumed_run_goes_on_as_if_it_had_not_stopped() {
    for task in [Task::Detector, Task::Joint] {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        let device = Device::flex();
        let straight = losses(&mut Run::start(small(task, 8), &at("straight"), &[], device.clone()).unwrap(), None);
        assert_eq!(straight.len(), 8);
        let mut run = Run::start(small(task, 8), &at("cut"), &[], device.clone()).unwrap();
        let first = losses(&mut run, Some(5));
        drop(run);
        assert_eq!(first, straight[..5]);
        // As after kill -9 between checkpoints: the newest is of step 3.
        fs::remove_file(at("cut").join("checkpoint-00000005.safetensors")).unwrap();
        let mut run = Run::resume(&at("cut"), None, device).unwrap();
        assert_eq!(run.step(), 3);
        assert_eq!(losses(&mut run, None), straight[3..], "{task:?}");
        let metrics = Metrics::read(&at("cut"), u64::MAX);
        assert_eq!(metrics.0.iter().filter(|line| line.kind == "train").count(), 8, "each step once");
        assert!(at("cut").join("curves.svg").exists());
    }
}

/// The proof that the whole chain learns: a few fixed crops are learnt by heart.
#[test]
fn a_few_crops_are_learnt_by_heart() {
    // One example, cut in its middle, the same at every step.
    let steps = if std::env::var_os("TILTLINE_SLOW_TESTS").is_some() { 400 } else { 150 };
    let folder = tempfile::tempdir().unwrap();
    let mut settings = small(Task::Detector, steps);
    settings.data.augment = AugmentSettings::none();
    settings.data.crop_px = 96;
    settings.data.crops_per_example = 1_000_000;
    settings.data.batch = 1;
    settings.learning_rate = 1e-2;
    settings.validate_every = 1_000_000;
    settings.checkpoint_every = 1_000_000;
    let mut run = Run::start(settings, &folder.path().join("detector"), &[], Device::flex()).unwrap();
    let losses = losses(&mut run, None);
    let mean = |part: &[(u64, u64)]| {
        part.iter().map(|(_, bits)| f64::from_bits(*bits)).sum::<f64>() / part.len() as f64
    };
    let (first, last) = (mean(&losses[..10]), mean(&losses[losses.len() - 10..]));
    assert!(last < 0.35 * first, "{first} before, {last} after");
}

#[test]
fn a_folder_with_a_run_and_a_matcher_without_a_detector_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("run");
    let error = Run::start(small(Task::Matcher, 1), &path, &[], Device::flex()).err().unwrap();
    assert!(matches!(error, TrainError::NoDetector));
    Run::start(small(Task::Detector, 1), &path, &[], Device::flex()).unwrap();
    let error = Run::start(small(Task::Detector, 1), &path, &[], Device::flex()).err().unwrap();
    assert!(error.to_string().contains("--resume"), "{error}");
}
