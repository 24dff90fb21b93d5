//! The graph of a skeleton of voxels, and what is done to it: spurs are pruned, and arms that continue each other are joined.
//!
//! The 3D counterpart of [`crate::trace::graph`] and of the crossings of [`crate::trace`]: a voxel with three or more of its 26
//! neighbours set belongs to a node, touching ones are one node. Positions are (x, y, z) in voxels.

use std::collections::{BTreeSet, HashMap};

use crate::geometry::{Point3, Vector3};

/// Largest bend of a line that passes through a node: cos 40 degrees.
const STRAIGHT_ON: f64 = 0.766;
/// The direction of an arm is taken over this many of its points.
const ARM_POINTS: usize = 8;

/// A path between nodes or free ends.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Path {
    /// Points in order, those of nodes included.
    pub points: Vec<Point3>,
    /// The node at either end.
    pub ends: [Option<usize>; 2],
    /// Whether the last point joins the first.
    pub closed: bool,
}

impl Path {
    pub fn length(&self) -> f64 {
        self.points.windows(2).map(|pair| (pair[1] - pair[0]).norm()).sum()
    }

    /// Direction in which the path leaves its end.
    fn outward(&self, end: usize) -> Vector3 {
        let last = self.points.len() - 1;
        let (tip, inner) = match end {
            0 => (0, ARM_POINTS.min(last)),
            _ => (last, last - ARM_POINTS.min(last)),
        };
        (self.points[tip] - self.points[inner]).try_normalize(1e-9).unwrap_or_else(Vector3::zeros)
    }
}

fn position(voxel: &[usize; 3]) -> Point3 {
    Point3::new(voxel[2] as f64, voxel[1] as f64, voxel[0] as f64)
}

/// Paths of a skeleton, `[z, y, x]` each.
pub(super) fn paths(voxels: &[[usize; 3]]) -> Vec<Path> {
    let index: HashMap<[usize; 3], usize> = voxels.iter().enumerate().map(|(index, at)| (*at, index)).collect();
    let neighbours: Vec<Vec<usize>> = voxels
        .iter()
        .map(|at| {
            let mut found = Vec::new();
            // In the order of the volume, so that the result does not depend on the map's.
            for place in (0..27_usize).filter(|place| *place != 13) {
                let step = |axis: usize, digit: usize| (at[axis] + digit).checked_sub(1);
                let next = (step(0, place / 9), step(1, place / 3 % 3), step(2, place % 3));
                if let (Some(z), Some(y), Some(x)) = next
                    && let Some(other) = index.get(&[z, y, x])
                {
                    found.push(*other);
                }
            }
            found
        })
        .collect();
    let mut node_of: Vec<Option<usize>> = vec![None; voxels.len()];
    let mut nodes: Vec<Point3> = Vec::new();
    for start in 0..voxels.len() {
        if node_of[start].is_some() || neighbours[start].len() < 3 {
            continue;
        }
        node_of[start] = Some(nodes.len());
        let mut members = vec![start];
        let mut next = 0;
        while next < members.len() {
            for &other in &neighbours[members[next]] {
                if node_of[other].is_none() && neighbours[other].len() >= 3 {
                    node_of[other] = Some(nodes.len());
                    members.push(other);
                }
            }
            next += 1;
        }
        let sum = members.iter().fold(Vector3::zeros(), |sum, member| sum + position(&voxels[*member]).coords);
        nodes.push(Point3::from(sum / members.len() as f64));
    }
    let mut used = vec![false; voxels.len()];
    let mut paths = Vec::new();
    let mut follow = |start: usize, closed: bool| {
        if used[start] {
            return;
        }
        used[start] = true;
        let mut chain = vec![start];
        let mut here = start;
        while let Some(&next) = neighbours[here].iter().find(|other| node_of[**other].is_none() && !used[**other]) {
            used[next] = true;
            chain.push(next);
            here = next;
        }
        let touching = |at: usize| neighbours[at].iter().filter_map(|other| node_of[*other]);
        let ends = if chain.len() == 1 {
            let first = touching(start).next();
            [first, touching(start).find(|node| Some(*node) != first)]
        } else {
            [touching(start).next(), touching(here).next()]
        };
        // One voxel between two of one node is part of its clump.
        if chain.len() == 1 && ends[1].is_none() && touching(start).count() > 1 {
            return;
        }
        let mut points: Vec<Point3> = chain.iter().map(|at| position(&voxels[*at])).collect();
        if let Some(node) = ends[0] {
            points.insert(0, nodes[node]);
        }
        if let Some(node) = ends[1] {
            points.push(nodes[node]);
        }
        paths.push(Path { points, ends, closed });
    };
    let free = |at: usize| neighbours[at].iter().filter(|other| node_of[**other].is_none()).count();
    for start in (0..voxels.len()).filter(|at| node_of[*at].is_none() && free(*at) <= 1) {
        follow(start, false);
    }
    for start in (0..voxels.len()).filter(|at| node_of[*at].is_none()) {
        follow(start, true);
    }
    paths
}

