//! The report's figures for print, as SVG (W3C SVG 1.1, which every journal and drawing program reads): lengths in points,
//! 180 mm wide, text as text.
//!
//! Colours are those of the page on white; what they mean stands in a colour bar with its unit.

mod charts;
mod images;
mod projections;
mod series;
pub(crate) mod svg;

use crate::report::Report;

/// A figure and the name of its file, without an extension.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Figure {
    /// For example `projections`.
    pub name: &'static str,
    /// The document.
    pub svg: String,
}

/// Every figure of a report; those of curves are left out where there are none.
pub fn all(report: &Report) -> Vec<Figure> {
    let mut figures = vec![Figure { name: "images", svg: images::draw(report) }];
    if !report.curves.is_empty() {
        figures.push(Figure { name: "projections", svg: projections::draw(report) });
        figures.push(Figure { name: "histograms", svg: charts::histograms(report) });
    }
    if !report.point_matches.x.is_empty() {
        figures.push(Figure { name: "residuals", svg: charts::residuals(report) });
    }
    if let Some(svg) = series::draw(report) {
        figures.push(Figure { name: "series", svg });
    }
    figures
}
