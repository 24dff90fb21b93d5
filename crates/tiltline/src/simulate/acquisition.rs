//! From noise-free intensity to a recorded micrograph: blur, gain, vignetting, dose, read noise, scan-line streaks and
//! jitter, black borders, quantisation. Each view has its own.

use ndarray::Array2;
use rand::{RngExt, SeedableRng};
use rand_distr::{Distribution, StandardNormal};
use rand_pcg::Pcg64;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::settings::{SimulateError, check_range, check_value};
use crate::filter::{gaussian_blur, sample_linear};

/// Noise is judged after averaging with a Gaussian of this standard deviation, px: half the width of a usual line.
const LINE_SCALE_PX: f64 = 1.5;

/// What a recording may suffer; ranges are `[low, high]`, strengths relative to a background of 1.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct AcquisitionSettings {
    /// Standard deviation of the blur, px.
    pub blur_px: [f64; 2],
    /// Electrons per pixel at a background of 1 (log-uniform).
    pub dose: [f64; 2],
    /// Standard deviation of noise that does not depend on the signal.
    pub read_noise: [f64; 2],
    /// Chance that the noise is correlated, as in images that were resized or denoised.
    pub correlated: f64,
    /// Chance of scan-line streaks.
    pub streaks: f64,
    /// Chance of a black border.
    pub border: f64,
    /// Chance of scan jitter (rows shifted against each other).
    pub jitter: f64,
}

impl Default for AcquisitionSettings {
    fn default() -> Self {
        Self {
            blur_px: [0.3, 1.3],
            dose: [150.0, 10_000.0],
            read_noise: [0.003, 0.04],
            correlated: 0.5,
            streaks: 0.3,
            border: 0.12,
            jitter: 0.1,
        }
    }
}

/// How one image is recorded.
#[derive(Clone, Debug, PartialEq)]
pub struct Acquisition {
    blur_px: f64,
    dose: f64,
    read_noise: f64,
    /// Standard deviation in px of the filter on the noise, and of a second, coarser part with its share.
    grain_px: f64,
    coarse: Option<(f64, f64)>,
    streaks: Option<(f64, f64)>,
    border: Option<Border>,
    jitter_px: f64,
    gain: f64,
    gamma: f64,
    vignetting: f64,
    seed: u64,
}

#[derive(Clone, Copy, Debug, PartialEq)]
struct Border {
    side: usize,
    /// In the middle of the side.
    width_px: f64,
    /// Change of the width along the side, px per px: borders from alignment are wedges.
    slope: f64,
    level: f32,
}

/// A recorded image.
#[derive(Clone, Debug, PartialEq)]
pub struct Recording {
    /// Intensity `[row, column]`; the background is near the gain.
    pub image: Array2<f32>,
    /// What a line must stand out from.
    pub noise: LineNoise,
    /// Whether a pixel shows the foil (not a black border).
    pub valid: Array2<bool>,
}

/// Variances of the noise after averaging over the width of a line (a Gaussian of 1.5 px), in units of the noise-free image.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LineNoise {
    /// Of the electrons, on a background of 1; it is in proportion to the background.
    pub shot: f64,
    /// Of reading, everywhere.
    pub read: f64,
}

impl LineNoise {
    /// Variance relative to a background of this brightness.
    pub fn variance_at(self, background: f32) -> f32 {
        let background = f64::from(background).max(0.01);
        ((self.shot + self.read / background) / background) as f32
    }
}

impl AcquisitionSettings {
    /// Checks every number.
    ///
    /// # Errors
    /// [`SimulateError::Value`] with the name of the first that is not possible.
    pub fn validate(&self) -> Result<(), SimulateError> {
        check_range("acquisition.blur_px", self.blur_px, [0.0, 20.0])?;
        check_range("acquisition.dose", self.dose, [1.0, 1e9])?;
        check_range("acquisition.read_noise", self.read_noise, [0.0, 1.0])?;
        check_value("acquisition.correlated", self.correlated, [0.0, 1.0])?;
        check_value("acquisition.streaks", self.streaks, [0.0, 1.0])?;
        check_value("acquisition.border", self.border, [0.0, 1.0])?;
        check_value("acquisition.jitter", self.jitter, [0.0, 1.0])
    }
}

