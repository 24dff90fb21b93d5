//! Opening a tilt series: a stack (MRC, ST, TIFF, ImageJ) with its tilts, or a folder of single images.
//!
//! Views are sorted by tilt, and of several at one tilt the first is used; each keeps the section it was stored in. Pixels are
//! read a view at a time: a series may be larger than the memory.

use std::path::Path;

use super::SeriesError;
use super::evenness::{SAME_TILT_DEG, tilt_notes, usual_step_deg};
use super::names::{parse_table, tilts_of_names};
use crate::io::{Header, ReadOptions, open, parse_tilts, read_micrograph_with};
use crate::micrograph::{Micrograph, Source};
use crate::progress::Stage;
use crate::warning::Warning;

/// Endings of the images that are looked for in a folder.
const ENDINGS: [&str; 5] = ["tif", "tiff", "png", "mrc", "st"];
/// A step of the tilts is never taken as smaller than this when views are looked for, degrees.
const LEAST_STEP_DEG: f64 = 0.1;

/// One view of a series; its pixels are read by [`Series::view`].
#[derive(Clone, Debug, PartialEq)]
pub struct SeriesView {
    /// File and section (`series.mrc#36`), or the file of a single image: a name that every command understands.
    pub spec: String,
    /// Place in the series as it was stored, from 0.
    pub section: usize,
    /// Tilt in degrees.
    pub tilt_deg: f64,
}

/// A tilt series: at least two views at different tilts, sorted by tilt.
#[derive(Clone, Debug, PartialEq)]
pub struct Series {
    /// The file or folder as given.
    pub path: String,
    /// The views by ascending tilt.
    pub views: Vec<SeriesView>,
    /// Tilts in degrees in the order the views are stored, duplicates among them.
    pub stored_tilts_deg: Vec<f64>,
    /// Rows and columns of every view.
    pub shape: [usize; 2],
    /// Side of a pixel in nm and where that was found, if known.
    pub pixel_size: Option<(f64, String)>,
    /// Where the tilts come from, in words.
    pub tilts_from: String,
    /// What is odd.
    pub warnings: Vec<Warning>,
    options: ReadOptions,
}

impl Series {
    /// Opens a series. `tilts`, where given, is a list, a range or a file (`.tlt`, `.rawtlt`, `.mdoc`; for a folder also a table
    /// `.csv` of files and tilts), one tilt a view in the order they are stored; for a folder that is the order of names.
    ///
    /// # Errors
    /// Where a file cannot be read or is cut off, there are fewer than two views, tilts are unknown or of another number, or
    /// images differ in size.
    ///
    /// ```no_run
    /// let series = tiltline::series::Series::open("series.mrc", Some("-60:60:2"), &Default::default())?;
    /// let least_tilted = series.view(series.nearest(0.0)?)?;
    /// # Ok::<(), tiltline::series::SeriesError>(())
    /// ```
    pub fn open(path: &str, tilts: Option<&str>, options: &ReadOptions) -> Result<Self, SeriesError> {
        if Path::new(path).is_dir() {
            Self::of_folder(path, tilts, options)
        } else {
            Self::of_stack(path, tilts, options)
        }
    }

    fn of_stack(path: &str, tilts: Option<&str>, options: &ReadOptions) -> Result<Self, SeriesError> {
        let file = open(path, options)?;
        let header = file.header();
        let (found, from) = match tilts {
            Some(text) => (Some(parse_tilts(text)?), text.to_owned()),
            None => match &header.tilts_deg {
                Some(found) => (Some(found.value.clone()), found.origin.clone()),
                None => (None, String::new()),
            },
        };
        if header.pages < 2 {
            return Err(SeriesError::TooFewViews { path: path.to_owned(), views: header.pages });
        }
        let tilts_deg = found.ok_or_else(|| error_no_tilts(path, header.pages, &header.notes))?;
        let specs = (0..header.pages).map(|page| format!("{path}#{page}")).collect();
        let pixel_size = header.pixel_size_nm.clone().map(|found| (found.value, found.origin));
        let warnings = header.notes.iter().map(|note| Warning::new(Stage::Read, format!("{path}: {note}"))).collect();
        let shape = [header.rows, header.columns];
        Self { shape, pixel_size, warnings, ..Self::empty(path, options) }.with_views(specs, tilts_deg, from)
    }

