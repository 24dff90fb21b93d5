//! Curves as nodes and segments that share their junctions: what tree and network formats are made of.
//!
//! A junction is known from the left image. In the foil the ends that meet there must also agree in depth: ends that
//! differ from the others by more than `MAX_DISAGREEMENT` standard deviations only cross in projection and are not
//! joined. Lengths are in the unit of the reconstruction.

use std::collections::BTreeMap;

use crate::curve::{Curve3, TraceEnd};
use crate::geometry::{Point2, Point3, Vector2};
use crate::reconstruction::Reconstruction;

/// Ends whose depths differ by more than this many standard deviations do not meet.
const MAX_DISAGREEMENT: f64 = 4.0;
/// An end this close to its junction (rectified px) is the junction; one further away is linked to it by a segment.
const MERGE_PX: f64 = 1.5;

/// What a node is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum NodeKind {
    /// A point inside a curve.
    Inner,
    /// The end of one curve.
    End,
    /// Where two or more curve ends meet; the index is that of [`CurveGraph::junctions`].
    Junction(usize),
}

/// A point of the network.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Node {
    /// Where it is.
    pub position: Point3,
    /// One sigma of its depth.
    pub sigma_z: f64,
    /// What it is.
    pub kind: NodeKind,
}

/// One end of one curve at a junction.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct JunctionEnd {
    /// Index of the curve.
    pub curve: usize,
    /// 0 for its first point, 1 for its last.
    pub end: usize,
    /// Whether its depth agrees with the junction's.
    pub joined: bool,
}

/// Where curves meet.
#[derive(Clone, Debug, PartialEq)]
pub struct Junction {
    /// Index in the left [`crate::curve::TraceGraph::junctions`].
    pub trace_junction: usize,
    /// Where it is in the rectified left image.
    pub left_rectified: Point2,
    /// Where it is in the foil: above its place in the left image, at the mean depth of the ends that are joined, weighted
    /// by 1/sigma^2.
    pub position: Point3,
    /// One sigma of its depth.
    pub sigma_z: f64,
    /// All ends that were traced to it in the left image.
    pub ends: Vec<JunctionEnd>,
}

/// All curves as one network.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct CurveGraph {
    /// Points; those of curve 0 first, junctions last.
    pub nodes: Vec<Node>,
    /// Pairs of node indices, along each curve in turn.
    pub segments: Vec<[usize; 2]>,
    /// Places where at least one curve ends at a junction of the left image.
    pub junctions: Vec<Junction>,
}

impl CurveGraph {
    /// The network of a result.
    pub fn new(reconstruction: &Reconstruction) -> Self {
        let curves = &reconstruction.curves;
        let junctions = junctions(reconstruction);
        let mut graph = Self::default();
        // Node of a curve's end if it is merged into a junction, else nothing.
        let mut merged = BTreeMap::<(usize, usize), usize>::new();
        let mut links = Vec::<(usize, usize, usize)>::new();
        for (index, junction) in junctions.iter().enumerate() {
            let joined: Vec<&JunctionEnd> = junction.ends.iter().filter(|end| end.joined).collect();
            if joined.len() < 2 {
                continue;
            }
            for end in joined {
                let point = end_point(&curves[end.curve], end.end);
                let distance = (point.left_rectified - junction.left_rectified).norm();
                // The first and last point of a short curve may not both become one node.
                if distance <= MERGE_PX && curves[end.curve].points.len() > 2 {
                    merged.insert((end.curve, end.end), index);
                } else {
                    links.push((end.curve, end.end, index));
                }
            }
        }
        let total: usize = curves.iter().map(|curve| curve.points.len()).sum();
        let junction_node: BTreeMap<usize, usize> = {
            let used: std::collections::BTreeSet<usize> =
                merged.values().copied().chain(links.iter().map(|link| link.2)).collect();
            let first = total - merged.len();
            used.into_iter().enumerate().map(|(rank, junction)| (junction, first + rank)).collect()
        };
        let mut end_nodes = BTreeMap::<(usize, usize), usize>::new();
        for (curve_index, curve) in curves.iter().enumerate() {
            graph.push_curve(curve_index, curve, &merged, &junction_node, &mut end_nodes);
        }
        for &junction in junction_node.keys() {
            let Junction { position, sigma_z, .. } = junctions[junction];
            graph.nodes.push(Node { position, sigma_z, kind: NodeKind::Junction(junction) });
        }
        for (curve, end, junction) in links {
            let node = end_nodes[&(curve, end)];
            graph.nodes[node].kind = NodeKind::Inner;
            graph.segments.push([node, junction_node[&junction]]);
        }
        graph.junctions = junctions;
        graph
    }

