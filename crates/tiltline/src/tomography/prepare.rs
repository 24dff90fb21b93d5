//! Views as a tomogram wants them: tilt axis upright, lines bright on a background of zero.
//!
//! A tomogram takes the views for projections of one density. Diffraction contrast is none: a line's contrast changes with the
//! tilt, thickness fringes and bend contours wander, and lines are dark. Dividing out the background and turning the contrast
//! over leaves views whose lines are bright wherever they are seen, which is the best that can be done without a model of the
//! contrast, and is done alike for every method that is compared.

use nalgebra::{Rotation2, Translation2};
use ndarray::{Array2, Zip};
use serde::{Deserialize, Serialize};

use crate::filter::{gaussian_blur, percentiles};
use crate::geometry::{Similarity2, Vector2};
use crate::rectify::resample::resample;
use crate::ridge::prepare::data_mask;

/// What is done to the views.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct PrepareSettings {
    /// Standard deviation, px, of the Gaussian whose mean is the background; the view becomes its relative difference from that.
    /// With `None` the view less the level of its emptiest places is taken: a detector's offset is no matter.
    pub flatten_px: Option<f64>,
    /// Turns the contrast over: for dark lines.
    pub invert: bool,
}

impl PrepareSettings {
    /// For dark lines on a bright foil: flattened over several times the width of a line, and inverted.
    pub fn dark_lines() -> Self {
        Self { flatten_px: Some(12.0), invert: true }
    }
}

/// Least background that is divided by, as a share of the view's mean.
const LEAST_BACKGROUND: f32 = 0.05;
/// Share of a view's pixels that are darker than what counts as empty (brighter, where the contrast is turned over).
const EMPTY_SHARE: f64 = 0.02;
/// Pixels this near to a border without data, px, are not trusted.
const MARGIN_PX: f64 = 2.0;

/// The map that turns an image about its middle so that an axis at `axis_rad` (clockwise on the screen from image y) is upright,
/// and the shape of the turned image: rows and columns change places where the axis is nearer to the horizontal.
pub fn upright(shape: [usize; 2], axis_rad: f64) -> (Similarity2, [usize; 2]) {
    let turned = if axis_rad.sin().abs() > axis_rad.cos().abs() { [shape[1], shape[0]] } else { shape };
    (upright_from_projection(turned) * image_from_projection(shape, axis_rad).inverse(), turned)
}

/// Projected plane (origin in the middle, axis along y) to the upright image of a shape.
pub fn upright_from_projection(shape: [usize; 2]) -> Similarity2 {
    image_from_projection(shape, 0.0)
}

fn image_from_projection(shape: [usize; 2], axis_rad: f64) -> Similarity2 {
    let middle = Vector2::new(0.5 * (shape[1] as f64 - 1.0), 0.5 * (shape[0] as f64 - 1.0));
    Similarity2::from_parts(Translation2::from(middle), Rotation2::new(axis_rad).into(), 1.0)
}

/// A view `[row, column]` prepared and moved by `upright_from_image` on to a grid of `shape`. Finite everywhere: 0 where it has no
/// data.
pub fn prepare(
    image: &Array2<f32>,
    upright_from_image: &Similarity2,
    shape: [usize; 2],
    settings: &PrepareSettings,
) -> Array2<f32> {
    let sign = if settings.invert { -1.0 } else { 1.0 };
    let values = match settings.flatten_px {
        Some(sigma) => flattened(image, sigma).mapv(|value| sign * value),
        None => {
            let [least, largest] = percentiles(image, [EMPTY_SHARE, 1.0 - EMPTY_SHARE]);
            let empty = if settings.invert { largest } else { least };
            image.mapv(|value| sign * (value - empty))
        }
    };
    let moved = resample(&values.view(), upright_from_image, shape);
    moved.mapv_into(|value| if value.is_finite() { value } else { 0.0 })
}

/// Relative difference from the background, 0 where there is no data.
pub(crate) fn flattened(image: &Array2<f32>, sigma: f64) -> Array2<f32> {
    // A black border's edge is no line; a blurred mask says how near it is.
    let known = gaussian_blur(&data_mask(image).mapv(|data| if data { 1.0 } else { 0.0 }), MARGIN_PX)
        .mapv_into(|share: f32| if share > 0.99 { 1.0 } else { 0.0 });
    let mut values = image.clone();
    Zip::from(&mut values).and(&known).for_each(|value, known| *value = if *known > 0.0 { *value } else { 0.0 });
    let count: f32 = known.sum();
    let least = LEAST_BACKGROUND * (values.sum() / count.max(1.0)).abs();
    let share = gaussian_blur(&known, sigma);
    let mut background = gaussian_blur(&values, sigma);
    background.zip_mut_with(&share, |mean, share| *mean /= share.max(1e-6));
    Zip::from(&mut values).and(&background).and(&known).for_each(|value, background, known| {
        *value = known * (*value - background) / background.abs().max(least).max(f32::MIN_POSITIVE);
    });
    values
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Point2;

    /// An axis at 90 degrees points along -x: what lies below the middle of the image, at larger y, is at larger X.
    #[test]
    fn a_horizontal_axis_is_stood_up_without_loss() {
        let image = Array2::from_shape_fn((20, 31), |(row, column)| (100 * row + column) as f32);
        let (map, shape) = upright([20, 31], std::f64::consts::FRAC_PI_2);
        assert_eq!(shape, [31, 20]);
        let turned = prepare(&image, &map, shape, &PrepareSettings::default());
        let [empty] = percentiles(&image, [EMPTY_SHARE]);
        for ((row, column), value) in image.indexed_iter() {
            let place = map * Point2::new(column as f64, row as f64);
            let found = turned[[place.y.round() as usize, place.x.round() as usize]];
            assert!((found + empty - value).abs() < 0.01, "{row} {column} {found} {value}");
            assert_eq!(place.x.round() as usize, row);
        }
    }

    #[test]
    fn a_dark_line_becomes_bright_on_zero_whatever_the_brightness() {
        let dark_line = |brightness: f32| {
            Array2::from_shape_fn((80, 80), |(row, column)| {
                let slope = 1.0 + 0.004 * row as f32;
                brightness * slope * (1.0 - 0.3 * (-0.5 * (column as f32 - 40.0).powi(2) / 2.0).exp())
            })
        };
        let (map, shape) = upright([80, 80], 0.0);
        let [faint, strong] =
            [0.1, 40.0].map(|level| prepare(&dark_line(level), &map, shape, &PrepareSettings::dark_lines()));
        assert!((strong[[40, 40]] - faint[[40, 40]]).abs() < 1e-4);
        assert!(strong[[40, 40]] > 0.2 && strong[[40, 5]].abs() < 0.03);
    }
}