    fn of_folder(path: &str, tilts: Option<&str>, options: &ReadOptions) -> Result<Self, SeriesError> {
        let (names, tables) = list_folder(path)?;
        let at = |name: &str| Path::new(path).join(name).to_string_lossy().into_owned();
        let headers = names.iter().map(|name| Ok(open(&at(name), options)?.header().clone()));
        let headers: Vec<Header> = headers.collect::<Result<_, SeriesError>>()?;
        let [first, ..] = &headers[..] else { return Err(SeriesError::NoImages { folder: path.to_owned() }) };
        for (header, name) in headers.iter().zip(&names) {
            if header.pages != 1 {
                return Err(SeriesError::StackInFolder { path: at(name), pages: header.pages });
            }
            if (header.rows, header.columns) != (first.rows, first.columns) {
                let size = |header: &Header| format!("{}x{}", header.columns, header.rows);
                let (first_size, other_size) = (size(first), size(header));
                return Err(SeriesError::Sizes { first: at(&names[0]), first_size, other: at(name), other_size });
            }
        }
        if names.len() < 2 {
            return Err(SeriesError::TooFewViews { path: path.to_owned(), views: names.len() });
        }
        let own: Option<Vec<f64>> = headers
            .iter()
            .map(|header| header.tilts_deg.as_ref().and_then(|found| found.value.first().copied()))
            .collect();
        let table = |file: &Path| tilts_of_table(file, &names);
        let (tilts_deg, from) = match tilts {
            Some(text) if text.to_lowercase().ends_with(".csv") => (table(Path::new(text))?, text.to_owned()),
            Some(text) => (parse_tilts(text)?, text.to_owned()),
            None => match (&tables[..], own, tilts_of_names(&names)) {
                ([file], ..) => (table(&Path::new(path).join(file))?, file.clone()),
                (_, Some(own), _) => (own, "the images' files".to_owned()),
                (_, None, Some(tilts)) => (tilts, "the images' names".to_owned()),
                _ => return Err(error_no_tilts(path, names.len(), &[])),
            },
        };
        let pixel_size = first.pixel_size_nm.clone().map(|found| (found.value, found.origin));
        let specs = names.iter().map(|name| at(name)).collect();
        let shape = [first.rows, first.columns];
        Self { shape, pixel_size, ..Self::empty(path, options) }.with_views(specs, tilts_deg, from)
    }

    fn empty(path: &str, options: &ReadOptions) -> Self {
        Self {
            path: path.to_owned(),
            views: Vec::new(),
            stored_tilts_deg: Vec::new(),
            shape: [0, 0],
            pixel_size: None,
            tilts_from: String::new(),
            warnings: Vec::new(),
            options: *options,
        }
    }

    /// Checks and sorts the views.
    fn with_views(mut self, specs: Vec<String>, tilts_deg: Vec<f64>, from: String) -> Result<Self, SeriesError> {
        let (path, views) = (self.path.clone(), specs.len());
        if tilts_deg.len() != views {
            return Err(SeriesError::WrongCount { path, views, from, tilts: tilts_deg.len() });
        }
        let notes = tilt_notes(&tilts_deg).into_iter().map(|note| Warning::new(Stage::Read, format!("{path}: {note}")));
        self.warnings.extend(notes);
        self.stored_tilts_deg.clone_from(&tilts_deg);
        let mut sorted: Vec<SeriesView> = specs
            .into_iter()
            .zip(tilts_deg)
            .enumerate()
            .map(|(section, (spec, tilt_deg))| SeriesView { spec, section, tilt_deg })
            .collect();
        sorted.sort_by(|a, b| a.tilt_deg.total_cmp(&b.tilt_deg).then(a.section.cmp(&b.section)));
        // Of views at one tilt the first that was stored: later ones have had more dose.
        let mut distinct: Vec<SeriesView> = Vec::new();
        for view in sorted {
            if distinct.last().is_none_or(|last| view.tilt_deg - last.tilt_deg >= SAME_TILT_DEG) {
                distinct.push(view);
            }
        }
        if let [only] = &distinct[..] {
            return Err(SeriesError::OneTilt { path, tilt_deg: only.tilt_deg });
        }
        (self.views, self.tilts_from) = (distinct, from);
        Ok(self)
    }

    /// The series of some of its views only (by their places in [`Series::views`], in the order they are given): as if the others
    /// had not been taken.
    pub fn part(&self, chosen: &[usize]) -> Self {
        Self { views: chosen.iter().map(|view| self.views[*view].clone()).collect(), ..self.clone() }
    }

    /// Tilts in degrees, ascending.
    pub fn tilts_deg(&self) -> Vec<f64> {
        self.views.iter().map(|view| view.tilt_deg).collect()
    }

    /// The usual step of the tilts in degrees.
    pub fn step_deg(&self) -> f64 {
        usual_step_deg(&self.tilts_deg()).max(LEAST_STEP_DEG)
    }

