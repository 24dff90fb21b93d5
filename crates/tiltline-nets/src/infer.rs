//! The networks in the main job: [`NetDetector`] finds lines, [`NetMatcher`] their disparities.
//!
//! Large images are worked on in tiles with margins as wide as the networks' fields of view, so that memory is bounded and results
//! do not depend on the tiles.

mod costs;
mod curves;
mod octaves;
mod tiles;

use std::path::{Path, PathBuf};

use burn::tensor::{Device, Tensor, TensorData};
use ndarray::{Array2, s};
use tiltline::curve::{LineMap, MatchedCurve, TraceGraph};
use tiltline::dataset::LINE_WIDTH_PX;
use tiltline::matching::MatchSettings;
use tiltline::micrograph::View;
use tiltline::pipeline::{Detect, Match};
use tiltline::rectify::RectifiedPair;

use crate::config::{DetectorConfig, MatcherConfig, MatcherInput};
use crate::detector::{Detected, Detector};
use crate::flatten::flattened;
use crate::matcher::Matcher;
use crate::networks::matcher_input;
use crate::score::probability;
use crate::weights::{NetworkConfig, Weights, WeightsError};
use costs::Costs;
use octaves::{enlarged, halved};
use tiles::{Tile, tiles};

/// Side of a tile without its margins, px.
const TILE_PX: usize = 512;
/// Side of the part of an image, halved as it is, that its magnification is judged by, px.
const JUDGED_PX: usize = 768;
/// Images are halved this many times at most, and not below this side.
const MOST_OCTAVES: u32 = 3;
const LEAST_SIDE_PX: usize = 160;
/// Probability above which a pixel speaks for a magnification.
const SURE: f32 = 0.35;
/// What is found in an image of half the size counts this much less: less detail is a loss of its own.
const FINER_FIRST: f64 = 0.7;

/// Weights as a file or as part of the program, with a name for messages.
#[derive(Clone, Debug)]
pub struct Named {
    /// File or "built in".
    pub path: PathBuf,
    /// The weights.
    pub weights: Weights,
}

/// The detector that is part of the program.
const DETECTOR: &[u8] = include_bytes!("../weights/detector.safetensors");
/// The matcher that is part of the program.
const MATCHER: &[u8] = include_bytes!("../weights/matcher.safetensors");

impl Named {
    /// From a file.
    ///
    /// # Errors
    /// As for [`Weights::read`].
    pub fn read(path: &Path) -> Result<Self, WeightsError> {
        Ok(Self { path: path.into(), weights: Weights::read(path)? })
    }

    /// The detector that is part of the program.
    ///
    /// # Errors
    /// Never, unless the program was built from damaged files.
    pub fn built_in_detector() -> Result<Self, WeightsError> {
        Self::built_in("built-in detector", DETECTOR)
    }

    /// The matcher that is part of the program.
    ///
    /// # Errors
    /// Never, unless the program was built from damaged files.
    pub fn built_in_matcher() -> Result<Self, WeightsError> {
        Self::built_in("built-in matcher", MATCHER)
    }

    fn built_in(name: &str, bytes: &[u8]) -> Result<Self, WeightsError> {
        let path = PathBuf::from(name);
        Ok(Self { weights: Weights::from_bytes(bytes, &path)?, path })
    }
}

/// A flattened image, or a map, as `[1, 1, H, W]`.
fn tensor(image: &Array2<f32>, device: &Device) -> Tensor<4> {
    let (rows, columns) = image.dim();
    let values: Vec<f32> = image.iter().copied().collect();
    Tensor::from_data(TensorData::new(values, [1, 1, rows, columns]), device)
}

/// A part of an image, 0 beyond its borders.
fn cut(image: &Array2<f32>, rows: &Tile, columns: &Tile) -> Array2<f32> {
    let mut part = Array2::zeros((rows.length, columns.length));
    let last = |tile: &Tile, count: usize| (tile.start + tile.length).min(count);
    let (bottom, right) = (last(rows, image.nrows()), last(columns, image.ncols()));
    part.slice_mut(s![..bottom - rows.start, ..right - columns.start])
        .assign(&image.slice(s![rows.start..bottom, columns.start..right]));
    part
}

/// The U-Net as a detector.
#[derive(Debug)]
pub struct NetDetector {
    network: Detector,
    config: DetectorConfig,
    device: Device,
}

impl NetDetector {
    /// The detector of some weights.
    ///
    /// # Errors
    /// Where the weights are another network's, or damaged.
    pub fn new(named: &Named, device: &Device) -> Result<Self, WeightsError> {
        let NetworkConfig::Detector(config) = &named.weights.network else {
            return Err(named.weights.kind_error("detector", &named.path));
        };
        let network = named.weights.load_into(Detector::new(config, device), &named.path)?;
        Ok(Self { network, config: config.clone(), device: device.clone() })
    }

