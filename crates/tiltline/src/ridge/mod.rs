//! The classical line detector: a multi-scale oriented ridge filter whose crests are linked and judged as lines.
//!
//! prepare (gaps, borders, streaks) -> scale space -> oriented responses in units of noise -> crest points -> chains,
//! judged for length, two-sidedness, width -> a painted line map. One file a step. It needs no weights, and is the
//! baseline that a network must beat.

mod chains;
mod oriented;
mod padded;
mod paint;
mod points;
pub(crate) mod prepare;
mod scales;

use ndarray::Array2;
use serde::{Deserialize, Serialize};

use crate::curve::LineMap;
use crate::micrograph::View;
use crate::pipeline::Detect;
use crate::rectify::RectifiedPair;

/// Significance (standard deviations of the noise of the responses) at which the line probability is 1/2 at
/// sensitivity 1. The largest response to pure noise in a megapixel is about 6, but is short.
const HALF_SIGNIFICANCE: f64 = 6.0;
/// Polarity is decided on images halved until they have at most this many pixels, but not more than twice.
const POLARITY_PIXELS: usize = 80_000;
/// FWHM of a Gaussian in units of its standard deviation.
const FWHM: f64 = 2.354_820_045;

/// Whether lines are darker or brighter than what surrounds them.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum LinePolarity {
    /// Dark lines (bright field).
    Dark,
    /// Bright lines (dark field, weak beam).
    Bright,
    /// Whichever gives the stronger lines, the same in both images.
    Auto,
}

/// Settings of the ridge detector.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct RidgeSettings {
    /// Dark or bright lines.
    pub lines: LinePolarity,
    /// Narrowest and widest line that is looked for, full width at half maximum in px of the rectified image.
    pub width_px: [f64; 2],
    /// More than 1 finds fainter lines and more that are none; less than 1 is stricter.
    pub sensitivity: f64,
}

impl Default for RidgeSettings {
    fn default() -> Self {
        Self { lines: LinePolarity::Auto, width_px: [2.0, 12.0], sensitivity: 1.0 }
    }
}

/// The ridge filter as a detector.
#[derive(Clone, Debug, Default)]
pub struct RidgeDetector {
    /// Its settings.
    pub settings: RidgeSettings,
}

impl Detect for RidgeDetector {
    fn detect(&self, pair: &RectifiedPair, view: View) -> LineMap {
        let polarity = self.polarity(pair);
        let found = find(pair.view(view), polarity, rows_rad(pair, view), &self.settings);
        LineMap { probability: found.probability, line_width_px: found.line_width_px }
    }
}

impl RidgeDetector {
    /// The polarity that is used for both views of a pair: `Dark` or `Bright`.
    ///
    /// `Auto` compares the summed significance of all lines of either polarity in both images, at reduced size.
    pub fn polarity(&self, pair: &RectifiedPair) -> LinePolarity {
        if self.settings.lines != LinePolarity::Auto {
            return self.settings.lines;
        }
        let mut settings = self.settings.clone();
        let reduced = View::BOTH.map(|view| {
            let mut image = pair.view(view).clone();
            for _ in 0..2 {
                if image.len() > POLARITY_PIXELS {
                    image = scales::halve(&image);
                }
            }
            image
        });
        let factor = reduced[0].ncols() as f64 / pair.left.ncols().max(1) as f64;
        settings.width_px = settings.width_px.map(|width| width * factor);
        let [dark, bright] = [LinePolarity::Dark, LinePolarity::Bright].map(|polarity| {
            View::BOTH
                .iter()
                .map(|view| find(&reduced[view.index()], polarity, rows_rad(pair, *view), &settings).evidence)
                .sum::<f64>()
        });
        if bright > dark { LinePolarity::Bright } else { LinePolarity::Dark }
    }
}

/// Direction of the input image's rows on the rectified grid, in which a scanning microscope leaves its streaks.
fn rows_rad(pair: &RectifiedPair, view: View) -> f64 {
    match view {
        View::Left => pair.rectification.rectified_from_left.isometry.rotation.angle(),
        View::Right => pair.rectification.rectified_from_right.isometry.rotation.angle(),
    }
}

/// What one image shows in one polarity.
struct Found {
    probability: Array2<f32>,
    line_width_px: f64,
    /// Summed strength of the lines, each point's capped so that no single line decides.
    evidence: f64,
}

fn find(image: &Array2<f32>, polarity: LinePolarity, rows_rad: f64, settings: &RidgeSettings) -> Found {
    let shape = image.dim();
    let [narrowest, widest] =
        [settings.width_px[0].min(settings.width_px[1]), settings.width_px[0].max(settings.width_px[1])];
    let (sigmas, detecting) = sigmas_px(narrowest, widest);
    let mut found =
        Found { probability: Array2::zeros(shape), line_width_px: narrowest.max(3.0).min(widest), evidence: 0.0 };
    if image.nrows() < 8 || image.ncols() < 8 {
        return found;
    }
    let half_significance = HALF_SIGNIFICANCE / settings.sensitivity.max(1e-3);
    let sign = if polarity == LinePolarity::Bright { -1.0 } else { 1.0 };
    let prepared = prepare::prepare(image, rows_rad);
    let scales = scales::scale_space(&prepared.image, &sigmas);
    let mut strongest = points::Strongest::new(shape);
    for (index, scale) in scales.iter().enumerate().take(detecting) {
        strongest.add(index, scale, &oriented::respond(scale, sign, &prepared.distance_to_gap));
    }
    let mut points = strongest.points(&scales, &prepared.distance_to_gap);
    let judge = chains::Judge {
        scales: &scales,
        sign,
        widest_px: widest,
        half_significance,
        streaks_rad: &prepared.streaks_rad,
    };
    let chains = chains::chains(&mut points, shape, &judge);
    if let Some(width) = chains::typical_width_px(&chains) {
        found.line_width_px = width;
    }
    found.evidence = chains
        .iter()
        .flat_map(chains::Chain::strengths)
        .filter(|strength| *strength > half_significance)
        .map(|strength| strength.min(5.0 * half_significance))
        .sum();
    found.probability = paint::paint(shape, &points, &chains, half_significance, found.line_width_px);
    found
}

/// Scales by steps of sqrt 2, ascending, and how many of them detect; the others only tell that something is wider
/// than a line.
fn sigmas_px(narrowest: f64, widest: f64) -> (Vec<f64>, usize) {
    // A kernel as wide as the line serves; below 1 px it cannot be sampled.
    let first = (narrowest / FWHM).clamp(1.0, 64.0);
    let last = (0.8 * widest / FWHM).clamp(first, 64.0);
    let detecting = 1 + ((last / first).log2() * 2.0 + 0.2).floor() as usize;
    let sigmas = (0..detecting + 3).map(|step| first * 2.0_f64.powf(0.5 * step as f64)).collect();
    (sigmas, detecting)
}

#[cfg(test)]
mod tests;
