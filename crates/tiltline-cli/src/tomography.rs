//! `tiltline tomography wbp|sirt`: a volume from a tilt series.

use std::path::PathBuf;
use std::sync::Mutex;
use std::time::Instant;

use clap::{Args, ValueEnum};
use miette::{IntoDiagnostic, Result, miette};
use ndarray::{Array2, s};
use tiltline::export::mrc_volume::VolumeWriter;
use tiltline::io::{ReadOptions, xf as transforms};
use tiltline::progress::Event;
use tiltline::series::{AlignedSeries, Series, align};
use tiltline::tomography::prepare::{PrepareSettings, prepare, upright, upright_from_projection};
use tiltline::tomography::{Filter, Geometry, Method, SirtSettings, WbpSettings, coverage, evenly_spaced, reconstruct};
use tiltline::warning::Warning;

use crate::args::Verbosity;
use crate::compared::{Compared, volume_in_memory};
use crate::interrupt;
use crate::output;
use crate::progress::Count;
use crate::quantity::{PixelSize, short};
use crate::reconstruct::wrong_usage;

/// Flags of `tiltline tomography`.
#[derive(Debug, Args)]
pub struct Tomography {
    /// How the volume is made.
    pub method: Kind,
    /// The series: a stack (MRC, ST, TIFF) with its tilts, or a folder of images.
    pub series: String,
    /// The volume, MRC of 32-bit floats (docs/formats.md).
    #[arg(short, long, value_name = "FILE")]
    pub output: PathBuf,
    /// Tilts in degrees, one a view: LIST, START:END:STEP, or a FILE (.tlt, .rawtlt, .mdoc; for a folder also .csv).
    #[arg(long, value_name = "LIST|START:END:STEP|FILE", allow_hyphen_values = true)]
    pub tilts: Option<String>,
    /// Use only so many views, evenly spaced from the least tilt to the largest.
    #[arg(long = "use", value_name = "COUNT")]
    pub views: Option<usize>,
    /// How the views lie on each other: IMOD's .xf (one line a section), or auto for phase correlation. Without it they are
    /// taken to be aligned.
    #[arg(long, value_name = "FILE.xf|auto")]
    pub align: Option<String>,
    /// Compare with the curves of a result of this series, and show both in its report. Aligns by what `tiltline reproject` wrote
    /// into its reprojection/ or a fit to all views beside it; --align FILE.xf names that of a re-projection elsewhere.
    #[arg(long, value_name = "RESULT")]
    pub compare: Option<PathBuf>,
    /// Direction of the tilt axis, degrees clockwise on the screen from image y (0 vertical, 90 horizontal); an .xf says its own
    /// [default: 0].
    #[arg(long, value_name = "DEGREES", allow_hyphen_values = true)]
    pub tilt_axis: Option<f64>,
    /// How far the tilt axis lies beside the middle of the views, px to the right once it is upright.
    #[arg(long, value_name = "PX", default_value_t = 0.0, allow_hyphen_values = true)]
    pub axis_offset: f64,
    /// Layers of the volume [default: as many as it is wide; with --compare as many as the curves need].
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
    for (name, value) in [("--tilt-axis", flags.tilt_axis.unwrap_or(0.0)), ("--axis-offset", flags.axis_offset)] {
        if !value.is_finite() {
            wrong_usage(&format!("{name} {value} is not a number"));
        }
    }
    let has_axis = flags.tilt_axis.is_some() && flags.align.as_deref() != Some("auto");
    if has_axis && (flags.align.is_some() || flags.compare.is_some()) {
        wrong_usage("--tilt-axis is not for views aligned by an .xf, which says where the axis lies");
    }
    if flags.compare.is_some() && (flags.align.as_deref() == Some("auto") || flags.axis_offset != 0.0) {
        wrong_usage(
            "--compare needs the alignment that was refined on the curves: that of `tiltline reproject`, without --align auto and \
             --axis-offset",
        );
    }
    if let Some(sigma) = flags.flatten.filter(|sigma| !(*sigma > 0.0 && sigma.is_finite())) {
        wrong_usage(&format!("--flatten {sigma} is not a positive number of px"));
    }
    if flags.output.exists() && !flags.force {
        return Err(miette!("{} is there already; name another file, or give --force", flags.output.display()));
    }
    let start = Instant::now();
    let result = flags.compare.as_deref().map(Compared::read).transpose()?;
    let Views { series, images, tilts_deg, pixel_size_nm, warnings } = read(flags, result.as_ref())?;
    let tilts_rad: Vec<f64> = tilts_deg.iter().map(|tilt| tilt.to_radians()).collect();
    let covered = coverage(&tilts_rad).into_diagnostic()?;
    let (rows, width) = images[0].dim();
    let depth = flags.depth.or(result.as_ref().map(Compared::depth)).unwrap_or(width);
    let mut geometry = Geometry::centred(tilts_rad, width, depth);
    geometry.axis_column += flags.axis_offset;
    let whole = result.as_ref().map(|_| volume_in_memory([geometry.depth, rows, width])).transpose()?.map(Mutex::new);

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
            if let Some(whole) = &whole {
                let last = slab.first_row + slab.values.dim().1;
                let mut whole = whole.lock().expect(LOCK);
                whole.slice_mut(s![.., slab.first_row..last, ..]).assign(&slab.values);
            }
            Ok(writer.lock().expect(LOCK).write_rows(slab.first_row, slab.values.view())?)
        })
        .into_diagnostic()?;
        let writer = writer.into_inner().expect(LOCK);
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
    let unit =
        pixel_size_nm.map_or("1 voxel is 1 px of the views".into(), |size| format!("{} nm a voxel", short(size)));
    let compared = match (result, whole) {
        (Some(result), Some(whole)) => {
            let method = format!("{}, {} views from {least} to {largest} degrees", named(&method), images.len());
            result.report(&whole.into_inner().expect(LOCK), &geometry, method, &series)
        }
        _ => String::new(),
    };
    let warnings: String = warnings.iter().map(|warning| format!("warning    {warning}\n")).collect();
    output::print(&format!(
        "views      {} from {least} to {largest} degrees, {wedge}\nvolume     {width} x {rows} x {} voxels, {unit}\n\
         time       {:.1} s\n{compared}{warnings}written to {}\n",
        images.len(),
        geometry.depth,
        start.elapsed().as_secs_f64(),
        flags.output.display()
    ))
}