impl Acquisition {
    /// The recordings of all views of one foil: one microscope on one day, so the kind of noise, blur and streaks is the same,
    /// and dose and focus nearly so; gain, contrast curve, vignetting and borders are each view's own.
    pub fn of_views(rng: &mut Pcg64, settings: &AcquisitionSettings, count: usize) -> Vec<Self> {
        let first = Self::random(rng, settings);
        let mut views = vec![first.clone()];
        for _ in 1..count {
            let own = Self::random(rng, settings);
            let [dose, focus] = [0; 2].map(|_| rng.random_range(-1.0_f64..1.0));
            views.push(Self {
                dose: first.dose * (0.25 * dose).exp(),
                blur_px: first.blur_px * (0.2 * focus).exp(),
                gain: own.gain,
                gamma: first.gamma + 0.3 * (own.gamma - first.gamma),
                vignetting: own.vignetting,
                border: own.border,
                seed: own.seed,
                ..first.clone()
            });
        }
        views.truncate(count);
        views
    }

    /// A random recording.
    pub fn random(rng: &mut Pcg64, settings: &AcquisitionSettings) -> Self {
        let range = |rng: &mut Pcg64, [low, high]: [f64; 2]| if low < high { rng.random_range(low..high) } else { low };
        let chance = |rng: &mut Pcg64, probability: f64| rng.random_range(0.0..1.0) < probability;
        let log_dose = range(rng, settings.dose.map(f64::ln));
        Self {
            blur_px: range(rng, settings.blur_px),
            dose: log_dose.exp(),
            read_noise: range(rng, settings.read_noise),
            // Mostly as from resizing (half a pixel), now and then as from denoising.
            grain_px: if chance(rng, settings.correlated) {
                rng.random_range(0.35_f64.ln()..1.6_f64.ln()).exp()
            } else {
                0.0
            },
            coarse: chance(rng, 0.3 * settings.correlated)
                .then(|| (rng.random_range(2.0..7.0), rng.random_range(0.03..0.35))),
            streaks: chance(rng, settings.streaks).then(|| (rng.random_range(0.003..0.05), rng.random_range(0.0..1.5))),
            border: chance(rng, settings.border).then(|| Border {
                side: rng.random_range(0..4),
                width_px: rng.random_range(2.0..40.0),
                slope: if chance(rng, 0.5) { rng.random_range(-0.15..0.15) } else { 0.0 },
                level: if chance(rng, 0.75) { 0.0 } else { rng.random_range(0.0..1.0) },
            }),
            jitter_px: if chance(rng, settings.jitter) { rng.random_range(0.1..0.6) } else { 0.0 },
            gain: rng.random_range(0.7..1.4),
            gamma: rng.random_range(0.75..1.35),
            vignetting: rng.random_range(0.0..0.5) * rng.random_range(0.0..1.0),
            seed: rng.random_range(0..u64::MAX),
        }
    }

