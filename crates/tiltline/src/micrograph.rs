//! A micrograph and a stereo pair of them: what comes out of the readers and goes into rectification.

use ndarray::Array2;
use serde::{Deserialize, Serialize};

use crate::filter::percentiles;
use crate::geometry::TiltPair;

/// One grey image of the foil.
#[derive(Clone, Debug, PartialEq)]
pub struct Micrograph {
    /// Intensity `[row, column]` as recorded (any scale); every value is finite.
    pub pixels: Array2<f32>,
    /// Side of a pixel in nm, if known.
    pub pixel_size_nm: Option<f64>,
    /// Tilt of the specimen in radians, if known.
    pub tilt_rad: Option<f64>,
    /// Where the image came from; empty for images made in memory.
    pub source: Source,
}

/// Where a micrograph came from, for run records and messages.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Source {
    /// Path as the user gave it, with `#page` if one was chosen.
    pub path: String,
    /// SHA-256 of the whole file, in hexadecimal.
    pub sha256: String,
}

impl Micrograph {
    /// A micrograph of unknown pixel size and tilt.
    pub fn new(pixels: Array2<f32>) -> Self {
        Self { pixels, pixel_size_nm: None, tilt_rad: None, source: Source::default() }
    }

    /// Number of rows.
    pub fn height(&self) -> usize {
        self.pixels.nrows()
    }

    /// Number of columns.
    pub fn width(&self) -> usize {
        self.pixels.ncols()
    }

    /// Intensity scaled so that the 0.5 and 99.5 percentiles become 0 and 1, clipped to `[-0.5, 1.5]`.
    ///
    /// A constant image becomes all zeros.
    pub fn normalised(&self) -> Array2<f32> {
        let [low, high] = percentiles(&self.pixels, [0.005, 0.995]);
        let range = high - low;
        let gain = if range > 0.0 { 1.0 / range } else { 0.0 };
        self.pixels.mapv(|value| ((value - low) * gain).clamp(-0.5, 1.5))
    }
}

/// Two micrographs of one foil and the tilts they were taken at.
#[derive(Clone, Debug, PartialEq)]
pub struct StereoPair {
    /// The view at `tilts.left_rad`.
    pub left: Micrograph,
    /// The view at `tilts.right_rad`.
    pub right: Micrograph,
    /// Tilts of the two views.
    pub tilts: TiltPair,
    /// Angle of the tilt axis, radians clockwise on the screen from image y, as given by the user.
    pub tilt_axis_rad: f64,
}

impl StereoPair {
    /// The micrograph of one view.
    pub fn view(&self, view: View) -> &Micrograph {
        match view {
            View::Left => &self.left,
            View::Right => &self.right,
        }
    }

    /// Side of a left pixel in nm, if known.
    pub fn pixel_size_nm(&self) -> Option<f64> {
        self.left.pixel_size_nm
    }
}

/// One of the two views of a pair.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum View {
    /// The first image given, the reference of all disparities.
    Left,
    /// The second image given.
    Right,
}

impl View {
    /// Left, then right.
    pub const BOTH: [View; 2] = [View::Left, View::Right];

    /// The other view.
    pub fn other(self) -> View {
        match self {
            View::Left => View::Right,
            View::Right => View::Left,
        }
    }

    /// 0 for left, 1 for right: the index into pairs such as `[LineMap; 2]`.
    pub fn index(self) -> usize {
        self as usize
    }
}