const LOCK: &str = "no thread panics while it holds the lock";

fn named(method: &Method) -> String {
    match method {
        Method::Wbp(_) => "weighted back projection".into(),
        Method::Sirt(settings) => format!("SIRT, {} iterations", settings.iterations),
    }
}

/// Prepared views with their tilts.
struct Views {
    series: Series,
    images: Vec<Array2<f32>>,
    tilts_deg: Vec<f64>,
    pixel_size_nm: Option<f64>,
    warnings: Vec<Warning>,
}

/// Reads the views that are used, one at a time.
fn read(flags: &Tomography, result: Option<&Compared>) -> Result<Views> {
    let shared = match (result, &flags.align) {
        (Some(result), None) => Some(result.alignment()?),
        _ => None,
    };
    let fitted_tilts = shared.as_ref().and_then(|shared| shared.tilts.as_deref());
    let tilts = flags.tilts.as_deref().or(fitted_tilts);
    let series = Series::open(&flags.series, tilts, &ReadOptions::default()).into_diagnostic()?;
    let tilts_deg = series.tilts_deg();
    let chosen = match flags.views {
        Some(count) => evenly_spaced(&tilts_deg, count).into_diagnostic()?,
        None => (0..tilts_deg.len()).collect(),
    };
    let settings = PrepareSettings { flatten_px: flags.flatten, invert: flags.invert };
    let axis_rad = flags.tilt_axis.unwrap_or(0.0).to_radians();
    let aligned = match (flags.align.as_deref(), &shared) {
        (Some("auto"), _) => Some(align(&series, axis_rad, &|_, _| ()).into_diagnostic()?),
        (Some(file), _) => Some(alignment(&series, file)?),
        (None, Some(shared)) => Some(alignment(&series, &shared.transforms)?),
        (None, None) => None,
    };
    let axis_rad = aligned.as_ref().map_or(axis_rad, |aligned| aligned.axis_rad);
    let (upright_from_image, shape) = upright(series.shape, axis_rad);
    let mut images = Vec::with_capacity(chosen.len());
    for view in &chosen {
        let image = series.view(*view).into_diagnostic()?.pixels;
        let first = image[[0, 0]];
        if image.iter().all(|value| *value == first) {
            let spec = &series.views[*view].spec;
            return Err(miette!("{spec} is constant: every pixel is {first}; leave it out"));
        }
        let map = aligned.as_ref().map_or(upright_from_image, |aligned| {
            upright_from_projection(shape) * aligned.poses[*view].image_from_projection.inverse()
        });
        images.push(prepare(&image, &map, shape, &settings));
    }
    let pixel_size_nm = flags.pixel_size.map(|size| size.nm).or(series.pixel_size.as_ref().map(|(size, _)| *size));
    let tilts_deg = chosen.iter().map(|view| tilts_deg[*view]).collect();
    let mut warnings = series.warnings.clone();
    warnings.extend(aligned.into_iter().flat_map(|aligned| aligned.warnings));
    Ok(Views { series, images, tilts_deg, pixel_size_nm, warnings })
}

fn alignment(series: &Series, file: &str) -> Result<AlignedSeries> {
    let read = transforms::read(file).into_diagnostic()?;
    AlignedSeries::from_transforms(series, &read, file).into_diagnostic()
}
