//! Examples: a rectified pair with what is known about it.

use ndarray::Array2;
use rand::RngExt;
use rand_pcg::Pcg64;
use tiltline::dataset::{Dataset, Item, LINE_WIDTH_PX, disparity_map, line_mask};
use tiltline::geometry::{Point2, Similarity2, TiltPair};
use tiltline::io::read_micrograph;
use tiltline::micrograph::{Micrograph, StereoPair};
use tiltline::rectify::{RectifySettings, rectify};
use tiltline::simulate::alignment::AlignmentSettings;
use tiltline::simulate::draw::stroke;
use tiltline::simulate::geometry::{Split, geometry_seed};
use tiltline::simulate::sample::{Lines, sample};
use tiltline::simulate::settings::{Mode, SimulateSettings};
use tiltline::truth::{TrueView, Truth, draw_polyline};

use super::{DataError, DataSettings, Task};

/// Rows of both sides of a labelled match may differ by this much, px.
const SAME_ROW_PX: f64 = 2.0;
/// Lines are asked for where their contrast is this many times what counts as visible in scores.
const SURELY_VISIBLE: f64 = 1.4;

/// A stereo pair on a rectified grid.
#[derive(Clone, Debug, PartialEq)]
pub struct Example {
    /// Left and right, as the main job normalises them; 0 where there is no data.
    pub images: [Array2<f32>; 2],
    /// 1 on lines, 0 elsewhere, NaN where it is not known; `None` where nothing is known.
    pub lines: [Option<Array2<f32>>; 2],
    /// `x_R - x_L` on left line pixels, NaN elsewhere; `None` where nothing is known.
    pub disparity: Option<Array2<f32>>,
    /// Disparity in the middle of the known ones, px.
    pub median_px: f32,
}

impl Example {
    fn new(images: [Array2<f32>; 2], lines: [Option<Array2<f32>>; 2], disparity: Option<Array2<f32>>) -> Self {
        let mut known: Vec<f32> = disparity.iter().flatten().copied().filter(|d| !d.is_nan()).collect();
        let middle = known.len() / 2;
        let median_px = if known.is_empty() { 0.0 } else { *known.select_nth_unstable_by(middle, f32::total_cmp).1 };
        Self { images, lines, disparity, median_px }
    }

    /// A simulated pair: perfectly aligned, so that its images are rectified already.
    pub(super) fn simulated(
        settings: &DataSettings,
        index: u64,
        split: Split,
        rng: &mut Pcg64,
    ) -> Result<Self, DataError> {
        let family = settings.families[rng.random_range(0..settings.families.len())];
        let physics = rng.random_range(0.0..1.0) < settings.physics;
        let [low, high] = settings.phi_deg;
        let half = 0.5 * (low + (high - low) * rng.random_range(0.0..1.0));
        let half = if rng.random_range(0..2) == 0 { half } else { -half };
        let mid = settings.mid_tilt_deg * rng.random_range(-1.0..1.0);
        let mut family = SimulateSettings::of_family(family);
        let look = &mut family.look;
        for mean in [&mut look.boundary_families, &mut look.lamellae, &mut look.hair, &mut look.slip_traces] {
            *mean *= settings.clutter;
        }
        look.debris *= settings.clutter;
        look.faults = settings.faults;
        let simulate = SimulateSettings {
            mode: if physics { Mode::Physics } else { Mode::Parametric },
            size_px: settings.simulated_px,
            tilts_deg: vec![mid - half, mid + half],
            alignment: AlignmentSettings { shift: 0.0, axis_deg: 0.0, turn_deg: 0.0, scale: 0.0 },
            // Lines that are hardly seen are left open: asked for, they would teach to see lines in noise and mottling.
            visible_above_noise: SURELY_VISIBLE * family.visible_above_noise,
            least_contrast: SURELY_VISIBLE * family.least_contrast,
            ..family
        };
        let sample = sample(&simulate, Lines::Random, geometry_seed(split, index))?;
        let images = [0, 1].map(|view| Micrograph::new(sample.views[view].recording.image.clone()).normalised());
        let truth = &sample.truth;
        let lines = [0, 1].map(|view| Some(known_lines(&line_mask(truth, &truth.views[view]))));
        let pair = truth
            .pair(0, 1)
            .map_err(|error| DataError::Item { item: "a simulated pair".into(), why: error.to_string() })?;
        Ok(Self::new(images, lines, Some(disparity_map(&pair))))
    }

    /// An item of a data set, rectified as the main job does it. Where that cannot be done, a detector, which needs no pair, is taught on
    /// the images as they were recorded, and a matcher has `None`.
    pub(super) fn of_item(set: &Dataset, item: &Item, task: Task) -> Result<Option<Self>, DataError> {
        let (truth, pair) = read_item(set, item)?;
        match Self::rectified(set, item, &truth, &pair)? {
            None if task == Task::Detector => Ok(Some(Self::as_recorded(&truth, &pair, item))),
            example => Ok(example),
        }
    }

    /// An item of a data set, rectified; `None` where it cannot be.
    pub(super) fn rectified_item(set: &Dataset, item: &Item) -> Result<Option<Self>, DataError> {
        let (truth, pair) = read_item(set, item)?;
        Self::rectified(set, item, &truth, &pair)
    }

