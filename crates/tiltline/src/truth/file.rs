//! Reading, checking and writing truth files (JSON; docs/truth.md).
//!
//! Coordinates are written to 1e-4 of their unit: finer than any score, and half the file.

use std::collections::HashMap;
use std::path::Path;

use crate::geometry::{Point2, Point3};
use crate::truth::{TRUTH_VERSION, Truth, TruthError, ViewMap};

/// No truth is larger: 100 views of 2000 curves of 1000 points are 10 times smaller.
const MAX_BYTES: u64 = 1 << 31;
/// No image is wider.
const MAX_SIDE_PX: usize = 65_536;
/// No coordinate is further out, in px or nm.
const MAX_COORDINATE: f64 = 1e7;
/// Written coordinates are multiples of its inverse.
const PER_UNIT: f64 = 1e4;

impl Truth {
    /// Reads and checks a truth file.
    ///
    /// # Errors
    /// Where the file cannot be read, has an unknown key, or fails [`Truth::check`].
    pub fn read(path: impl AsRef<Path>) -> Result<Self, TruthError> {
        let path = path.as_ref();
        let truth: Self = serde_json::from_slice(&read_bytes(path)?)
            .map_err(|source| TruthError::Json { path: path.into(), source })?;
        truth.check()?;
        Ok(truth)
    }

    /// Checks and writes a truth file; an existing file is replaced only when the new one is complete.
    ///
    /// # Errors
    /// Where the truth fails [`Truth::check`] (nothing is written then) or the file cannot be written.
    pub fn write(&self, path: impl AsRef<Path>) -> Result<(), TruthError> {
        let path = path.as_ref();
        let io = |source| TruthError::Io { path: path.into(), source };
        let json = self.to_json()?;
        let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
        let file = crate::temporary::file_in(folder, ".tiltline-").map_err(io)?;
        std::fs::write(file.path(), json).map_err(io)?;
        file.persist(path).map_err(|error| io(error.error))?;
        Ok(())
    }

    /// The checked truth as JSON, coordinates rounded to 1e-4.
    ///
    /// # Errors
    /// Where the truth fails [`Truth::check`].
    pub fn to_json(&self) -> Result<String, TruthError> {
        self.check()?;
        Ok(serde_json::to_string(&self.rounded()).expect("a checked truth has only finite numbers and string keys"))
    }

    /// Fails on numbers and lists that cannot be right.
    ///
    /// # Errors
    /// The first thing found: wrong version, a number that is not finite or absurdly large, lists of unequal length, labels
    /// used twice or unknown.
    pub fn check(&self) -> Result<(), TruthError> {
        if self.version != TRUTH_VERSION {
            return Err(TruthError::Version { found: self.version, known: TRUTH_VERSION });
        }
        if let Some(size) = self.pixel_size_nm {
            positive(|| "pixel_size_nm".into(), size)?;
        }
        unique(self.curves.iter().map(|curve| curve.label.as_str()), || "`curves`".into())?;
        let mut counts = HashMap::new();
        for curve in &self.curves {
            let place = || format!("curve '{}'", curve.label);
            if let Some(points) = &curve.points {
                points.iter().try_for_each(|point| coordinates(place, point.coords.as_slice()))?;
                at_least_two(place, points.len())?;
            }
            for vector in [curve.burgers_nm, curve.plane_normal].into_iter().flatten() {
                coordinates(place, vector.as_slice())?;
            }
            counts.insert(curve.label.as_str(), curve.points.as_ref().map(Vec::len));
        }
        self.views.iter().try_for_each(|view| view.check(&counts))
    }

    fn rounded(&self) -> Self {
        let mut truth = self.clone();
        for point in truth.curves.iter_mut().filter_map(|curve| curve.points.as_mut()).flatten() {
            *point = Point3::from(point.coords.map(rounded));
        }
        for curve in truth.views.iter_mut().flat_map(|view| &mut view.curves) {
            for point in curve.contrast.iter_mut().chain(curve.core.iter_mut().flatten()) {
                *point = Point2::from(point.coords.map(rounded));
            }
        }
        truth
    }
}

impl crate::truth::TrueView {
    /// Fails where the image has another size than the truth.
    ///
    /// # Errors
    /// [`TruthError::ImageSize`].
    pub fn check_image_size(&self, [height, width]: [usize; 2]) -> Result<(), TruthError> {
        if (self.width, self.height) == (width, height) {
            return Ok(());
        }
        let (view, truth_width, truth_height) = (self.name.clone(), self.width, self.height);
        Err(TruthError::ImageSize { view, truth_width, truth_height, width, height })
    }

