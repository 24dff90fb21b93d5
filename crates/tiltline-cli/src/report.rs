//! `tiltline report`: the page of a result once more, and its figures as SVG and PNG.

use std::io::Write;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use miette::{IntoDiagnostic, Result, WrapErr, miette};
use resvg::tiny_skia::{Pixmap, Transform};
use resvg::usvg::{Options, Tree, fontdb};
use tiltline::export::Staging;
use tiltline::report::{figures, page};

use crate::args::Report;
use crate::interrupt;
use crate::output;

/// Name of the page in a result's folder.
const REPORT: &str = "report.html";
/// Resolution of the PNG figures; journals ask for 300.
const DOTS_PER_INCH: f32 = 300.0;
/// The only font of the PNG figures, so that they are the same on every machine.
const FONT: &[u8] = include_bytes!("../assets/DejaVuSans-subset.ttf");

/// The page of a result: a folder's, or the file itself.
pub fn report_in(result: &Path) -> Result<PathBuf> {
    let path = if result.is_dir() { result.join(REPORT) } else { result.to_owned() };
    if path.is_file() {
        return Ok(path);
    }
    Err(miette!("there is no {}: name a folder that `tiltline reconstruct` wrote, or a {REPORT}", path.display()))
}

/// Changes the report in a result's folder. Returns whether there is one.
pub fn update(folder: &Path, change: impl FnOnce(&mut tiltline::report::Report)) -> Result<bool> {
    let path = if folder.is_dir() { folder.join(REPORT) } else { folder.with_file_name(REPORT) };
    if !path.is_file() {
        return Ok(false);
    }
    let mut report = read(&path)?;
    change(&mut report);
    write(&path, &report)?;
    Ok(true)
}

/// Makes sure that the report in a result's folder, if there is one, can be read and so changed.
pub fn check(folder: &Path) -> Result<()> {
    let path = folder.join(REPORT);
    if path.is_file() { read(&path).map(drop) } else { Ok(()) }
}

fn read(path: &Path) -> Result<tiltline::report::Report> {
    let text =
        std::fs::read_to_string(path).into_diagnostic().wrap_err_with(|| format!("cannot read {}", path.display()))?;
    page::read(&text).into_diagnostic().wrap_err_with(|| format!("in {}", path.display()))
}

fn write(path: &Path, report: &tiltline::report::Report) -> Result<()> {
    let page = page::write(report).into_diagnostic()?;
    interrupt::write_file(path, |file| file.write_all(page.as_bytes()).into_diagnostic())
}

/// Runs the command.
pub fn run(flags: &Report) -> Result<()> {
    let path = report_in(&flags.result)?;
    let report = read(&path)?;
    let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    write(&path, &report)?;
    let mut written = vec![path.clone()];
    if flags.png {
        let staging = Staging::begin(&folder.join("figures"), true).into_diagnostic()?;
        let mut names = Vec::new();
        for figure in figures::all(&report) {
            let png = raster(&figure.svg)?;
            for (extension, content) in [("svg", figure.svg.as_bytes()), ("png", &png)] {
                let name = format!("{}.{extension}", figure.name);
                staging.write(&name, |out| out.write_all(content)).into_diagnostic()?;
                names.push(name);
            }
        }
        written.extend(staging.commit(names.iter().map(String::as_str)).into_diagnostic()?);
    }
    let lines: Vec<String> = written.iter().map(|path| format!("{}\n", path.display())).collect();
    output::print(&lines.concat())
}

/// A figure as PNG at [`DOTS_PER_INCH`].
pub fn raster(svg: &str) -> Result<Vec<u8>> {
    let mut fonts = fontdb::Database::new();
    fonts.load_font_data(FONT.to_vec());
    fonts.set_sans_serif_family("DejaVu Sans");
    let options = Options { fontdb: Arc::new(fonts), dpi: DOTS_PER_INCH, ..Options::default() };
    let tree = Tree::from_str(svg, &options).into_diagnostic()?;
    let size = tree.size();
    let (width, height) = (size.width().round() as u32, size.height().round() as u32);
    let mut pixels =
        Pixmap::new(width, height).ok_or_else(|| miette!("a figure of {width} x {height} px is too large"))?;
    resvg::render(&tree, Transform::identity(), &mut pixels.as_mut());
    with_resolution(&pixels.encode_png().into_diagnostic()?)
}

/// Puts the resolution into a PNG (chunk pHYs, W3C PNG section 11.3.4.3), after the header, so that it prints at its size.
fn with_resolution(png: &[u8]) -> Result<Vec<u8>> {
    // Signature and the header's chunk.
    const HEADER: usize = 8 + 25;
    let per_metre = (f64::from(DOTS_PER_INCH) / 0.0254).round() as u32;
    let mut chunk = b"pHYs".to_vec();
    chunk.extend(per_metre.to_be_bytes());
    chunk.extend(per_metre.to_be_bytes());
    chunk.push(1);
    let (header, rest) = png.split_at_checked(HEADER).ok_or_else(|| miette!("the PNG encoder wrote no header"))?;
    Ok([header, &9_u32.to_be_bytes(), &chunk, &crc32(&chunk).to_be_bytes(), rest].concat())
}

/// CRC of PNG chunks (ISO 3309).
fn crc32(bytes: &[u8]) -> u32 {
    !bytes.iter().fold(u32::MAX, |crc, byte| {
        (0..8).fold(crc ^ u32::from(*byte), |crc, _| (crc >> 1) ^ (0xEDB8_8320 & (crc & 1).wrapping_neg()))
    })
}
