//! Alignment of a whole series without any line: shifts of neighbours by phase correlation, and the direction of the tilt axis.
//!
//! From the least tilted view outwards each view is stretched across the axis to the foreshortening of its neighbour and
//! correlated with it. The axis is the direction along which every tilt shows the same profile: nothing moves along it, so
//! the image summed across it is the same in all views. A common shift of the specimen cannot be seen: the axis goes through
//! what the views have in common, at the centre of the aligned images.

use std::f64::consts::{FRAC_PI_2, PI};

use nalgebra::{Matrix2, Rotation2};
use ndarray::Array2;
use rayon::prelude::*;

use super::phase::PhaseCorrelator;
use super::{Series, SeriesError, ViewPose};
use crate::filter::{gaussian_blur, sample_linear};
use crate::geometry::{Point2, Vector2};
use crate::io::xf::SectionTransform;
use crate::progress::Stage;
use crate::warning::Warning;

/// Images are averaged down to at most so many px a side.
const LARGEST_PX: usize = 320;
/// A peak that stands out less is no match.
const LEAST_CONTRAST: f64 = 6.0;
/// Views compared for the axis, evenly over the tilts, and how far those of a pair are apart in that list.
const AXIS_VIEWS: usize = 16;
const AXIS_APART: [usize; 2] = [3, 6];
/// Steps of the search for the axis, degrees: all directions, then about the best.
const AXIS_STEPS_DEG: [f64; 2] = [2.0, 0.25];
/// Mean correlation of profiles below which the axis is not seen.
const LEAST_AXIS_CORRELATION: f64 = 0.3;
/// What profiles along the best direction differ by (1 - correlation) must be less than this share of what they differ by along any
/// direction that is not near it.
const AXIS_MARGIN: f64 = 0.85;
/// Directions this near are one, degrees.
const NEAR_AXIS_DEG: f64 = 12.0;
/// Furthest a profile is moved along the axis, as a share of its length.
const MOST_LAG: f64 = 0.05;

/// How a series is aligned.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct AlignSettings {
    /// Direction of the tilt axis, radians clockwise on the screen from image y, if it is known; else it is looked for.
    pub axis_rad: Option<f64>,
}

/// An aligned series.
#[derive(Clone, Debug, PartialEq)]
pub struct AlignedSeries {
    /// Pose of each view in the order of [`Series::views`], tilts from zero.
    pub poses: Vec<ViewPose>,
    /// How far the shift from its neighbour stands out, per view; 0 where it was not found.
    pub contrast: Vec<f64>,
    /// Direction of the tilt axis, radians clockwise on the screen from image y.
    pub axis_rad: f64,
    /// What could not be done.
    pub warnings: Vec<Warning>,
}

/// A view as it is compared: averaged down, its slow changes of grey and finest noise removed.
struct Small {
    image: Array2<f32>,
    usable: bool,
}

/// Aligns a series. `progress` is told how many views are read.
///
/// # Errors
/// Where a view cannot be read, or fewer than two show anything.
pub fn align(
    series: &Series,
    settings: &AlignSettings,
    progress: &dyn Fn(usize, usize),
) -> Result<AlignedSeries, SeriesError> {
    let count = series.views.len();
    let step = series.shape.iter().max().copied().unwrap_or(1).div_ceil(LARGEST_PX);
    let mut small = Vec::with_capacity(count);
    for index in 0..count {
        progress(index, count);
        small.push(reduced(&series.view(index)?.pixels, step));
    }
    let mut warnings = Vec::new();
    let blank: Vec<String> = series.views.iter().zip(&small).filter(|(_, small)| !small.usable).map(angle).collect();
    if count - blank.len() < 2 {
        let what = format!("views of constant grey: {} of {count}; a series needs two that show the foil", blank.len());
        return Err(SeriesError::Blank { path: series.path.clone(), what });
    }
    if !blank.is_empty() {
        let message = format!("views at {} degrees are constant grey: they are passed over", blank.join(", "));
        warnings.push(Warning::new(Stage::Read, message));
    }
    let tilts: Vec<f64> = series.views.iter().map(|view| view.tilt_deg.to_radians()).collect();
    // Neighbours are hardly stretched: a first alignment without the axis is good enough to see it.
    let (origins, _) = chain(&small, &tilts, None);
    let axis_rad = match settings.axis_rad {
        Some(axis) => axis,
        None => match find_axis(&small, &origins, &tilts) {
            Ok(axis) => axis,
            Err(message) => {
                warnings.push(Warning::new(Stage::Rectify, message));
                0.0
            }
        },
    };
    let (origins, contrast) = chain(&small, &tilts, Some(axis_rad));
    let lost: Vec<String> = (0..count)
        .filter(|&view| small[view].usable && contrast[view] < LEAST_CONTRAST)
        .map(|view| format!("{}", series.views[view].tilt_deg))
        .collect();
    if !lost.is_empty() {
        let message = format!(
            "the shifts of the views at {} degrees do not stand out (phase correlation below {LEAST_CONTRAST}): they are \
             guesses",
            lost.join(", ")
        );
        warnings.push(Warning::new(Stage::Rectify, message));
    }
    // Small px to input px: px of blocks have their centre in the middle of the block.
    let to_input = |point: &Point2| point.map(|value| value * step as f64 + 0.5 * (step as f64 - 1.0));
    let poses = tilts.iter().zip(&origins).map(|(&tilt, origin)| ViewPose::new(tilt, axis_rad, 1.0, to_input(origin)));
    Ok(AlignedSeries { poses: poses.collect(), contrast, axis_rad, warnings })
}

