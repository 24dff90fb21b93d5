//! Figure 9: tomograms and stereo against the number of views, and the fit of curves to all views.
//!
//! All methods see the same foils, and their curves are scored alike, as those of one stereo pair ([`crate::score`], end to end).
//! *Tomograms* get evenly spaced views, which suit them best, and from the truth everything that a user must estimate or choose:
//! alignment, tilts, depth and the threshold with the best F-score. *Stereo* gets two views, nothing else. *All views* gets as many
//! views as the tomogram, evenly spaced but for two that are moved to the pair ([`with_pair`]), and estimates everything itself.

use std::fmt::Write;

use serde::{Deserialize, Serialize};

use super::FiguresError;
use super::chart::{Line, Panel, lines};
use crate::pipeline::Detect;
use crate::reconstruction::Reconstruction;
use crate::score::{PairScore, ResultCurve, ResultCurves, ResultPoint, ScoreSettings, score_pair};
use crate::series::{Series, SeriesError, ViewLines, align, reconstruct_series};
use crate::settings::Settings;
use crate::tomography::against_truth::KnownSeries;
use crate::tomography::{Method, SirtSettings, WbpSettings, evenly_spaced};
use crate::truth::{Truth, TruthPair};

/// Numbers of views of the published figure.
pub const COUNTS: [usize; 7] = [2, 3, 5, 9, 15, 25, 45];

/// What makes curves of a series.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Way {
    /// Weighted back projection.
    Wbp,
    /// Simultaneous iterative reconstruction technique.
    Sirt,
    /// One stereo pair.
    Stereo,
    /// Curves fitted to all views.
    AllViews,
}

impl Way {
    /// All of them, in the order of the tables.
    pub const ALL: [Way; 4] = [Way::Wbp, Way::Sirt, Way::Stereo, Way::AllViews];

    /// For tables and charts.
    pub fn word(self) -> &'static str {
        match self {
            Way::Wbp => "WBP",
            Way::Sirt => "SIRT",
            Way::Stereo => "two-view stereo",
            Way::AllViews => "all views",
        }
    }

    /// The tomogram's method; none for curves without a volume.
    pub fn tomography(self) -> Option<Method> {
        match self {
            Way::Wbp => Some(Method::Wbp(WbpSettings::default())),
            Way::Sirt => Some(Method::Sirt(SirtSettings::default())),
            Way::Stereo | Way::AllViews => None,
        }
    }

    fn colour(self) -> &'static str {
        // Told apart by the colour-blind (Okabe & Ito 2008).
        match self {
            Way::Wbp => "#e69f00",
            Way::Sirt => "#d55e00",
            Way::Stereo => "#000000",
            Way::AllViews => "#0072b2",
        }
    }
}

/// Scores of the curves that one way made of some views of one series.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Row {
    /// Name of the series.
    pub series: String,
    /// The way.
    pub way: Way,
    /// How many views it was given.
    pub views: usize,
    /// Their tilts, degrees.
    pub tilts_deg: Vec<f64>,
    /// Share of the visible true length that was found.
    pub completeness: f64,
    /// Share of the found length that is right.
    pub correctness: Option<f64>,
    /// Harmonic mean of both.
    pub f_score: f64,
    /// Mean distance in 3D of what was matched, in the unit of the truth.
    pub mean_distance: Option<f64>,
    /// Visible true length, px.
    pub truth_px: f64,
    /// Found length, px.
    pub result_px: f64,
}

impl Row {
    fn new(series: &str, way: Way, tilts_deg: Vec<f64>, score: &PairScore) -> Self {
        let score = &score.end_to_end;
        Self {
            series: series.into(),
            way,
            views: tilts_deg.len(),
            tilts_deg,
            completeness: score.completeness,
            correctness: score.correctness,
            f_score: score.f_score,
            mean_distance: score.distance.map(|distance| distance.mean),
            truth_px: score.truth_length_px,
            result_px: score.result_length_px,
        }
    }
}

