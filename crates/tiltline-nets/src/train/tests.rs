use super::*;
use crate::data::AugmentSettings;
use tiltline::simulate::Family;

fn small(task: Task, steps: u64) -> TrainSettings {
    TrainSettings {
        task,
        steps,
        warm_up: 2,
        learning_rate: Some(2e-3),
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

/// What a run gives can be trained on: the head gets back what files leave out, and steps follow.
#[test]
fn a_detector_is_trained_further() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let mut run = Run::start(small(Task::Detector, 40), &at("first"), &[], Device::flex()).unwrap();
    let first = losses(&mut run, None);
    let file = at("first").join("last.safetensors");
    let weights = Weights::read(&file).unwrap();
    let filed = weights.load_into(Run::networks(&run.settings, &Device::flex()).unwrap().detector, &file).unwrap();
    let mut run = Run::start(small(Task::Detector, 4), &at("second"), &[(file, weights)], Device::flex()).unwrap();
    let bias = |detector: &crate::detector::Detector| detector.head_bias()[0];
    let raised = f64::from(bias(&run.networks.detector) - bias(&filed));
    assert!(run.settings.losses.line > 1.0 && (raised - run.settings.losses.line.ln()).abs() < 1e-5, "{raised}");
    let further = losses(&mut run, None);
    assert_ne!(further[0].1, further[3].1);
    assert_eq!(further.len(), 4);
    let loss = |(_, bits): (u64, u64)| f64::from_bits(bits);
    assert!(loss(further[0]) < 0.9 * loss(first[0]), "{} {}", loss(further[0]), loss(first[0]));
    assert!(at("second").join("last.safetensors").exists());
}

/// Two fixed pairs, cut in their middle and never changed.
fn by_heart(task: Task, steps: u64) -> TrainSettings {
    let mut settings = small(task, steps);
    settings.data.augment = AugmentSettings::none();
    settings.data.crop_px = 96;
    settings.data.examples = 2;
    settings.learning_rate = Some(5e-3);
    (settings.report_every, settings.validate_every, settings.checkpoint_every) = (steps, 1_000_000, 1_000_000);
    settings
}

/// Values of the last report.
fn last(run: &mut Run) -> BTreeMap<String, f64> {
    let mut values = BTreeMap::new();
    run.train(&mut |event| {
        if let Event::Line { line, .. } = event
            && line.kind == "train"
        {
            values = line.values.clone();
        }
        true
    })
    .unwrap();
    values
}

/// The proof that the whole chain learns: a few images are learnt by heart, down to the course of the lines in them.
#[test]
fn the_detector_learns_a_few_images_by_heart() {
    let folder = tempfile::tempdir().unwrap();
    let mut settings = by_heart(Task::Detector, 700);
    // Foils that both show lines.
    settings.seed = 15;
    let (data, seed) = (settings.data.clone(), settings.seed);
    let mut run = Run::start(settings, &folder.path().join("run"), &[], Device::flex()).unwrap();
    last(&mut run);
    let named = crate::infer::Named::read(&folder.path().join("run/last.safetensors")).unwrap();
    let detector = crate::infer::NetDetector::new(&named, &Device::flex()).unwrap();
    let source = Source::new(&data, DataTask::Detector, seed, Split::Train).unwrap();
    let batch = source.batch(0).unwrap();
    let shape = (batch.side, batch.side);
    for (image, lines) in
        batch.left.chunks_exact(shape.0 * shape.1).zip(batch.left_lines.chunks_exact(shape.0 * shape.1))
    {
        let image = ndarray::Array2::from_shape_vec(shape, image.to_vec()).unwrap();
        let lines = ndarray::Array2::from_shape_vec(shape, lines.to_vec()).unwrap();
        // Where it is not known whether there is a line, nothing is asked.
        let found = ndarray::Zip::from(&detector.probability_of_flattened(&image))
            .and(&lines)
            .map_collect(|p, line| *p > 0.5 && !line.is_nan());
        let score =
            tiltline::score::cl_dice(&found, &lines.mapv(|line| line == 1.0), tiltline::trace::thin::thin).unwrap();
        assert!(score > 0.99, "clDice {score}");
    }
}

#[test]
fn the_matcher_learns_a_few_pairs_by_heart() {
    let folder = tempfile::tempdir().unwrap();
    let mut settings = by_heart(Task::Joint, 300);
    settings.matcher.channels = 8;
    let mut run = Run::start(settings, &folder.path().join("run"), &[], Device::flex()).unwrap();
    let values = last(&mut run);
    assert!(values["epe"] < 5.0, "{values:?}");
    // The mean over all steps is reported: the end is what counts.
    run.settings.steps += 20;
    run.settings.report_every = 20;
    let values = last(&mut run);
    assert!(values["epe"] < 0.1, "{values:?}");
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
