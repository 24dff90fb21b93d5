//! From line probability to sub-pixel centrelines and their junctions.
//!
//! hysteresis -> thinning -> graph of the skeleton -> crests -> network (spurs, crossings, gaps) -> smooth curves. The
//! steps are public where they are useful alone. Positions are in px of the map, (x, y).

mod centreline;
pub mod graph;
mod network;
pub mod thin;

use ndarray::Array2;
use serde::{Deserialize, Serialize};

use crate::curve::{LineMap, Trace, TraceEnd, TraceGraph};
use crate::geometry::{Point2, Vector2};
use crate::trace::graph::skeleton_graph;
use crate::trace::network::{End, Line, Network};
use crate::trace::thin::{fill_small_holes, hysteresis, thin};

/// Settings of tracing.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct TraceSettings {
    /// Probability above which a pixel starts a line.
    pub high: f32,
    /// Probability above which a connected pixel belongs to it.
    pub low: f32,
    /// Shortest line that is kept, in px.
    pub min_length_px: f64,
}

impl Default for TraceSettings {
    fn default() -> Self {
        Self { high: 0.5, low: 0.25, min_length_px: 15.0 }
    }
}

/// Centrelines and junctions of a line map that has data everywhere.
pub fn trace(lines: &LineMap, settings: &TraceSettings) -> TraceGraph {
    trace_within(lines, None, settings)
}

/// Centrelines and junctions of a line map; `has_data` (`[row, column]`, the shape of the map) tells where its image
/// has data, so that lines cut off there end at a [`TraceEnd::Border`].
pub fn trace_within(lines: &LineMap, has_data: Option<&Array2<bool>>, settings: &TraceSettings) -> TraceGraph {
    let map = &lines.probability;
    assert!(has_data.is_none_or(|mask| mask.dim() == map.dim()), "has_data must have the shape of the map");
    let width_px = lines.line_width_px.clamp(1.0, 50.0);
    let mut mask = hysteresis(map, settings.low, settings.high);
    fill_small_holes(&mut mask, (0.5 * width_px * width_px).round() as usize);
    let skeleton = skeleton_graph(&thin(&mask));

    let nodes = (0..skeleton.junctions.len()).map(|index| skeleton.junction_position(index)).collect();
    let mut network = Network::new(nodes, width_px);
    for branch in &skeleton.branches {
        let pixels: Vec<Point2> = branch.pixels.iter().map(|at| Point2::new(at[1] as f64, at[0] as f64)).collect();
        let points = centreline::crest(map, &pixels, branch.closed, width_px);
        let ends = branch.ends.map(|end| end.map_or(End::Free, End::Node));
        network.add(Line { points, ends, closed: branch.closed });
    }
    network.prune_spurs(1.5 * width_px);
    network.resolve_crossings();
    network.bridge_gaps((3.0 * width_px).max(6.0));
    network.attach_ends(2.0 * width_px + 3.0);
    network.prune_spurs(1.5 * width_px);
    network.drop_short(settings.min_length_px);
    finish(map, has_data, &network, width_px)
}

/// Smooth curves of the network's lines, and the junctions that three or more of them meet at.
fn finish(map: &Array2<f32>, has_data: Option<&Array2<bool>>, network: &Network, width_px: f64) -> TraceGraph {
    let mut graph = TraceGraph::default();
    let mut junction_of: Vec<Option<usize>> = vec![None; network.nodes.len()];
    for (node, position) in network.nodes.iter().enumerate() {
        if network.degree(node) >= 3 {
            junction_of[node] = Some(graph.junctions.len());
            graph.junctions.push(*position);
        }
    }
    for line in network.lines.iter().flatten() {
        let mut raw = line.points.clone();
        for end in [0, 1] {
            if line.closed {
                break;
            }
            if end == 1 {
                raw.reverse();
            }
            match line.ends[end] {
                End::Node(node) => reach_node(&mut raw, network.nodes[node], 0.6 * width_px),
                End::Free => fit_free_end(map, &mut raw),
            }
            if end == 1 {
                raw.reverse();
            }
        }
        let points = centreline::smooth_curve(map, &raw, line.closed, width_px);
        if points.len() < 2 {
            continue;
        }
        let last = points.len() - 1;
        let ends = [(0, points[0].position, -points[0].tangent), (1, points[last].position, points[last].tangent)].map(
            |(end, position, outward)| match line.ends[end] {
                _ if line.closed => TraceEnd::Free,
                End::Node(node) if junction_of[node].is_some() => {
                    junction_of[node].map_or(TraceEnd::Free, TraceEnd::Junction)
                }
                _ if at_border(map.dim(), has_data, position, outward, width_px) => TraceEnd::Border,
                _ => TraceEnd::Free,
            },
        );
        graph.traces.push(Trace { points, closed: line.closed, ends });
    }
    graph
}

/// Leads a line straight into its node: within about half a line width the skeleton bends towards the other arms.
fn reach_node(raw: &mut Vec<Point2>, node: Point2, bent_px: f64) {
    let cut = raw.iter().take_while(|point| (*point - node).norm() < bent_px).count();
    raw.drain(..cut.min(raw.len().saturating_sub(2)));
    raw.insert(0, node);
}

/// Moves the first point of a line to where its map ends.
fn fit_free_end(map: &Array2<f32>, raw: &mut Vec<Point2>) {
    // The last few points of a skeleton wander: the direction is taken a little inside.
    let inside = 3.min(raw.len() - 1);
    let far = 9.min(raw.len() - 1);
    if far < inside + 2 {
        return;
    }
    let inner = raw[inside];
    let Some(outward) = (inner - raw[far]).try_normalize(1e-9) else { return };
    let end = raw[0];
    let along: f64 = (end - inner).dot(&outward);
    let target = along + centreline::overhang(map, inner + outward * along, outward, inner);
    raw.drain(..inside);
    let steps = target.floor().max(0.0) as usize;
    for step in 1..=steps {
        raw.insert(0, inner + outward * step as f64);
    }
    if target > steps as f64 + 0.2 {
        raw.insert(0, inner + outward * target);
    }
}

/// Whether a line that goes on for about a line width would leave the image or its data.
fn at_border(
    (rows, columns): (usize, usize),
    has_data: Option<&Array2<bool>>,
    position: Point2,
    outward: Vector2,
    width_px: f64,
) -> bool {
    let reach = (width_px + 5.0).ceil() as usize;
    (0..=reach).any(|step| {
        let point = position + outward * step as f64;
        let (row, column) = (point.y.round(), point.x.round());
        let outside = row < 0.0 || column < 0.0 || row >= rows as f64 || column >= columns as f64;
        outside || has_data.is_some_and(|mask| !mask[[row as usize, column as usize]])
    })
}

#[cfg(test)]
mod tests;
