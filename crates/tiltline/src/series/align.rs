//! Alignment of a whole series without any line: shifts of neighbours by phase correlation.
//!
//! From the least tilted view outwards each view is stretched across the axis to the foreshortening of its neighbour and
//! correlated with it. The direction of the axis must be known (the rectification of a pair shows it). A common shift of the specimen cannot be seen: the axis goes through
//! what the views have in common, at the centre of the aligned images.

use nalgebra::{Matrix2, Rotation2};
use ndarray::Array2;
use rayon::prelude::*;

use super::phase::PhaseCorrelator;
use super::{Series, SeriesError, ViewPose};
use crate::filter::{block_sums, gaussian_blur, sample_linear};
use crate::geometry::{Point2, Vector2};
use crate::io::xf::SectionTransform;
use crate::progress::Stage;
use crate::warning::Warning;

/// Images are averaged down to at most so many px a side.
const LARGEST_PX: usize = 320;
/// A peak that stands out less is no match.
const LEAST_CONTRAST: f64 = 6.0;

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

/// Aligns a series whose tilt axis has the direction `axis_rad`, radians clockwise on the screen from image y. `progress` is told
/// how many views are read.
///
/// # Errors
/// Where a view cannot be read, or fewer than two show anything.
pub fn align(series: &Series, axis_rad: f64, progress: &dyn Fn(usize, usize)) -> Result<AlignedSeries, SeriesError> {
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
    let (origins, contrast) = chain(&small, &tilts, axis_rad);
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
    let cells = block_sums(image, step);
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
fn chain(small: &[Small], tilts: &[f64], axis_rad: f64) -> (Vec<Point2>, Vec<f64>) {
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
            let narrower = tilts[to].cos() / tilts[from].cos();
            let turn = Rotation2::new(axis_rad);
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