fn angle((view, _): (&super::SeriesView, &Small)) -> String {
    format!("{}", view.tilt_deg)
}

impl AlignedSeries {
    /// Transforms that bring each stored section on to the aligned series, whose tilt axis is vertical and central, and their
    /// tilts in degrees: what `.xf` and `.tlt` hold.
    pub fn transforms(&self, series: &Series) -> (Vec<SectionTransform>, Vec<f64>) {
        let centre = centre(series.shape);
        let of_section = |(section, tilt_deg): (usize, &f64)| {
            let off = |view: &super::SeriesView| (view.tilt_deg - tilt_deg).abs();
            // A duplicate gets the transform of the view at its tilt that is used.
            let view = series.views.iter().position(|view| view.section == section).or_else(|| {
                (0..series.views.len()).min_by(|&a, &b| off(&series.views[a]).total_cmp(&off(&series.views[b])))
            });
            let pose = &self.poses[view.expect("a series has views")];
            let turn = Rotation2::new(-pose.axis_rad());
            let matrix: Matrix2<f64> = turn.matrix() / pose.scale();
            SectionTransform { matrix, shift: matrix * (centre - pose.origin()) }
        };
        (series.stored_tilts_deg.iter().enumerate().map(of_section).collect(), series.stored_tilts_deg.clone())
    }

    /// Tilt of each stored section in degrees, with what the alignment found.
    pub fn tilts_deg(&self, series: &Series) -> Vec<f64> {
        let tilt = |(section, nominal): (usize, &f64)| {
            let view = series.views.iter().position(|view| view.section == section);
            view.map_or(*nominal, |view| self.poses[view].tilt_rad.to_degrees())
        };
        series.stored_tilts_deg.iter().enumerate().map(tilt).collect()
    }

    /// The alignment that transforms (one a stored section) describe. Stretches, which no pose has, are left out.
    ///
    /// # Errors
    /// Where there is another number of transforms than of sections.
    pub fn from_transforms(series: &Series, transforms: &[SectionTransform], from: &str) -> Result<Self, SeriesError> {
        let sections = series.stored_tilts_deg.len();
        if transforms.len() != sections {
            let what = format!("{from} has {} transforms for {sections} sections", transforms.len());
            return Err(SeriesError::Align { path: series.path.clone(), what });
        }
        let centre = centre(series.shape);
        let pose = |view: &super::SeriesView| {
            let SectionTransform { matrix, shift } = transforms[view.section];
            let inverse = matrix.try_inverse().unwrap_or_else(Matrix2::identity);
            let turn = (inverse[(1, 0)] - inverse[(0, 1)]).atan2(inverse[(0, 0)] + inverse[(1, 1)]);
            let scale = inverse.determinant().abs().sqrt();
            ViewPose::new(view.tilt_deg.to_radians(), turn, scale, centre - inverse * shift)
        };
        let poses: Vec<ViewPose> = series.views.iter().map(pose).collect();
        let middle = poses.len() / 2;
        let axis_rad = poses[middle].axis_rad();
        Ok(Self { contrast: vec![f64::INFINITY; poses.len()], poses, axis_rad, warnings: Vec::new() })
    }
}

fn centre([height, width]: [usize; 2]) -> Point2 {
    Point2::new(0.5 * (width as f64 - 1.0), 0.5 * (height as f64 - 1.0))
}

