//! Figures 4 to 9: series of views.

use std::collections::HashMap;
use std::path::PathBuf;

use miette::{IntoDiagnostic, Result, miette};
use ndarray::Array2;
use tiltline::dataset::{Dataset, Item};
use tiltline::figures::foil::{
    SpecimenCurve, beside_tomogram, detection, disparity, in_specimen, reprojections, true_curves,
};
use tiltline::figures::page::{Section, picture};
use tiltline::figures::views::{
    Row, Way, all_views, draw, draw_each, fit, stereo, tables, tomogram, verdict, with_pair,
};
use tiltline::figures::{sheet, stereo_pair};
use tiltline::io::read_micrograph;
use tiltline::pipeline;
use tiltline::reconstruction::Reconstruction;
use tiltline::report::{Report, figures, page};
use tiltline::score::ResultCurves;
use tiltline::series::{SavedCurves, Series, ViewLines, align, detect_lines, reproject, typical_view};
use tiltline::tomography::against_truth::KnownSeries;
use tiltline::tomography::prepare::PrepareSettings;
use tiltline::truth::Truth;

use super::{Made, Work};
use crate::report::raster;

/// Tilts of the views of Figure 7, degrees.
const SHOWN_DEG: [f64; 4] = [-44.0, -6.0, 8.0, 44.0];

/// A row of Figure 9 with its curves.
type Fitted = (Row, Vec<SpecimenCurve>);

/// One series with all that its methods share.
struct Foil<'a> {
    work: &'a Work<'a>,
    dataset: &'a Dataset,
    item: &'a Item,
    hash: String,
}

/// What takes long to read, once it is needed.
struct Loaded {
    truth: Truth,
    images: Vec<Array2<f32>>,
    series: Series,
}

impl<'a> Foil<'a> {
    fn new(work: &'a Work<'a>, dataset: &'a Dataset, item: &'a Item) -> Self {
        let hash = item.files.get(&item.truth).cloned().unwrap_or_default();
        Self { work, dataset, item, hash }
    }

    fn load(&self) -> Result<Loaded> {
        let truth = self.dataset.truth(self.item).into_diagnostic()?;
        let read = |name: &str| -> Result<Array2<f32>> {
            Ok(read_micrograph(&self.dataset.path(self.item, name).to_string_lossy()).into_diagnostic()?.pixels)
        };
        let images = truth.views.iter().map(|view| read(&view.name)).collect::<Result<_>>()?;
        let stack = self.dataset.path(self.item, "series.mrc");
        let series = Series::open(&stack.to_string_lossy(), None, &Default::default()).into_diagnostic()?;
        Ok(Loaded { truth, images, series })
    }

    fn name(&self, what: &str) -> String {
        format!("{}-{what}", self.item.name)
    }

    /// Rows of the tomograms of all numbers of views.
    fn tomograms(&self, loaded: &mut Option<Loaded>) -> Result<Vec<Row>> {
        let mut rows = Vec::new();
        let ways = [Way::Wbp, Way::Sirt];
        let jobs: Vec<(Way, usize)> =
            ways.into_iter().flat_map(|way| self.work.plan.counts.iter().map(move |count| (way, *count))).collect();
        let file = |(way, count): &(Way, usize)| self.name(&format!("{}-{count}", way.word().to_lowercase()));
        let missing = jobs.iter().any(|job| self.work.cache.get::<Row>(&file(job), &self.hash).is_none());
        let loaded = if missing { Some(self.loaded(loaded)?) } else { None };
        let known =
            loaded.map(|loaded| KnownSeries::new(&loaded.truth, &loaded.images, &PrepareSettings::dark_lines()));
        let known = known.transpose().into_diagnostic()?;
        for job in jobs {
            let (way, count) = job;
            rows.push(self.work.cache.taken(&file(&job), &self.hash, || {
                self.work.say(&format!("Figure 9: {}, {} of {count} views", self.item.name, way.word()));
                let known = known.as_ref().ok_or_else(|| miette!("a measurement has gone while it was read"))?;
                let row = tomogram(&self.item.name, known, way, count, self.item.pair).into_diagnostic()?;
                row.ok_or_else(|| miette!("{} makes no tomogram", way.word()))
            })?);
        }
        Ok(rows)
    }

