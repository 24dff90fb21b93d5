//! Point matches by area: whole images, then blocks of them, from where SIFT and whole images say they are.
//!
//! Blocks see what points do not: noisy images of few lines, where no single place can be told from others. First each
//! start is tried with a wide search, and the one whose blocks agree best with one geometry wins; then the blocks are
//! searched again, about that geometry's rows. Lines of different depth lie in one block, so the search stays wide along
//! the rows.

use ndarray::Array2;

use super::align::align;
use super::blocks::{Search, match_blocks};
use super::epipolar::AxisPrior;
use super::point_matching::{PointMatch, PointMatches};
use super::ransac::{common, consensus};
use super::texture::Texture;
use crate::geometry::{Point2, Similarity2};

/// Larger images are averaged down for the blocks: their peaks are found to a small fraction of a px.
const LARGEST_PX: usize = 1536;
/// Search across the rows, first and second, texture px.
const ACROSS_PX: [f64; 2] = [20.0, 4.0];
/// Search along the rows, texture px: the disparities of a foil.
const ALONG_PX: f64 = 30.0;
/// Starts closer than this at all corners are one, texture px.
const SAME_START_PX: f64 = 5.0;

/// Matches of blocks of two images; none where no start is supported. `by_points` are matches of points, if there are any.
pub fn match_areas(
    images: &[Array2<f32>; 2],
    by_points: &[PointMatch],
    prior: &AxisPrior,
    seed: u64,
) -> Vec<PointMatch> {
    let side = images.iter().flat_map(|image| [image.nrows(), image.ncols()]).max().unwrap_or(1);
    let diagonal = |image: &Array2<f32>| (image.nrows() as f64).hypot(image.ncols() as f64);
    let diagonal_px = images.iter().map(diagonal).fold(0.0, f64::max);
    let textures = images.each_ref().map(|image| Texture::of(image, side.div_ceil(LARGEST_PX)));
    let from_points = common(by_points, diagonal_px, seed);
    let mut starts: Vec<Similarity2> = from_points.into_iter().collect();
    let whole = align(images, &starts).map(|found| found.right_from_left);
    let near = SAME_START_PX * textures[0].step as f64;
    starts.extend(whole.filter(|whole| !starts.iter().any(|start| far_apart(start, whole, images[0].dim()) < near)));

    let search = Search { axis_rad: prior.axis_rad, across_px: ACROSS_PX[0], along_px: ALONG_PX };
    let try_start = |start: &Similarity2| {
        let distinct = match_blocks(&textures, start, &search);
        consensus(&PointMatches { distinct, possible: Vec::new() }, diagonal_px, prior, seed).ok()
    };
    let found = starts.iter().filter_map(try_start);
    let Some(best) = found.reduce(|best, next| if next.inliers.len() > best.inliers.len() { next } else { best })
    else {
        return Vec::new();
    };
    let axis_rad = best.posterior.geometry.axis_left_rad;
    match_blocks(&textures, &best.right_from_left, &Search { axis_rad, across_px: ACROSS_PX[1], ..search })
}

/// Largest distance at the corners of an image of `(rows, columns)` between where two maps take them.
fn far_apart(a: &Similarity2, b: &Similarity2, (height, width): (usize, usize)) -> f64 {
    let (x, y) = (width as f64 - 1.0, height as f64 - 1.0);
    let corners = [(0.0, 0.0), (x, 0.0), (0.0, y), (x, y)].map(|(x, y)| Point2::new(x, y));
    corners.iter().map(|corner| (a * corner - b * corner).norm()).fold(0.0, f64::max)
}