/// Takes away paths that end freely and are shorter than `spur`, unless they are all there is, and joins what they leave.
pub(super) fn prune(mut paths: Vec<Path>, spur: f64) -> Vec<Path> {
    loop {
        let before = paths.len();
        paths.retain(|path| {
            let is_spur = path.ends.iter().flatten().count() == 1 && path.length() < spur;
            !is_spur
        });
        paths = join(paths, -1.0, true);
        if paths.len() == before {
            return paths;
        }
    }
}

/// Joins arms that continue each other at their node, the straightest first; `only_pairs`: where a node has two arms.
pub(super) fn join_straight(paths: Vec<Path>) -> Vec<Path> {
    join(paths, STRAIGHT_ON, false)
}

fn join(mut paths: Vec<Path>, least_cosine: f64, only_pairs: bool) -> Vec<Path> {
    let nodes: BTreeSet<usize> = paths.iter().flat_map(|path| path.ends).flatten().collect();
    for node in nodes {
        loop {
            let arms: Vec<(usize, usize)> = (0..paths.len())
                .flat_map(|path| [(path, 0), (path, 1)])
                .filter(|(path, end)| paths[*path].ends[*end] == Some(node))
                .collect();
            if arms.len() < 2 || only_pairs && arms.len() != 2 {
                break;
            }
            let mut best: Option<(f64, [(usize, usize); 2])> = None;
            for (index, a) in arms.iter().enumerate() {
                for b in &arms[index + 1..] {
                    let straight = -paths[a.0].outward(a.1).dot(&paths[b.0].outward(b.1));
                    if straight >= best.map_or(least_cosine, |(found, _)| found) {
                        best = Some((straight, [*a, *b]));
                    }
                }
            }
            let Some((_, [(first, first_end), (second, second_end)])) = best else { break };
            if first == second {
                // Both ends of one path: it is a ring.
                paths[first].closed = true;
                paths[first].points.pop();
                paths[first].ends = [None, None];
                continue;
            }
            let mut tail = paths.remove(second.max(first));
            let mut head = paths.remove(second.min(first));
            let (mut head_end, mut tail_end) = (first_end, second_end);
            if first > second {
                std::mem::swap(&mut head_end, &mut tail_end);
            }
            if head_end == 0 {
                head.points.reverse();
                head.ends.reverse();
            }
            if tail_end == 1 {
                tail.points.reverse();
                tail.ends.reverse();
            }
            head.points.extend(tail.points.drain(1..));
            head.ends[1] = tail.ends[1];
            paths.push(head);
        }
    }
    paths
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Voxels of a straight line between two, one a step.
    fn line(from: [i32; 3], to: [i32; 3]) -> Vec<[usize; 3]> {
        let steps = (0..3).map(|axis| (to[axis] - from[axis]).abs()).max().unwrap_or(1);
        (0..=steps)
            .map(|step| [0, 1, 2].map(|axis| (from[axis] + (to[axis] - from[axis]) * step / steps) as usize))
            .collect()
    }

    fn union(lines: &[Vec<[usize; 3]>]) -> Vec<[usize; 3]> {
        let all: BTreeSet<[usize; 3]> = lines.iter().flatten().copied().collect();
        all.into_iter().collect()
    }

    #[test]
    fn two_lines_that_cross_are_two_and_their_spur_goes() {
        let voxels =
            union(&[line([5, 20, 0], [5, 20, 40]), line([0, 0, 20], [10, 40, 20]), line([5, 20, 33], [5, 17, 33])]);
        let all = paths(&voxels);
        assert!(all.len() >= 6, "{}", all.len());
        let kept = join_straight(prune(all, 6.0));
        assert_eq!(kept.len(), 2);
        let mut lengths: Vec<f64> = kept.iter().map(Path::length).collect();
        lengths.sort_by(f64::total_cmp);
        assert!((lengths[0] - 40.0).abs() < 2.0 && (lengths[1] - 41.2).abs() < 5.0, "{lengths:?}");
    }

    #[test]
    fn a_ring_is_closed_and_a_t_stays_a_t() {
        let ring = union(&[
            line([4, 4, 6], [4, 4, 14]),
            line([4, 16, 6], [4, 16, 14]),
            line([4, 6, 4], [4, 14, 4]),
            line([4, 6, 16], [4, 14, 16]),
            vec![[4, 5, 5], [4, 5, 15], [4, 15, 5], [4, 15, 15]],
        ]);
        let found = paths(&ring);
        assert_eq!((found.len(), found[0].closed), (1, true));
        let t = union(&[line([3, 20, 0], [3, 20, 40]), line([3, 20, 20], [23, 20, 20])]);
        let kept = join_straight(prune(paths(&t), 6.0));
        assert_eq!(kept.len(), 2);
    }
}
