//! `tiltline tomography wbp|sirt`: a volume from a tilt series.

use std::path::PathBuf;
use std::sync::Mutex;
use std::time::Instant;

use clap::{Args, ValueEnum};
use miette::{IntoDiagnostic, Result, miette};
use ndarray::Array2;
use tiltline::export::mrc_volume::VolumeWriter;
use tiltline::io::{ReadOptions, open, parse_tilts};
use tiltline::progress::Event;
use tiltline::tomography::prepare::{PrepareSettings, prepare, upright};
use tiltline::tomography::{Filter, Geometry, Method, SirtSettings, WbpSettings, coverage, evenly_spaced, reconstruct};

use crate::args::Verbosity;
use crate::interrupt;
use crate::output;
use crate::progress::Count;
use crate::quantity::PixelSize;
use crate::reconstruct::wrong_usage;

/// Flags of `tiltline tomography`.
#[derive(Debug, Args)]
pub struct Tomography {
    /// How the volume is made.
    pub method: Kind,
    /// The series: a stack (MRC, ST, TIFF) whose views are aligned.
    pub series: String,
    /// The volume, MRC of 32-bit floats (docs/formats.md).
    #[arg(short, long, value_name = "FILE")]
    pub output: PathBuf,
    /// Tilts in degrees, one a view: LIST, START:END:STEP, or a FILE (.tlt, .rawtlt, .mdoc). Overrides the file's.
    #[arg(long, value_name = "LIST|START:END:STEP|FILE", allow_hyphen_values = true)]
    pub tilts: Option<String>,
    /// Use only so many views, evenly spaced from the least tilt to the largest.
    #[arg(long = "use", value_name = "COUNT")]
    pub views: Option<usize>,
    /// Direction of the tilt axis, degrees clockwise on the screen from image y (0 vertical, 90 horizontal).
    #[arg(long, value_name = "DEGREES", default_value_t = 0.0, allow_hyphen_values = true)]
    pub tilt_axis: f64,
    /// How far the tilt axis lies beside the middle of the views, px to the right once it is upright.
    #[arg(long, value_name = "PX", default_value_t = 0.0, allow_hyphen_values = true)]
    pub axis_offset: f64,
    /// Layers of the volume [default: as many as it is wide].
    #[arg(long, value_name = "PX")]
    pub depth: Option<usize>,
    /// Take the views' relative difference from their background, a mean over a Gaussian of this standard deviation: for lines.
    #[arg(long, value_name = "PX", num_args = 0..=1, default_missing_value = "12")]
    pub flatten: Option<f64>,
    /// Turn the contrast over: for dark lines, which become bright.
    #[arg(long)]
    pub invert: bool,
    /// Filter of weighted back projection.
    #[arg(long, value_name = "FILTER", default_value = "hamming")]
    pub filter: FilterFlag,
    /// Iterations of SIRT.
    #[arg(long, value_name = "COUNT", default_value_t = 30)]
    pub iterations: usize,
    /// Relaxation of SIRT, between 0 and 2.
    #[arg(long, value_name = "FACTOR", default_value_t = 1.0)]
    pub relaxation: f32,
    /// Let voxels of SIRT be negative.
    #[arg(long)]
    pub signed: bool,
    /// Side of a pixel with its unit: 1.2nm, 3.4A. Overrides the file's.
    #[arg(long, value_name = "SIZE")]
    pub pixel_size: Option<PixelSize>,
    /// Replace a file that is there.
    #[arg(long)]
    pub force: bool,
    /// How much to say while working.
    #[command(flatten)]
    pub verbosity: Verbosity,
}

/// How a volume is made.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Kind {
    /// Weighted back projection.
    Wbp,
    /// Simultaneous iterative reconstruction technique.
    Sirt,
}

/// Filters of weighted back projection.
#[derive(Clone, Copy, Debug, ValueEnum)]
pub enum FilterFlag {
    /// |f| alone.
    Ramp,
    /// |f| times a Hamming window.
    Hamming,
}