    /// Furthest that a pixel can matter to another, px, as a multiple of what sides must be: two convolutions on the way down
    /// and two on the way up at each level, and the two of the bottom.
    fn margin_px(&self) -> usize {
        let field: usize = (0..self.config.depth).map(|level| 5 << level).sum::<usize>() + (2 << self.config.depth);
        field.next_multiple_of(self.config.multiple())
    }

    /// Line probability `[row, column]` of a normalised image as seen when it is halved `octave` times, 0 where it has no data.
    pub fn probability(&self, image: &Array2<f32>, octave: u32) -> Array2<f32> {
        let mut small = image.clone();
        for _ in 0..octave {
            small = halved(&small);
        }
        let mut result = enlarged(&self.probability_of_flattened(&flattened(&small)), octave, image.dim());
        result.zip_mut_with(image, |value, pixel| {
            if !pixel.is_finite() {
                *value = 0.0;
            }
        });
        result
    }

    /// The same of an image that is flattened already, as training batches are.
    pub fn probability_of_flattened(&self, seen: &Array2<f32>) -> Array2<f32> {
        let mut result = Array2::zeros(seen.dim());
        let along = |count| tiles(count, TILE_PX, self.margin_px(), self.config.multiple());
        for rows in along(seen.nrows()) {
            for columns in along(seen.ncols()) {
                let part = cut(seen, &rows, &columns);
                let shape = part.dim();
                let values = probability(self.network.forward(tensor(&part, &self.device)).logits);
                let values = Array2::from_shape_vec(shape, values).expect("a probability for each pixel");
                result
                    .slice_mut(s![rows.keep.clone(), columns.keep.clone()])
                    .assign(&values.slice(s![rows.inner(), columns.inner()]));
            }
        }
        result
    }

    /// How often an image is halved before lines are looked for: lines should be as wide as those the network was taught (some 2
    /// to 10 px), and where they are, it finds most. Judged on the middle of large images.
    pub fn octave(&self, image: &Array2<f32>) -> u32 {
        let lengths = self.lengths(image);
        // The finest of equals.
        (0..lengths.len()).rev().max_by(|&a, &b| lengths[a].total_cmp(&lengths[b])).unwrap_or(0) as u32
    }

    /// Length of the lines that are found per area of an image when it is halved 0, 1, 2, ... times; finer ones count for more.
    fn lengths(&self, image: &Array2<f32>) -> Vec<f64> {
        let part = |length: usize| {
            let start = length.saturating_sub(JUDGED_PX) / 2;
            start..(start + JUDGED_PX).min(length)
        };
        let mut image = image.clone();
        let mut lengths = Vec::new();
        for octave in 0..=MOST_OCTAVES {
            let middle = image.slice(s![part(image.nrows()), part(image.ncols())]).to_owned();
            let map = self.probability_of_flattened(&flattened(&middle));
            // A line is as many px wide in each map: its share of the area, by the size of a pixel, is its length per area.
            let share: f64 = map.iter().map(|p| f64::from((p - SURE).max(0.0))).sum::<f64>() / map.len() as f64;
            lengths.push(share / f64::from(1_u32 << octave) * FINER_FIRST.powi(octave as i32));
            image = halved(&image);
            if image.nrows().min(image.ncols()) < LEAST_SIDE_PX {
                break;
            }
        }
        lengths
    }

    /// Lines of a normalised image at a magnification (see [`NetDetector::octave`]).
    pub fn lines(&self, image: &Array2<f32>, octave: u32) -> LineMap {
        // Whatever the width of a line, the network was taught to mark its middle.
        let line_width_px = LINE_WIDTH_PX * f64::from(1_u32 << octave);
        LineMap { probability: self.probability(image, octave), line_width_px }
    }
}

impl Detect for NetDetector {
    fn detect(&self, pair: &RectifiedPair, view: View) -> LineMap {
        // Both views at the magnification that the left one wants: their lines must be comparable.
        self.lines(pair.view(view), self.octave(&pair.left))
    }

    fn looks(&self, view: &Array2<f32>) -> Vec<f64> {
        self.lengths(view)
    }
}

/// The 3D network as a matcher.
#[derive(Debug)]
pub struct NetMatcher {
    network: Matcher,
    config: MatcherConfig,
    /// For a matcher that looks at a detector's features.
    detector: Option<NetDetector>,
    device: Device,
    /// The range that is looked for.
    settings: MatchSettings,
}