/// `count` views, evenly spaced from the least tilt to the largest but for the two nearest to those of `pair`, which are moved there;
/// in the order of their tilts.
///
/// # Errors
/// As for [`evenly_spaced`].
pub fn with_pair(tilts: &[f64], count: usize, pair: [usize; 2]) -> Result<Vec<usize>, FiguresError> {
    let mut chosen = evenly_spaced(tilts, count)?;
    for wanted in pair {
        if !chosen.contains(&wanted) {
            let movable = (0..count).filter(|place| !pair.contains(&chosen[*place]));
            let off = |place: &usize| (tilts[chosen[*place]] - tilts[wanted]).abs();
            if let Some(nearest) = movable.min_by(|a, b| off(a).total_cmp(&off(b))) {
                chosen[nearest] = wanted;
            }
        }
    }
    chosen.sort_by(|a, b| tilts[*a].total_cmp(&tilts[*b]));
    Ok(chosen)
}

/// The curves of a tomogram of `count` evenly spaced views; `None` for ways without a tomogram.
///
/// # Errors
/// Where the series cannot be judged.
pub fn tomogram(
    name: &str,
    known: &KnownSeries<'_>,
    way: Way,
    count: usize,
    pair: [usize; 2],
) -> Result<Option<Row>, FiguresError> {
    let Some(method) = way.tomography() else { return Ok(None) };
    let judged = known.judge(count, &method, pair)?;
    Ok(Some(Row::new(name, way, judged.tilts_deg, &judged.score)))
}

/// The score of a pair's curves.
///
/// # Errors
/// Where they cannot be scored.
pub fn stereo(name: &str, truth: &Truth, pair: [usize; 2], result: &ResultCurves) -> Result<Row, FiguresError> {
    scored(name, Way::Stereo, truth, pair, &pair, result)
}

/// The score of curves of all the views `chosen`.
///
/// # Errors
/// Where they cannot be scored.
pub fn all_views(
    name: &str,
    truth: &Truth,
    pair: [usize; 2],
    chosen: &[usize],
    result: &ResultCurves,
) -> Result<Row, FiguresError> {
    scored(name, Way::AllViews, truth, pair, chosen, result)
}

fn scored(
    name: &str,
    way: Way,
    truth: &Truth,
    pair: [usize; 2],
    chosen: &[usize],
    result: &ResultCurves,
) -> Result<Row, FiguresError> {
    let true_pair = truth.pair(pair[0], pair[1])?;
    let score = score_pair(name, &in_both(result, &true_pair), &true_pair, &ScoreSettings::default())?;
    let tilt = |view: &usize| truth.views[*view].tilt_rad.map(|rad| (rad.to_degrees() * 1e6).round() / 1e6);
    let tilts = chosen.iter().map(tilt).collect::<Option<Vec<f64>>>();
    let tilts_deg = tilts.ok_or_else(|| FiguresError::NoTilts { item: name.into() })?;
    Ok(Row::new(name, way, tilts_deg, &score))
}

/// The stretches of curves that lie in both images: what other views show beyond them is asked of no method.
fn in_both(result: &ResultCurves, pair: &TruthPair<'_>) -> ResultCurves {
    let inside = |point: &ResultPoint| pair.left.contains(&point.left) && pair.right.contains(&point.right);
    let mut curves = Vec::new();
    for curve in &result.curves {
        for run in curve.points.split(|point| !inside(point)).filter(|run| run.len() >= 2) {
            let closed = curve.closed && run.len() == curve.points.len();
            curves.push(ResultCurve { points: run.into(), closed });
        }
    }
    ResultCurves { curves, ..result.clone() }
}

