//! `curves.swc`: the SWC tree format (Cannon et al., J. Neurosci. Methods 84 (1998) 49), one node a line:
//! `id type x y z radius parent`, ids from 1, parent -1 for a root, a parent always before its children.
//!
//! Coordinates and radius are in the unit of the result. The radius is sigma_z, because a dislocation has none of its
//! own. Types: 0 undefined (inner points), 5 fork (junctions), 6 end point. SWC holds trees only: every loop is cut by
//! leaving out its last segment in the order of the curves, and the two nodes of each cut are listed in a comment.

use std::io::{self, Write};

use crate::export::graph::{CurveGraph, Node, NodeKind};
use crate::export::number::{fixed, length_decimals};
use crate::reconstruction::Reconstruction;

/// Writes `curves.swc`.
pub fn write(reconstruction: &Reconstruction, out: &mut (impl Write + ?Sized)) -> io::Result<()> {
    let decimals = length_decimals(&reconstruction.frame);
    let graph = CurveGraph::new(reconstruction);
    let Forest { order, parent, cut } = Forest::new(&graph);
    let mut id = vec![0; graph.nodes.len()];
    for (rank, &node) in order.iter().enumerate() {
        id[node] = rank + 1;
    }
    writeln!(
        out,
        "# Tiltline curves; unit {} (not micrometres); x right, y down, z away",
        reconstruction.frame.unit.word()
    )?;
    writeln!(out, "# radius = sigma_z; type 0 inner, 5 junction, 6 end")?;
    for [a, b] in &cut {
        writeln!(out, "# loop cut between {} and {}", id[*a], id[*b])?;
    }
    writeln!(out, "# id type x y z radius parent")?;
    for &node in &order {
        let Node { position, sigma_z, kind } = graph.nodes[node];
        let kind = match kind {
            NodeKind::Inner => 0,
            NodeKind::Junction(_) => 5,
            NodeKind::End => 6,
        };
        let [x, y, z, radius] = [position.x, position.y, position.z, sigma_z].map(|value| fixed(value, decimals));
        let parent = parent[node].map_or("-1".to_owned(), |parent| id[parent].to_string());
        writeln!(out, "{} {kind} {x} {y} {z} {radius} {parent}", id[node])?;
    }
    Ok(())
}

/// A spanning forest of a network.
struct Forest {
    /// Nodes, parents before children.
    order: Vec<usize>,
    /// Parent of each node; none for roots.
    parent: Vec<Option<usize>>,
    /// Segments that would have closed a loop.
    cut: Vec<[usize; 2]>,
}

impl Forest {
    fn new(graph: &CurveGraph) -> Self {
        let mut set: Vec<usize> = (0..graph.nodes.len()).collect();
        let mut neighbours = vec![Vec::new(); graph.nodes.len()];
        let mut cut = Vec::new();
        for &[a, b] in &graph.segments {
            let (root_a, root_b) = (root(&mut set, a), root(&mut set, b));
            if root_a == root_b {
                cut.push([a, b]);
            } else {
                set[root_b] = root_a;
                neighbours[a].push(b);
                neighbours[b].push(a);
            }
        }
        let mut parent = vec![None; graph.nodes.len()];
        let mut seen = vec![false; graph.nodes.len()];
        let mut order = Vec::with_capacity(graph.nodes.len());
        for start in 0..graph.nodes.len() {
            let mut stack = if seen[start] { Vec::new() } else { vec![start] };
            seen[start] = true;
            while let Some(node) = stack.pop() {
                order.push(node);
                for &next in neighbours[node].iter().rev() {
                    if !seen[next] {
                        seen[next] = true;
                        parent[next] = Some(node);
                        stack.push(next);
                    }
                }
            }
        }
        Self { order, parent, cut }
    }
}

/// Representative of a node's set, with path halving (Tarjan and van Leeuwen 1984).
fn root(set: &mut [usize], mut node: usize) -> usize {
    while set[node] != node {
        set[node] = set[set[node]];
        node = set[node];
    }
    node
}
