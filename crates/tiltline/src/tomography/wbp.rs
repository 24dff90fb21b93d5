//! Weighted back projection: views filtered along x, each weighted by the angle it stands for, projected back (Radermacher, in
//! Electron Tomography, 1992; the filter's kernel after Kak and Slaney, Principles of Computerized Tomographic Imaging, 1988,
//! equation 61, whose sum is right, unlike that of a ramp cut off in frequency).

use std::f64::consts::PI;
use std::sync::Arc;

use rustfft::num_complex::Complex32;
use rustfft::{Fft, FftPlanner};
use serde::{Deserialize, Serialize};

use super::angles::coverage;
use super::projector::{LANES, Lanes, Projector};
use super::{Geometry, TomographyError};

/// The filter of weighted back projection.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Filter {
    /// The ramp |f| alone: sharpest, and it amplifies noise most.
    Ramp,
    /// The ramp times a Hamming window, `0.54 + 0.46 cos(2 pi f)`, f in 1/px.
    #[default]
    Hamming,
}

/// Settings of weighted back projection.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct WbpSettings {
    /// The filter.
    pub filter: Filter,
}

/// Weighted back projection for the slabs of one geometry.
pub struct Wbp {
    projector: Projector,
    width: usize,
    /// Angle of each view times the filter, `[view]`, and the filter's spectrum with the transform's norm.
    weights: Vec<f32>,
    spectrum: Vec<f32>,
    forward: Arc<dyn Fft<f32>>,
    inverse: Arc<dyn Fft<f32>>,
}

impl Wbp {
    /// Prepares filter and weights.
    ///
    /// # Errors
    /// [`TomographyError::TooFewViews`] where there are not two different tilts.
    pub fn new(geometry: &Geometry, settings: &WbpSettings) -> Result<Self, TomographyError> {
        let weights = coverage(&geometry.tilts_rad)?.weights_rad.into_iter().map(|weight| weight as f32).collect();
        // Twice the width, so that one end does not fold on to the other.
        let size = (2 * geometry.width).next_power_of_two().max(64);
        let mut planner = FftPlanner::new();
        let (forward, inverse) = (planner.plan_fft_forward(size), planner.plan_fft_inverse(size));
        let spectrum = spectrum(size, settings.filter, &*forward);
        let projector = Projector::new(geometry);
        Ok(Self { projector, width: geometry.width, weights, spectrum, forward, inverse })
    }

    /// The slab `[z][x]` of views `[view][column]`.
    pub fn reconstruct(&self, views: &[Lanes]) -> Vec<Lanes> {
        let filtered = self.filter(views);
        let mut volume = vec![[0.0; LANES]; self.projector.volume_len()];
        self.projector.back_project(&filtered, |index, sum| volume[index] = *sum);
        volume
    }

    fn filter(&self, views: &[Lanes]) -> Vec<Lanes> {
        let mut filtered = vec![[0.0; LANES]; views.len()];
        let mut line = vec![Complex32::ZERO; self.spectrum.len()];
        let mut scratch =
            vec![Complex32::ZERO; self.forward.get_inplace_scratch_len().max(self.inverse.get_inplace_scratch_len())];
        let each = views.chunks_exact(self.width).zip(filtered.chunks_exact_mut(self.width)).zip(&self.weights);
        for ((bins, out), weight) in each {
            // The filter is real and even: two rows go through it as one complex row.
            for lane in (0..LANES).step_by(2) {
                for (value, bin) in line.iter_mut().zip(bins) {
                    *value = Complex32::new(bin[lane], bin[lane + 1]);
                }
                line[self.width..].fill(Complex32::ZERO);
                self.forward.process_with_scratch(&mut line, &mut scratch);
                line.iter_mut().zip(&self.spectrum).for_each(|(value, factor)| *value *= factor * weight);
                self.inverse.process_with_scratch(&mut line, &mut scratch);
                for (bin, value) in out.iter_mut().zip(&line) {
                    (bin[lane], bin[lane + 1]) = (value.re, value.im);
                }
            }
        }
        filtered
    }
}

/// The filter's response at the frequencies of a transform, divided by its length.
fn spectrum(size: usize, filter: Filter, forward: &dyn Fft<f32>) -> Vec<f32> {
    let kernel = |offset: usize| match offset {
        0 => 0.25,
        odd if odd % 2 == 1 => -1.0 / (PI * odd as f64).powi(2),
        _ => 0.0,
    };
    let mut line: Vec<Complex32> =
        (0..size).map(|index| Complex32::new(kernel(index.min(size - index)) as f32, 0.0)).collect();
    forward.process(&mut line);
    let window = |index: usize| match filter {
        Filter::Ramp => 1.0,
        Filter::Hamming => 0.54 + 0.46 * (2.0 * PI * index as f64 / size as f64).cos(),
    };
    line.iter().enumerate().map(|(index, value)| value.re * window(index) as f32 / size as f32).collect()
}