    fn loaded<'b>(&self, loaded: &'b mut Option<Loaded>) -> Result<&'b Loaded> {
        if loaded.is_none() {
            *loaded = Some(self.load()?);
        }
        loaded.as_ref().ok_or_else(|| miette!("it was just loaded"))
    }

    /// Rows and curves of the pair, and of the fits of all numbers of views.
    fn stereo(&self, loaded: &mut Option<Loaded>) -> Result<Vec<Fitted>> {
        let file = |count: usize| self.name(&format!("all-views-{count}"));
        let counts: Vec<usize> =
            [2].into_iter().chain(self.work.plan.counts.iter().copied().filter(|n| *n > 2)).collect();
        let missing = counts.iter().any(|count| self.work.cache.get::<Fitted>(&file(*count), &self.hash).is_none());
        if !missing {
            return Ok(counts.iter().filter_map(|count| self.work.cache.get(&file(*count), &self.hash)).collect());
        }
        let Loaded { truth, series, .. } = self.loaded(loaded)?;
        let (config, stages) = (&self.work.config, &self.work.stages);
        let (detector, matcher) = (&*stages.detector, &*stages.matcher);
        self.work.say(&format!("Figure 9: {}, stereo", self.item.name));
        let pair = stereo_pair(self.dataset, self.item, truth, self.item.pair).into_diagnostic()?;
        let of_pair = pipeline::reconstruct(pair, detector, matcher, &config.settings, &|_| {}).into_diagnostic()?;
        let true_pair = truth.pair(self.item.pair[0], self.item.pair[1]).into_diagnostic()?;
        let beside = typical_view(series, detector).into_diagnostic()?;
        let mut lines: HashMap<usize, ViewLines> = HashMap::new();
        let mut lines_of = |view: usize| {
            if let Some(found) = lines.get(&view) {
                return Ok(found.clone());
            }
            let found = detect_lines(&series.view(view)?, beside.as_ref(), detector, &config.settings.trace);
            lines.insert(view, found.clone());
            Ok(found)
        };
        let tilts = series.tilts_deg();
        let mut fitted = Vec::new();
        for count in counts {
            fitted.push(self.work.cache.taken(&file(count), &self.hash, || {
                let chosen = if count == 2 {
                    self.item.pair.into()
                } else {
                    with_pair(&tilts, count, self.item.pair).into_diagnostic()?
                };
                self.work.say(&format!("Figure 9: {}, fit of {count} views", self.item.name));
                let result: Reconstruction =
                    fit(&of_pair, self.item.pair, series, &chosen, detector, &config.settings, &mut lines_of)
                        .into_diagnostic()?;
                let result = ResultCurves::from(&result);
                let row = match count {
                    2 => stereo(&self.item.name, truth, self.item.pair, &result),
                    _ => all_views(&self.item.name, truth, self.item.pair, &chosen, &result),
                };
                Ok((row.into_diagnostic()?, in_specimen(&result, &true_pair)))
            })?);
        }
        Ok(fitted)
    }

    /// The folder of the result of two views (by their places in the truth), reconstructed if need be.
    fn pair_folder(&self, truth: &Truth, views: [usize; 2]) -> Result<PathBuf> {
        let names = views.map(|view| truth.views[view].name.clone());
        let images = names.map(|name| self.dataset.path(self.item, &name).to_string_lossy().into_owned());
        let mut config = self.work.config.clone();
        let pair = truth.pair(views[0], views[1]).into_diagnostic()?;
        let tilts = pair.tilts.ok_or_else(|| miette!("{} has no tilts", self.item.name))?;
        let tilts = [tilts.left_rad, tilts.right_rad].map(|tilt| (tilt.to_degrees() * 1e6).round() / 1e6);
        config.acquisition.tilts_deg = Some(tilts);
        let stages = &self.work.stages;
        let key = &self.hash.get(..12).unwrap_or("unknown");
        let method = stages.names.join("-").replace(' ', "-");
        let folder = self.work.folder.join("pairs");
        std::fs::create_dir_all(&folder).into_diagnostic()?;
        let folder = folder.join(format!("{}-{}-{}-{key}-{method}", self.item.name, views[0], views[1]));
        if !folder.join("run.toml").is_file() {
            self.work.say(&format!("reconstructing {} at {} and {} degrees", self.item.name, tilts[0], tilts[1]));
            let images = [images[0].as_str(), images[1].as_str()];
            crate::reconstruct::reconstruct(images, &mut config, stages, &folder, true, &|_| {})?;
        }
        Ok(folder)
    }
}

