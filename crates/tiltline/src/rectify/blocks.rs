//! Point matches by area: normalised cross-correlation of blocks.

use rayon::prelude::*;
use rustfft::num_complex::Complex32;

use super::correlation::{Correlator, Workspace};
use super::point_matching::PointMatch;
use super::texture::Texture;
use crate::geometry::{Point2, Similarity2, Vector2};

/// Room for shifts about a block on each side of its window, px.
const MARGIN: usize = 24;
/// Smallest distance of neighbouring blocks.
const SPACING: usize = 24;
/// Largest shift that can be seen.
const REACH: isize = MARGIN as isize - 1;
/// The peak must stand out by so much from the root mean square of the correlation elsewhere.
const LEAST_CONTRAST: f64 = 3.0;
/// A second place may correlate with the block by this share of the best one: a straight line looks the same all along.
const LARGEST_SECOND: f64 = 0.75;
/// Places nearer than this to the peak belong to it, px.
const PEAK_PX: isize = 6;
/// A block needs data in so much of it, in both images.
const LEAST_DATA: f32 = 0.6;

/// What is searched for each block.
#[derive(Clone, Copy, Debug)]
pub struct Search {
    /// Side of a block, texture px.
    pub block: usize,
    /// Direction of the tilt axis in the left image.
    pub axis_rad: f64,
    /// Largest shift across the rows, texture px.
    pub across_px: f64,
    /// Largest shift along the rows, texture px.
    pub along_px: f64,
}

/// The blocks of the left image that are found in the right one, by their centres; `right_from_left` maps left to right
/// input px to within what is searched. Images with
/// room for more than about `most` blocks have them further apart.
pub fn match_blocks(
    textures: &[Texture; 2],
    right_from_left: &Similarity2,
    search: &Search,
    most: usize,
) -> Vec<PointMatch> {
    let [left, right] = textures;
    let here_from_there = texture_map(textures, right_from_left);
    let shape = left.shape();
    let warped = right.warped(&here_from_there, shape);
    let block = search.block;
    let correlator = Correlator::new(block + 2 * MARGIN);
    let spacing = SPACING.max((((shape[0] * shape[1]) / most.max(1)) as f64).sqrt() as usize);
    let places = |side: usize| (0..).map(move |i| i * spacing).take_while(move |start| start + block <= side);
    let corners: Vec<[usize; 2]> = places(shape[0]).flat_map(|y| places(shape[1]).map(move |x| [y, x])).collect();
    let middle = Vector2::repeat(0.5 * (block.max(1) - 1) as f64);
    let find = |workspace: &mut Workspace, corner: &[usize; 2]| {
        let map = Map::of(left, &warped, *corner, block, &correlator, workspace)?;
        let centre = Point2::new(corner[1] as f64, corner[0] as f64) + middle;
        let found = here_from_there * (centre + map.peak(search)?);
        Some(PointMatch { left: left.to_input(&centre), right: right.to_input(&found) })
    };
    corners.par_iter().map_init(|| correlator.workspace(), find).flatten_iter().collect()
}

/// A map of input px as a map of texture px.
fn texture_map(textures: &[Texture; 2], right_from_left: &Similarity2) -> Similarity2 {
    let [left, right] = textures;
    let origin = right.from_input(&(right_from_left * left.to_input(&Point2::origin())));
    let scale = right_from_left.scaling() * left.step as f64 / right.step as f64;
    Similarity2::new(origin.coords, right_from_left.isometry.rotation.angle(), scale)
}

/// Normalised correlation of one block with every place of its window.
struct Map<'a> {
    /// Sums of products, as [`Correlator::correlate`] leaves them.
    products: &'a [Complex32],
    /// Sums of squares and of data of the window, over rectangles from its corner.
    sums: Vec<[f64; 2]>,
    /// Sum of squares of the block.
    energy: f64,
    block: usize,
    window: usize,
}

impl<'a> Map<'a> {
    /// Of the block whose first pixel is at `[row, column]`; `None` where it holds nothing.
    fn of(
        left: &Texture,
        right: &Texture,
        [top, start]: [usize; 2],
        block: usize,
        correlator: &Correlator,
        workspace: &'a mut Workspace,
    ) -> Option<Self> {
        let [height, width] = left.shape();
        let window = block + 2 * MARGIN;
        workspace.window.fill(Complex32::default());
        let (mut energy, mut data) = (0.0_f64, 0.0);
        for y in 0..block {
            for x in 0..block {
                let value = left.values[[top + y, start + x]];
                data += left.valid[[top + y, start + x]];
                energy += f64::from(value * value);
                workspace.window[(y + MARGIN) * window + x + MARGIN].re = value;
            }
        }
        if data < LEAST_DATA * (block * block) as f32 || energy <= 0.0 {
            return None;
        }
        let stride = window + 1;
        let mut sums = vec![[0.0_f64; 2]; stride * stride];
        for y in 0..window {
            let mut line = [0.0; 2];
            for x in 0..window {
                // Left of and above the image the difference wraps around and is beyond its other side.
                let (row, column) = ((top + y).wrapping_sub(MARGIN), (start + x).wrapping_sub(MARGIN));
                if row < height && column < width {
                    let value = right.values[[row, column]];
                    workspace.window[y * window + x].im = value;
                    line[0] += f64::from(value * value);
                    line[1] += f64::from(right.valid[[row, column]]);
                }
                for i in 0..2 {
                    sums[(y + 1) * stride + x + 1][i] = sums[y * stride + x + 1][i] + line[i];
                }
            }
        }
        correlator.correlate(workspace);
        Some(Self { products: &workspace.window, sums, energy, block, window })
    }

