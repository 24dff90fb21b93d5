//! Whether two micrographs can be a stereo pair, before any work is done on them.

use crate::geometry::TiltPair;
use crate::measure::MeasureSettings;
use crate::micrograph::{Micrograph, StereoPair};
use crate::progress::Stage;
use crate::warning::Warning;

/// Least side of an image in px: below this there is no room for features to match.
pub const MIN_SIDE_PX: usize = 32;
/// Pixel sizes that differ by a larger share are those of two magnifications.
const MAX_PIXEL_SIZE_DIFFERENCE: f64 = 0.01;
/// Beyond this angle between the views lines change too much to be matched.
const MAX_PHI_DEG: f64 = 40.0;
/// Below this angle depth is mostly error.
const MIN_PHI_DEG: f64 = 0.5;

/// Why two micrographs are no stereo pair.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum PairError {
    /// The images differ in size.
    #[error("{left} is {left_size} and {right} is {right_size}; crop or pad one of them")]
    Size {
        /// The left image.
        left: String,
        /// Its columns and rows.
        left_size: String,
        /// The right image.
        right: String,
        /// Its columns and rows.
        right_size: String,
    },
    /// An image is too small.
    #[error("{image} is {size}; each side must be at least {MIN_SIDE_PX} px")]
    TooSmall {
        /// The image.
        image: String,
        /// Its columns and rows.
        size: String,
    },
    /// The images differ in pixel size.
    #[error(
        "{left} has {left_nm} nm/px and {right} has {right_nm} nm/px, {percent:.1} % apart; resample one of them, or \
         give --pixel-size if one is wrong"
    )]
    PixelSize {
        /// The left image.
        left: String,
        /// Its pixel size in nm.
        left_nm: f64,
        /// The right image.
        right: String,
        /// Its pixel size in nm.
        right_nm: f64,
        /// By how much they differ.
        percent: f64,
    },
    /// A pixel size that is no length.
    #[error("{image} has a pixel size of {pixel_size_nm} nm; it must be a positive number")]
    NoLength {
        /// The image.
        image: String,
        /// Its pixel size in nm.
        pixel_size_nm: f64,
    },
    /// An image without content.
    #[error("{image} is constant: every pixel is {value}; is it the right file or page?")]
    Constant {
        /// The image.
        image: String,
        /// The value.
        value: f32,
    },
    /// Pixels that are no numbers.
    #[error("{image} has {count} pixels that are NaN or infinite; replace them")]
    NotFinite {
        /// The image.
        image: String,
        /// How many.
        count: usize,
    },
    /// A tilt or the axis is no angle.
    #[error("the {what} is {value_deg} degrees; it must be a finite number")]
    NoAngle {
        /// "left tilt", "right tilt" or "tilt axis".
        what: &'static str,
        /// The value.
        value_deg: f64,
    },
    /// Both views were taken at one tilt.
    #[error("both tilts are {tilt_deg} degrees; depth needs two different tilts: check --tilts")]
    EqualTilts {
        /// The tilt.
        tilt_deg: f64,
    },
}

