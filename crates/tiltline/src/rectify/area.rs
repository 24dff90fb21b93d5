//! Point matches by area: whole images, then blocks of them, from where SIFT and whole images say they are.
//!
//! Blocks see what points do not: noisy images of few lines, where no single place can be told from others. First each
//! start is tried with a wide search, and the one whose blocks agree best with one geometry wins; then the blocks are
//! searched again, about that geometry's rows. Lines of different depth lie in one block, so the search stays wide along
//! the rows.

use std::cell::OnceCell;

use ndarray::Array2;

use super::align::align;
use super::blocks::{Search, match_blocks};
use super::epipolar::AxisPrior;
use super::point_matching::{PointMatch, PointMatches};
use super::ransac::{Consensus, common, consensus};
use super::texture::Texture;
use crate::geometry::{Point2, Similarity2};

/// Larger images are averaged down for the blocks: their peaks are found to a small fraction of a px.
const LARGEST_PX: usize = 1536;
/// Search across the rows, first and second, texture px.
const ACROSS_PX: [f64; 2] = [20.0, 4.0];
/// Search along the rows, texture px: the disparities of a foil.
const ALONG_PX: f64 = 30.0;
/// Sides of blocks, texture px. Small ones first, because lines of different depth in one block pull its peak off the row;
/// where noise leaves too few of them, larger ones.
const BLOCKS_PX: [usize; 2] = [48, 80];
/// Blocks at most, about, first and second: large images have enough.
const MOST_BLOCKS: [usize; 2] = [450, 800];
/// So many blocks, and such a share of all that were found, must agree in the wide search; one of the two is enough. Of the
/// images of different foils (each left image of `val-8deg` and `val-hard` with the right one three pairs on) up to 17 agree by
/// chance with a share above a half, and never more than 0.61 of them.
const LEAST_SUPPORT: [(usize, f64); 2] = [(20, 0.5), (10, 0.75)];
/// With so many behind it, the points' start needs no rival.
const AMPLE_SUPPORT: usize = 60;
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
    let whole = OnceCell::new();
    let whole = || *whole.get_or_init(|| align(images, from_points.as_slice()).map(|found| found.right_from_left));
    for block in BLOCKS_PX {
        let search = Search { block, axis_rad: prior.axis_rad, across_px: ACROSS_PX[0], along_px: ALONG_PX };
        let try_start = |start: &Similarity2| {
            let distinct = match_blocks(&textures, start, &search, MOST_BLOCKS[0]);
            consensus(&PointMatches { distinct, possible: Vec::new() }, diagonal_px, prior, seed).ok()
        };
        let mut best = from_points.as_ref().and_then(try_start);
        if support(&best) < AMPLE_SUPPORT {
            let near = SAME_START_PX * textures[0].step as f64;
            let new =
                |whole: &Similarity2| from_points.is_none_or(|start| far_apart(&start, whole, images[0].dim()) > near);
            let found = whole().filter(new).as_ref().and_then(try_start);
            if support(&found) > support(&best) {
                best = found;
            }
        }
        if let Some(best) = best.filter(supported) {
            let search = Search { axis_rad: best.posterior.geometry.axis_left_rad, across_px: ACROSS_PX[1], ..search };
            return match_blocks(&textures, &best.right_from_left, &search, MOST_BLOCKS[1]);
        }
    }
    Vec::new()
}

fn support(found: &Option<Consensus>) -> usize {
    found.as_ref().map_or(0, |found| found.inliers.len())
}

/// Whether more blocks agree than would by chance.
fn supported(found: &Consensus) -> bool {
    let (count, share) = (found.inliers.len(), found.inliers.len() as f64 / found.matches.max(1) as f64);
    LEAST_SUPPORT.iter().any(|(least, least_share)| count >= *least && share >= *least_share)
}