impl NetMatcher {
    /// The matcher of some weights, and the detector whose features it was trained on, if it was.
    ///
    /// # Errors
    /// Where the weights are another network's, or damaged.
    pub fn new(
        named: &Named,
        detector: Option<NetDetector>,
        settings: MatchSettings,
        device: &Device,
    ) -> Result<Self, WeightsError> {
        let NetworkConfig::Matcher(config) = &named.weights.network else {
            return Err(named.weights.kind_error("matcher", &named.path));
        };
        let network = named.weights.load_into(Matcher::new(config, device), &named.path)?;
        let detector = detector.filter(|_| config.input == MatcherInput::Features);
        if config.input == MatcherInput::Features && detector.is_none() {
            let why = "it was trained on the features of a detector, which must be given too".into();
            return Err(WeightsError::Mismatch { path: named.path.clone(), why });
        }
        Ok(Self { network, config: config.clone(), detector, device: device.clone(), settings })
    }

    fn input(&self, image: &Array2<f32>, lines: &Array2<f32>) -> Tensor<4> {
        let images = tensor(image, &self.device);
        match &self.detector {
            Some(detector) => matcher_input(images.clone(), detector.network.forward(images), &self.config),
            None => {
                // Back to log-odds, which `matcher_input` takes.
                let odds = lines.mapv(|p| {
                    let p = p.clamp(1e-6, 1.0 - 1e-6);
                    (p / (1.0 - p)).ln()
                });
                let logits = tensor(&odds, &self.device);
                matcher_input(images.clone(), Detected { logits, features: images }, &self.config)
            }
        }
    }

    /// Furthest that a pixel can matter to another along columns and rows, px. Features: 3x3 convolutions at full, half and the volume's
    /// resolution; then the volume's own network, in which an hourglass reaches 12 voxels; along the row the disparity too.
    fn margins_px(&self) -> [usize; 2] {
        let MatcherConfig { downscale, hourglasses, levels, .. } = self.config;
        let features = 8 + 4 * downscale + self.detector.as_ref().map_or(0, NetDetector::margin_px);
        let reach = features + downscale * (4 + 12 * hourglasses);
        [reach, reach + downscale * levels / 2]
    }

    /// Costs of all disparities near the needed left pixels, and nowhere else if the image is larger than a tile.
    fn costs(&self, images: &[Array2<f32>; 2], lines: &[Array2<f32>; 2], needed: &Array2<bool>) -> Costs {
        let mut costs = Costs::new(needed.dim(), &self.config);
        let seen = [&images[0], &images[1]].map(flattened);
        let [height, width] = self.margins_px();
        let multiple =
            self.config.multiple().max(self.detector.as_ref().map_or(1, |detector| detector.config.multiple()));
        let along = |count, margin| tiles(count, TILE_PX, margin, multiple);
        for rows in along(needed.nrows(), height) {
            for columns in along(needed.ncols(), width) {
                if !needed.slice(s![rows.keep.clone(), columns.keep.clone()]).iter().any(|needed| *needed) {
                    continue;
                }
                let input =
                    |view: usize| self.input(&cut(&seen[view], &rows, &columns), &cut(&lines[view], &rows, &columns));
                let cost = self.network.forward(input(0), input(1)).pop().expect("there is a hourglass at least");
                costs.put(cost, &rows, &columns);
            }
        }
        costs
    }

    /// Pixels of a map of this shape whose costs are read for a point of a trace, in an image halved `octave` times.
    fn needed(&self, traces: &TraceGraph, shape: (usize, usize), octave: u32) -> Array2<bool> {
        let mut needed = Array2::from_elem(shape, false);
        // Costs are interpolated between voxels: their neighbours count too.
        let reach = self.config.downscale as isize;
        for point in traces.traces.iter().flat_map(|trace| &trace.points) {
            let [row, column] =
                [point.position.y, point.position.x].map(|at| octaves::halved_at(at, octave).round() as isize);
            for (down, right) in [(0, 0), (-reach, 0), (reach, 0), (0, -reach), (0, reach)] {
                let place = [row + down, column + right].map(|at| at.max(0) as usize);
                if let Some(pixel) = needed.get_mut(place) {
                    *pixel = true;
                }
            }
        }
        needed
    }
}

impl Match for NetMatcher {
    /// Works at the magnification that the lines were found at.
    fn match_curves(&self, pair: &RectifiedPair, lines: &[LineMap; 2], traces: &[TraceGraph; 2]) -> Vec<MatchedCurve> {
        let wider = (lines[0].line_width_px / LINE_WIDTH_PX).max(1.0).log2().round();
        let octave = (wider as u32).min(MOST_OCTAVES);
        let mut images = [pair.left.clone(), pair.right.clone()];
        let mut maps = [lines[0].probability.clone(), lines[1].probability.clone()];
        for _ in 0..octave {
            images = images.map(|image| halved(&image));
            maps = maps.map(|map| halved(&map));
        }
        let needed = self.needed(&traces[0], images[0].dim(), octave);
        let costs = self.costs(&images, &maps, &needed);
        let range_px = self.settings.range_px(&pair.rectification);
        curves::match_traces(&costs, octave, &lines[1], &traces[0], &pair.rectification, range_px)
    }
}

#[cfg(test)]
mod tests;