impl StereoPair {
    /// Checks two micrographs and makes a pair of them.
    ///
    /// `tilt_axis_rad` is measured clockwise on the screen from image y. Warnings are given where the tilts are so far
    /// apart (above 40 degrees) or so near (below 0.5 degree) that depth will be poor, and where only one image states
    /// a pixel size: both get it.
    pub fn new(
        mut left: Micrograph,
        mut right: Micrograph,
        tilts: TiltPair,
        tilt_axis_rad: f64,
    ) -> Result<(Self, Vec<Warning>), PairError> {
        let mut warnings = Vec::new();
        check_tilts(&tilts, tilt_axis_rad, &mut warnings)?;
        let names = [name(&left, "left"), name(&right, "right")];
        for (image, name) in [&left, &right].into_iter().zip(&names) {
            check_image(image, name)?;
        }
        let [left_name, right_name] = names;
        if left.pixels.dim() != right.pixels.dim() {
            let (left_size, right_size) = (size(&left), size(&right));
            return Err(PairError::Size { left: left_name, left_size, right: right_name, right_size });
        }
        match (left.pixel_size_nm, right.pixel_size_nm) {
            (Some(left_nm), Some(right_nm)) => {
                let difference = (right_nm / left_nm - 1.0).abs();
                if difference > MAX_PIXEL_SIZE_DIFFERENCE {
                    let percent = 100.0 * difference;
                    return Err(PairError::PixelSize {
                        left: left_name,
                        left_nm,
                        right: right_name,
                        right_nm,
                        percent,
                    });
                }
            }
            (None, None) => {}
            (known, other) => {
                let (with, without) = if known.is_some() { (left_name, right_name) } else { (right_name, left_name) };
                let pixel_size_nm = known.or(other);
                let value = pixel_size_nm.unwrap_or_default();
                let message = format!("only {with} states a pixel size ({value} nm): it is used for {without} too");
                warnings.push(Warning::new(Stage::Read, message));
                left.pixel_size_nm = pixel_size_nm;
                right.pixel_size_nm = pixel_size_nm;
            }
        }
        Ok((Self { left, right, tilts, tilt_axis_rad }, warnings))
    }
}

fn check_tilts(tilts: &TiltPair, tilt_axis_rad: f64, warnings: &mut Vec<Warning>) -> Result<(), PairError> {
    let angles = [("left tilt", tilts.left_rad), ("right tilt", tilts.right_rad), ("tilt axis", tilt_axis_rad)];
    if let Some((what, value)) = angles.into_iter().find(|(_, value)| !value.is_finite()) {
        return Err(PairError::NoAngle { what, value_deg: value.to_degrees() });
    }
    let phi_deg = tilts.phi().to_degrees().abs();
    if phi_deg == 0.0 {
        return Err(PairError::EqualTilts { tilt_deg: tilts.left_rad.to_degrees() });
    }
    if phi_deg > MAX_PHI_DEG {
        let message = format!(
            "the views are {phi_deg:.1} degrees apart; beyond {MAX_PHI_DEG} lines change too much to be matched well: \
             choose views nearer to each other"
        );
        warnings.push(Warning::new(Stage::Read, message));
    }
    if phi_deg < MIN_PHI_DEG {
        let sigma_deg = MeasureSettings::default().tilt_sigma_deg;
        let percent = 100.0 * sigma_deg / phi_deg;
        let gain = 1.0 / phi_deg.to_radians();
        let message = format!(
            "the views are only {phi_deg:.3} degrees apart: a tilt error of {sigma_deg} degree scales all depths by \
             {percent:.0} %, and 1 px of disparity is {gain:.0} px of depth; choose views further apart"
        );
        warnings.push(Warning::new(Stage::Read, message));
    }
    Ok(())
}

fn check_image(image: &Micrograph, name: &str) -> Result<(), PairError> {
    let image_name = || name.to_owned();
    if image.width() < MIN_SIDE_PX || image.height() < MIN_SIDE_PX {
        return Err(PairError::TooSmall { image: image_name(), size: size(image) });
    }
    let count = image.pixels.iter().filter(|value| !value.is_finite()).count();
    if count > 0 {
        return Err(PairError::NotFinite { image: image_name(), count });
    }
    let value = image.pixels[[0, 0]];
    if image.pixels.iter().all(|&other| other == value) {
        return Err(PairError::Constant { image: image_name(), value });
    }
    match image.pixel_size_nm {
        Some(pixel_size_nm) if !(pixel_size_nm.is_finite() && pixel_size_nm > 0.0) => {
            Err(PairError::NoLength { image: image_name(), pixel_size_nm })
        }
        _ => Ok(()),
    }
}