    /// Normalised correlation at a shift; 0 where the window has too little data.
    fn at(&self, dy: isize, dx: isize) -> f64 {
        let (margin, block, window) = (MARGIN as isize, self.block, self.window);
        let (y, x) = ((margin + dy) as usize, (margin + dx) as usize);
        let corner = |row: usize, column: usize| &self.sums[row * (window + 1) + column];
        let [a, b, c, d] = [corner(y, x), corner(y, x + block), corner(y + block, x), corner(y + block, x + block)];
        let sum = |i: usize| d[i] - b[i] - c[i] + a[i];
        if sum(1) < f64::from(LEAST_DATA) * (block * block) as f64 {
            return 0.0;
        }
        let index = dy.rem_euclid(window as isize) as usize * window + dx.rem_euclid(window as isize) as usize;
        // An empty place must not correlate by its noise alone.
        f64::from(self.products[index].re) / (self.energy * sum(0).max(0.1 * self.energy)).sqrt()
    }

    /// The shift of the highest peak, to a fraction of a px; `None` where it is not distinct.
    fn peak(&self, search: &Search) -> Option<Vector2> {
        let (sin, cos) = search.axis_rad.sin_cos();
        let inside = |dy: isize, dx: isize| {
            let (dy, dx) = (dy as f64, dx as f64);
            (cos * dy - sin * dx).abs() <= search.across_px && (cos * dx + sin * dy).abs() <= search.along_px
        };
        let mut places = Vec::new();
        for (dy, dx) in (1 - REACH..REACH).flat_map(|dy| (1 - REACH..REACH).map(move |dx| (dy, dx))) {
            if inside(dy, dx) {
                places.push((self.at(dy, dx), dy, dx));
            }
        }
        let &(highest, dy, dx) = places.iter().max_by(|a, b| a.0.total_cmp(&b.0))?;
        let square = [-1, 0, 1].map(|y| [-1, 0, 1].map(|x| self.at(dy + y, dx + x)));
        // At the rim of what is searched, the peak may lie beyond it.
        if highest <= 0.0 || square.iter().flatten().any(|value| *value > highest) {
            return None;
        }
        let off_peak = |y: isize, x: isize| (y - dy).pow(2) + (x - dx).pow(2) > PEAK_PX * PEAK_PX;
        let (mut squares, mut count, mut second) = (0.0, 0.0, 0.0_f64);
        for (value, ..) in places.iter().filter(|(_, y, x)| off_peak(*y, *x)) {
            (squares, count, second) = (squares + value * value, count + 1.0, second.max(*value));
        }
        let noise = (squares / f64::max(count, 1.0)).sqrt();
        let distinct = highest > LEAST_CONTRAST * noise && second < LARGEST_SECOND * highest;
        let shift = if distinct { top_of(&square)? } else { return None };
        Some(shift + Vector2::new(dx as f64, dy as f64))
    }
}

/// The top (x, y) of the least squares parabola through 3 x 3 values `[y][x]` about (0, 0); `None` where it has none nearby.
fn top_of([a, b, c]: &[[f64; 3]; 3]) -> Option<Vector2> {
    let row = |row: &[f64; 3]| row.iter().sum::<f64>();
    let column = |x: usize| a[x] + b[x] + c[x];
    let (slope_x, slope_y) = ((column(2) - column(0)) / 6.0, (row(c) - row(a)) / 6.0);
    let xx = (column(0) - 2.0 * column(1) + column(2)) / 3.0;
    let yy = (row(a) - 2.0 * row(b) + row(c)) / 3.0;
    let xy = (a[0] + c[2] - a[2] - c[0]) / 4.0;
    let determinant = xx * yy - xy * xy;
    if !(xx < 0.0 && yy < 0.0 && determinant > 0.0) {
        return None;
    }
    let top = Vector2::new(xy * slope_y - yy * slope_x, xy * slope_x - xx * slope_y) / determinant;
    // Along a line the parabola is flat and its top far away.
    (top.amax() < 1.5).then_some(top)
}
