//! The files of one simulated item, and what is drawn from a truth: line masks and disparity.

use std::collections::BTreeMap;
use std::fs;
use std::io::Cursor;
use std::path::Path;

use ::tiff::encoder::colortype::{Gray16, Gray32Float};
use ndarray::Array2;

use super::{DatasetError, hash};
use crate::export::tiff::Description;
use crate::export::{mrc, png, tiff};
use crate::geometry::Point2;
use crate::simulate::draw::stroke;
use crate::simulate::{Sample, SampleView};
use crate::truth::{TrueView, Truth, TruthPair, curve_mask};

/// How the names of temporary folders begin.
pub(super) const TEMPORARY: &str = ".tiltline-";
/// Width of a line in masks and disparity maps, px: what the paper's authors painted.
pub const LINE_WIDTH_PX: f64 = 3.0;
/// Mask value where a line is that does not stand out from the noise.
const HIDDEN: u8 = 128;
/// Mask value of a visible line.
const VISIBLE: u8 = 255;
/// Value in a 16-bit file of the intensity 1, about that of the background.
const UNIT: f32 = 20_000.0;

/// Files by name, complete in memory.
pub(super) type Files = Vec<(String, Vec<u8>)>;

/// The files of a sample. `pair`: the views that get a disparity map.
pub(super) fn files(sample: &Sample, pair: [usize; 2]) -> Result<Files, DatasetError> {
    let truth = &sample.truth;
    let mut files = drawn_files(truth, pair)?;
    for (view, truth_view) in sample.views.iter().zip(&truth.views) {
        let tilt_deg = rounded_degrees(view.camera.tilt_rad);
        let description =
            Description { content: "micrograph", pixel_size_nm: Some(sample.pixel_size_nm), tilt_deg: Some(tilt_deg) };
        let counts = view.recording.image.mapv(|value| (value * UNIT).round().clamp(0.0, 65_535.0) as u16);
        let pixels = counts.as_slice().expect("recordings are in standard layout");
        files.push((
            truth_view.name.clone(),
            encoded(|out| tiff::encode::<Gray16>(pixels, counts.dim().into(), &description, false, out))?,
        ));
    }
    if sample.views.len() > 2 {
        files.extend(series(sample)?);
    }
    Ok(files)
}

/// The truth, and what is drawn from it: a mask for each view and the disparity of a pair.
pub(super) fn drawn_files(truth: &Truth, pair: [usize; 2]) -> Result<Files, DatasetError> {
    let mut files: Files = vec![("truth.json".into(), truth.to_json()?.into_bytes())];
    for view in &truth.views {
        files.push((companion(&view.name, "mask", "png"), mask_file(truth, view)?));
    }
    let stereo = truth.pair(pair[0], pair[1])?;
    let map = disparity_map(&stereo);
    let pixels = map.as_slice().expect("new arrays are contiguous");
    let content = format!("disparity in px of {} to {}, NaN off the lines", stereo.left.name, stereo.right.name);
    let description = Description { content: &content, pixel_size_nm: truth.pixel_size_nm, tilt_deg: None };
    let map = encoded(|out| tiff::encode::<Gray32Float>(pixels, map.dim().into(), &description, true, out))?;
    files.push(("disparity.tif".into(), map));
    Ok(files)
}

/// The series as one MRC stack with its tilts: `series.mrc`, `series.rawtlt`, `series.mrc.mdoc`.
fn series(sample: &Sample) -> Result<Files, DatasetError> {
    let section = |view: &SampleView| {
        // Half of the TIFF's values: many programs know MRC's signed 16 bits only.
        view.recording.image.mapv(|value| (0.5 * value * UNIT).round().clamp(0.0, 32_767.0) as i16)
    };
    let sections: Vec<Array2<i16>> = sample.views.iter().map(section).collect();
    let stack = encoded(|out| mrc::write_stack(&sections, Some(sample.pixel_size_nm), out))?;
    let tilts: Vec<f64> = sample.views.iter().map(|view| rounded_degrees(view.camera.tilt_rad)).collect();
    let list: String = tilts.iter().map(|tilt| format!("{tilt:.2}\n")).collect();
    let [rows, columns] = sample.views[0].camera.shape;
    let mut notes = format!(
        "PixelSpacing = {:.4}\nImageFile = series.mrc\nImageSize = {columns} {rows}\nDataMode = 1\n\n",
        10.0 * sample.pixel_size_nm
    );
    for (index, tilt) in tilts.iter().enumerate() {
        notes += &format!("[ZValue = {index}]\nTiltAngle = {tilt:.2}\n\n");
    }
    Ok(vec![
        ("series.mrc".into(), stack),
        ("series.rawtlt".into(), list.into_bytes()),
        ("series.mrc.mdoc".into(), notes.into_bytes()),
    ])
}

