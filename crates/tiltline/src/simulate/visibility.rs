//! What an eye can see of a line: contrast against noise and against the texture about it.
//!
//! Grain that the exposure adds is known from its settings. What the foil itself shows beside its lines (mottling, coarse
//! dirt, fringes) is measured in the noise-free image, at the width of a line and away from all lines.

use ndarray::{Array2, Zip};

use crate::filter::gaussian_blur;
use crate::geometry::Point2;
use crate::simulate::draw::stroke;

/// Width of a line, and of the background it is compared with, px (Gaussians).
const BAND_PX: [f64; 2] = [1.5, 8.0];
/// Texture is averaged over this, px (Gaussian).
const REACH_PX: f64 = 20.0;
/// Pixels this near a line take no part: the tails of the widest lines end there.
const LINE_PX: f64 = 10.0;
/// Deviations count as at most this many times the median deviation of the image: an edge is no texture.
const MOST: f32 = 4.0;
/// Prior weight of the texture of the whole image, as a share of the pixels about a place.
const PRIOR: f32 = 0.05;
/// Contrast is averaged along a line over this, px (standard deviation): an eye follows a dotted line through its gaps.
const ALONG_PX: f64 = 5.0;
/// Share of pixels about a place that must be away from lines for its own background to be known.
const LEAST_KNOWN: f32 = 1e-4;

/// What is beside the lines of a noise-free image, at each pixel.
pub(super) struct Beside {
    /// Brightness, at the pixels' own scale of 8 px; that of the image itself where there are only lines.
    pub background: Array2<f32>,
    /// Root mean square deviation from it at the width of a line, relative to it; large deviations are cut.
    pub texture: Array2<f32>,
}

/// Measures what is beside the lines.
pub(super) fn beside(image: &Array2<f32>, lines: &[&[Point2]]) -> Beside {
    let mut away = Array2::from_elem(image.dim(), 1.0_f32);
    let shape = [image.nrows(), image.ncols()];
    for line in lines {
        stroke(shape, line, LINE_PX, |row, column, _| away[[row, column]] = 0.0);
    }
    let without_lines = image * &away;
    let [fine, background] = BAND_PX.map(|sigma| {
        let mut mean = gaussian_blur(&without_lines, sigma);
        let all = gaussian_blur(image, sigma);
        Zip::from(&mut mean).and(&gaussian_blur(&away, sigma)).and(&all).for_each(|mean, weight, all| {
            *mean = if *weight > LEAST_KNOWN { *mean / weight } else { *all };
        });
        mean
    });
    let mut deviation = fine;
    deviation.zip_mut_with(&background, |fine, coarse| *fine = ((*fine - coarse) / coarse.max(0.02)).abs());
    let mut known: Vec<f32> =
        deviation.iter().zip(&away).filter(|(_, away)| **away > 0.0).map(|(deviation, _)| *deviation).collect();
    if known.is_empty() {
        return Beside { background, texture: Array2::zeros(image.dim()) };
    }
    let middle = known.len() / 2;
    let most = MOST * *known.select_nth_unstable_by(middle, f32::total_cmp).1;
    let square = |value: f32| value.min(most).powi(2);
    let whole = known.iter().map(|value| square(*value)).sum::<f32>() / known.len() as f32;
    let mut squares = deviation.mapv(square);
    squares *= &away;
    let (mut texture, weights) = (gaussian_blur(&squares, REACH_PX), gaussian_blur(&away, REACH_PX));
    texture.zip_mut_with(&weights, |sum, weight| *sum = ((*sum + PRIOR * whole) / (weight + PRIOR)).sqrt());
    Beside { background, texture }
}

/// Contrast of a line as an eye follows it: averaged along it over the points that have any. Those that have none keep none.
pub(super) fn followed(points: &[Point2], contrast: &[f32]) -> Vec<f32> {
    let mut place = vec![0.0; points.len()];
    for index in 1..points.len() {
        place[index] = place[index - 1] + (points[index] - points[index - 1]).norm();
    }
    let mut first = 0;
    (0..points.len())
        .map(|index| {
            while place[index] - place[first] > 3.0 * ALONG_PX {
                first += 1;
            }
            if contrast[index] <= 0.0 {
                return 0.0;
            }
            let near = (first..points.len()).take_while(|&other| place[other] - place[index] <= 3.0 * ALONG_PX);
            let (mut sum, mut total) = (0.0, 0.0);
            for other in near.filter(|&other| contrast[other] > 0.0) {
                let distance = (place[other] - place[index]) / ALONG_PX;
                let weight = (-0.5 * distance * distance).exp();
                sum += weight * f64::from(contrast[other]);
                total += weight;
            }
            (sum / total) as f32
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_clean_image_has_no_texture_however_many_lines_it_has() {
        let mut image = Array2::from_elem((120, 120), 1.0);
        let lines: Vec<Vec<Point2>> = (0..5)
            .map(|line| (0..120).map(|x| Point2::new(f64::from(x), 12.0 + 25.0 * f64::from(line))).collect())
            .collect();
        for line in &lines {
            stroke([120, 120], line, 12.0, |row, column, near| {
                image[[row, column]] -= 0.6 * (-0.5 * (near.distance / 2.5).powi(2)).exp();
            });
        }
        let lines: Vec<&[Point2]> = lines.iter().map(Vec::as_slice).collect();
        let found = beside(&image, &lines);
        assert!(found.texture.iter().all(|value| *value < 0.003), "{}", found.texture[[25, 60]]);
        assert!(found.background.iter().all(|value| (value - 1.0).abs() < 0.01));
        // Not known to be lines, they are texture.
        assert!(beside(&image, &[]).texture[[25, 60]] > 0.05);
    }

    #[test]
    fn texture_is_local_and_relative_to_the_background() {
        // Mottling of 10 percent on the right half, at two brightnesses of the foil.
        let wave = |row: usize, column: usize| ((row as f32 * 0.6).sin() * (column as f32 * 0.6).sin()) * 0.1;
        let image = |gain: f32| {
            Array2::from_shape_fn((128, 256), |(row, column)| {
                gain * (1.0 + if column < 128 { 0.1 * wave(row, column) } else { wave(row, column) })
            })
        };
        let (bright, dark) = (beside(&image(1.0), &[]).texture, beside(&image(0.4), &[]).texture);
        // Ten times as strong, but cut at four times the median of the whole image, which lies between the halves.
        assert!(bright[[64, 200]] > 3.0 * bright[[64, 40]], "{} {}", bright[[64, 200]], bright[[64, 40]]);
        assert!((bright[[64, 200]] / dark[[64, 200]] - 1.0).abs() < 0.01);
    }

    #[test]
    fn a_dotted_line_is_followed_through_its_gaps_and_what_is_hidden_stays_so() {
        let points: Vec<Point2> = (0..100).map(|x| Point2::new(f64::from(x), 40.0)).collect();
        let dotted: Vec<f32> = (0..100)
            .map(|x| {
                if x >= 60 {
                    0.0
                } else if x % 6 < 3 {
                    1.0
                } else {
                    0.2
                }
            })
            .collect();
        let followed = followed(&points, &dotted);
        assert!(followed[..60].iter().all(|value| (value - 0.6).abs() < 0.15));
        assert!(followed[60..].iter().all(|value| *value == 0.0));
    }
}