    fn rectified(set: &Dataset, item: &Item, truth: &Truth, pair: &StereoPair) -> Result<Option<Self>, DataError> {
        let Ok((rectified, _)) = rectify(pair, &RectifySettings::default(), 0) else { return Ok(None) };
        let maps = [rectified.rectification.rectified_from_left, rectified.rectification.rectified_from_right];
        let shape = rectified.left.dim();
        let lines = [0, 1].map(|view| labelled(truth, &truth.views[item.pair[view]], &maps[view], shape));
        let disparity = mapped_disparity(truth, item.pair, &maps, shape).map_err(|why| wrong(set, item, why))?;
        let images = [rectified.left, rectified.right].map(|image| image.mapv(|v| if v.is_finite() { v } else { 0.0 }));
        Ok(Some(Self::new(images, lines, disparity)))
    }

    fn as_recorded(truth: &Truth, pair: &StereoPair, item: &Item) -> Self {
        let images = [&pair.left, &pair.right].map(Micrograph::normalised);
        let lines = [0, 1]
            .map(|view| labelled(truth, &truth.views[item.pair[view]], &Similarity2::identity(), images[view].dim()));
        Self::new(images, lines, None)
    }
}

fn wrong(set: &Dataset, item: &Item, why: String) -> DataError {
    DataError::Item { item: set.folder.join(&item.name), why }
}

/// The truth of an item and its pair, whose views the truth is then sure to have.
fn read_item(set: &Dataset, item: &Item) -> Result<(Truth, StereoPair), DataError> {
    let wrong = |why: String| wrong(set, item, why);
    let truth = set.truth(item)?;
    let [Some(left), Some(right)] = item.pair.map(|view| truth.views.get(view)) else {
        return Err(wrong("its truth has no such views".into()));
    };
    let read = |view: &TrueView| {
        let path = set.path(item, &view.name);
        read_micrograph(&path.to_string_lossy()).map_err(|error| wrong(error.to_string()))
    };
    let tilts = left.tilt_rad.zip(right.tilt_rad);
    let (left_rad, right_rad) = tilts.ok_or_else(|| wrong("its tilts are not known".into()))?;
    let (pair, _) = StereoPair::new(read(left)?, read(right)?, TiltPair { left_rad, right_rad }, 0.0)
        .map_err(|error| wrong(error.to_string()))?;
    Ok((truth, pair))
}

/// Lines of a view on a grid; none where nothing is labelled.
fn labelled(truth: &Truth, view: &TrueView, map: &Similarity2, shape: (usize, usize)) -> Option<Array2<f32>> {
    (!view.curves.is_empty()).then(|| mapped_lines(truth, view, map, shape))
}

/// 255, 128, 0 as a line, not known, none.
fn known_lines(mask: &Array2<u8>) -> Array2<f32> {
    mask.mapv(|value| match value {
        255 => 1.0,
        0 => 0.0,
        _ => f32::NAN,
    })
}

fn mapped_lines(truth: &Truth, view: &TrueView, map: &Similarity2, shape: (usize, usize)) -> Array2<f32> {
    let mut all = Array2::from_elem(shape, false);
    let mut visible = all.clone();
    for curve in &view.curves {
        let closed = truth.curve(&curve.label).is_some_and(|curve| curve.closed);
        let mut points: Vec<Point2> = curve.contrast.iter().map(|point| map * point).collect();
        let mut seen: Vec<bool> = (0..points.len()).map(|index| curve.is_visible(index)).collect();
        if let (true, Some(first)) = (closed, points.first().copied()) {
            points.push(first);
            seen.push(seen[0]);
        }
        draw_polyline(&mut all, &points, LINE_WIDTH_PX);
        for index in 1..points.len() {
            if seen[index - 1] && seen[index] {
                draw_polyline(&mut visible, &points[index - 1..=index], LINE_WIDTH_PX);
            }
        }
    }
    let mut lines = all.mapv(|line| if line { f32::NAN } else { 0.0 });
    lines.zip_mut_with(&visible, |line, visible| {
        if *visible {
            *line = 1.0;
        }
    });
    lines
}

fn mapped_disparity(
    truth: &Truth,
    pair: [usize; 2],
    maps: &[Similarity2; 2],
    shape: (usize, usize),
) -> Result<Option<Array2<f32>>, String> {
    let pair = truth.pair(pair[0], pair[1]).map_err(|error| error.to_string())?;
    let mut map = Array2::from_elem(shape, f32::NAN);
    let mut any = false;
    for curve in pair.curves() {
        let left: Vec<Point2> = curve.left.iter().map(|point| maps[0] * point).collect();
        let at = |index: usize| {
            let right = maps[1] * curve.right[index].filter(|_| curve.counts[index])?;
            ((right.y - left[index].y).abs() < SAME_ROW_PX).then(|| (right.x - left[index].x) as f32)
        };
        let disparity: Vec<Option<f32>> = (0..left.len()).map(at).collect();
        stroke([shape.0, shape.1], &left, 0.5 * LINE_WIDTH_PX, |row, column, near| {
            let (from, share) = (near.place as usize, near.place.fract());
            let ends = [from, from + 1].map(|index| disparity[index.min(left.len() - 1)]);
            if let [Some(a), Some(b)] = ends {
                map[[row, column]] = a * (1.0 - share) + b * share;
                any = true;
            }
        });
    }
    Ok(any.then_some(map))
}
