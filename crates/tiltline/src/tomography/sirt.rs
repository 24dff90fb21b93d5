//! SIRT: x <- x + r C A' R (b - A x), with C and R the inverse column and row sums of the projector A (Gilbert, J. Theor. Biol. 36,
//! 1972; in this form Gregor and Benson, IEEE Trans. Med. Imaging 27, 2008). It converges for a relaxation r below 2.

use serde::{Deserialize, Serialize};

use super::projector::{LANES, Lanes, Projector};
use super::{Geometry, TomographyError};

/// Rays that cross less of the volume than this, and voxels that meet less of the views, take no part.
const LEAST_SUM: f32 = 1e-4;

/// Settings of SIRT.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct SirtSettings {
    /// Number of iterations.
    pub iterations: usize,
    /// Relaxation, above 0 and below 2.
    pub relaxation: f32,
    /// Whether voxels are kept from being negative.
    pub non_negative: bool,
}

impl Default for SirtSettings {
    fn default() -> Self {
        Self { iterations: 30, relaxation: 1.0, non_negative: true }
    }
}

impl SirtSettings {
    /// Checks every number.
    ///
    /// # Errors
    /// [`TomographyError::Value`].
    pub fn validate(&self) -> Result<(), TomographyError> {
        if self.iterations == 0 {
            return Err(TomographyError::Value { name: "iterations", value: 0.0, expected: "use at least 1" });
        }
        if !(self.relaxation > 0.0 && self.relaxation < 2.0) {
            let value = f64::from(self.relaxation);
            return Err(TomographyError::Value {
                name: "relaxation",
                value,
                expected: "use more than 0 and less than 2",
            });
        }
        Ok(())
    }
}

/// SIRT for the slabs of one geometry: the sums are those of every row.
#[derive(Clone, Debug)]
pub struct Sirt {
    projector: Projector,
    settings: SirtSettings,
    /// Inverse row sums `[view][column]`.
    rows: Vec<f32>,
    /// Inverse column sums `[z][x]`.
    columns: Vec<f32>,
}

impl Sirt {
    /// Prepares the sums.
    ///
    /// # Errors
    /// Where a setting is not possible.
    pub fn new(geometry: &Geometry, settings: &SirtSettings) -> Result<Self, TomographyError> {
        settings.validate()?;
        let projector = Projector::new(geometry);
        let inverse = |sum: &f32| if *sum > LEAST_SUM { 1.0 / sum } else { 0.0 };
        let ones = [1.0; LANES];
        let mut views = vec![[0.0; LANES]; projector.views_len()];
        projector.project(&vec![ones; projector.volume_len()], &mut views);
        let rows: Vec<f32> = views.iter().map(|sums| inverse(&sums[0])).collect();
        let mut columns = vec![0.0; projector.volume_len()];
        projector.back_project(&vec![ones; projector.views_len()], |index, sum| columns[index] = inverse(&sum[0]));
        Ok(Self { projector, settings: settings.clone(), rows, columns })
    }

    /// The slab `[z][x]` of views `[view][column]`, starting from nothing; also the root mean square of the difference between the
    /// views and the projections of the volume before each iteration.
    pub fn reconstruct(&self, views: &[Lanes]) -> (Vec<Lanes>, Vec<f64>) {
        let mut volume = vec![[0.0; LANES]; self.projector.volume_len()];
        let mut projected = vec![[0.0; LANES]; self.projector.views_len()];
        let misfit = (0..self.settings.iterations).map(|_| self.iterate(views, &mut volume, &mut projected)).collect();
        (volume, misfit)
    }

    fn iterate(&self, views: &[Lanes], volume: &mut [Lanes], projected: &mut [Lanes]) -> f64 {
        self.projector.project(volume, projected);
        let mut squares = 0.0;
        for ((projected, measured), inverse) in projected.iter_mut().zip(views).zip(&self.rows) {
            let mut own = 0.0;
            for lane in 0..LANES {
                let difference = measured[lane] - projected[lane];
                own += difference * difference;
                projected[lane] = difference * inverse;
            }
            squares += f64::from(own);
        }
        let least = if self.settings.non_negative { 0.0 } else { f32::NEG_INFINITY };
        self.projector.back_project(projected, |index, sum| {
            let step = self.settings.relaxation * self.columns[index];
            let voxel = &mut volume[index];
            for lane in 0..LANES {
                voxel[lane] = (voxel[lane] + step * sum[lane]).max(least);
            }
        });
        (squares / (views.len() * LANES).max(1) as f64).sqrt()
    }
}