/// "left (a.png)", or "left" for an image made in memory.
fn name(image: &Micrograph, view: &str) -> String {
    if image.source.path.is_empty() { view.to_owned() } else { format!("{view} ({})", image.source.path) }
}

fn size(image: &Micrograph) -> String {
    format!("{}x{}", image.width(), image.height())
}

#[cfg(test)]
mod tests {
    use super::*;
    use ndarray::Array2;

    /// A slope of `width` columns and `height` rows: nothing in it but that it is not constant.
    fn image(width: usize, height: usize) -> Micrograph {
        Micrograph::new(Array2::from_shape_fn((height, width), |(_, column)| column as f32))
    }

    fn pair(left: Micrograph, right: Micrograph, tilts_deg: [f64; 2]) -> Result<Vec<Warning>, PairError> {
        let tilts = TiltPair::from_degrees(tilts_deg[0], tilts_deg[1]);
        StereoPair::new(left, right, tilts, 0.0).map(|(_, warnings)| warnings)
    }

    fn message(left: Micrograph, right: Micrograph, tilts_deg: [f64; 2]) -> String {
        pair(left, right, tilts_deg).unwrap_err().to_string()
    }

    #[test]
    fn a_good_pair_raises_no_doubt() {
        assert_eq!(pair(image(64, 48), image(64, 48), [-4.0, 4.0]), Ok(Vec::new()));
    }

    #[test]
    fn what_cannot_be_a_pair_is_refused_with_the_values() {
        let text = message(image(512, 512), image(512, 480), [-4.0, 4.0]);
        assert_eq!(text, "left is 512x512 and right is 512x480; crop or pad one of them");
        assert!(message(image(64, 31), image(64, 31), [-4.0, 4.0]).contains("left is 64x31"));
        assert!(message(image(64, 64), image(64, 64), [3.0, 3.0]).contains("both tilts are 3"));
        assert!(message(image(64, 64), image(64, 64), [f64::NAN, 3.0]).contains("left tilt is NaN"));
        let constant = Micrograph::new(Array2::from_elem((64, 64), 7.0));
        assert!(message(image(64, 64), constant, [-4.0, 4.0]).contains("right is constant: every pixel is 7"));
        let mut broken = image(64, 64);
        broken.pixels[[3, 5]] = f32::NAN;
        assert!(message(broken, image(64, 64), [-4.0, 4.0]).contains("left has 1 pixels"));
    }

    #[test]
    fn pixel_sizes_agree_within_a_percent() {
        let with = |size| Micrograph { pixel_size_nm: Some(size), ..image(64, 64) };
        assert_eq!(pair(with(1.0), with(1.009), [-4.0, 4.0]), Ok(Vec::new()));
        assert!(message(with(1.0), with(1.02), [-4.0, 4.0]).contains("2.0 % apart"));
        assert!(message(with(0.0), with(1.0), [-4.0, 4.0]).contains("positive"));
        let (pair, warnings) =
            StereoPair::new(image(64, 64), with(2.0), TiltPair::from_degrees(-4.0, 4.0), 0.0).unwrap();
        assert_eq!(pair.pixel_size_nm(), Some(2.0));
        assert!(warnings[0].message.contains("only right states a pixel size (2 nm)"));
    }

    #[test]
    fn angles_that_give_poor_depth_are_doubted_with_numbers() {
        let wide = pair(image(64, 64), image(64, 64), [-25.0, 25.0]).unwrap();
        assert!(wide[0].message.contains("50.0 degrees apart"));
        // 0.1 degree of 0.2 degree is a half; 1 / (0.2 degree in radians) is 286.5.
        let narrow = pair(image(64, 64), image(64, 64), [0.1, -0.1]).unwrap();
        assert!(narrow[0].message.contains("50 %") && narrow[0].message.contains("286 px of depth"), "{}", narrow[0]);
        assert_eq!(pair(image(64, 64), image(64, 64), [-20.0, 20.0]), Ok(Vec::new()));
    }
}