    fn push_curve(
        &mut self,
        curve_index: usize,
        curve: &Curve3,
        merged: &BTreeMap<(usize, usize), usize>,
        junction_node: &BTreeMap<usize, usize>,
        end_nodes: &mut BTreeMap<(usize, usize), usize>,
    ) {
        let last = curve.points.len() - 1;
        let mut along = Vec::with_capacity(curve.points.len() + 1);
        for (index, point) in curve.points.iter().enumerate() {
            let end = if index == 0 { Some(0) } else { (index == last).then_some(1) };
            let end = end.filter(|_| !curve.closed);
            let shared = end.and_then(|end| merged.get(&(curve_index, end)));
            let node = if let Some(junction) = shared {
                junction_node[junction]
            } else {
                let kind = if end.is_some() { NodeKind::End } else { NodeKind::Inner };
                self.nodes.push(Node { position: point.position, sigma_z: point.sigma_z, kind });
                self.nodes.len() - 1
            };
            if let Some(end) = end {
                end_nodes.insert((curve_index, end), node);
            }
            along.push(node);
        }
        if curve.closed && curve.points.len() > 2 {
            along.push(along[0]);
        }
        self.segments.extend(along.windows(2).map(|pair| [pair[0], pair[1]]));
    }

    /// The segments at each node, by index.
    pub fn segments_of_nodes(&self) -> Vec<Vec<usize>> {
        let mut at = vec![Vec::new(); self.nodes.len()];
        for (index, [a, b]) in self.segments.iter().enumerate() {
            at[*a].push(index);
            at[*b].push(index);
        }
        at
    }
}

/// First (0) or last (1) point of a curve.
fn end_point(curve: &Curve3, end: usize) -> &crate::curve::CurvePoint {
    &curve.points[if end == 0 { 0 } else { curve.points.len() - 1 }]
}

fn junctions(reconstruction: &Reconstruction) -> Vec<Junction> {
    let mut at = BTreeMap::<usize, Vec<(usize, usize)>>::new();
    for (curve_index, curve) in reconstruction.curves.iter().enumerate().filter(|(_, curve)| !curve.closed) {
        for (end, traced) in curve.ends.iter().enumerate() {
            if let TraceEnd::Junction(junction) = traced {
                at.entry(*junction).or_default().push((curve_index, end));
            }
        }
    }
    at.into_iter().map(|(trace_junction, ends)| junction(reconstruction, trace_junction, &ends)).collect()
}

/// The ends whose depths agree with most others', and their mean.
fn junction(reconstruction: &Reconstruction, trace_junction: usize, ends: &[(usize, usize)]) -> Junction {
    let (curves, frame) = (&reconstruction.curves, &reconstruction.frame);
    let depth = |&(curve, end): &(usize, usize)| {
        let point = end_point(&curves[curve], end);
        (point.position.z, point.sigma_z.max(1e-9))
    };
    let agree = |a: &(usize, usize), b: &(usize, usize)| {
        let ((z_a, sigma_a), (z_b, sigma_b)) = (depth(a), depth(b));
        (z_a - z_b).abs() <= MAX_DISAGREEMENT * sigma_a.hypot(sigma_b)
    };
    // The end with which most others agree leads; the first of equals, so that the order decides and not chance.
    let mut leader = (0, 0);
    for (index, end) in ends.iter().enumerate() {
        let votes = ends.iter().filter(|other| agree(end, other)).count();
        if votes > leader.1 {
            leader = (index, votes);
        }
    }
    let ends: Vec<JunctionEnd> =
        ends.iter().map(|key| JunctionEnd { curve: key.0, end: key.1, joined: agree(&ends[leader.0], key) }).collect();
    let (mut disparity, mut z, mut left, mut weights) = (0.0, 0.0, Vector2::zeros(), 0.0);
    for end in ends.iter().filter(|end| end.joined) {
        let point = end_point(&curves[end.curve], end.end);
        let weight = point.sigma_z.max(1e-9).powi(-2);
        disparity += weight * point.disparity_px;
        z += weight * point.position.z;
        left += point.left_rectified.coords * weight;
        weights += weight;
    }
    let traced = reconstruction.traces[0].junctions.get(trace_junction);
    let left_rectified = traced.copied().unwrap_or(Point2::from(left / weights));
    let sin_half_phi = (0.5 / frame.depth_gain).clamp(-1.0, 1.0);
    let x_gain = 0.5 / (1.0 - sin_half_phi * sin_half_phi).sqrt();
    let position = Point3::new(
        (2.0 * (left_rectified.x - frame.centre_px[0]) + disparity / weights) * x_gain * frame.pixel,
        (left_rectified.y - frame.centre_px[1]) * frame.pixel,
        z / weights,
    );
    Junction { trace_junction, left_rectified, position, sigma_z: (1.0 / weights).sqrt(), ends }
}
