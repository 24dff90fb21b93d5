//! A line mask for images without truth: what the ridge filter and the tracer find with their defaults. Statistics over it
//! leave out lines that the filter misses and take in what it invents, so they are for comparing images, not methods.

use ndarray::Array2;

use crate::geometry::Point2;
use crate::micrograph::{Micrograph, View};
use crate::pipeline::Detect;
use crate::rectify::{Rectification, RectifiedPair};
use crate::ridge::RidgeDetector;
use crate::simulate::ViewSettings;
use crate::trace::{TraceSettings, trace};
use crate::truth::draw_polyline;

/// Width of the lines in the mask, px: that of [`crate::truth::curve_mask`] in scores.
const WIDTH_PX: f64 = 3.0;

/// Pixels `[row, column]` of lines that the ridge filter finds, dark or bright, whichever are stronger.
pub fn detected_lines(image: &Array2<f32>) -> Array2<bool> {
    let shape = image.dim().into();
    let view = ViewSettings { shape, ..ViewSettings::default() };
    let image = Micrograph::new(image.clone()).normalised();
    let rectification = Rectification::from_known_views(&view, &view);
    let pair = RectifiedPair { left: image.clone(), right: image, rectification };
    let lines = RidgeDetector::default().detect(&pair, View::Left);
    let mut mask = Array2::from_elem(shape, false);
    for found in trace(&lines, &TraceSettings::default()).traces {
        let points: Vec<Point2> = found.points.iter().map(|point| point.position).collect();
        draw_polyline(&mut mask, &points, WIDTH_PX);
    }
    mask
}