/// Fits the curves of a pair's result to the views `chosen` of its series (places in [`Series::views`], the pair's among them), as
/// `tiltline reconstruct SERIES` does to all. With no view beside the pair, the pair's result is returned.
///
/// # Errors
/// Where a view cannot be read.
pub fn fit(
    result: &Reconstruction,
    pair: [usize; 2],
    series: &Series,
    chosen: &[usize],
    detector: &dyn Detect,
    settings: &Settings,
    lines_of: &mut dyn FnMut(usize) -> Result<ViewLines, SeriesError>,
) -> Result<Reconstruction, FiguresError> {
    if chosen.len() < 3 || result.curves.is_empty() {
        return Ok(result.clone());
    }
    let part = series.part(chosen);
    let place = |view: usize| part.views.iter().position(|other| other.section == series.views[view].section);
    let both = place(pair[0]).zip(place(pair[1]));
    let (left, right) = both.ok_or_else(|| FiguresError::NoTilts { item: series.path.clone() })?;
    let axis_rad = result.rectified.rectification.rectified_from_left.isometry.rotation.angle();
    let aligned = align(&part, -axis_rad, &|_, _| ())?;
    let mut of_part = |view: usize| lines_of(chosen[view]);
    let fit = reconstruct_series(
        result.clone(),
        [left, right],
        &part,
        &aligned,
        detector,
        settings,
        &settings.series,
        &mut of_part,
    )?;
    Ok(fit.reconstruction)
}

/// Pooled over series by length, as far as their rows allow.
struct Pooled {
    completeness: f64,
    correctness: f64,
    f_score: f64,
    distance: Option<f64>,
}

fn pool(rows: &[&Row]) -> Pooled {
    let sum = |value: &dyn Fn(&Row) -> f64| rows.iter().map(|row| value(row)).sum::<f64>();
    let found = |row: &Row| row.completeness * row.truth_px;
    let right = |row: &Row| row.correctness.unwrap_or(0.0) * row.result_px;
    let share = |part: f64, whole: f64| if whole > 0.0 { part / whole } else { 0.0 };
    let completeness = share(sum(&found), sum(&|row| row.truth_px));
    let correctness = share(sum(&right), sum(&|row| row.result_px));
    let f_score = share(2.0 * completeness * correctness, completeness + correctness);
    let matched = |row: &Row| if row.mean_distance.is_some() { found(row) + right(row) } else { 0.0 };
    let distance = sum(&|row| matched(row) * row.mean_distance.unwrap_or(0.0));
    let weight = sum(&matched);
    Pooled { completeness, correctness, f_score, distance: (weight > 0.0).then(|| distance / weight) }
}

fn of<'a>(rows: &'a [Row], way: Way, views: usize, series: Option<&str>) -> Vec<&'a Row> {
    let wanted = |row: &&Row| row.way == way && row.views == views && series.is_none_or(|series| row.series == series);
    rows.iter().filter(wanted).collect()
}

/// Numbers of views that occur, ascending.
fn counts(rows: &[Row]) -> Vec<usize> {
    let mut counts: Vec<usize> = rows.iter().map(|row| row.views).collect();
    counts.sort_unstable();
    counts.dedup();
    counts
}

/// Names of the series, in their order.
fn series(rows: &[Row]) -> Vec<&str> {
    let mut names: Vec<&str> = Vec::new();
    for row in rows {
        if !names.contains(&row.series.as_str()) {
            names.push(&row.series);
        }
    }
    names
}

/// Tables: pooled over the series, and each series.
pub fn tables(rows: &[Row]) -> String {
    let mut page = String::from("All series, pooled by length:\n\n");
    page += &table(rows, None);
    for name in series(rows) {
        let _ = write!(page, "\n`{name}`:\n\n{}", table(rows, Some(name)));
    }
    page
}

fn table(rows: &[Row], name: Option<&str>) -> String {
    let mut text =
        "| views | method | completeness | correctness | F | mean distance, nm |\n|---|---|---|---|---|---|\n"
            .to_owned();
    for count in counts(rows) {
        for way in Way::ALL {
            let found = of(rows, way, count, name);
            if found.is_empty() || (way == Way::AllViews && count == 2) {
                continue;
            }
            let Pooled { completeness, correctness, f_score, distance } = pool(&found);
            let distance = distance.map_or("-".into(), |distance| format!("{distance:.1}"));
            let word = way.word();
            let _ = writeln!(
                text,
                "| {count} | {word} | {completeness:.3} | {correctness:.3} | {f_score:.3} | {distance} |"
            );
        }
    }
    text
}