/// Figure 9.
pub fn views(work: &Work<'_>, dataset: &Dataset) -> Result<Made> {
    let mut rows = Vec::new();
    for item in &dataset.manifest.items {
        let foil = Foil::new(work, dataset, item);
        let mut loaded = None;
        rows.extend(foil.stereo(&mut loaded)?.into_iter().map(|(row, _)| row));
        rows.extend(foil.tomograms(&mut loaded)?);
    }
    let verdicts: Vec<String> =
        [Way::Sirt, Way::Wbp, Way::Stereo].into_iter().filter_map(|other| verdict(&rows, other)).collect();
    let counts: Vec<String> = work.plan.counts.iter().map(usize::to_string).collect();
    let caption = format!(
        "Curves of tomograms (WBP; SIRT of 30 iterations) of {} evenly spaced views, of two-view stereo, and of the fit of curves to all views, \
         on the {} series of `{}`; the same foils and the same scores (end to end, as those of the pair at -4 and 4 degrees). \
         Tomograms are given from the truth what a user must estimate or choose: alignment, tilts, depth, and the threshold with the best \
         F-score. Stereo and the fit estimate everything themselves; the fit sees as many views as the tomogram, evenly spaced but for the two \
         nearest to the pair's, which are moved there. Mean distance in 3D is that of what was found. The paper gives no numbers; it says \
         that stereo is ahead where there are few views. {}",
        counts.join(", "),
        dataset.manifest.items.len(),
        dataset.manifest.name.clone().unwrap_or_default(),
        verdicts.join(" ")
    );
    let body = format!(
        "{}\n{}\n{}",
        picture("figure-9", "Scores against the number of views"),
        picture("figure-9-series", "F-score against the number of views, each series"),
        tables(&rows)
    );
    let section = Section { heading: "Figure 9: against the number of views".into(), caption, body };
    let files = vec![
        ("figure-9.png".into(), raster(&draw(&rows))?),
        ("figure-9-series.png".into(), raster(&draw_each(&rows))?),
    ];
    Ok(Made { section, files })
}

/// Figures 4 to 8.
pub fn foil(work: &Work<'_>, dataset: &Dataset) -> Result<Vec<Made>> {
    let item = dataset.manifest.items.iter().find(|item| item.name == work.plan.shown);
    let item = item.ok_or_else(|| miette!("{} is not in {}", work.plan.shown, dataset.folder.display()))?;
    let foil = Foil::new(work, dataset, item);
    let loaded = foil.load()?;
    let tilts = loaded.series.tilts_deg();
    let nearest = |wanted: f64| {
        let off = |view: &usize| (tilts[*view] - wanted).abs();
        (0..tilts.len()).min_by(|a, b| off(a).total_cmp(&off(b))).unwrap_or(0)
    };
    let tilt = |view: usize| tilts[view];
    let four = [nearest(-2.0), nearest(2.0)];
    let folder = foil.pair_folder(&loaded.truth, four)?;
    let read = |name: &str| std::fs::read_to_string(folder.join(name)).into_diagnostic();
    let report = page::read(&read("report.html")?).into_diagnostic()?;
    let name = &item.name;
    let angle = tilt(four[1]) - tilt(four[0]);
    let mut made = vec![detected(&foil, &loaded, &folder, four[0])?];
    made.push(Made {
        section: Section {
            heading: "Figure 5: disparity".into(),
            caption: format!(
                "Disparity of the lines of Figure 4, from a pair {angle:.0} degrees apart ({:+} and {:+}; the paper's is 4 degrees apart).",
                tilt(four[0]),
                tilt(four[1])
            ),
            body: picture("figure-5", "Disparity of the lines"),
        },
        files: vec![("figure-5.png".into(), raster(&disparity(&report))?)],
    });
    made.push(projections(&report, angle)?);
    made.push(reprojected(&foil, &loaded, SHOWN_DEG.map(nearest))?);
    made.push(tomography(&foil, loaded, [nearest(0.0), nearest(2.0)])?);
    for made in &mut made {
        made.section.caption += &format!(" Foil: `{name}`.");
    }
    Ok(made)
}

