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
/// Pixels this near a line do not count as texture.
const LINE_PX: f64 = 6.0;
/// Deviations count as at most this many times the median deviation of the image: an edge is no texture.
const MOST: f32 = 4.0;
/// Prior weight of the texture of the whole image, as a share of the pixels about a place.
const PRIOR: f32 = 0.05;
/// Contrast is averaged along a line over this, px (standard deviation): an eye follows a dotted line through its gaps.
const ALONG_PX: f64 = 5.0;

/// Standard deviation of what is beside the lines of a noise-free image, at the width of a line and relative to the
/// background about each pixel.
pub(super) fn texture(image: &Array2<f32>, lines: &[&[Point2]]) -> Array2<f32> {
    let (fine, coarse) = (gaussian_blur(image, BAND_PX[0]), gaussian_blur(image, BAND_PX[1]));
    let mut away = Array2::from_elem(image.dim(), 1.0_f32);
    let shape = [image.nrows(), image.ncols()];
    for line in lines {
        stroke(shape, line, LINE_PX, |row, column, _| away[[row, column]] = 0.0);
    }
    let mut deviation = Array2::zeros(image.dim());
    Zip::from(&mut deviation).and(&fine).and(&coarse).for_each(|deviation: &mut f32, fine, coarse| {
        *deviation = ((fine - coarse) / coarse.max(0.05)).abs();
    });
    let mut known: Vec<f32> =
        deviation.iter().zip(&away).filter(|(_, away)| **away > 0.0).map(|(deviation, _)| *deviation).collect();
    if known.is_empty() {
        return Array2::zeros(image.dim());
    }
    let middle = known.len() / 2;
    let most = MOST * *known.select_nth_unstable_by(middle, f32::total_cmp).1;
    let square = |value: f32| value.min(most).powi(2);
    let whole = known.iter().map(|value| square(*value)).sum::<f32>() / known.len() as f32;
    let mut squares = deviation.mapv(square);
    squares *= &away;
    let (mut squares, weights) = (gaussian_blur(&squares, REACH_PX), gaussian_blur(&away, REACH_PX));
    squares.zip_mut_with(&weights, |sum, weight| *sum = ((*sum + PRIOR * whole) / (weight + PRIOR)).sqrt());
    squares
}

/// Contrast of a line as an eye follows it: averaged along it.
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
            let near = (first..points.len()).take_while(|&other| place[other] - place[index] <= 3.0 * ALONG_PX);
            let (mut sum, mut total) = (0.0, 0.0);
            for other in near {
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

    fn row(count: usize) -> Vec<Point2> {
        (0..count).map(|x| Point2::new(x as f64, 40.0)).collect()
    }

    #[test]
    fn a_flat_image_has_no_texture_and_lines_are_none() {
        let mut image = Array2::from_elem((80, 80), 1.0);
        let line = row(80);
        stroke([80, 80], &line, 2.0, |row, column, _| image[[row, column]] = 0.5);
        let about_line = texture(&image, &[&line]);
        assert!(about_line.iter().all(|value| *value < 0.01), "{:?}", about_line[[40, 40]]);
        assert!(texture(&image, &[])[[40, 40]] > 0.02);
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
        let (bright, dark) = (texture(&image(1.0), &[]), texture(&image(0.4), &[]));
        assert!(bright[[64, 200]] > 4.0 * bright[[64, 40]], "{} {}", bright[[64, 200]], bright[[64, 40]]);
        assert!((bright[[64, 200]] / dark[[64, 200]] - 1.0).abs() < 0.01);
    }

    #[test]
    fn a_dotted_line_is_followed_through_its_gaps_and_an_end_is_an_end() {
        let points = row(100);
        let dotted: Vec<f32> = (0..100).map(|x| if x < 60 && x % 6 < 3 { 1.0 } else { 0.0 }).collect();
        let followed = followed(&points, &dotted);
        assert!(followed[8..50].iter().all(|value| (value - 0.5).abs() < 0.05));
        assert!(followed[80..].iter().all(|value| *value < 0.01));
    }
}
