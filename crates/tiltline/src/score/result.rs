//! The result that is scored, in the form users have: `curves.csv` (and `lines.csv` beside it), or a [`Reconstruction`]
//! in memory.

use std::path::{Path, PathBuf};

use crate::curve::{Flag, UnmatchedLine};
use crate::geometry::{Point2, Point3};
use crate::micrograph::View;
use crate::reconstruction::{LengthUnit, Reconstruction};
use crate::score::ScoreError;

/// Curves of a result.
#[derive(Clone, Debug, PartialEq)]
pub struct ResultCurves {
    /// Unit of the 3D points.
    pub unit: LengthUnit,
    /// Matched curves.
    pub curves: Vec<ResultCurve>,
    /// Lines detected in the left image that found no match, in left input px; `None` where the result does not say
    /// (a `curves.csv` without its `lines.csv`).
    pub unmatched_left: Option<Vec<Vec<Point2>>>,
}

/// One matched curve.
#[derive(Clone, Debug, PartialEq)]
pub struct ResultCurve {
    /// Points in order, at least one.
    pub points: Vec<ResultPoint>,
    /// Whether the last point joins the first.
    pub closed: bool,
}

/// A point of a matched curve.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ResultPoint {
    /// In left input px.
    pub left: Point2,
    /// In right input px.
    pub right: Point2,
    /// One sigma of the disparity, in px of the left image.
    pub sigma_disparity_px: f64,
    /// Mid-view frame, in the unit of the result.
    pub position: Point3,
    /// How far the result trusts it.
    pub flag: Flag,
}

impl ResultCurve {
    /// The curve in the left image.
    pub fn left(&self) -> Vec<Point2> {
        self.points.iter().map(|point| point.left).collect()
    }
}

impl From<&Reconstruction> for ResultCurves {
    fn from(reconstruction: &Reconstruction) -> Self {
        let curves = reconstruction.curves.iter().map(|curve| {
            let point = |point: &crate::curve::CurvePoint| ResultPoint {
                left: point.left_input,
                right: point.right_input,
                sigma_disparity_px: point.sigma_disparity_px,
                position: point.position,
                flag: point.flag,
            };
            ResultCurve { points: curve.points.iter().map(point).collect(), closed: curve.closed }
        });
        let in_left = |line: &&UnmatchedLine| line.view == View::Left;
        let unmatched = reconstruction.unmatched.iter().filter(in_left).map(|line| line.points_input.clone());
        Self { unit: reconstruction.frame.unit, curves: curves.collect(), unmatched_left: Some(unmatched.collect()) }
    }
}

impl ResultCurves {
    /// A result without any line: what a pair that could not be reconstructed counts as.
    pub fn none() -> Self {
        Self { unit: LengthUnit::Px, curves: Vec::new(), unmatched_left: Some(Vec::new()) }
    }
}

/// Columns of `curves.csv`, `{unit}` being nm or px.
const CURVE_COLUMNS: &str = "curve,point,x_left_px,y_left_px,x_right_px,y_right_px,disparity_px,sigma_disparity_px,\
    x_{unit},y_{unit},z_{unit},sigma_z_{unit},flag";
/// Columns of `lines.csv`.
const LINE_COLUMNS: &str = "view,line,point,x_px,y_px";
/// A curve whose ends are at most this many times its median spacing apart joins itself: `curves.csv` does not say.
const CLOSED_SPACINGS: f64 = 1.5;
/// Fewest points of such a curve.
const CLOSED_POINTS: usize = 12;

impl ResultCurves {
    /// Reads `curves.csv` (or the one in a result's folder), and `lines.csv` where it lies beside it.
    ///
    /// # Errors
    /// Where a file cannot be read, has other columns, or a number in it is missing or not finite.
    pub fn read(path: impl AsRef<Path>) -> Result<Self, ScoreError> {
        let path = path.as_ref();
        let path = if path.is_dir() { path.join("curves.csv") } else { path.to_path_buf() };
        let mut result = Self::parse(&read_text(&path)?, &path)?;
        let lines = path.with_file_name("lines.csv");
        if lines.is_file() {
            result.unmatched_left = Some(parse_lines(&read_text(&lines)?, &lines)?);
        }
        Ok(result)
    }

