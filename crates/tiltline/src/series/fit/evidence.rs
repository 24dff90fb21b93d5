//! What a view says for a line at each of its pixels: the detector's odds and, where the lines that it is sure of are dark, how dark the
//! pixel is.
//!
//! A detector looks at one view. Lines that are hardly there in any view have next to no probability in all of them, while noise, which
//! is another in every view, averages out in a tomogram of the views themselves. Log-likelihood ratios add up over views: that of the
//! detector is the logarithm of its odds; that of a line of contrast `w` in noise of unit variance is `w c - w^2 / 2` where the pixel
//! differs from its surroundings by `c` (`w^2 / 2` is left out: nothing is 0, beyond the borders of an image too). Both come from the same image, and the second is taken for less than it says.

use ndarray::{Array2, Zip};

use crate::series::ViewLines;

/// The detector's probabilities are taken to be between these: below the first it says nothing.
const PROBABILITY: [f32; 2] = [0.003, 0.98];
/// Share of the contrast that the detector does not know of.
const INDEPENDENT: f32 = 0.7;
/// Largest contrast of lines, in noise of unit variance, that is counted on.
const MOST_CONTRAST: f32 = 2.0;

/// Evidence for a line at each pixel of a view, 0 where nothing speaks for or against one; the probabilities must be known.
pub(super) fn evidence(lines: &ViewLines) -> Array2<f32> {
    let odds = |probability: f32| (probability / (1.0 - probability)).ln();
    let [least, most] = PROBABILITY;
    let mut evidence =
        lines.probability.mapv(|value| odds((f32::from(value) / 255.0).clamp(least, most)) - odds(least));
    if lines.contrast.dim() == lines.probability.dim() {
        let weight = INDEPENDENT * contrast_of_lines(lines);
        Zip::from(&mut evidence)
            .and(&*lines.contrast)
            .for_each(|value, contrast| *value += weight * ViewLines::CONTRAST_STEP * f32::from(*contrast));
    }
    evidence
}

/// The contrast of the lines that the detector is sure of, in standard deviations of the view's; 0 where they are as often dark as bright.
pub(super) fn contrast_of_lines(lines: &ViewLines) -> f32 {
    let (mut sum, mut weights) = (0.0_f64, 0.0_f64);
    Zip::from(&*lines.probability).and(&*lines.contrast).for_each(|probability, contrast| {
        let weight = (f64::from(*probability) / 255.0).powi(2);
        sum += weight * f64::from(*contrast);
        weights += weight;
    });
    let mean = ViewLines::CONTRAST_STEP * (sum / weights.max(1e-9)) as f32;
    mean.clamp(-MOST_CONTRAST, MOST_CONTRAST)
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;
    use crate::curve::TraceGraph;

    fn lines(probability: Array2<u8>, contrast: Array2<i8>) -> ViewLines {
        let shape = [probability.nrows(), probability.ncols()];
        ViewLines {
            probability: Arc::new(probability),
            contrast: Arc::new(contrast),
            ..ViewLines::new(TraceGraph::default(), shape)
        }
    }

    /// The detector is sure of a line in column 2; column 5 is as dark, or as bright, as it, and the detector knows nothing of that.
    #[test]
    fn what_looks_like_the_sure_lines_is_evidence_too() {
        let sure = Array2::from_shape_fn([8, 8], |(_, column)| if column == 2 { 250 } else { 0 });
        let at = |contrast: i8| {
            let contrast =
                Array2::from_shape_fn([8, 8], |(_, column)| if matches!(column, 2 | 5) { contrast } else { 0 });
            evidence(&lines(sure.clone(), contrast))[[4, 5]]
        };
        assert!(at(60) > 0.5 && (at(60) - at(-60)).abs() < 1e-6, "{} {}", at(60), at(-60));
        assert!(at(0).abs() < 1e-6);
        // Darker than its surroundings where the sure line is brighter speaks against a line.
        let mixed = Array2::from_shape_fn([8, 8], |(_, column)| match column {
            2 => 60,
            5 => -60,
            _ => 0,
        });
        assert!(evidence(&lines(sure.clone(), mixed))[[4, 5]] < -0.5);
        // Where the sure line is dark and bright in turn, contrast says nothing; nor does one that is not known.
        let dashed = Array2::from_shape_fn([8, 8], |(row, _)| if row % 2 == 0 { 60 } else { -60 });
        assert!(evidence(&lines(sure.clone(), dashed))[[4, 5]].abs() < 1e-6);
        let alone = evidence(&lines(sure, Array2::default([0, 0])));
        assert!(alone[[4, 2]] > 5.0 && alone[[4, 5]].abs() < 1e-6);
    }
}