    /// Records a noise-free image.
    pub fn record(&self, image: &Array2<f32>) -> Recording {
        let (height, width) = image.dim();
        let mut rng = Pcg64::seed_from_u64(self.seed);
        let mut out = gaussian_blur(image, self.blur_px);
        if self.jitter_px > 0.0 {
            out = self.jittered(&out, &mut rng);
        }
        let noise = self.noise_field(height, width);
        let (dose, read2) = (self.dose as f32, (self.read_noise * self.read_noise) as f32);
        out.zip_mut_with(&noise, |value, noise| {
            // Poisson noise of many electrons is Gaussian with the signal's own variance.
            *value = (*value + noise * (value.max(0.0) / dose + read2).sqrt()).max(0.0);
        });
        if let Some((amplitude, correlation)) = self.streaks {
            let rows = smooth_rows(&mut rng, height, correlation);
            for (mut line, offset) in out.rows_mut().into_iter().zip(rows) {
                line.mapv_inplace(|value| value + (amplitude * offset) as f32);
            }
        }
        let radius2 = 0.25 * ((height * height + width * width) as f64);
        for ((row, column), value) in out.indexed_iter_mut() {
            let (dy, dx) = (row as f64 - 0.5 * height as f64, column as f64 - 0.5 * width as f64);
            let shade = 1.0 - self.vignetting * (dx * dx + dy * dy) / radius2;
            *value = ((self.gain * shade) as f32 * value.max(0.0)).powf(self.gamma as f32);
        }
        let mut valid = Array2::from_elem((height, width), true);
        if let Some(border) = self.border {
            for ((row, column), value) in out.indexed_iter_mut() {
                let distance = [row, column, height - 1 - row, width - 1 - column][border.side] as f64;
                let along = [column as f64 - 0.5 * width as f64, row as f64 - 0.5 * height as f64][border.side % 2];
                if distance < border.width_px + border.slope * along {
                    *value = border.level;
                    valid[[row, column]] = false;
                }
            }
        }
        Recording { image: out, noise: self.noise_at_line_scale(), valid }
    }

    /// White noise filtered with a Gaussian of s px has variance 1 / (4 pi s^2).
    fn noise_at_line_scale(&self) -> LineNoise {
        let kept = |grain_px: f64| {
            // A pixel's own noise has the extent of a Gaussian of 1 / sqrt(4 pi) px.
            let own = grain_px * grain_px + 0.25 / std::f64::consts::PI;
            own / (own + LINE_SCALE_PX * LINE_SCALE_PX)
        };
        let (coarse_px, share) = self.coarse.unwrap_or((0.0, 0.0));
        let kept = (1.0 - share) * kept(self.grain_px) + share * kept(coarse_px);
        LineNoise { shot: kept / self.dose, read: kept * self.read_noise * self.read_noise }
    }

    /// Noise of variance 1 with the recording's own correlation.
    fn noise_field(&self, height: usize, width: usize) -> Array2<f32> {
        let white = |salt: u64| {
            let mut pixels = vec![0.0_f32; height * width];
            // Each row has its own stream, so that the result does not depend on the number of threads.
            pixels.par_chunks_mut(width.max(1)).enumerate().for_each(|(row, line)| {
                let mut rng = Pcg64::seed_from_u64(self.seed ^ salt ^ (row as u64).wrapping_mul(0x9e37_79b9_7f4a_7c15));
                line.fill_with(|| StandardNormal.sample(&mut rng));
            });
            Array2::from_shape_vec((height, width), pixels).expect("the buffer has height * width values")
        };
        let grain = |salt: u64, sigma: f64| {
            let mut noise = gaussian_blur(&white(salt), sigma);
            let variance = noise.iter().map(|v| f64::from(v * v)).sum::<f64>() / noise.len().max(1) as f64;
            let gain = (1.0 / variance.max(1e-12).sqrt()) as f32;
            noise.mapv_inplace(|value| value * gain);
            noise
        };
        let mut noise = if self.grain_px > 0.3 { grain(1, self.grain_px) } else { white(1) };
        if let Some((sigma, share)) = self.coarse {
            let (fine, coarse) = ((1.0 - share).sqrt() as f32, share.sqrt() as f32);
            noise.zip_mut_with(&grain(2, sigma), |value, other| *value = fine * *value + coarse * other);
        }
        noise
    }

