//! What memory a step takes, estimated from the sizes of all activations, and what the machine has.

use super::{Task, TrainSettings};

/// Every activation is held for the backward pass beside its own gradient and what is made on the way: measured on both
/// networks (peak memory of a run against the sum of activations).
const COPIES: f64 = 2.6;
/// Program, data in preparation, weights.
const BASE_BYTES: f64 = 350e6;

/// Floats of all activations of the detector an image px, forward.
fn detector_floats(settings: &TrainSettings) -> f64 {
    let config = &settings.detector;
    // A level has four convolutions (down and up), each with an input to its norm, and a joined input.
    (0..=config.depth).map(|level| (config.channels << level) as f64 * 11.0 / f64::from(1_u32 << (2 * level))).sum()
}

/// The same of the matcher, an image px of one view.
fn matcher_floats(settings: &TrainSettings) -> f64 {
    let config = &settings.matcher;
    let area = 1.0 / (config.downscale * config.downscale) as f64;
    let voxels = config.levels as f64 * area;
    let encoder = 2.0 * (config.features as f64 * 2.0 + config.features as f64 * 12.0 * area);
    let volume = 3.0 * (2 * config.concatenated + config.groups + config.features) as f64 * voxels;
    let hourglass = config.channels as f64 * (10.0 + 16.0 / 8.0 + 16.0 / 64.0);
    let volumes = voxels * (6.0 * config.channels as f64 + config.hourglasses as f64 * hourglass);
    // Costs brought to full resolution, for each hourglass.
    let full = config.hourglasses as f64 * config.levels as f64 * 3.0;
    // The warp loss wants the disparity of every pixel, at all fine levels.
    let warped = if settings.losses.warp > 0.0 { 4.0 * (config.downscale * config.levels) as f64 } else { 0.0 };
    encoder + volume + volumes + full + warped
}

/// Bytes that a step takes at most, about.
pub fn step_bytes(settings: &TrainSettings, crop_px: usize) -> f64 {
    let pixels = (crop_px * crop_px * settings.data.batch) as f64;
    let floats = match settings.task {
        Task::Detector => detector_floats(settings),
        // A detector that is not trained keeps nothing.
        Task::Matcher => matcher_floats(settings) + 0.2 * detector_floats(settings),
        Task::Joint => matcher_floats(settings) + 2.0 * detector_floats(settings),
    };
    BASE_BYTES + 4.0 * COPIES * floats * pixels
}

/// Memory that is free for programs, where the system says it.
fn available_bytes() -> Option<f64> {
    let text = std::fs::read_to_string("/proc/meminfo").ok()?;
    let line = text.lines().find(|line| line.starts_with("MemAvailable:"))?;
    line.split_whitespace().nth(1)?.parse::<f64>().ok().map(|kib| kib * 1024.0)
}

/// The largest crop whose step fits.
fn fitting_crop(settings: &TrainSettings, bytes: f64) -> Option<usize> {
    (2..=128).rev().map(|sixteen| 16 * sixteen).find(|crop| step_bytes(settings, *crop) <= bytes)
}

/// A line for a reader.
pub fn described(settings: &TrainSettings) -> String {
    let crop = settings.data.crop_px;
    let needed = step_bytes(settings, crop);
    let gib = |bytes: f64| bytes / f64::from(1 << 30);
    let mut text =
        format!("a step of {} crops of {crop} px takes about {:.1} GiB of memory", settings.data.batch, gib(needed));
    if let Some(available) = available_bytes().filter(|available| needed > 0.9 * available) {
        text += &format!("; this machine has {:.1} GiB free", gib(available));
        text += &match fitting_crop(settings, 0.9 * available) {
            Some(fits) => format!(": set data.crop_px = {fits} in a settings file (--config)"),
            None => ": set a smaller data.batch in a settings file (--config)".to_owned(),
        };
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_offered_crop_fits_and_the_next_does_not() {
        for task in [Task::Detector, Task::Matcher, Task::Joint] {
            let settings = TrainSettings { task, ..TrainSettings::default() };
            let bytes = 2e9;
            let crop = fitting_crop(&settings, bytes).unwrap();
            assert!(step_bytes(&settings, crop) <= bytes && step_bytes(&settings, crop + 16) > bytes);
        }
    }
}