fn reduced(image: &Array2<f32>, step: usize) -> Small {
    let (height, width) = (image.nrows() / step, image.ncols() / step);
    let cells = Array2::from_shape_fn((height.max(1), width.max(1)), |(row, column)| {
        let mut sum = 0.0;
        for y in row * step..((row + 1) * step).min(image.nrows()) {
            for x in column * step..((column + 1) * step).min(image.ncols()) {
                sum += image[[y, x]];
            }
        }
        sum
    });
    let first = image[[0, 0]];
    let usable = image.iter().any(|value| *value != first);
    let low = crate::filter::percentiles(&cells, [0.002, 0.998]);
    let cells = cells.mapv(|value| value.clamp(low[0], low[1]));
    let mut fine = gaussian_blur(&cells, 1.0) - gaussian_blur(&cells, 12.0);
    let rms = (fine.iter().map(|value| f64::from(value * value)).sum::<f64>() / fine.len() as f64).sqrt();
    let gain = if rms > 0.0 { 1.0 / rms as f32 } else { 0.0 };
    fine.mapv_inplace(|value| value * gain);
    Small { image: fine, usable }
}

/// Where what lies in the centre of the least tilted view lies in every view, and how far the shifts stand out.
fn chain(small: &[Small], tilts: &[f64], axis_rad: Option<f64>) -> (Vec<Point2>, Vec<f64>) {
    let shape = small[0].image.dim();
    let middle = centre([shape.0, shape.1]);
    let usable: Vec<usize> = (0..small.len()).filter(|&view| small[view].usable).collect();
    let least =
        (0..usable.len()).min_by(|&a, &b| tilts[usable[a]].abs().total_cmp(&tilts[usable[b]].abs())).unwrap_or(0);
    let correlator = PhaseCorrelator::new(shape.0.max(shape.1));
    let mut links: Vec<(usize, usize)> = Vec::new();
    links.extend((least + 1..usable.len()).map(|at| (usable[at - 1], usable[at])));
    links.extend((0..least).rev().map(|at| (usable[at + 1], usable[at])));
    let found: Vec<(Matrix2<f64>, super::phase::Shift)> = links
        .par_iter()
        .map(|&(from, to)| {
            // The further view is narrower across the axis: stretched to its neighbour.
            let narrower = axis_rad.map_or(1.0, |_| tilts[to].cos() / tilts[from].cos());
            let turn = Rotation2::new(axis_rad.unwrap_or(0.0));
            let matrix = turn.matrix() * Matrix2::new(narrower, 0.0, 0.0, 1.0) * turn.inverse().matrix();
            let stretched = warped(&small[to].image, &matrix, &middle);
            let spectra = [&small[from].image, &stretched].map(|image| correlator.spectrum(image));
            (matrix, correlator.shift(&spectra[0], &spectra[1]))
        })
        .collect();
    let (mut origins, mut contrast) = (vec![middle; small.len()], vec![0.0; small.len()]);
    contrast[usable[least]] = f64::INFINITY;
    for (&(from, to), (matrix, found)) in links.iter().zip(&found) {
        let shift = if found.contrast < LEAST_CONTRAST { Vector2::zeros() } else { found.shift };
        origins[to] = middle + matrix * (origins[from] - middle + shift);
        contrast[to] = found.contrast;
    }
    // A view that shows nothing lies where its neighbour does.
    for view in (0..small.len()).filter(|&view| !small[view].usable) {
        let nearest = usable.iter().min_by_key(|&&other| other.abs_diff(view));
        origins[view] = nearest.map_or(middle, |&other| origins[other]);
    }
    (origins, contrast)
}

/// The image seen through `matrix` about the centre: the value at p is that of the image at `middle + matrix (p - middle)`.
fn warped(image: &Array2<f32>, matrix: &Matrix2<f64>, middle: &Point2) -> Array2<f32> {
    Array2::from_shape_fn(image.dim(), |(row, column)| {
        let at = middle + matrix * (Point2::new(column as f64, row as f64) - middle);
        sample_linear(&image.view(), at.x, at.y).unwrap_or(0.0)
    })
}