/// Where the fit of all views beats another way (F-score, pooled, and on how many of the series), in a sentence; none where nothing
/// was compared. Two views of stereo are held against every number of views.
pub fn verdict(rows: &[Row], other: Way) -> Option<String> {
    let views = |count: usize| if other == Way::Stereo { 2 } else { count };
    let wins = |count: usize, name: Option<&str>| {
        let f = |way: Way, count: usize| {
            let found = of(rows, way, count, name);
            (!found.is_empty()).then(|| pool(&found).f_score)
        };
        Some(f(Way::AllViews, count)? > f(other, views(count))?)
    };
    let names = series(rows);
    let compared: Vec<(bool, String)> = counts(rows)
        .into_iter()
        .filter(|count| *count > 2)
        .filter_map(|count| {
            let each: Vec<bool> = names.iter().filter_map(|name| wins(count, Some(name))).collect();
            let won = each.iter().filter(|won| **won).count();
            Some((wins(count, None)?, format!("{count} ({won} of {} series)", each.len())))
        })
        .collect();
    let list = |better: bool| {
        let counts: Vec<&str> = compared.iter().filter(|row| row.0 == better).map(|row| row.1.as_str()).collect();
        counts.join(", ")
    };
    let name = other.word();
    match (compared.is_empty(), list(true).as_str(), list(false).as_str()) {
        (true, ..) => None,
        (_, counts, "") => Some(format!(
            "Pooled, the fit of all views has a higher F-score than {name} at every number of views: {counts}."
        )),
        (_, "", counts) => Some(format!(
            "Pooled, the fit of all views has a lower F-score than {name} at every number of views: {counts}."
        )),
        (_, better, worse) => Some(format!(
            "Pooled, the fit of all views has a higher F-score than {name} at {better} views, and a lower one at {worse}."
        )),
    }
}

/// The chart: F-score, completeness, correctness and distance against the number of views, pooled over the series.
pub fn draw(rows: &[Row]) -> String {
    chart(rows, None, "All series")
}

/// The same of each series alone, F-score only.
pub fn draw_each(rows: &[Row]) -> String {
    let labels: Vec<String> = counts(rows).iter().map(usize::to_string).collect();
    let panels = series(rows).into_iter().map(|name| Panel {
        heading: name.to_owned(),
        y_title: "F-score".into(),
        y: Some([0.0, 1.0]),
        lines: ways(rows, Some(name), &|pooled| Some(pooled.f_score)),
    });
    lines("F-score against the number of views, each series", "views", &labels, &panels.collect::<Vec<_>>(), 3)
}

fn chart(rows: &[Row], name: Option<&str>, title: &str) -> String {
    let labels: Vec<String> = counts(rows).iter().map(usize::to_string).collect();
    let panel = |heading: &str, y: Option<[f64; 2]>, value: &dyn Fn(&Pooled) -> Option<f64>| Panel {
        heading: heading.to_owned(),
        y_title: heading.to_owned(),
        y,
        lines: ways(rows, name, value),
    };
    let share = Some([0.0, 1.0]);
    let panels = [
        panel("F-score", share, &|pooled| Some(pooled.f_score)),
        panel("Completeness", share, &|pooled| Some(pooled.completeness)),
        panel("Correctness", share, &|pooled| Some(pooled.correctness)),
        panel("Mean distance (nm)", None, &|pooled| pooled.distance),
    ];
    lines(&format!("{title} against the number of views"), "views", &labels, &panels, 2)
}

fn ways(rows: &[Row], name: Option<&str>, value: &dyn Fn(&Pooled) -> Option<f64>) -> Vec<Line> {
    let counts = counts(rows);
    let line = |way: Way| {
        let at = |count: usize| {
            // Two views stay two: the level that the others are held against.
            let views = if way == Way::Stereo { 2 } else { count };
            let found = of(rows, way, views, name);
            (!found.is_empty()).then(|| value(&pool(&found))).flatten()
        };
        Line {
            name: way.word().into(),
            colour: way.colour(),
            dashed: way == Way::Stereo,
            values: counts.iter().map(|count| at(*count)).collect(),
        }
    };
    Way::ALL.map(line).into()
}