fn detected(foil: &Foil<'_>, loaded: &Loaded, folder: &std::path::Path, view: usize) -> Result<Made> {
    let truth = &loaded.truth.views[view];
    let image = loaded.series.view(view).into_diagnostic()?;
    let map = read_micrograph(&folder.join("lines_left.png").to_string_lossy()).into_diagnostic()?.pixels / 255.0;
    let canvas = detection(&image, &map, &loaded.truth, truth);
    let caption = format!(
        "(a) The view at {:+} degrees; (b) what the detector finds in it, dark where it is sure; (c) the true lines, grey where they do not stand \
         out from noise and texture. The paper's Figure 4 shows (a) and (b) of an ABF-STEM image of TiAl.",
        loaded.series.views[view].tilt_deg
    );
    let section = Section {
        heading: "Figure 4: detection".into(),
        caption,
        body: picture("figure-4", "Image, line probability, true lines"),
    };
    foil.work.say("Figure 4");
    Ok(Made { section, files: vec![("figure-4.png".into(), sheet::png(&canvas).into_diagnostic()?)] })
}

fn projections(report: &Report, angle: f64) -> Result<Made> {
    let figure = figures::all(report).into_iter().find(|figure| figure.name == "projections");
    let (body, files) = match figure {
        Some(figure) => (
            picture("figure-6", "The curves along the beam, along x and edge on"),
            vec![("figure-6.png".into(), raster(&figure.svg)?)],
        ),
        None => ("No curve was found.".into(), Vec::new()),
    };
    let caption = format!(
        "The curves of the same pair, {angle:.0} degrees apart, in 3D: along the beam, along x, and edge on. The error of depth is large at so small an \
         angle (Table 1)."
    );
    Ok(Made { section: Section { heading: "Figure 6: 3D reconstruction".into(), caption, body }, files })
}

