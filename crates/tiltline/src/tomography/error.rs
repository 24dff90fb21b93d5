//! Why there is no tomogram.

/// Errors of tomography.
#[derive(Debug, thiserror::Error)]
pub enum TomographyError {
    /// The number of tilts is not the number of views.
    #[error("{views} views have {tilts} tilts; give one tilt a view (--tilts LIST, START:END:STEP or FILE)")]
    TiltCount {
        /// Number of views.
        views: usize,
        /// Number of tilts.
        tilts: usize,
    },
    /// Too few different tilts.
    #[error("{views} view(s) with {distinct} different tilt(s): a tomogram needs at least two")]
    TooFewViews {
        /// Number of views.
        views: usize,
        /// Number of different tilts.
        distinct: usize,
    },
    /// More views were asked for than there are.
    #[error("{wanted} views were asked for (--use), and the series has {views}")]
    NoSuchCount {
        /// How many were asked for.
        wanted: usize,
        /// How many there are.
        views: usize,
    },
    /// Views of different shapes.
    #[error(
        "view {view} is {columns}x{rows} px and the first is {first_columns}x{first_rows}; crop or pad them to one size"
    )]
    Shape {
        /// Index of the view.
        view: usize,
        /// Its columns.
        columns: usize,
        /// Its rows.
        rows: usize,
        /// Columns of the first view.
        first_columns: usize,
        /// Rows of the first view.
        first_rows: usize,
    },
    /// A pixel that is not a number.
    #[error("view {view} has {count} pixels that are NaN or infinite; replace them first")]
    NotFinite {
        /// Index of the view.
        view: usize,
        /// How many.
        count: usize,
    },
    /// A setting that makes no sense.
    #[error("{name} is {value}; {expected}")]
    Value {
        /// The setting.
        name: &'static str,
        /// Its value.
        value: f64,
        /// What it may be.
        expected: &'static str,
    },
    /// A slab could not be written.
    #[error("the volume could not be written: {0}")]
    Write(#[from] std::io::Error),
}
