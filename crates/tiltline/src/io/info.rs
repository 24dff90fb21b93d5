//! What is in a file: the description behind `tiltline info`.

use serde::Serialize;

use super::samples::Statistics;
use super::{ByteOrder, Format, Header, ReadError, ReadOptions, SampleType, input, open};

/// Pixels up to which every page of a stack is measured; of a larger one the first page is.
const MEASURED_PIXELS: usize = 1 << 26;
/// A share of pixels at the least or largest value above which clipping is likely.
const CLIPPED_SHARE: f64 = 0.01;

/// What is in a file of images.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct FileInfo {
    /// The path as given.
    pub path: String,
    /// Kind of file, by its content.
    pub format: Format,
    /// Columns of a page.
    pub columns: usize,
    /// Rows of a page.
    pub rows: usize,
    /// Number of pages, slices or sections.
    pub pages: usize,
    /// Type of a stored sample.
    pub sample_type: SampleType,
    /// Order of the bytes in the file.
    pub byte_order: ByteOrder,
    /// Side of a pixel in nm, if it is stated.
    pub pixel_size_nm: Option<f64>,
    /// Where the pixel size was found.
    pub pixel_size_from: Option<String>,
    /// Tilts in degrees, one a page, if they are stated.
    pub tilts_deg: Option<Vec<f64>>,
    /// Where the tilts were found.
    pub tilts_from: Option<String>,
    /// Range of the finite samples; `None` where there are none.
    pub intensities: Option<Intensities>,
    /// What is odd about the file, a sentence each.
    pub warnings: Vec<String>,
}

/// Range of the samples of a file.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Intensities {
    /// Least value.
    pub min: f32,
    /// Largest value.
    pub max: f32,
    /// Mean value.
    pub mean: f64,
    /// Share of the pixels at the least value.
    pub share_at_min: f64,
    /// Share of the pixels at the largest value.
    pub share_at_max: f64,
    /// First page measured.
    pub first_page: usize,
    /// How many pages were measured.
    pub pages_measured: usize,
}

/// Describes a file given as `path` or `path#k`.
///
/// Range and warnings about pixels are of page k, or of all pages where they are 2^26 px at most together, or of the
/// first. Unlike [`super::read_micrograph`] this accepts NaN and infinity, and counts them.
pub fn info(spec: &str) -> Result<FileInfo, ReadError> {
    let (path, chosen) = input::split_spec(spec)?;
    let mut file = open(&path, &ReadOptions::default())?;
    let Header { format, rows, columns, pages, sample, byte_order, .. } = *file.header();
    let measured = match chosen {
        Some(page) => page..page + 1,
        None if rows * columns <= MEASURED_PIXELS / pages => 0..pages,
        None => 0..1,
    };
    let mut statistics = Statistics::new();
    for page in measured.clone() {
        statistics.add(&file.read_page(page)?);
    }
    let Header { pixel_size_nm, tilts_deg, mut notes, .. } = file.header().clone();
    let intensities = (statistics.finite > 0).then(|| Intensities {
        min: statistics.min,
        max: statistics.max,
        mean: statistics.mean(),
        share_at_min: statistics.at_min as f64 / statistics.finite as f64,
        share_at_max: statistics.at_max as f64 / statistics.finite as f64,
        first_page: measured.start,
        pages_measured: measured.len(),
    });
    notes.extend(doubts(&statistics, intensities.as_ref()));
    let (pixel_size_nm, pixel_size_from) = pixel_size_nm.map(|found| (found.value, found.origin)).unzip();
    let (tilts_deg, tilts_from) = tilts_deg.map(|found| (found.value, found.origin)).unzip();
    Ok(FileInfo {
        path: spec.to_owned(),
        format,
        columns,
        rows,
        pages,
        sample_type: sample,
        byte_order,
        pixel_size_nm,
        pixel_size_from,
        tilts_deg,
        tilts_from,
        intensities,
        warnings: notes,
    })
}

fn doubts(statistics: &Statistics, intensities: Option<&Intensities>) -> Vec<String> {
    let mut doubts = Vec::new();
    let pixels = statistics.finite + statistics.not_finite;
    if statistics.not_finite > 0 {
        let count = statistics.not_finite;
        doubts.push(format!("{count} of {pixels} pixels are NaN or infinite: replace them before a reconstruction"));
    }
    let Some(&Intensities { min, max, share_at_min, share_at_max, .. }) = intensities else { return doubts };
    if min == max {
        doubts.push(format!("the image is constant: every pixel is {min}"));
        return doubts;
    }
    for (share, value, word, cause) in [
        (share_at_min, min, "least", "black borders or clipping"),
        (share_at_max, max, "largest", "saturation or white borders"),
    ] {
        if share > CLIPPED_SHARE {
            let percent = 100.0 * share;
            doubts.push(format!("{percent:.1} % of the pixels have the {word} value {value}: {cause} is likely"));
        }
    }
    doubts
}