    /// `counts`: the number of 3D points of each known label.
    fn check(&self, counts: &HashMap<&str, Option<usize>>) -> Result<(), TruthError> {
        let place = |what: &str| format!("{what} of view '{}'", self.name);
        for (what, side) in [("width", self.width), ("height", self.height)] {
            if side == 0 || side > MAX_SIDE_PX {
                return Err(value(place(what), side, "1 to 65536 px"));
            }
        }
        if let Some(tilt) = self.tilt_rad.filter(|tilt| tilt.is_nan() || tilt.abs() >= std::f64::consts::FRAC_PI_2) {
            return Err(value(place("tilt_deg"), tilt.to_degrees(), "between -90 and 90 degrees"));
        }
        if let Some(ViewMap { scale_px, axis_rad, origin_px }) = self.input_from_projection {
            positive(|| place("scale_px"), scale_px)?;
            coordinates(|| place("input_from_projection"), &[axis_rad, origin_px[0], origin_px[1]])?;
        }
        if let Some(multiple) = self.visible_above_noise {
            positive(|| place("visible_above_noise"), multiple)?;
        }
        unique(self.curves.iter().map(|curve| curve.label.as_str()), || format!("view '{}'", self.name))?;
        for curve in &self.curves {
            let place = || format!("curve '{}' in view '{}'", curve.label, self.name);
            let Some(&expected) = counts.get(curve.label.as_str()) else {
                return Err(TruthError::UnknownLabel { view: self.name.clone(), label: curve.label.clone() });
            };
            at_least_two(place, curve.contrast.len())?;
            let lists = [
                ("`contrast`", Some(curve.contrast.len())),
                ("`core`", curve.core.as_ref().map(Vec::len)),
                ("`visible`", curve.visible.as_ref().map(Vec::len)),
            ];
            let expected = expected.unwrap_or(curve.contrast.len());
            for (list, found) in lists {
                if let Some(found) = found.filter(|&found| found != expected) {
                    let (label, place) = (curve.label.clone(), format!("{list} of view '{}'", self.name));
                    return Err(TruthError::Length { label, place, found, expected });
                }
            }
            for point in curve.contrast.iter().chain(curve.core.iter().flatten()) {
                coordinates(place, point.coords.as_slice())?;
            }
        }
        Ok(())
    }
}

/// Reads a whole file unless it is absurdly large.
pub(super) fn read_bytes(path: &Path) -> Result<Vec<u8>, TruthError> {
    let io = |source| TruthError::Io { path: path.into(), source };
    let bytes = std::fs::metadata(path).map_err(io)?.len();
    if bytes > MAX_BYTES {
        return Err(TruthError::TooLarge { path: path.into(), bytes, limit: MAX_BYTES });
    }
    std::fs::read(path).map_err(io)
}

fn rounded(value: f64) -> f64 {
    (value * PER_UNIT).round() / PER_UNIT
}

fn value(what: String, value: impl std::fmt::Display, expected: &'static str) -> TruthError {
    TruthError::Value { what, value: value.to_string(), expected }
}

fn positive(what: impl Fn() -> String, number: f64) -> Result<(), TruthError> {
    if number > 0.0 && number < MAX_COORDINATE { Ok(()) } else { Err(value(what(), number, "positive, below 1e7")) }
}

fn coordinates(what: impl Fn() -> String, numbers: &[f64]) -> Result<(), TruthError> {
    match numbers.iter().find(|number| number.is_nan() || number.abs() >= MAX_COORDINATE) {
        Some(number) => Err(value(format!("a coordinate of {}", what()), number, "a finite number below 1e7")),
        None => Ok(()),
    }
}

fn at_least_two(what: impl Fn() -> String, count: usize) -> Result<(), TruthError> {
    if count >= 2 { Ok(()) } else { Err(value(format!("the number of points of {}", what()), count, "at least 2")) }
}

/// Fails on the first label that occurs more than once.
pub(super) fn unique<'a>(
    labels: impl Iterator<Item = &'a str> + Clone,
    place: impl Fn() -> String,
) -> Result<(), TruthError> {
    let mut counts = HashMap::<&str, usize>::new();
    for label in labels.clone() {
        *counts.entry(label).or_default() += 1;
    }
    match labels.clone().find(|label| counts[label] > 1) {
        Some(label) => Err(TruthError::DuplicateLabel { label: label.into(), count: counts[label], place: place() }),
        None => Ok(()),
    }
}

/// Optional radians, degrees in the file.
pub(super) mod degrees {
    use serde::{Deserialize, Deserializer, Serialize, Serializer};

    pub fn serialize<S: Serializer>(radians: &Option<f64>, serializer: S) -> Result<S::Ok, S::Error> {
        radians.map(super::tidy_degrees).serialize(serializer)
    }

    pub fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Option<f64>, D::Error> {
        Ok(Option::<f64>::deserialize(deserializer)?.map(f64::to_radians))
    }
}

/// Radians, degrees in the file.
pub(super) mod degrees_always {
    use serde::{Deserialize, Deserializer, Serialize, Serializer};

    pub fn serialize<S: Serializer>(radians: &f64, serializer: S) -> Result<S::Ok, S::Error> {
        super::tidy_degrees(*radians).serialize(serializer)
    }

    pub fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<f64, D::Error> {
        Ok(f64::deserialize(deserializer)?.to_radians())
    }
}

/// Degrees to 1e-10, so that 4 degrees are written as 4 after their turn through radians.
fn tidy_degrees(radians: f64) -> f64 {
    (radians.to_degrees() * 1e10).round() / 1e10
}
