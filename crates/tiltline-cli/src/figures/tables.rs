//! Tables 1 and 3, Figures 10 and 11.

use miette::{IntoDiagnostic, Result};
use tiltline::dataset::{Dataset, Item};
use tiltline::figures::page::{Section, picture};
use tiltline::figures::sheet::{self, Panel, Size};
use tiltline::figures::{angles, images, stereo_pair};
use tiltline::io::read_micrograph;

use super::{Made, Work};
use crate::progress::Count;
use crate::report::raster;

/// Table 1.
pub fn angles(work: &Work<'_>, dataset: &Dataset) -> Result<Made> {
    work.say("Table 1");
    let count = Count::new("reconstructing", work.flags.verbosity);
    let items = &dataset.manifest.items;
    let mut rows: Vec<angles::Row> = Vec::new();
    for (index, item) in items.iter().enumerate() {
        count.show(index, items.len());
        rows.push(work.cache.taken(&format!("angles-{}", item.name), &key(item), || {
            let truth = dataset.truth(item).into_diagnostic()?;
            let pair = stereo_pair(dataset, item, &truth, item.pair).into_diagnostic()?;
            let truth = truth.pair(item.pair[0], item.pair[1]).into_diagnostic()?;
            let (detector, matcher) = (&*work.stages.detector, &*work.stages.matcher);
            angles::measure(&item.name, pair, &truth, detector, matcher, &work.config.settings).into_diagnostic()
        })?);
    }
    count.clear();
    let caption = format!(
        "Error of depth for different angles between the views, raw and refined: {} pairs of `{}`, the same foils at every angle, by the paper's \
         protocol; pooled by length over what was predicted (coverage says how much). Depth error is EPE / (2 sin(phi / 2)).",
        items.len(),
        name(dataset)
    );
    let body = format!(
        "{}\n{}",
        angles::table(&rows),
        picture("table-1", "Depth error and end-point error against the angle")
    );
    let section = Section { heading: "Table 1: angles, raw and refined".into(), caption, body };
    Ok(Made { section, files: vec![("table-1.png".into(), raster(&angles::draw(&rows))?)] })
}

/// Figures 10 and 11, Table 3.
pub fn images(work: &Work<'_>, training: &Dataset, scored: &Dataset) -> Result<Vec<Made>> {
    work.say("Figures 10 and 11, Table 3");
    let shown = images::shown(&training.manifest);
    let mut panels = Vec::new();
    for item in &shown {
        let truth = training.truth(item).into_diagnostic()?;
        let image = read_micrograph(&training.path(item, &truth.views[0].name).to_string_lossy()).into_diagnostic()?;
        let caption = item.name.rsplit_once('-').map_or(item.name.clone(), |(kind, _)| kind.to_owned());
        panels.push(Panel { caption, canvas: sheet::drawn(&image.normalised(), Size::Half, &[], 1.0) });
    }
    let samples = Made {
        section: Section {
            heading: "Figure 10: samples".into(),
            caption: format!(
                "Images as networks are trained on: of each family one that is drawn and one by two-beam diffraction, from `{}` (training split). The \
                 paper shows four of its 90 labelled pairs.",
                name(training)
            ),
            body: picture("figure-10", "Training images"),
        },
        files: vec![("figure-10.png".into(), sheet::png(&sheet::sheet(&panels, 4)).into_diagnostic()?)],
    };
    let rows = statistics(work, training)?;
    let distribution = Made {
        section: Section {
            heading: "Figure 11: signal and contrast of the training images".into(),
            caption: format!(
                "Signal-to-noise ratio of lines and background and contrast of {} training images, measured as in Table 3 (truth.md says how).",
                rows.len()
            ),
            body: picture("figure-11", "Histograms of signal-to-noise ratio and contrast"),
        },
        files: vec![("figure-11.png".into(), raster(&images::draw(&rows))?)],
    };
    let rows = statistics(work, scored)?;
    let table = Made {
        section: Section {
            heading: "Table 3: signal and contrast of the scored images".into(),
            caption: format!("Means over the left images of `{}`; the paper's in square brackets.", name(scored)),
            body: images::table(&rows),
        },
        files: Vec::new(),
    };
    Ok(vec![samples, distribution, table])
}

fn statistics(work: &Work<'_>, dataset: &Dataset) -> Result<Vec<images::Row>> {
    let measure = |item: &Item| {
        work.cache.taken(&format!("statistics-{}-{}", name(dataset), item.name), &key(item), || {
            let truth = dataset.truth(item).into_diagnostic()?;
            let view = &truth.views[item.pair[0]];
            let image = read_micrograph(&dataset.path(item, &view.name).to_string_lossy()).into_diagnostic()?;
            images::measure(&item.name, &image.pixels, &truth, view).into_diagnostic()
        })
    };
    dataset.manifest.items.iter().map(measure).collect()
}

/// What a measurement of an item depends on.
fn key(item: &Item) -> String {
    item.files.get(&item.truth).cloned().unwrap_or_default()
}

fn name(dataset: &Dataset) -> String {
    dataset.manifest.name.clone().unwrap_or_default()
}