/// The direction along which profiles agree best, or why it is not seen.
fn find_axis(small: &[Small], origins: &[Point2], tilts: &[f64]) -> Result<f64, String> {
    let usable: Vec<usize> = (0..small.len()).filter(|&view| small[view].usable).collect();
    let chosen: Vec<usize> = match usable.len() {
        few if few <= AXIS_VIEWS => usable,
        many => (0..AXIS_VIEWS).map(|at| usable[at * (many - 1) / (AXIS_VIEWS - 1)]).collect(),
    };
    let span_deg = (tilts[chosen[chosen.len() - 1]] - tilts[chosen[0]]).to_degrees();
    let agreement = |axis_rad: f64| {
        let profiles: Vec<Vec<f64>> =
            chosen.iter().map(|&view| profile(&small[view].image, &origins[view], axis_rad)).collect();
        let apart = AXIS_APART.map(|apart| apart.min(chosen.len() - 1));
        let pairs = apart.into_iter().flat_map(|apart| (apart..chosen.len()).map(move |at| (at - apart, at)));
        let pairs: Vec<f64> = pairs.map(|(a, b)| correlation(&profiles[a], &profiles[b])).collect();
        pairs.iter().sum::<f64>() / pairs.len().max(1) as f64
    };
    let steps = (PI / AXIS_STEPS_DEG[0].to_radians()).round() as i32;
    let coarse: Vec<(f64, f64)> = (0..steps)
        .into_par_iter()
        .map(|step| {
            let axis = -FRAC_PI_2 + f64::from(step + 1) * AXIS_STEPS_DEG[0].to_radians();
            (agreement(axis), axis)
        })
        .collect();
    let best = coarse.iter().copied().fold((f64::NEG_INFINITY, 0.0), |a, b| if b.0 > a.0 { b } else { a });
    let apart_deg = |axis: f64| {
        let off = (axis - best.1).to_degrees().rem_euclid(180.0);
        off.min(180.0 - off)
    };
    let rival = coarse.iter().filter(|(_, axis)| apart_deg(*axis) > NEAR_AXIS_DEG).map(|(score, _)| *score);
    let rival = rival.fold(f64::NEG_INFINITY, f64::max);
    if best.0 < LEAST_AXIS_CORRELATION || 1.0 - best.0 > AXIS_MARGIN * (1.0 - rival) {
        return Err(format!(
            "the direction of the tilt axis does not show in the {span_deg:.0} degrees of the series (profiles along {:.0} \
             degrees agree best, with correlation {:.2}, and others with {rival:.2}): it is taken as 0, vertical; give --tilt-axis",
            best.1.to_degrees(),
            best.0
        ));
    }
    let fine = (-12..=12).map(|step| {
        let axis = best.1 + f64::from(step) * AXIS_STEPS_DEG[1].to_radians();
        (agreement(axis), axis)
    });
    let axis = fine.fold(best, |a, b| if b.0 > a.0 { b } else { a }).1;
    // Directions 180 degrees apart are one axis; which of them is up only turns the sign of depth.
    Ok(if axis > FRAC_PI_2 + 1e-9 { axis - PI } else { axis })
}

/// The image summed across the axis, by place along it from the view's origin; weighted towards the middle.
fn profile(image: &Array2<f32>, origin: &Point2, axis_rad: f64) -> Vec<f64> {
    let (height, width) = image.dim();
    let reach = 0.5 * height.min(width) as f64;
    let length = 2 * reach as usize + 1;
    let (sin, cos) = axis_rad.sin_cos();
    let (mut sums, mut weights) = (vec![0.0; length + 1], vec![1e-9; length + 1]);
    for ((row, column), value) in image.indexed_iter() {
        let (x, y) = (column as f64 - origin.x, row as f64 - origin.y);
        let (along, across) = (y * cos - x * sin, x * cos + y * sin);
        let place = along + reach;
        if place < 0.0 || place >= length as f64 || across.abs() > reach {
            continue;
        }
        let weight = 0.5 + 0.5 * (PI * across / reach).cos();
        let (cell, part) = (place as usize, place.fract());
        for (cell, share) in [(cell, 1.0 - part), (cell + 1, part)] {
            sums[cell] += weight * share * f64::from(*value);
            weights[cell] += weight * share;
        }
    }
    sums.iter().zip(&weights).map(|(sum, weight)| if *weight > 1.0 { sum / weight } else { 0.0 }).collect()
}

/// Highest correlation coefficient of two profiles over small moves.
fn correlation(a: &[f64], b: &[f64]) -> f64 {
    let most = (MOST_LAG * a.len() as f64) as isize;
    let at = |lag: isize| {
        let overlap = (0..a.len() as isize).filter(|i| (0..b.len() as isize).contains(&(i + lag)));
        let pairs: Vec<(f64, f64)> = overlap.map(|i| (a[i as usize], b[(i + lag) as usize])).collect();
        let count = pairs.len().max(1) as f64;
        let (ma, mb) = pairs.iter().fold((0.0, 0.0), |(x, y), (u, v)| (x + u / count, y + v / count));
        let (mut ab, mut aa, mut bb) = (0.0, 0.0, 0.0);
        for (u, v) in pairs {
            (ab, aa, bb) = (ab + (u - ma) * (v - mb), aa + (u - ma).powi(2), bb + (v - mb).powi(2));
        }
        if aa * bb > 0.0 { ab / (aa * bb).sqrt() } else { 0.0 }
    };
    (-most..=most).map(at).fold(f64::NEG_INFINITY, f64::max)
}