    fn jittered(&self, image: &Array2<f32>, rng: &mut Pcg64) -> Array2<f32> {
        let (height, width) = image.dim();
        let offsets = smooth_rows(rng, height, 0.7);
        Array2::from_shape_fn((height, width), |(row, column)| {
            let x = (column as f64 + self.jitter_px * offsets[row]).clamp(0.0, (width - 1) as f64);
            sample_linear(&image.view(), x, row as f64).unwrap_or(image[[row, column]])
        })
    }
}

/// One number a row of mean 0 and variance 1, correlated over `length` rows.
fn smooth_rows(rng: &mut Pcg64, rows: usize, length: f64) -> Vec<f64> {
    let keep = (-1.0 / length.max(0.05)).exp();
    let mut value: f64 = StandardNormal.sample(rng);
    (0..rows)
        .map(|_| {
            let fresh: f64 = StandardNormal.sample(rng);
            value = keep * value + (1.0 - keep * keep).sqrt() * fresh;
            value
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The formula against the recorded noise itself, averaged.
    #[test]
    fn noise_at_the_scale_of_a_line_is_what_averaging_leaves() {
        let flat = Array2::from_elem([256, 256], 1.0_f32);
        for (grain_px, coarse) in [(0.0, None), (1.2, None), (0.8, Some((5.0, 0.4)))] {
            let acquisition = Acquisition {
                blur_px: 0.0,
                dose: 400.0,
                read_noise: 0.02,
                grain_px,
                coarse,
                streaks: None,
                border: None,
                jitter_px: 0.0,
                gain: 1.0,
                gamma: 1.0,
                vignetting: 0.0,
                seed: 3,
            };
            let recording = acquisition.record(&flat);
            let averaged = gaussian_blur(&recording.image, LINE_SCALE_PX);
            let deviation = f64::from(averaged.std(0.0));
            // 256 x 256 px hold about 600 independent patches of the coarse grain: 3 percent; and the formula is for the continuum.
            let noise = f64::from(recording.noise.variance_at(1.0)).sqrt();
            assert!((deviation / noise - 1.0).abs() < 0.12, "{deviation} {noise}");
            // In a darker place: fewer electrons, whose share of noise is larger, and the same noise of reading.
            let dark = recording.noise.variance_at(0.25);
            let LineNoise { shot, read } = recording.noise;
            assert!((f64::from(dark) / (4.0 * shot + 16.0 * read) - 1.0).abs() < 1e-6);
        }
    }

    #[test]
    fn views_of_one_foil_share_the_kind_of_noise_and_differ_in_gain() {
        let mut rng = Pcg64::seed_from_u64(4);
        for _ in 0..20 {
            let views = Acquisition::of_views(&mut rng, &AcquisitionSettings::default(), 3);
            assert_eq!(views.len(), 3);
            for view in &views[1..] {
                let first = &views[0];
                assert_eq!((view.grain_px, view.coarse, view.streaks), (first.grain_px, first.coarse, first.streaks));
                assert!(
                    (view.dose / first.dose).ln().abs() <= 0.25 && view.gain != first.gain && view.seed != first.seed
                );
            }
        }
    }

    /// A border is where nothing is recorded, one level, and invalid; a wedge is wider at one end.
    #[test]
    fn a_slanted_border_is_wider_at_one_end_and_holds_nothing_of_the_foil() {
        let mut rng = Pcg64::seed_from_u64(1);
        let border = Border { side: 1, width_px: 20.0, slope: 0.1, level: 0.0 };
        let mut acquisition = Acquisition::random(&mut rng, &AcquisitionSettings::default());
        acquisition.border = Some(border);
        let recording = acquisition.record(&Array2::ones([100, 120]));
        let width = |row: usize| (0..120).filter(|column| !recording.valid[[row, *column]]).count();
        assert_eq!((width(0), width(50), width(99)), (15, 20, 25));
        for (value, valid) in recording.image.iter().zip(&recording.valid) {
            assert!(*valid || *value == 0.0);
        }
    }
}