/// Runs the command.
pub fn run(flags: &Tomography) -> Result<()> {
    let method = match flags.method {
        Kind::Wbp => Method::Wbp(WbpSettings {
            filter: match flags.filter {
                FilterFlag::Ramp => Filter::Ramp,
                FilterFlag::Hamming => Filter::Hamming,
            },
        }),
        Kind::Sirt => {
            let settings = SirtSettings {
                iterations: flags.iterations,
                relaxation: flags.relaxation,
                non_negative: !flags.signed,
            };
            settings.validate().unwrap_or_else(|error| wrong_usage(&error.to_string()));
            Method::Sirt(settings)
        }
    };
    for (name, value) in [("--tilt-axis", flags.tilt_axis), ("--axis-offset", flags.axis_offset)] {
        if !value.is_finite() {
            wrong_usage(&format!("{name} {value} is not a number"));
        }
    }
    if let Some(sigma) = flags.flatten.filter(|sigma| !(*sigma > 0.0 && sigma.is_finite())) {
        wrong_usage(&format!("--flatten {sigma} is not a positive number of px"));
    }
    if flags.output.exists() && !flags.force {
        return Err(miette!("{} is there already; name another file, or give --force", flags.output.display()));
    }
    let start = Instant::now();
    let Views { images, tilts_deg, pixel_size_nm } = read(flags)?;
    let tilts_rad: Vec<f64> = tilts_deg.iter().map(|tilt| tilt.to_radians()).collect();
    let covered = coverage(&tilts_rad).into_diagnostic()?;
    let (rows, width) = images[0].dim();
    let mut geometry = Geometry::centred(tilts_rad, width, flags.depth.unwrap_or(width));
    geometry.axis_column += flags.axis_offset;

    let progress = Count::new("slabs", flags.verbosity);
    interrupt::write_file(&flags.output, |file| {
        let shape = [geometry.depth, rows, width];
        let writer = Mutex::new(VolumeWriter::begin(file, shape, pixel_size_nm).into_diagnostic()?);
        let show = |event| {
            if let Event::Advanced(_, done, of) = event {
                progress.show(done, of);
            }
        };
        reconstruct(&images, &geometry, &method, &show, &|slab| {
            let mut writer = writer.lock().expect("no thread panics while it holds the lock");
            Ok(writer.write_rows(slab.first_row, slab.values.view())?)
        })
        .into_diagnostic()?;
        let writer = writer.into_inner().expect("no thread panics while it holds the lock");
        writer.finish().map(drop).into_diagnostic()
    })?;
    progress.clear();

    // Takes the rounding of the way to radians and back out.
    let [least, largest] = covered.range_rad.map(|tilt| (tilt.to_degrees() * 1e6).round() / 1e6);
    let missing = covered.missing_rad.to_degrees();
    let wedge = if covered.wedge {
        format!("missing wedge of {missing:.1} degrees: what lies across it is drawn out along z")
    } else {
        format!("no missing wedge (largest step {missing:.1} degrees)")
    };
    let unit = pixel_size_nm.map_or("1 voxel is 1 px of the views".into(), |size| format!("{size} nm a voxel"));
    output::print(&format!(
        "views      {} from {least} to {largest} degrees, {wedge}\nvolume     {width} x {rows} x {} voxels, {unit}\n\
         time       {:.1} s\nwritten to {}\n",
        images.len(),
        geometry.depth,
        start.elapsed().as_secs_f64(),
        flags.output.display()
    ))
}

/// Prepared views with their tilts.
struct Views {
    images: Vec<Array2<f32>>,
    tilts_deg: Vec<f64>,
    pixel_size_nm: Option<f64>,
}

/// Reads the views that are used, one at a time.
fn read(flags: &Tomography) -> Result<Views> {
    let mut file = open(&flags.series, &ReadOptions::default()).into_diagnostic()?;
    let header = file.header().clone();
    let tilts_deg = match (&flags.tilts, header.tilts_deg) {
        (Some(text), _) => parse_tilts(text).unwrap_or_else(|error| wrong_usage(&format!("--tilts {text}: {error}"))),
        (None, Some(found)) => found.value,
        (None, None) => {
            return Err(miette!(
                "the tilts of {} are neither in it nor beside it; give them, for example --tilts=-60:60:2",
                flags.series
            ));
        }
    };
    if tilts_deg.len() != header.pages {
        return Err(miette!("{} has {} views, and {} tilts were given", flags.series, header.pages, tilts_deg.len()));
    }
    let chosen = match flags.views {
        Some(count) => evenly_spaced(&tilts_deg, count).into_diagnostic()?,
        None => (0..header.pages).collect(),
    };
    let settings = PrepareSettings { flatten_px: flags.flatten, invert: flags.invert };
    let (upright_from_image, shape) = upright([header.rows, header.columns], flags.tilt_axis.to_radians());
    let mut images = Vec::with_capacity(chosen.len());
    for page in &chosen {
        let image = file.read_page(*page).into_diagnostic()?;
        let bad = image.iter().filter(|value| !value.is_finite()).count();
        if bad > 0 {
            return Err(miette!("{}#{page} has {bad} pixels that are NaN or infinite; replace them", flags.series));
        }
        let first = image[[0, 0]];
        if image.iter().all(|value| *value == first) {
            return Err(miette!("{}#{page} is constant: every pixel is {first}; leave it out", flags.series));
        }
        images.push(prepare(&image, &upright_from_image, shape, &settings));
    }
    let pixel_size_nm = flags.pixel_size.map(|size| size.nm).or(header.pixel_size_nm.map(|found| found.value));
    Ok(Views { images, tilts_deg: chosen.iter().map(|page| tilts_deg[*page]).collect(), pixel_size_nm })
}