    /// The view nearest to an angle.
    ///
    /// # Errors
    /// Where it is further away than half a step.
    pub fn nearest(&self, asked_deg: f64) -> Result<usize, SeriesError> {
        let off = |view: &SeriesView| (view.tilt_deg - asked_deg).abs();
        let nearest = (0..self.views.len()).min_by(|&a, &b| off(&self.views[a]).total_cmp(&off(&self.views[b])));
        let nearest = nearest.expect("a series has at least two views");
        let half_step_deg = 0.5 * self.step_deg();
        // A tilt of the goniometer is written with two decimals.
        if off(&self.views[nearest]) <= half_step_deg + SAME_TILT_DEG {
            return Ok(nearest);
        }
        Err(SeriesError::NoView {
            asked_deg,
            nearest_deg: self.views[nearest].tilt_deg,
            half_step_deg,
            first_deg: self.views[0].tilt_deg,
            last_deg: self.views[self.views.len() - 1].tilt_deg,
        })
    }

    /// Reads the pixels of a view, by its place in [`Series::views`].
    ///
    /// # Errors
    /// Where the file cannot be read, or a pixel is NaN or infinite.
    pub fn view(&self, index: usize) -> Result<Micrograph, SeriesError> {
        let view = &self.views[index];
        // The whole file would be hashed again for each of its views: only those of a reconstruction are.
        let (path, page) = match view.spec.rsplit_once('#') {
            Some((path, page)) if path == self.path => (path, page.parse().unwrap_or(0)),
            _ => (view.spec.as_str(), 0),
        };
        let pixels = open(path, &self.options)?.read_page(page)?;
        crate::io::require_finite(&view.spec, &pixels)?;
        Ok(Micrograph {
            pixels,
            pixel_size_nm: self.pixel_size.as_ref().map(|(size, _)| *size),
            tilt_rad: Some(view.tilt_deg.to_radians()),
            source: Source { path: view.spec.clone(), sha256: String::new() },
        })
    }

    /// [`Series::view`], with the hash of its file, for records.
    ///
    /// # Errors
    /// As for [`Series::view`].
    pub fn hashed_view(&self, index: usize) -> Result<Micrograph, SeriesError> {
        let read = read_micrograph_with(&self.views[index].spec, &self.options)?.micrograph;
        Ok(Micrograph { source: read.source, ..self.view(index)? })
    }
}

fn error_no_tilts(path: &str, views: usize, notes: &[String]) -> SeriesError {
    let notes = notes.iter().filter(|note| note.contains("tilt")).map(|note| format!("; {note}")).collect();
    SeriesError::NoTilts { path: path.to_owned(), views, notes }
}

/// Names of the images of a folder in their natural order (`view-2` before `view-10`), and of its tables.
fn list_folder(path: &str) -> Result<(Vec<String>, Vec<String>), SeriesError> {
    let fault = |source| SeriesError::Folder { folder: path.to_owned(), source };
    let (mut names, mut tables) = (Vec::new(), Vec::new());
    for entry in std::fs::read_dir(path).map_err(fault)? {
        let name = entry.map_err(fault)?.file_name().to_string_lossy().into_owned();
        let ending = name.rsplit_once('.').map(|(_, ending)| ending.to_lowercase()).unwrap_or_default();
        if name.starts_with('.') {
            continue;
        }
        if ENDINGS.contains(&ending.as_str()) {
            names.push(name);
        } else if ending == "csv" {
            tables.push(name);
        }
    }
    names.sort_by_cached_key(|name| natural(name));
    Ok((names, tables))
}

/// A key that sorts numbers in names by their value.
fn natural(name: &str) -> Vec<(u64, String)> {
    let mut parts = Vec::new();
    let mut rest = name;
    while !rest.is_empty() {
        let text = rest.find(|c: char| c.is_ascii_digit()).unwrap_or(rest.len());
        let digits = rest[text..].find(|c: char| !c.is_ascii_digit()).map_or(rest.len(), |end| text + end);
        parts.push((0, rest[..text].to_owned()));
        parts.push((rest[text..digits].parse().unwrap_or(u64::MAX), String::new()));
        rest = &rest[digits..];
    }
    parts
}

/// The tilt of each image from a table; one that is not in it is an error.
fn tilts_of_table(file: &Path, names: &[String]) -> Result<Vec<f64>, SeriesError> {
    let fault = |what: String| SeriesError::Table { path: file.display().to_string(), what };
    let text = std::fs::read_to_string(file).map_err(|error| fault(format!("cannot be read: {error}")))?;
    let table = parse_table(&text, file)?;
    let tilt = |name: &String| {
        let row = table.get(name).or_else(|| {
            // Tables often name the files with their folders.
            table.iter().find(|(row, _)| row.rsplit(['/', '\\']).next() == Some(name)).map(|(_, tilt)| tilt)
        });
        row.copied()
            .ok_or_else(|| fault(format!("the image {name} is not in it; add a row, or take it out of the folder")))
    };
    names.iter().map(tilt).collect()
}