fn reprojected(foil: &Foil<'_>, loaded: &Loaded, mut views: [usize; 4]) -> Result<Made> {
    let Foil { work, item, .. } = foil;
    let folder = foil.pair_folder(&loaded.truth, item.pair)?;
    views.sort_unstable();
    let curves = SavedCurves::read(&folder).into_diagnostic()?;
    let heading = "Figure 7: in other views".to_owned();
    if curves.curves.is_empty() {
        let section = Section { heading, caption: String::new(), body: "No curve was found.".into() };
        return Ok(Made { section, files: Vec::new() });
    }
    work.say("Figure 7");
    let aligned = align(&loaded.series, curves.poses[0].axis_rad(), &|_, _| ()).into_diagnostic()?;
    // The pose of a view is looked for from its neighbour's: those between are needed too.
    let all: Vec<usize> = (0..loaded.series.views.len()).collect();
    let (detector, trace) = (&*work.stages.detector, &work.config.settings.trace);
    let beside = typical_view(&loaded.series, detector).into_diagnostic()?;
    let mut lines_of = |view: usize| Ok(detect_lines(&loaded.series.view(view)?, beside.as_ref(), detector, trace));
    let found = reproject(&curves, &loaded.series, &aligned, &all, &mut lines_of).into_diagnostic()?;
    let mut shown = Vec::new();
    let mut words = Vec::new();
    for view in found.views.iter().filter(|view| views.contains(&view.view)) {
        shown.push((view, loaded.series.view(view.view).into_diagnostic()?));
        words.push(match &view.distances {
            Some(distances) => format!(
                "{:+} degrees: median {:.1} px, {:.0} % within 2 px and {:.0} % within 5 px ({:.0} % within 3 px would be by chance){}",
                view.tilt_deg,
                distances.median_px,
                100.0 * distances.within_2px,
                100.0 * distances.within_5px,
                100.0 * distances.chance_within_3px,
                if view.supported { "" } else { ", pose not supported" }
            ),
            None => format!("{:+} degrees: no lines", view.tilt_deg),
        });
    }
    let closed: Vec<bool> = curves.curves.iter().map(|curve| curve.closed).collect();
    let canvas = reprojections(&shown, &closed, &loaded.truth);
    let [left, right] = item.pair.map(|view| loaded.series.views[view].tilt_deg);
    let caption = format!(
        "Curves of the pair at {left:+} and {right:+} degrees, re-projected (green) into views that they were not made from; below, the true lines \
         there (grey: hidden in noise). Each view's shift, turn and magnification are fitted to its lines first. Distance of re-projected points to the nearest detected line: {}. The paper's views are at -44, -6.39, +8 and \
         +44 degrees, its pair is 8 degrees apart too.",
        words.join("; ")
    );
    let section = Section { heading, caption, body: picture("figure-7", "Re-projections into four views") };
    Ok(Made { section, files: vec![("figure-7.png".into(), sheet::png(&canvas).into_diagnostic()?)] })
}

fn tomography(foil: &Foil<'_>, loaded: Loaded, narrow: [usize; 2]) -> Result<Made> {
    let Foil { work, item, .. } = foil;
    let most = work.plan.counts.iter().copied().max().unwrap_or(2);
    let folder = foil.pair_folder(&loaded.truth, narrow)?;
    let mut loaded = Some(loaded);
    let fitted = foil.stereo(&mut loaded)?;
    let of = |views: usize| fitted.iter().find(|(row, _)| row.views == views).map(|fitted| fitted.1.clone());
    work.say("Figure 8");
    let Loaded { truth, images, .. } = foil.loaded(&mut loaded)?;
    let known = KnownSeries::new(truth, images, &PrepareSettings::dark_lines()).into_diagnostic()?;
    let sirt = Way::Sirt.tomography().ok_or_else(|| miette!("SIRT makes a tomogram"))?;
    let (volume, geometry, _) = known.tomogram(most, &sirt).into_diagnostic()?;
    let pair = truth.pair(narrow[0], narrow[1]).into_diagnostic()?;
    let narrow_curves = in_specimen(&ResultCurves::read(&folder).into_diagnostic()?, &pair);
    let visible = true_curves(&truth.pair(item.pair[0], item.pair[1]).into_diagnostic()?);
    let captions =
        ["true lines".to_owned(), "stereo, 2\u{b0}".into(), "stereo, 8\u{b0}".into(), format!("fit, {most} views")];
    let [first, second, third, fourth] = &captions;
    let results = [
        (first.as_str(), visible),
        (second.as_str(), narrow_curves),
        (third.as_str(), of(2).unwrap_or_default()),
        (fourth.as_str(), of(most).unwrap_or_default()),
    ];
    let canvas = beside_tomogram(&volume, &geometry, &known, &results);
    let caption = format!(
        "SIRT of {most} views (grey: largest values along the beam and, below, along the tilt axis) and, over it, the true lines that are visible in the \
         pair (blue), stereo of two views 2 degrees apart as in the paper, of the pair 8 degrees apart, and the fit of curves to {most} views (yellow)."
    );
    let section = Section {
        heading: "Figure 8: beside a tomogram".into(),
        caption,
        body: picture("figure-8", "Curves over a tomogram"),
    };
    Ok(Made { section, files: vec![("figure-8.png".into(), sheet::png(&canvas).into_diagnostic()?)] })
}