/// Angles were given in degrees: takes the rounding of the way to radians and back out.
fn rounded_degrees(radians: f64) -> f64 {
    (radians.to_degrees() * 1e6).round() / 1e6
}

/// `left.tif` and `mask` give `left-mask.png`.
fn companion(name: &str, what: &str, extension: &str) -> String {
    let stem = name.rsplit_once('.').map_or(name, |(stem, _)| stem);
    format!("{stem}-{what}.{extension}")
}

fn mask_file(truth: &Truth, view: &TrueView) -> Result<Vec<u8>, DatasetError> {
    let mask = line_mask(truth, view);
    let pixels = mask.as_slice().expect("new arrays are contiguous");
    encoded(|out| png::encode(out, mask.dim().into(), ::png::ColorType::Grayscale, pixels))
}

fn encoded(write: impl FnOnce(&mut Cursor<Vec<u8>>) -> std::io::Result<()>) -> Result<Vec<u8>, DatasetError> {
    let mut out = Cursor::new(Vec::new());
    write(&mut out).map_err(|source| DatasetError::Io { path: "an image in memory".into(), source })?;
    Ok(out.into_inner())
}

/// Lines of a view `[row, column]`: 255 where one is visible, 128 where one is that does not stand out from the noise,
/// 0 elsewhere; lines are 3 px wide about their centre of contrast.
pub fn line_mask(truth: &Truth, view: &TrueView) -> Array2<u8> {
    let closed = |label: &str| truth.curve(label).is_some_and(|curve| curve.closed);
    let all = curve_mask(view, closed, LINE_WIDTH_PX, false);
    let visible = curve_mask(view, closed, LINE_WIDTH_PX, true);
    let mut mask = all.mapv(|line| if line { HIDDEN } else { 0 });
    mask.zip_mut_with(&visible, |value, visible| {
        if *visible {
            *value = VISIBLE;
        }
    });
    mask
}

/// Disparity in px of the left image about the tilt axis, on the left image's own grid `[row, column]`, at visible lines
/// 3 px wide; NaN elsewhere. Where lines overlap, the value is that of the nearest.
pub fn disparity_map(pair: &TruthPair<'_>) -> Array2<f32> {
    let shape = [pair.left.height, pair.left.width];
    let mut map = Array2::from_elem(shape, f32::NAN);
    let mut nearest = Array2::from_elem(shape, f32::INFINITY);
    for curve in pair.curves() {
        let at = |index: usize| {
            let right = curve.right[index].filter(|_| curve.counts[index])?;
            Some(pair.disparity_px(&curve.left[index], &right) as f32)
        };
        let disparity: Vec<Option<f32>> = (0..curve.left.len()).map(at).collect();
        let closing = curve.left.first().filter(|_| curve.curve.closed);
        let points: Vec<Point2> = curve.left.iter().chain(closing).copied().collect();
        stroke(shape, &points, 0.5 * LINE_WIDTH_PX, |row, column, near| {
            let (from, share) = (near.place as usize, near.place.fract());
            let ends = [from, from + 1].map(|index| disparity[index.min(points.len() - 1) % disparity.len()]);
            if let ([Some(a), Some(b)], true) = (ends, near.distance < nearest[[row, column]]) {
                nearest[[row, column]] = near.distance;
                map[[row, column]] = a * (1.0 - share) + b * share;
            }
        });
    }
    map
}

/// Writes the files of an item to a temporary folder and moves it into place.
pub(super) fn place(files: &Files, folder: &Path, name: &str) -> Result<(), DatasetError> {
    let target = folder.join(name);
    let io = |path: &Path| {
        let path = path.to_owned();
        move |source| DatasetError::Io { path, source }
    };
    let temporary = crate::temporary::folder_in(folder, TEMPORARY).map_err(io(folder))?;
    for (name, bytes) in files {
        fs::write(temporary.path().join(name), bytes).map_err(io(&target.join(name)))?;
    }
    fs::rename(temporary.path(), &target).map_err(io(&target))
}

/// Names and hashes of files.
pub(super) fn hashes(files: &Files) -> BTreeMap<String, String> {
    files.iter().map(|(name, bytes)| (name.clone(), hash(bytes))).collect()
}