/// Largest distance at the corners of an image of `(rows, columns)` between where two maps take them.
fn far_apart(a: &Similarity2, b: &Similarity2, (height, width): (usize, usize)) -> f64 {
    let (x, y) = (width as f64 - 1.0, height as f64 - 1.0);
    let corners = [(0.0, 0.0), (x, 0.0), (0.0, y), (x, y)].map(|(x, y)| Point2::new(x, y));
    corners.iter().map(|corner| (a * corner - b * corner).norm()).fold(0.0, f64::max)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Vector2;
    use crate::simulate::{Scene, SceneSettings, ViewSettings, render};

    fn prior() -> AxisPrior {
        AxisPrior { axis_rad: 0.0, sigma_rad: 1.0_f64.to_radians() }
    }

    fn scene(seed: u64) -> Scene {
        Scene::random(&SceneSettings { seed, ..SceneSettings::default() })
    }

    fn image(scene: &Scene, view: &ViewSettings) -> Array2<f32> {
        render(scene, view).normalised()
    }

    /// Two tilts of one foil, the second turned by 4 degrees, 3 percent larger and shifted by a tenth of the image. No point
    /// matches are given.
    fn views() -> [ViewSettings; 2] {
        let left = ViewSettings { tilt_rad: (-2.0_f64).to_radians(), ..ViewSettings::default() };
        let right = ViewSettings {
            tilt_rad: 2.0_f64.to_radians(),
            axis_rad: 4.0_f64.to_radians(),
            scale: 1.03,
            shift_px: [40.0, -30.0],
            seed: 2,
            ..left.clone()
        };
        [left, right]
    }

    #[test]
    fn whole_images_find_each_other_and_their_blocks_lie_on_rows() {
        let (scene, views) = (scene(1), views());
        let images = views.each_ref().map(|view| image(&scene, view));
        let matches = match_areas(&images, &[], &prior(), 0);
        assert!(matches.len() > 100, "{}", matches.len());
        // Rows of both images at the left one's scale: along the axis, which is seen turned by 4 degrees in the right.
        let row = |point: Point2, view: &ViewSettings| {
            let centre = Vector2::new(0.5 * (view.shape[1] - 1) as f64, 0.5 * (view.shape[0] - 1) as f64);
            let off = point.coords - centre - Vector2::from(view.shift_px);
            (off.y * view.axis_rad.cos() - off.x * view.axis_rad.sin()) / view.scale
        };
        let mut off: Vec<f64> =
            matches.iter().map(|pair| (row(pair.right, &views[1]) - row(pair.left, &views[0])).abs()).collect();
        off.sort_by(f64::total_cmp);
        // Half a px: a block holds lines of several depths, which pull its peak off the row.
        assert!(off[off.len() / 2] < 0.5, "{}", off[off.len() / 2]);
    }

    /// Grey gradients, another gain and a black border are no part of the foil.
    #[test]
    fn gradients_gain_and_borders_move_no_block() {
        let (scene, views) = (scene(2), views());
        let [left, right] = views.each_ref().map(|view| image(&scene, view));
        let plain = match_areas(&[left.clone(), right.clone()], &[], &prior(), 0);
        let mut changed = right;
        for ((row, column), value) in changed.indexed_iter_mut() {
            *value = if row < 30 { 0.0 } else { 0.7 * *value + 0.002 * column as f32 };
        }
        let again = match_areas(&[left, changed], &[], &prior(), 0);
        let moved = again.iter().filter_map(|pair| {
            plain.iter().find(|other| other.left == pair.left).map(|other| (other.right - pair.right).norm())
        });
        let mut moved: Vec<f64> = moved.collect();
        moved.sort_by(f64::total_cmp);
        assert!(moved.len() * 10 > plain.len() * 8, "{} of {}", moved.len(), plain.len());
        // A tenth of a px: the gradient leaves a trace of itself in the band.
        assert!(moved[moved.len() * 9 / 10] < 0.1, "{}", moved[moved.len() * 9 / 10]);
    }

    #[test]
    fn images_of_different_foils_have_no_matches() {
        let views = views();
        for seed in 1..4 {
            let images = [image(&scene(seed), &views[0]), image(&scene(seed + 10), &views[1])];
            assert_eq!(match_areas(&images, &[], &prior(), 0), []);
        }
    }

    /// A straight line looks the same all along: where along it a block lies is not known, and nothing is said.
    #[test]
    fn a_straight_line_alone_gives_no_match() {
        let line = Array2::from_shape_fn((256, 256), |(row, column)| {
            let across = (row as f32 - 0.6 * column as f32 - 40.0) / 1.17;
            1.0 - 0.5 * (-across * across / 8.0).exp()
        });
        let textures = [Texture::of(&line, 1), Texture::of(&line, 1)];
        let search = Search { block: 48, axis_rad: 0.0, across_px: 20.0, along_px: 20.0 };
        assert_eq!(match_blocks(&textures, &Similarity2::identity(), &search, 1000), []);
    }
}
