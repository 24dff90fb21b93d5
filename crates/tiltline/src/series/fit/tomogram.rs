//! A tomogram of what all views show, one of what meets by chance, and the curves of the first.

use ndarray::{Array2, Array3};

use super::grid::Grid;
use super::{FitView, StartCurve};
use crate::tomography::curves::{CurveSettings, VolumeCurve, curves};
use crate::tomography::{Geometry, Method, WbpSettings, volume};

/// Voxels of the largest tomogram; views are shrunk until theirs is no larger.
pub(super) const MOST_VOXELS: f64 = 1.2e8;
/// Rows of the tomogram of chance.
const CHANCE_ROWS: usize = 128;
/// One sigma of a curve's depth in the tomogram, voxels.
const SIGMA_Z: f64 = 1.5;

/// No more than this share of what is taken for lines is there by chance.
const MOST_BY_CHANCE: f64 = 0.1;

/// A tomogram of views by weighted back projection, and one of chance.
pub(super) struct Tomogram {
    /// Its voxels in the frame of the poses.
    pub grid: Grid,
    geometry: Geometry,
    values: Array3<f32>,
    chance: Array3<f32>,
}

impl Tomogram {
    /// Of what `image` has of each view on a grid between two depths, px; `None` where there are not two different tilts.
    pub fn new(
        views: &[&FitView],
        depth: [f64; 2],
        most_voxels: f64,
        image: impl Fn(&Grid, &FitView) -> Array2<f32>,
    ) -> Option<Self> {
        let grid = Grid::new(views.first()?, depth, most_voxels);
        let images: Vec<Array2<f32>> = views.iter().map(|view| image(&grid, view)).collect();
        let geometry = grid.geometry(views.iter().map(|view| view.pose.tilt_rad).collect());
        let chance = tomogram_of_chance(&images, &geometry)?;
        let values = volume(&images, &geometry, &Method::Wbp(WbpSettings::default())).ok()?;
        Some(Self { grid, geometry, values, chance })
    }

    /// The root mean square of the tomogram of chance.
    pub fn rms_of_chance(&self) -> f64 {
        let squares: f64 = self.chance.iter().map(|value| f64::from(*value).powi(2)).sum();
        (squares / self.chance.len() as f64).sqrt()
    }

    /// The lowest value from `least` on beyond which no more than a tenth of the voxels are there by chance.
    pub fn beyond_chance(&self, least: f64) -> Option<f64> {
        beyond_chance(&self.values, &self.chance, least, MOST_BY_CHANCE)
    }

    /// The curves of its voxels from a value on, in the frame of the poses.
    pub fn curves(&self, threshold: f64) -> Vec<StartCurve> {
        let found = curves(&self.values, &self.geometry, threshold as f32, &CurveSettings::default());
        let start = |curve: VolumeCurve| StartCurve {
            sigma_z: vec![SIGMA_Z * self.grid.px; curve.points.len()],
            points: curve.points.into_iter().map(|point| self.grid.in_frame(point)).collect(),
            closed: curve.closed,
        };
        found.into_iter().map(start).collect()
    }
}

/// A tomogram in which lines meet by chance only: of each view rows from elsewhere, moved along them too.
fn tomogram_of_chance(images: &[Array2<f32>], geometry: &Geometry) -> Option<Array3<f32>> {
    // Multiples of these, without their whole part, are spread evenly and far from each other (a generalised golden ratio).
    const STEPS: [f64; 2] = [0.754_877_666_246_69, 0.569_840_290_998_05];
    let elsewhere = |(index, image): (usize, &Array2<f32>)| {
        let (height, width) = image.dim();
        let [down, right] = [(STEPS[0], height), (STEPS[1], width)]
            .map(|(step, length)| ((index as f64 * step).fract() * length as f64) as usize);
        let at = |(row, column): (usize, usize)| image[[(row + down) % height, (column + right) % width]];
        Array2::from_shape_fn([CHANCE_ROWS.min(height), width], at)
    };
    let images: Vec<Array2<f32>> = images.iter().enumerate().map(elsewhere).collect();
    volume(&images, geometry, &Method::Wbp(WbpSettings::default())).ok()
}

/// The lowest value from `least` on beyond which no more than the share `most` of the voxels are there by chance; `None` where
/// there is no such value.
fn beyond_chance(tomogram: &Array3<f32>, chance: &Array3<f32>, least: f64, most: f64) -> Option<f64> {
    // Values in steps of this, as far as the largest value of a tomogram can be of interest.
    const STEP: f64 = 1.1;
    const STEPS: usize = 60;
    if least <= 0.0 {
        return None;
    }
    let shares = |tomogram: &Array3<f32>| {
        let mut counts = [0_usize; STEPS];
        for value in tomogram.iter().filter(|value| f64::from(**value) >= least) {
            let step = (f64::from(*value) / least).ln() / STEP.ln();
            counts[(step as usize).min(STEPS - 1)] += 1;
        }
        for step in (1..STEPS).rev() {
            counts[step - 1] += counts[step];
        }
        counts.map(|count| count as f64 / tomogram.len() as f64)
    };
    let (real, by_chance) = (shares(tomogram), shares(chance));
    let step = (0..STEPS).find(|&step| real[step] > 0.0 && by_chance[step] <= most * real[step])?;
    Some(least * STEP.powi(step as i32))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The threshold is the least one where chance has next to nothing above it, and higher where it has; there is none where chance
    /// has as much everywhere.
    #[test]
    fn the_threshold_is_where_little_is_there_by_chance() {
        let of =
            |values: &[f32]| Array3::from_shape_fn([1, 1, 1000], |(_, _, at)| values.get(at).copied().unwrap_or(0.0));
        let real = of(&[[2.0; 20], [5.0; 20]].concat());
        assert_eq!(beyond_chance(&real, &of(&[]), 1.0, 0.1), Some(1.0));
        let higher = beyond_chance(&real, &of(&[2.0; 20]), 1.0, 0.1).unwrap();
        assert!((2.0..=5.0).contains(&higher), "{higher}");
        assert_eq!(beyond_chance(&real, &real, 1.0, 0.1), None);
        assert_eq!(beyond_chance(&real, &of(&[]), 0.0, 0.1), None);
        assert_eq!(beyond_chance(&of(&[]), &of(&[]), 1.0, 0.1), None);
    }
}
