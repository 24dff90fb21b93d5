//! Scale-space extrema: where SIFT features are (Lowe 2004, sections 3 to 5.1). Positions and scales in input px.

use rayon::prelude::*;

use super::scale_space::{BASE_SIGMA, INTERVALS, Octave, Plane};
use super::sift::SiftSettings;

/// Extrema closer than this to the border of an octave are not sought: differences reach one pixel further.
const BORDER: usize = 5;
/// Times a keypoint may move to a neighbouring sample while its position is interpolated.
const MOVES: usize = 5;

/// An extremum of the difference of Gaussians.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Keypoint {
    /// Column in octave px.
    pub column: f32,
    /// Row in octave px.
    pub row: f32,
    /// Octave, counted from the first.
    pub octave: usize,
    /// Gaussian level of the octave that is nearest in scale, `1..=INTERVALS`.
    pub level: usize,
    /// Blur in octave px.
    pub sigma: f32,
    /// Interpolated difference of Gaussians: positive for dark spots, negative for bright ones.
    pub contrast: f32,
}

/// The extrema of one octave, in order of level, row and column.
pub fn extrema(octave: &Octave, index: usize, settings: &SiftSettings) -> Vec<Keypoint> {
    let (width, height) = (octave.levels[0].width, octave.levels[0].height);
    if width <= 2 * BORDER || height <= 2 * BORDER {
        return Vec::new();
    }
    // A sample at the extremum is at most a little weaker than the interpolated value; half loses none.
    let gate = 0.5 * settings.contrast_threshold;
    let sought: Vec<(usize, usize)> =
        (1..=INTERVALS).flat_map(|level| (BORDER..height - BORDER).map(move |row| (level, row))).collect();
    sought
        .par_iter()
        .with_min_len(32)
        .flat_map_iter(|&(level, row)| {
            let centre = octave.differences[level].row(row);
            (BORDER..width - BORDER)
                .filter(move |&column| {
                    centre[column].abs() > gate && is_extremum(&octave.differences, level, row, column)
                })
                .filter_map(move |column| interpolate(octave, index, [level, row, column], settings))
        })
        .collect()
}

fn is_extremum(differences: &[Plane], level: usize, row: usize, column: usize) -> bool {
    let value = differences[level].at(row, column);
    // Minima are maxima of the negative.
    let sign = value.signum();
    let peak = sign * value;
    [level, level - 1, level + 1].into_iter().all(|level| {
        [row, row - 1, row + 1].into_iter().all(|row| {
            let line = &differences[level].row(row)[column - 1..column + 2];
            // Equal neighbours are let through, else a plateau of two would be lost; interpolation merges or drops them.
            peak >= sign * line[0] && peak >= sign * line[1] && peak >= sign * line[2]
        })
    })
}

/// Fits a parabola to the 3x3x3 neighbourhood (Lowe, section 4, after Brown and Lowe 2002).
fn interpolate(octave: &Octave, index: usize, start: [usize; 3], settings: &SiftSettings) -> Option<Keypoint> {
    let (width, height) = (octave.levels[0].width, octave.levels[0].height);
    let [mut level, mut row, mut column] = start;
    for _ in 0..MOVES {
        let cube = Neighbourhood::new(&octave.differences, level, row, column);
        let [x, y, s] = cube.peak()?;
        if x.abs() <= 0.5 && y.abs() <= 0.5 && s.abs() <= 0.5 {
            let contrast = cube.value + 0.5 * (cube.gradient[0] * x + cube.gradient[1] * y + cube.gradient[2] * s);
            if contrast.abs() < settings.contrast_threshold || cube.is_edge(settings.edge_ratio) {
                return None;
            }
            let sigma = BASE_SIGMA as f32 * ((level as f32 + s) / INTERVALS as f32).exp2();
            return Some(Keypoint {
                column: column as f32 + x,
                row: row as f32 + y,
                octave: index,
                level,
                sigma,
                contrast,
            });
        }
        let moved = |at: usize, by: f32| at.saturating_add_signed(by.round().clamp(-1.0, 1.0) as isize);
        (column, row, level) = (moved(column, x), moved(row, y), moved(level, s));
        let inside = (1..=INTERVALS).contains(&level)
            && (BORDER..height - BORDER).contains(&row)
            && (BORDER..width - BORDER).contains(&column);
        if !inside {
            return None;
        }
    }
    None
}

/// Value, gradient and second derivatives (x, y, scale) of the difference of Gaussians at a sample.
struct Neighbourhood {
    value: f32,
    gradient: [f32; 3],
    /// xx, yy, ss, xy, xs, ys.
    curvature: [f32; 6],
}

impl Neighbourhood {
    fn new(differences: &[Plane], level: usize, row: usize, column: usize) -> Self {
        let at = |s: isize, y: isize, x: isize| {
            let plane = &differences[level.wrapping_add_signed(s)];
            plane.at(row.wrapping_add_signed(y), column.wrapping_add_signed(x))
        };
        let value = at(0, 0, 0);
        let gradient = [
            0.5 * (at(0, 0, 1) - at(0, 0, -1)),
            0.5 * (at(0, 1, 0) - at(0, -1, 0)),
            0.5 * (at(1, 0, 0) - at(-1, 0, 0)),
        ];
        let curvature = [
            at(0, 0, 1) + at(0, 0, -1) - 2.0 * value,
            at(0, 1, 0) + at(0, -1, 0) - 2.0 * value,
            at(1, 0, 0) + at(-1, 0, 0) - 2.0 * value,
            0.25 * (at(0, 1, 1) - at(0, 1, -1) - at(0, -1, 1) + at(0, -1, -1)),
            0.25 * (at(1, 0, 1) - at(1, 0, -1) - at(-1, 0, 1) + at(-1, 0, -1)),
            0.25 * (at(1, 1, 0) - at(1, -1, 0) - at(-1, 1, 0) + at(-1, -1, 0)),
        ];
        Self { value, gradient, curvature }
    }