    /// Curves from the text of a `curves.csv`; `path` is for messages.
    ///
    /// # Errors
    /// As for [`ResultCurves::read`].
    pub fn parse(text: &str, path: &Path) -> Result<Self, ScoreError> {
        let found = text.lines().next().unwrap_or_default().trim();
        let columns = |unit: LengthUnit| CURVE_COLUMNS.replace("{unit}", unit.word());
        let unit =
            [LengthUnit::Nm, LengthUnit::Px].into_iter().find(|unit| found == columns(*unit)).ok_or_else(|| {
                let (found, expected) = (found.to_owned(), columns(LengthUnit::Nm) + "' (or _px for _nm in '");
                ScoreError::Columns { path: path.into(), found, expected }
            })?;
        let mut curves: Vec<ResultCurve> = Vec::new();
        let mut current = None;
        for row in Row::all(text, path, 13) {
            let row = row?;
            let [x_left, y_left, x_right, y_right, _, sigma, x, y, z, _] = row.numbers(2)?;
            if sigma < 0.0 {
                return Err(row.error(format!("sigma_disparity_px is {sigma}; it must not be negative")));
            }
            let flag =
                [Flag::Ok, Flag::IllConditioned, Flag::Bridged].into_iter().find(|flag| flag.word() == row.cells[12]);
            let flag = flag.ok_or_else(|| row.error(format!("unknown flag '{}'", row.cells[12])))?;
            let point = ResultPoint {
                left: Point2::new(x_left, y_left),
                right: Point2::new(x_right, y_right),
                sigma_disparity_px: sigma,
                position: Point3::new(x, y, z),
                flag,
            };
            let name = row.cells[0].to_owned();
            match curves.last_mut().filter(|_| current.as_ref() == Some(&name)) {
                Some(curve) => curve.points.push(point),
                None => curves.push(ResultCurve { points: vec![point], closed: false }),
            }
            current = Some(name);
        }
        for curve in &mut curves {
            curve.closed = looks_closed(&curve.left());
        }
        Ok(Self { unit, curves, unmatched_left: None })
    }
}

fn parse_lines(text: &str, path: &Path) -> Result<Vec<Vec<Point2>>, ScoreError> {
    let found = text.lines().next().unwrap_or_default().trim();
    if found != LINE_COLUMNS {
        return Err(ScoreError::Columns { path: path.into(), found: found.into(), expected: LINE_COLUMNS.into() });
    }
    let mut lines: Vec<Vec<Point2>> = Vec::new();
    let mut current = None;
    for row in Row::all(text, path, 5) {
        let row = row?;
        let [x, y] = row.numbers(3)?;
        if row.cells[0] != "left" {
            continue;
        }
        let name = row.cells[1].to_owned();
        match lines.last_mut().filter(|_| current.as_ref() == Some(&name)) {
            Some(line) => line.push(Point2::new(x, y)),
            None => lines.push(vec![Point2::new(x, y)]),
        }
        current = Some(name);
    }
    Ok(lines)
}

fn looks_closed(points: &[Point2]) -> bool {
    let (Some(first), Some(last), true) = (points.first(), points.last(), points.len() >= CLOSED_POINTS) else {
        return false;
    };
    let mut spacings: Vec<f64> = points.windows(2).map(|pair| (pair[1] - pair[0]).norm()).collect();
    spacings.sort_unstable_by(f64::total_cmp);
    (last - first).norm() <= CLOSED_SPACINGS * spacings[spacings.len() / 2]
}

fn read_text(path: &Path) -> Result<String, ScoreError> {
    std::fs::read_to_string(path).map_err(|source| ScoreError::Io { path: path.into(), source })
}

/// One row of a table.
struct Row<'a> {
    cells: Vec<&'a str>,
    line: usize,
    path: &'a Path,
}

impl<'a> Row<'a> {
    /// All rows below the header that are not empty.
    fn all(text: &'a str, path: &'a Path, columns: usize) -> impl Iterator<Item = Result<Self, ScoreError>> {
        let rows = text.lines().enumerate().skip(1).filter(|(_, line)| !line.trim().is_empty());
        rows.map(move |(index, line)| {
            let row = Row { cells: line.trim_end().split(',').collect(), line: index + 1, path };
            if row.cells.len() == columns {
                return Ok(row);
            }
            Err(row.error(format!("{} cells, {columns} expected; is the file complete?", row.cells.len())))
        })
    }

    fn numbers<const N: usize>(&self, first: usize) -> Result<[f64; N], ScoreError> {
        let mut numbers = [0.0; N];
        for (number, cell) in numbers.iter_mut().zip(&self.cells[first..]) {
            *number = cell
                .parse()
                .ok()
                .filter(|number: &f64| number.is_finite())
                .ok_or_else(|| self.error(format!("'{cell}' is not a finite number")))?;
        }
        Ok(numbers)
    }

    fn error(&self, message: String) -> ScoreError {
        ScoreError::Row { path: PathBuf::from(self.path), line: self.line, message }
    }
}