    /// Offset (x, y, scale) of the parabola's stationary point; `None` where it has none.
    fn peak(&self) -> Option<[f32; 3]> {
        let [xx, yy, ss, xy, xs, ys] = self.curvature.map(f64::from);
        let gradient = nalgebra::Vector3::from(self.gradient.map(f64::from));
        let offset = -(nalgebra::Matrix3::new(xx, xy, xs, xy, yy, ys, xs, ys, ss).try_inverse()? * gradient);
        offset.iter().all(|value| value.is_finite()).then(|| [offset.x as f32, offset.y as f32, offset.z as f32])
    }

    /// Whether the ratio of principal curvatures in the image exceeds `ratio` (Lowe, section 4.1).
    fn is_edge(&self, ratio: f32) -> bool {
        let [xx, yy, _, xy, ..] = self.curvature;
        let (trace, determinant) = (xx + yy, xx * yy - xy * xy);
        determinant <= 0.0 || trace * trace * ratio >= (ratio + 1.0) * (ratio + 1.0) * determinant
    }
}

/// At most `count` keypoints: the strongest of each cell of a grid over the image, then the strongest of the rest, so
/// that one busy corner cannot take all. In order of strength.
pub fn strongest_spread(
    mut keypoints: Vec<Keypoint>,
    steps_px: &[f64],
    count: usize,
    shape: [usize; 2],
) -> Vec<Keypoint> {
    keypoints.par_sort_by(|a, b| b.contrast.abs().total_cmp(&a.contrast.abs()));
    if keypoints.len() <= count {
        return keypoints;
    }
    /// Cells each way.
    const CELLS: usize = 8;
    let cell = |keypoint: &Keypoint| {
        let step = steps_px[keypoint.octave];
        let index =
            |at: f32, size: usize| ((f64::from(at) * step / size as f64 * CELLS as f64) as usize).min(CELLS - 1);
        index(keypoint.row, shape[0]) * CELLS + index(keypoint.column, shape[1])
    };
    let quota = count / (CELLS * CELLS);
    let mut taken = [0_usize; CELLS * CELLS];
    let (mut chosen, rest): (Vec<_>, Vec<_>) = keypoints.into_iter().partition(|keypoint| {
        let taken = &mut taken[cell(keypoint)];
        *taken += 1;
        *taken <= quota
    });
    let missing = count - chosen.len();
    chosen.extend(rest.into_iter().take(missing));
    chosen
}

#[cfg(test)]
mod tests {
    use super::*;

    fn spot_image(x: f32, y: f32, sigma: f32, amplitude: f32) -> Plane {
        let value = |i: usize| {
            let (dx, dy) = ((i % 96) as f32 - x, (i / 96) as f32 - y);
            amplitude * (-(dx * dx + dy * dy) / (2.0 * sigma * sigma)).exp()
        };
        Plane { values: (0..96 * 96).map(value).collect(), width: 96, height: 96 }
    }

    #[test]
    fn a_gaussian_spot_is_found_at_its_place_with_its_size() {
        // The difference of Gaussians of blurs t and k t of a spot of blur s has its extremum at s^2 = k t^2 (the two
        // blurs that straddle s): t = s / sqrt(k), with the input's assumed blur of 0.5 px counted in t.
        let (x, y, sigma) = (40.3, 51.7, 3.0_f32);
        let octave = Octave::first(&spot_image(x, y, sigma, 0.5), false);
        let found = extrema(&octave, 0, &SiftSettings::default());
        let best = found.iter().max_by(|a, b| a.contrast.abs().total_cmp(&b.contrast.abs())).unwrap();
        // Interpolation by a parabola is good to a few hundredths of a px.
        assert!((best.column - x).abs() < 0.05 && (best.row - y).abs() < 0.05, "{best:?}");
        let expected = (sigma * sigma / 2.0_f32.powf(1.0 / 3.0) + 0.25).sqrt();
        assert!((best.sigma / expected - 1.0).abs() < 0.05, "{} {expected}", best.sigma);
        assert!(best.contrast < 0.0, "bright on dark: {}", best.contrast);
    }

    #[test]
    fn a_straight_line_has_no_keypoints_because_its_place_along_the_line_is_unknown() {
        let value = |i: usize| {
            let across = ((i % 96) as f32 - 47.5) * 0.8 + ((i / 96) as f32 - 47.5) * 0.6;
            -0.5 * (-across * across / 8.0).exp()
        };
        let line = Plane { values: (0..96 * 96).map(value).collect(), width: 96, height: 96 };
        assert_eq!(extrema(&Octave::first(&line, false), 0, &SiftSettings::default()), []);
    }

    #[test]
    fn the_cap_keeps_weak_keypoints_of_quiet_regions() {
        let keypoint = |i: usize| {
            let busy = i < 1000;
            let (column, row) =
                if busy { ((i % 40) as f32, (i / 40) as f32) } else { (400.0, (i - 1000) as f32 * 40.0) };
            Keypoint { column, row, octave: 0, level: 1, sigma: 2.0, contrast: if busy { 0.2 } else { -0.05 } }
        };
        let kept = strongest_spread((0..1010).map(keypoint).collect(), &[1.0], 200, [512, 512]);
        assert_eq!(kept.len(), 200);
        assert_eq!(kept.iter().filter(|keypoint| keypoint.column == 400.0).count(), 10);
    }
}
